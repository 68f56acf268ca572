"""Random mechanisms and states for the identities."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from hypothesis import strategies as st

from robodyn_cli.algorithms.composite import crba
from robodyn_cli.algorithms.rnea import rnea
from robodyn_cli.expr.graph import Expr
from robodyn_cli.model.model import Model
from tests.numeric import real
from tests.random_models import random_tree, shuffled

KINDS = (("revolute", "prismatic"), ("revolute",), ("prismatic",))


def trees(largest: int = 12) -> st.SearchStrategy[Model]:
    """Trees of 1 to ``largest`` bodies: chains and bushes, with or without rotors, joints in any order."""

    def build(n: int, seed: int, branching: float, kinds: tuple[str, ...], armature: bool) -> Model:
        model = random_tree(n, seed, branching=branching, kinds=kinds, armature=armature)
        return shuffled(model, seed) if seed % 2 else model

    return st.builds(
        build,
        st.sampled_from(range(1, largest + 1)),
        st.integers(0, 2**31),
        st.sampled_from((0.3, 0.0, 0.8)),
        st.sampled_from(KINDS),
        st.booleans(),
    )


@dataclasses.dataclass(frozen=True)
class State:
    """Positions, rates, accelerations and torques of a model, plain arrays (n,)."""

    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray
    tau: np.ndarray

    @staticmethod
    def random(model: Model, seed: int = 0) -> State:
        rng = np.random.default_rng([seed, model.nv])
        return State(
            rng.uniform(-np.pi, np.pi, model.nq), *(rng.normal(size=model.nv) * s for s in (1.5, 4.0, 20.0))
        )

    @property
    def inputs(self) -> dict[str, list[float]]:
        """The arrays by symbol group, for ``evaluate``."""
        return {k: [float(x) for x in getattr(self, k)] for k in ("q", "qd", "qdd", "tau")}

    @property
    def step(self) -> float:
        """Time step for differences along q + t qd: the fastest term of M turns some 0.06 rad in it."""
        return 0.03 / max(float(np.abs(self.qd).sum()), 1.0)


def symbols(model: Model) -> tuple[list[Expr], list[Expr], list[Expr], list[Expr]]:
    """Return symbols for q, qd, qdd and tau."""
    make = lambda group, n: model.graph.symbols([f"{group}{k}" for k in range(n)], group)  # noqa: E731
    return make("q", model.nq), make("qd", model.nv), make("qdd", model.nv), make("tau", model.nv)


def flat(array: Any) -> list[Any]:
    return list(np.asarray(array, dtype=object).ravel())


def torque_scale(model: Model, s: State) -> float:
    """Size of the terms that make up a torque, before they cancel."""
    inertia = np.abs(real(crba(model, s.q))) @ np.abs(s.qdd)
    bias = np.abs(real(rnea(model, s.q, s.qd, [0.0] * model.nv)))
    weight = np.abs(real(rnea(model, s.q, [0.0] * model.nv, [0.0] * model.nv, model.gravity)))
    return float((inertia + bias + weight).max())


def condition(M: Any) -> float:
    return float(np.linalg.cond(real(M)))
