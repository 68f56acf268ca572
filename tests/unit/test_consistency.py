"""Bodies that cannot exist are told from those at the limit."""

from __future__ import annotations

import re

import numpy as np
import pytest

from robodyn_cli.model.consistency import body_problems
from robodyn_cli.scene.types import Inertia, Link
from tests.random_models import random_inertia, random_rotation


def link(m: float, I: np.ndarray) -> Link:
    names = {"xx": (0, 0), "yy": (1, 1), "zz": (2, 2), "xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}
    return Link("body", mass=m, inertia=Inertia(**{k: float(I[place]) for k, place in names.items()}))


@pytest.mark.parametrize(
    ("m", "moments", "problem"),
    [
        (1.0, (1.0, 1.0, 1.0), ""),
        (1.0, (1.0, 2.0, 3.0), ""),  # a flat body: exactly at the limit
        (1.0, (0.0, 2.0, 2.0), ""),  # a thin rod
        (0.0, (0.0, 0.0, 0.0), ""),  # a massless link is legal
        (1.0, (0.0, 0.0, 0.0), ""),  # so is a point mass
        (1.0, (1.0, 1.0, 2.5), r"triangle inequality by 0\.5"),
        (1.0, (-0.1, 2.0, 2.0), r"not positive semi-definite: principal moment -0\.1"),
        (0.0, (0.4, 0.4, 0.4), "inertia but no mass"),
        # on the scale of the body, small or large
        (1.0, (1e-13, 1e-13, 2.5e-13), r"triangle inequality by 5e-14"),
        (1.0, (1e6, 2e6, 3e6), ""),
        (1.0, (0.0, 2e6, 2e6), ""),
    ],
)
def test_what_no_body_can_have_is_named_with_its_size(
    m: float, moments: tuple[float, ...], problem: str
) -> None:
    R = random_rotation(np.random.default_rng(1))
    found = body_problems(link(m, R @ np.diag(moments) @ R.T))
    assert len(found) == bool(problem)
    assert all(re.search(problem, text) for text in found)


def test_sums_of_point_masses_are_consistent() -> None:
    for seed in range(20):
        m, _, I = random_inertia(np.random.default_rng(seed))
        assert body_problems(link(float(m), I)) == []
