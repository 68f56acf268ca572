"""The search for a motor and a gear of each joint that bear its motion, with the masses of all others.

The cheapest or lightest drives of all joints together.

What is cheapest at a joint far out may be so heavy that the joints further in cost more. So the combinations of all
joints are gone through by branch and bound: each joint after those whose drives it feels, its drives that bear the
motion from the smallest price on, until no sum can be below the best that is known.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from robodyn_cli.drives.cycle import Duty
from robodyn_cli.drives.figures import Evaluated
from robodyn_cli.errors import CapabilityError, SceneError
from robodyn_cli.joints.registry import joint_types
from robodyn_cli.motors.drive import Catalogue, Drive, Train
from robodyn_cli.record import record
from robodyn_cli.scene.types import Scene
from robodyn_cli.solve.extremes import largest_magnitude
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.inverse import MotorAndGear
from robodyn_cli.torques.checks import breaks_of_joint
from robodyn_cli.works.size.candidates import SPEED, Candidates, Responses

MOST_SWEEPS = 40
ALIKE = 1e-9  # relative change of a load that is rounding
CALM = 8  # sweeps after which a mass that was chosen once is never taken as less


def candidates_of(scene: Scene, drives: Mapping[str, Drive], catalogue: Catalogue) -> dict[str, Candidates]:
    """Return what there is to choose from, by joint.

    Raises
    ------
    SceneError : the catalogue has nothing that moves a joint.
    """
    types = {joint.name: joint_types[joint.type] for joint in scene.robot.joints}
    alike: dict[Any, Candidates] = {}  # most joints have the same to choose from
    by_joint = {}
    for name, drive in drives.items():
        key = dataclasses.replace(drive, motor="", gear=None), types[name].v_units[0]
        if key not in alike:
            alike[key] = Candidates.of(drive, catalogue, key[1])
        one = by_joint[name] = alike[key]
        if not one.usable.any():
            message = f"{scene.path}: catalogue: no motor and gear for joint {name!r}"
            raise SceneError(
                f"{message}; allowed: a catalogue with some that run and move it", key="catalogue"
            )
    return by_joint


@record
class DriveSearch:
    """The search over all joints. candidates : by joint. uses : of each combination, by joint and limit, (M, G), under
    the loads (T,) of each joint."""

    responses: Responses
    candidates: dict[str, Candidates]
    by: str
    chosen: dict[str, int]
    uses: dict[str, dict[str, Array]]
    loads: dict[str, Array]

    @staticmethod
    def of(responses: Responses, drives: Mapping[str, Drive], catalogue: Catalogue, by: str) -> DriveSearch:
        """Return the search, in which nothing is chosen yet.

        Raises
        ------
        SceneError : the catalogue has nothing that moves a joint.
        """
        return DriveSearch(responses, candidates_of(responses.scene, drives, catalogue), by, {}, {}, {})

    def run(self, tell: Callable[[str], None]) -> int:
        """Choose for all joints, telling how far it is, and return in how many sweeps.

        Raises
        ------
        CapabilityError : the choice does not settle.
        """
        assumed = dict.fromkeys(self.candidates, 0.0)
        for sweep in range(1, MOST_SWEEPS + 1):
            before = dict(self.chosen), dict(assumed)
            for done, name in enumerate(reversed(list(self.candidates))):
                tell(f"joint {done + 1} of {len(self.candidates)}, sweep {sweep} over the joints")
                self.chosen[name] = self._best(name, assumed)
                mass = self.figure(name, "masses")
                assumed[name] = max(assumed[name], mass) if sweep > CALM else mass
            if before == (self.chosen, assumed):
                return sweep
        raise CapabilityError(f"the choice of drives does not settle in {MOST_SWEEPS} sweeps")

    def figure(self, name: str, key: str) -> float:
        """Return a figure of the chosen combination of a joint, 0 where none is chosen yet."""
        values: Array = getattr(self.candidates[name], key)
        return float(values.flat[self.chosen[name]]) if name in self.chosen else 0.0

    def _duty(self, name: str, masses: Mapping[str, float]) -> Duty:
        """Return what a joint's drive has to bear, with drives of these masses elsewhere."""
        responses = self.responses
        k = responses.columns[responses.joints.index(name)]
        m = np.array([masses[n] for n in responses.joints])
        I = np.array([self.figure(n, "inertias") for n in responses.joints])
        tau = responses.tau.at(m, I)[:, k]
        load = tau - self.figure(name, "inertias") * responses.qdd[:, k]
        hold = None if responses.hold is None else responses.hold.at(m, I)[:, k]
        qd, qdd = responses.qd[:, k], responses.qdd[:, k]
        breaks = breaks_of_joint(responses.times, qd, qdd, responses.breaks)
        return Duty(responses.times, qd, qdd, load, hold, breaks=breaks)

    def _best(self, name: str, masses: Mapping[str, float]) -> int:
        """Return the combination to choose for a joint, and keep how much of the limits all use."""
        one, duty = self.candidates[name], self._duty(name, masses)
        if name in self.uses:
            change = np.abs(duty.load - self.loads[name]).max()
            if change <= ALIKE * np.abs(duty.load).max():
                return self.chosen[name]
        self.uses[name], self.loads[name] = one.uses(duty), duty.load
        margins = self.margins(name)
        passing = margins >= one.drive.margin
        if not passing.any():
            return int(np.argmax(margins))
        first, second = self.prices(name)
        ranks = np.lexsort((-margins.ravel(), second, first, ~passing.ravel()))
        return int(ranks[0])

    def take(self, choice: Mapping[str, int]) -> None:
        """Choose combinations of all joints, and keep how much of the limits all use with these."""
        self.chosen.update(choice)
        masses = {name: self.figure(name, "masses") for name in self.candidates}
        for name, one in self.candidates.items():
            duty = self._duty(name, masses)
            self.uses[name], self.loads[name] = one.uses(duty), duty.load

    @property
    def all_pass(self) -> bool:
        """Whether what is chosen bears the motion of all joints."""
        return all(
            self.margins(name).flat[self.chosen[name]] >= one.drive.margin
            for name, one in self.candidates.items()
        )

    def prices(self, name: str) -> tuple[Array, Array]:
        """Return of each combination what is to be small, and what decides between equals."""
        one = self.candidates[name]
        costs, masses = one.costs.ravel(), one.masses.ravel()
        return (costs, masses) if self.by == "cost" else (masses, costs)

    def margins(self, name: str) -> Array:
        """Return the margin of each combination (M, G), -inf where it cannot run."""
        return self.candidates[name].margins(self.uses[name])

    def margins_under(self, name: str, masses: Mapping[str, float]) -> Array:
        """Return the same with drives of other masses elsewhere."""
        one = self.candidates[name]
        return one.margins(one.uses(self._duty(name, masses)))

    def train(self, name: str) -> Train:
        """Return what is chosen for a joint."""
        return self.candidates[name].train(self.chosen[name])

    def _figures(self, name: str, k: int) -> MotorAndGear:
        """Return the figures of the k-th combination of a joint."""
        one, train = self.candidates[name], self.candidates[name].train(k)
        cost, mass, margin = (float(x.flat[k]) for x in (one.costs, one.masses, self.margins(name)))
        duty = self._duty(name, {other: self.figure(other, "masses") for other in self.candidates})
        evaluated = Evaluated.of(train, duty)
        # of equal uses that of ``inverse``, and none of a limit that this drive does not have
        own = {limit: float(x.flat[k]) for limit, x in self.uses[name].items()}
        decides = max(
            (limit for limit in (*evaluated.uses, SPEED) if not np.isnan(own.get(limit, np.nan))),
            key=own.__getitem__,
        )
        if decides == SPEED:
            fast = largest_magnitude(duty.times, duty.speed[:, None], duty.breaks)
            off = (1.0 - margin) * float(fast.error[0] / fast.value[0])
        else:
            off = evaluated.use_error(decides)
        return MotorAndGear(train.drive.motor, train.drive.gear, cost, mass, margin, off, decides)

    def best(self, name: str) -> MotorAndGear:
        """Return the combination of a joint with the largest margin."""
        return self._figures(name, int(np.argmax(self.margins(name))))

    def front(self, name: str) -> list[MotorAndGear]:
        """Return the combinations of a joint that none beats in both cost (or mass) and margin, the cheapest first."""
        one, margins = self.candidates[name], self.margins(name)
        price = one.costs if self.by == "cost" else one.masses
        front: list[int] = []
        best = -np.inf
        for k in np.lexsort((-margins.ravel(), price.ravel())).tolist():
            if margins.flat[k] > best and margins.flat[k] >= one.drive.margin:
                best = float(margins.flat[k])
                front.append(k)
        return [self._figures(name, k) for k in front]


