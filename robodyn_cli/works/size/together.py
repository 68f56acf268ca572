"""The cheapest or lightest drives of all joints together.

What is cheapest at a joint far out may be so heavy that the joints further in cost more. So the combinations of all
joints are gone through by branch and bound: each joint after those whose drives it feels, its drives that bear the
motion from the smallest price on, until no sum can be below the best that is known.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from robodyn_cli.spatial.algebra import Array
from robodyn_cli.works.size.responses import Responses
from robodyn_cli.works.size.search import Search

NOTHING = 1e-13  # part of a torque: less is no influence of a drive on it
Price = tuple[float, float]  # what is to be small, and what decides between equals


def order_of(responses: Responses) -> list[str] | None:
    """Return the joints, each after those whose drives' masses and inertias change its load; None where some change
    each other's, as in loops, or a drive its own."""
    felt = {name: influences(responses, name) for name in responses.joints}
    found: list[str] = []
    while len(found) < len(felt):
        free = [name for name in felt if name not in found and felt[name] <= set(found)]
        if not free:
            return None
        found += free
    return found


def influences(responses: Responses, name: str) -> set[str]:
    """Return the joints whose drives change what a joint's drive has to bear."""
    k = responses.columns[responses.joints.index(name)]
    loads = [responses.tau] + ([] if responses.hold is None else [responses.hold])
    found = set()
    for load in loads:
        scale = float(np.abs(load.none[:, k]).max())
        for j, other in enumerate(responses.joints):
            changes = [load.by_mass[j][:, k], load.by_inertia[j][:, k]]
            # the inertia of its own drive is no part of what a drive has to bear
            if any(
                float(np.abs(x).max()) > NOTHING * scale for x in (changes if other != name else changes[:1])
            ):
                found.add(other)
    return found


class Together:
    """The search; ``best`` and ``choice`` are the smallest price so far and its combination of each joint.

    limit : of combinations times samples that are evaluated. done : whether all that could be better was seen.
    """

    def __init__(self, search: Search, order: list[str], limit: float) -> None:
        self.search, self.order, self.left, self.done = search, order, limit, True
        self.felt = {name: influences(search.responses, name) for name in order}
        self.prices = {name: search.prices(name) for name in order}
        least = [_least(search, self.prices[name], name) for name in order]
        self.rest = [_sum(least[k:]) for k in range(len(order) + 1)]
        self.choice = dict(search.chosen) if search.all_pass else None
        chosen = [_price(self.prices[name], search.chosen[name]) for name in order]
        self.best = _sum(chosen) if search.all_pass else (np.inf, np.inf)
        self._known: dict[tuple[str, tuple[float, ...]], list[int]] = {}

    def run(self) -> None:
        """Look for better ones than the search has found, where there is room for each joint once at least."""
        samples = len(self.search.responses.times)
        if sum(self.search.candidates[name].masses.size * samples for name in self.order) > self.left:
            self.done = False
            return
        self._extend({}, {}, (0.0, 0.0))

    def _extend(self, choice: dict[str, int], masses: dict[str, float], price: Price) -> None:
        depth = len(choice)
        if depth == len(self.order):
            self.best, self.choice = price, dict(choice)
            return
        name = self.order[depth]
        for k in self._bearing(name, masses):
            with_it = _sum([price, _price(self.prices[name], k)])
            if _sum([with_it, self.rest[depth + 1]]) >= self.best:
                if with_it[0] + self.rest[depth + 1][0] > self.best[0]:
                    return  # all others are dearer
                continue
            mass = float(self.search.candidates[name].masses.flat[k])
            self._extend({**choice, name: k}, {**masses, name: mass}, with_it)

    def _bearing(self, name: str, masses: Mapping[str, float]) -> list[int]:
        """Return the combinations of a joint that bear its motion with such drives further out: those with the
        smallest price of each mass, the smallest first."""
        others = {other: masses.get(other, 0.0) for other in self.order}
        key = name, tuple(others[other] for other in self.order if other in self.felt[name])
        if key not in self._known:
            one, responses = self.search.candidates[name], self.search.responses
            self.left -= one.masses.size * len(responses.times)
            if self.left < 0.0:
                self.done = False
                return []
            margins = self.search.margins_under(name, others)
            first, second = self.prices[name]
            found: dict[float, int] = {}
            for k in np.lexsort((-margins.ravel(), second, first)).tolist():
                if margins.flat[k] >= one.drive.margin:
                    found.setdefault(float(one.masses.flat[k]), k)
            self._known[key] = list(found.values())
        return self._known[key]


def _least(search: Search, prices: tuple[Array, Array], name: str) -> Price:
    """Return what a joint's drive costs at least."""
    usable = search.candidates[name].usable.ravel()
    return float(prices[0][usable].min()), float(prices[1][usable].min())


def _price(prices: tuple[Array, Array], k: int) -> Price:
    return float(prices[0][k]), float(prices[1][k])


def _sum(prices: list[Price]) -> Price:
    return sum(x for x, _ in prices), sum(x for _, x in prices)
