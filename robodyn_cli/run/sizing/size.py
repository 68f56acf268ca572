"""The motors and gears of a catalogue that bear a motion: the cheapest or lightest at each joint."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from robodyn_cli.errors import CapabilityError, SceneError
from robodyn_cli.joints.registry import joint_types
from robodyn_cli.motors.drive import Catalogue, Drive, Train
from robodyn_cli.record import record
from robodyn_cli.results.result import Result
from robodyn_cli.results.summary import as_keys
from robodyn_cli.run.inverse.inverse import inverse
from robodyn_cli.run.progress import Progress, no_progress
from robodyn_cli.run.sizing.candidates import Candidates
from robodyn_cli.run.sizing.cycle import Duty
from robodyn_cli.run.sizing.responses import Responses
from robodyn_cli.run.stopwatch import Stopwatch
from robodyn_cli.scene.load import Family
from robodyn_cli.scene.text.catalogue import EXAMPLE
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import Array

BY = ("cost", "mass")
MOST_SWEEPS = 40
ALIKE = 1e-9  # relative change of a load that is rounding
CALM = 8  # sweeps after which a mass that was chosen once is never taken as less
_DEFAULTS = {"gear_ratio": 1.0, "rotor_inertia": 0.0}


@record
class Front:
    """A combination that no other beats in both: cost or mass of all equal drives, and margin of what decides."""

    motor: str
    gear: str | None
    cost: float
    mass: float
    margin: float
    decides: str


@record
class Sized:
    """What was found for a joint: how many of how many combinations bear its motion, the one with the largest margin
    (also where none bears it), and the front of cost or mass over margin, the cheapest first. motors, gears : that the
    columns of `/candidates` count from 0 on."""

    combinations: int
    passing: int
    best: Front
    front: list[Front]
    motors: list[str]
    gears: list[str | None]


@record
class Sizing:
    """What was sought and found. sweeps : over all joints until the choice stayed as it was. margin_difference : the
    largest between margins of the search and those of the run with the chosen drives."""

    by: str
    cost: float
    mass: float
    sweeps: int
    margin_difference: float
    joints: dict[str, Sized]


def size(
    scene: Scene,
    by: str = "cost",
    margin: float | None = None,
    types: Sequence[str] = (),
    progress: Progress = no_progress,
    watch: Stopwatch | None = None,
) -> Result:
    """Find, for each driven joint, the cheapest or lightest motor and gear of the catalogue that bear the motion.

    Driven are the joints of ``drives``, or all that have an actuator where there is no such key. The masses of the
    drives act on the links that carry them: joints are gone through from the last to the first, each with what the
    others have, until nothing changes. Where nothing bears a joint's motion it gets what comes nearest.

    Parameters
    ----------
    by : what is to be small, ``cost`` or ``mass``; the other decides between equals.
    margin : part of each limit that is to be left; default: that of each drive.
    types : kinds of motor to choose from; default: all.

    Returns
    -------
    The result of ``inverse`` with the drives that were found, and the tables of all combinations.

    Raises
    ------
    RobodynError : see ``inverse``. SceneError : a joint says itself what drives it.
    """
    watch = watch or Stopwatch()
    family, settings = Family.of(scene), []
    if scene.catalogue is None:
        settings = [f"catalogue={json.dumps(str(EXAMPLE))}"]
        scene = family.scene(settings)
    drives = _asked(scene, margin)
    with watch.stage("responses"):
        responses = Responses.of(scene, drives)
    with watch.stage("size"):
        search = Search.of(responses, drives, _of_types(scene.catalogue, types), by)
        sweeps = search.run()
    with watch.stage("load"):
        chosen = family.scene([*settings, *_chosen(scene, search)])
    result = inverse(chosen, progress=progress, watch=watch)
    result.command = "size"
    _add_tables(result, search)
    sizing = _sizing(search, sweeps, result.summary["drives"])
    result.summary = {**result.summary, **result.head, "size": as_keys(sizing), "wall_time_s": watch.report()}
    return result


def _of_types(catalogue: Catalogue, types: Sequence[str]) -> Catalogue:
    """Return the catalogue with motors of some kinds alone, of all where none is named."""
    kept = {name: motor for name, motor in catalogue.motors.items() if not types or motor.type in types}
    return dataclasses.replace(catalogue, motors=kept)


def _asked(scene: Scene, margin: float | None) -> dict[str, Drive]:
    """Return the drives to be found by joint, with what the scene says of them.

    Raises
    ------
    SceneError : there are none, or a joint says itself what drives it.
    """
    single = [joint for joint in scene.robot.joints if joint_types[joint.type].nv == 1]
    actuated = [j.name for j in single if scene.actuated is None or j.name in scene.actuated]
    if scene.actuated is None and (scene.loops or scene.couplers):
        actuated = [name for name in actuated if name in scene.torques]
    drives = dict(scene.drives) or {name: Drive(motor="") for name in actuated}
    if not drives:
        what = "no joint is driven; allowed: joints in 'drives', or in 'actuated'"
        raise SceneError(f"{scene.path}: {what}", key="drives")
    for joint in single:
        if joint.name not in drives or joint.name in scene.drives:
            continue
        own = (
            "gear"
            if "gear" in dict(joint.forces)
            else "gear_ratio"
            if joint.gear_ratio != 1.0
            else "rotor_inertia"
        )
        if own == "gear" or getattr(joint, own) != _DEFAULTS[own]:
            raise SceneError(
                f"{scene.path}: joint {joint.name!r} says by {own!r} what drives it; allowed: joints without that key, "
                "or 'drives' of other joints",
                key=f"robot.joints.{joint.name}.{own}",
            )
    if margin is not None:
        drives = {name: dataclasses.replace(drive, margin=margin) for name, drive in drives.items()}
    return drives


@record
class Search:
    """The search over all joints. candidates : by joint. uses : of each combination, by joint and limit, (M, G), under
    the loads (T,) of each joint."""

    responses: Responses
    candidates: dict[str, Candidates]
    by: str
    chosen: dict[str, int]
    uses: dict[str, dict[str, Array]]
    loads: dict[str, Array]

    @staticmethod
    def of(responses: Responses, drives: Mapping[str, Drive], catalogue: Catalogue, by: str) -> Search:
        """Return the search, in which nothing is chosen yet.

        Raises
        ------
        SceneError : the catalogue has nothing that moves a joint.
        """
        types = {joint.name: joint_types[joint.type] for joint in responses.scene.robot.joints}
        alike: dict[Any, Candidates] = {}  # most joints have the same to choose from
        found = {}
        for name, drive in drives.items():
            key = dataclasses.replace(drive, motor="", gear=None), types[name].v_units[0]
            if key not in alike:
                alike[key] = Candidates.of(drive, catalogue, key[1])
            one = found[name] = alike[key]
            if not one.usable.any():
                what = f"{responses.scene.path}: catalogue: no motor and gear for joint {name!r}"
                raise SceneError(
                    f"{what}; allowed: a catalogue with some that run and move it", key="catalogue"
                )
        return Search(responses, found, by, {}, {}, {})

    def run(self) -> int:
        """Choose for all joints, and return in how many sweeps.

        Raises
        ------
        CapabilityError : the choice does not settle.
        """
        assumed = dict.fromkeys(self.candidates, 0.0)
        for sweep in range(1, MOST_SWEEPS + 1):
            before = dict(self.chosen), dict(assumed)
            for name in reversed(list(self.candidates)):
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
        return Duty(responses.times, qd, qdd, load, hold, breaks=responses.breaks)

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
        first, second = (one.costs, one.masses) if self.by == "cost" else (one.masses, one.costs)
        ranks = np.lexsort((-margins.ravel(), second.ravel(), first.ravel(), ~passing.ravel()))
        return int(ranks[0])

    def margins(self, name: str) -> Array:
        """Return the margin of each combination (M, G), -inf where it cannot run."""
        return np.where(self.candidates[name].usable, 1.0 - self._use(name).max(axis=0), -np.inf)

    def _use(self, name: str) -> Array:
        """Return how much of each limit each combination uses (limits, M, G), 0 where it has no such limit."""
        return np.nan_to_num(np.stack(list(self.uses[name].values())), nan=0.0, posinf=np.inf)

    def train(self, name: str) -> Train:
        """Return what is chosen for a joint."""
        return self.candidates[name].train(self.chosen[name])

    def _figures(self, name: str, k: int) -> Front:
        """Return the figures of the k-th combination of a joint."""
        one, use = self.candidates[name], self._use(name)
        drive = one.train(k).drive
        decides = list(self.uses[name])[int(use.reshape(len(use), -1)[:, k].argmax())]
        cost, mass, margin = (float(x.flat[k]) for x in (one.costs, one.masses, self.margins(name)))
        return Front(drive.motor, drive.gear, cost, mass, margin, decides)

    def best(self, name: str) -> Front:
        """Return the combination of a joint with the largest margin."""
        return self._figures(name, int(np.argmax(self.margins(name))))

    def front(self, name: str) -> list[Front]:
        """Return the combinations of a joint that none beats in both cost (or mass) and margin, the cheapest first."""
        one, margins = self.candidates[name], self.margins(name)
        price = one.costs if self.by == "cost" else one.masses
        found: list[int] = []
        best = -np.inf
        for k in np.lexsort((-margins.ravel(), price.ravel())).tolist():
            if margins.flat[k] > best and margins.flat[k] >= one.drive.margin:
                best = float(margins.flat[k])
                found.append(k)
        return [self._figures(name, k) for k in found]


def _chosen(scene: Scene, search: Search) -> list[str]:
    """Return the settings of the scene that say what was found."""
    found = []
    for name in search.candidates:
        drive = search.train(name).drive
        keys = {"motor": drive.motor, "gear": drive.gear, "margin": repr(drive.margin)}
        if name in scene.drives:
            found += [f"drives.{name}.{key}={'null' if x is None else x}" for key, x in keys.items()]
        else:
            written = ", ".join(f"{key}: {x}" for key, x in keys.items() if x is not None)
            found.append(f"drives.{name}={{{written}}}")
    return found


def _sizing(search: Search, sweeps: int, figures: Mapping[str, Mapping[str, Any]]) -> Sizing:
    """Return what was found; ``figures`` : of the run with it, by joint."""
    joints, differences = {}, []
    for name, one in search.candidates.items():
        margins = search.margins(name)
        differences.append(abs(float(margins.flat[search.chosen[name]]) - figures[name]["margin"]))
        passing = int(np.count_nonzero(margins >= one.drive.margin))
        joints[name] = Sized(
            margins.size, passing, search.best(name), search.front(name), list(one.motors), list(one.gears)
        )
    return Sizing(
        by=search.by,
        cost=sum(search.figure(name, "costs") for name in joints),
        mass=sum(search.figure(name, "masses") for name in joints),
        sweeps=sweeps,
        margin_difference=max(differences),
        joints=joints,
    )


def _add_tables(result: Result, search: Search) -> None:
    """Add the table of combinations of each joint: a row each, in the order of the catalogue."""
    for name, one in search.candidates.items():
        motor, gear = np.indices(one.costs.shape)
        margins = search.margins(name)
        columns = (motor, gear, one.costs, one.masses, np.where(one.usable, margins, np.nan))
        units = ("1", "1", "1", "kg", "1")
        result.add(f"candidates/{name}", np.column_stack([x.ravel() for x in columns]), column_units=units)