NOTHING = 1e-13  # part of a torque: less is no influence of a drive on it
Price = tuple[float, float]  # what is to be small, and what decides between equals


def order_of(responses: Responses) -> list[str] | None:
    """Return the joints, each after those whose drives' masses and inertias change its load; None where some change
    each other's, as in loops, or a drive its own."""
    felt = {name: influences(responses, name) for name in responses.joints}
    order: list[str] = []
    while len(order) < len(felt):
        free = [name for name in felt if name not in order and felt[name] <= set(order)]
        if not free:
            return None
        order += free
    return order


def influences(responses: Responses, name: str) -> set[str]:
    """Return the joints whose drives change what a joint's drive has to bear."""
    k = responses.columns[responses.joints.index(name)]
    loads = [responses.tau] + ([] if responses.hold is None else [responses.hold])
    joints = set()
    for load in loads:
        scale = float(np.abs(load.none[:, k]).max())
        for j, other in enumerate(responses.joints):
            changes = [load.by_mass[j][:, k], load.by_inertia[j][:, k]]
            # the inertia of its own drive is no part of what a drive has to bear
            if any(
                float(np.abs(x).max()) > NOTHING * scale for x in (changes if other != name else changes[:1])
            ):
                joints.add(other)
    return joints


def _untold(text: str) -> None:
    """Say nothing."""


