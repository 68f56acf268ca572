"""Margins from the limits, so that they are kept between the points of a grid too."""

from __future__ import annotations

import dataclasses
from typing import Protocol

import numpy as np

from robodyn_cli.fastest.profile import Passes, Profile
from robodyn_cli.fastest.rows import FINE, Passed, Rows
from robodyn_cli.spatial.algebra import Array

ROUNDS = 5  # of what the rows ask for,
YIELDING = 2  # in which margins may become smaller again,
TANGENTS = 2  # in which forces are made linear anew
GOOD = 0.4  # until this, divided by the square of the segments, is passed
CHECKS = 8  # rounds of what the limits themselves ask for


class Limits(Protocol):
    """The rows of a path on a grid (K + 1,); for forces that are not linear in x their tangents at x (K, 3).

    ``linear`` : whether the rows do not depend on x, once they have been asked for.
    ``passed`` : for u and x at the ``FINE`` places of each segment.
    """

    linear: bool

    def __call__(self, s: Array, x: Array | None) -> Rows: ...

    def passed(self, s: Array, u: Array, x: Array) -> Passed: ...


class Margins:
    """What is kept free of each limit in each segment, so that none is passed between the grid points."""

    def __init__(self, s: Array, rows: Rows, profile: Profile, limits: Limits) -> None:
        self.s, self.rows, self.profile, self.limits = s, rows, profile, limits
        shape = (len(s) - 1, rows.A.shape[2])
        self.above, self.below, self.most = np.zeros(shape), np.zeros(shape), rows.most

    def take(self, passed: Passed) -> None:
        """Keep as much more free as is passed, and find the profile again."""
        self.above = np.maximum(self.above + passed.over, 0.0)
        self.below = np.maximum(self.below + passed.under, 0.0)
        slower = self.most / (1.0 + np.maximum(passed.fast, -0.5)[:, None])
        self.most = np.minimum(slower, self.rows.most)
        rows, x = dataclasses.replace(self.rows, most=self.most), self.profile.between(self.s)[1]
        self.profile = Passes(self.s, rows, (self.above, self.below), x).run()

    def by_rows(self) -> None:
        """Find margins as the rows ask for them."""
        for k in range(ROUNDS):
            u, x = self.profile.between(self.s)
            if k < TANGENTS and not self.limits.linear:
                self.rows = self.limits(self.s, x)
            passed = self.rows.passed(u, x)
            if passed.largest <= GOOD / len(u) ** 2:
                return
            self.take(passed if k < YIELDING else passed.positive())

    def by_limits(self, enough: float) -> float:
        """Find margins as the limits themselves ask for them, until ``enough`` is passed; return what is."""
        for _ in range(CHECKS):
            passed = self.limits.passed(self.s, *self.profile.between(self.s, FINE))
            if passed.largest <= enough:
                break
            self.take(passed.positive())
        return passed.largest
