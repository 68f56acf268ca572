"""The mechanisms on which engines are compared."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from robodyn_cli.model.model import BASE, FixedFrame, Model
from robodyn_cli.spatial.algebra import matrix, vector
from tests.identities.trees import State
from tests.random_models import random_rotation, random_tree, shuffled

CASES = [(n, seed) for n in (1, 2, 3, 5, 8, 12, 15) for seed in range(4)]

cases = pytest.mark.parametrize(("n", "seed"), CASES)


def tree(n: int, seed: int) -> tuple[Model, State]:
    """A tree with rotors, joints listed in any order, and a named frame on each body and on the base."""
    rng = np.random.default_rng([n, seed])
    kinds = [("revolute", "prismatic"), ("revolute",), ("revolute", "prismatic"), ("prismatic", "revolute")][
        seed
    ]
    model = shuffled(random_tree(n, 100 + seed, branching=(0.3, 0.0, 0.7, 0.2)[seed], kinds=kinds), seed)

    def frame(body: int) -> FixedFrame:
        return FixedFrame(body, vector(rng.normal(size=3).tolist()), matrix(random_rotation(rng).tolist()))

    frames = {f"frame{k}": frame(k) for k in range(BASE, n)}
    return dataclasses.replace(model, frames=frames), State.random(model, seed)