class Together:
    """The search; ``best`` and ``choice`` are the smallest price so far and its combination of each joint.

    limit : of combinations times samples that are evaluated. done : whether all that could be better was seen.
    """

    def __init__(self, search: DriveSearch, order: list[str], limit: float) -> None:
        self.search, self.order, self.left, self.done = search, order, limit, True
        self.felt = {name: influences(search.responses, name) for name in order}
        self.prices = {name: search.prices(name) for name in order}
        least = [_least(search, self.prices[name], name) for name in order]
        self.rest = [_sum(least[k:]) for k in range(len(order) + 1)]
        self.choice = dict(search.chosen) if search.all_pass else None
        chosen = [_price(self.prices[name], search.chosen[name]) for name in order]
        self.best = _sum(chosen) if search.all_pass else (np.inf, np.inf)
        self._limit = limit
        self._tell: Callable[[str], None] = _untold
        self._known: dict[tuple[str, tuple[float, ...]], list[int]] = {}

    def run(self, tell: Callable[[str], None]) -> None:
        """Look for better ones than the search has found, where there is room for each joint once at least;
        tell how far it is."""
        samples = len(self.search.responses.times)
        if sum(self.search.candidates[name].masses.size * samples for name in self.order) > self.left:
            self.done = False
            return
        self._tell = tell
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
            part = 100.0 * (1.0 - max(self.left, 0.0) / self._limit)
            self._tell(f"combinations of all joints, {part:.0f} % of the most that are tried")
            if self.left < 0.0:
                self.done = False
                return []
            margins = self.search.margins_under(name, others)
            first, second = self.prices[name]
            by_mass: dict[float, int] = {}
            for k in np.lexsort((-margins.ravel(), second, first)).tolist():
                if margins.flat[k] >= one.drive.margin:
                    by_mass.setdefault(float(one.masses.flat[k]), k)
            self._known[key] = list(by_mass.values())
        return self._known[key]


def _least(search: DriveSearch, prices: tuple[Array, Array], name: str) -> Price:
    """Return what a joint's drive costs at least."""
    usable = search.candidates[name].usable.ravel()
    return float(prices[0][usable].min()), float(prices[1][usable].min())


def _price(prices: tuple[Array, Array], k: int) -> Price:
    return float(prices[0][k]), float(prices[1][k])


def _sum(prices: list[Price]) -> Price:
    return sum(x for x, _ in prices), sum(x for _, x in prices)
