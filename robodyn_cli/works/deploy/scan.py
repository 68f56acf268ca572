"""The scan of a deployment: everything that can stop it, and when.

The motion is followed on the uniform 1 ms grid, free of the criterion, so that the report can say when each criterion
fired. A dead point ends the scan once the multipliers have been judged up to it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TypeVar

import numpy as np

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError, NumericalError, RobodynError, SingularConfigurationError
from robodyn_cli.expr.fixed import literal
from robodyn_cli.formulations.events import GO_ON, STOP, Event, EventFunction, EventKind, Outcome
from robodyn_cli.given.guided_motion import guided_motion
from robodyn_cli.given.loop_conditions import lead_of
from robodyn_cli.integrators.runtime.options import Grid, Options
from robodyn_cli.kernels.samples import SampleKernel
from robodyn_cli.model.model import STATE_GROUPS
from robodyn_cli.motion.build import contact_watchers, limit_watchers
from robodyn_cli.motion.contact.joint_states import JointStates
from robodyn_cli.motion.driver import Driver, MethodChange
from robodyn_cli.motion.failure import with_cause
from robodyn_cli.motion.method import supervisor_for
from robodyn_cli.motion.motion import Motion, Watcher
from robodyn_cli.motion.singular.rank_loss import Passage, PosesAhead
from robodyn_cli.observe.singular_values import LeastNorm
from robodyn_cli.ready.singularity import classify, driven_dead_point, passive_determinant
from robodyn_cli.record import record
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.tools.progress import Progress, no_progress
from robodyn_cli.works.deploy.growth import GRID, GrowthMonitor, levels_with, multiplier_norm

Pose = tuple[float, Array]  # a time [s] and the state x (nx,) there
W = TypeVar("W", bound=Watcher)
BLOCK = 4096  # samples whose multipliers are judged at a time


# -- what watches a deployment ------------------------------------------------------------------------------
class Bifurcation(PosesAhead):
    """Ends the scan where the motion runs into a loss of rank.

    found : the pose. clean_until : time [s] up to which the motion can be integrated as usual.
    """

    def begin(self, t: float, x: Array, options: Options) -> Array:
        self.found: Pose | None = None
        self.clean_until = 0.0
        return super().begin(t, x, options)

    def handle(self, event: Event) -> Outcome:
        pose = self.ahead(event)
        if pose is None:
            return GO_ON
        self.clean_until = pose.regular_until
        self.found = (pose.time, self.motion.system.join(pose.state.q, pose.state.v, pose.state.z))
        return STOP


class GrowthWatcher(Watcher):
    """Judges the multipliers of the loops on the 1 ms grid, by their growth and by their limit."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self.rows = problem.constraints.of_loops

    def follow(self, motion: Motion) -> None:
        self.system, self.deploy = motion.system, motion.scene.deploy
        lam = {"lam": list(self.problem.forward.lam)} if not self.problem.dependent else {}
        self.kernel = SampleKernel(lam, STATE_GROUPS) if lam else LeastNorm(self.problem)
        self.begin(0.0, motion.start, motion.options)

    @property
    def kernels(self) -> dict[str, SampleKernel]:
        kernel = self.kernel.function if isinstance(self.kernel, LeastNorm) else self.kernel
        return {"multipliers on the 1 ms grid": kernel}

    def begin(self, t: float, x: Array, options: Options) -> Array:
        self.monitor = GrowthMonitor(levels_with(self.deploy.growth), self.deploy.limit)
        return x

    def judge(self, t: Array, x: Array, parameters: Array) -> None:
        """Take samples x (T, nx) at times t (T,) of the grid, in one contact state (which ``parameters`` say)."""
        lam = self.kernel.evaluate(len(t), self.system.groups(t, x, parameters))["lam"]
        self.monitor.take(t, multiplier_norm(lam[:, self.rows]))

    @property
    def fired(self) -> float | None:
        """When the criterion on the multipliers fired [s]."""
        return fired(self.monitor, self.deploy.growth)


def fired(monitor: GrowthMonitor | None, growth: float) -> float | None:
    """Return when the multipliers first passed their growth or their limit [s]."""
    if monitor is None:
        return None
    times = [t for t in (monitor.times.get(growth), monitor.limit_time) if t is not None]
    return min(times) if times else None


class DeadPoint(Watcher):
    """Notes the poses in which the passive block of Psi loses rank; the first one ends the scan.

    Where only the multipliers count they may still fire beyond, and the scan goes on until they have.
    """

    def __init__(self, problem: Problem, passive: Sequence[int], growth: GrowthWatcher) -> None:
        self.problem, self.passive, self.growth = problem, passive, growth
        self.found: list[Pose] = []
        try:
            determinant = passive_determinant(problem, passive)
        except CapabilityError:
            if problem.scene.deploy.criterion not in ("multipliers", "latch"):
                raise
        else:
            self.functions = (EventFunction("dead_point", determinant, 0, EventKind.DEAD_POINT, self),)

    def follow(self, motion: Motion) -> None:
        self.system = motion.system

    def begin(self, t: float, x: Array, options: Options) -> Array:
        self.found = []
        return x

    def handle(self, event: Event) -> Outcome:
        q = self.system.split(event.state)[0]
        if classify(self.problem, q, self.passive).kind != "dead_point":
            return GO_ON
        self.found.append((event.time, event.state))
        criterion = self.problem.scene.deploy.criterion
        waits = criterion == "latch" or (criterion == "multipliers" and self.growth.fired is None)
        return GO_ON if waits else STOP


class LatchPosition(Watcher):
    """Ends the scan where a joint comes to the position at which the latch closes; found : that pose."""

    def __init__(self, problem: Problem) -> None:
        name, at = latch_position(problem.scene)
        value = problem.q[problem.model.q_names.index(name)] - literal(at, "deploy.latch.at")
        self.functions = (EventFunction("latch", value, 0, EventKind.LATCH, self),)
        self.found: Pose | None = None

    def begin(self, t: float, x: Array, options: Options) -> Array:
        self.found = None
        return x

    def handle(self, event: Event) -> Outcome:
        self.found = (event.time, event.state)
        return STOP


def latch_position(scene: Scene) -> tuple[str, float]:
    """Return the coordinate whose position closes the latch, and that position [rad or m]."""
    latch = scene.deploy.latch
    assert latch is not None
    if latch.at:
        ((name, at),) = latch.at.items()
        return name, at
    ((name, side),) = latch.at_limit.items()
    return name, float(getattr(scene.robot.limits_of(name), side))


def follow_deployment(problem: Problem, passive: Sequence[int]) -> list[Watcher]:
    """Return the watchers of a deployment.

    Raises
    ------
    CapabilityError : the input does not determine a dead point, or the contact states are not unique; extremes of a
        motion that is driven into one.
    """
    others = [*contact_watchers(problem), *limit_watchers(problem)]
    latch = [LatchPosition(problem)] if problem.scene.deploy.criterion == "latch" else []
    if not problem.model.closures:
        return [*latch, *others]
    refuse_driven_extremes(problem)
    growth = GrowthWatcher(problem)
    passes = problem.scene.simulate.singular == "pass"
    poses: list[Watcher] = []
    if not passes:
        poses = [Bifurcation(problem)]
    elif not problem.contact_joints:
        poses = [Passage(problem)]
    return [*poses, DeadPoint(problem, passive, growth), *latch, growth, *others]


# -- the scan -----------------------------------------------------------------------------------------------
MOST_SAMPLES = 2.0**62  # that are counted


@record
class Scan:
    """What the whole motion met.

    dead_points, bifurcation : poses. stopped : why the integration could not go on. driven : a prescribed motion has
    run into the dead point, whose pose is geometry. growth : of the multipliers, None in an open chain and
    where joints that stick leave them undetermined. end : time
    reached [s], in ``steps``. clean_until : see ``Bifurcation``. changes : of the method on the way. latched : where
    the latch closes, for a latch at a position.
    """

    dead_points: list[Pose]
    bifurcation: Pose | None
    stopped: NumericalError | None
    driven: bool
    growth: GrowthMonitor | None
    end: float
    steps: int
    clean_until: float
    changes: tuple[MethodChange, ...] = ()
    latched: Pose | None = None

    @property
    def dead_point(self) -> Pose | None:
        """The first one."""
        return self.dead_points[0] if self.dead_points else None


def scan(
    motion: Motion, options: Options, multipliers: bool = True, progress: Progress = no_progress
) -> Scan:
    """Integrate until everything that can stop the deployment has fired, or to the end of the duration.

    multipliers : whether these are judged too.
    """
    states, dead = watcher_of(motion, JointStates), watcher_of(motion, DeadPoint)
    growth = watcher_of(motion, GrowthWatcher)
    if states is not None and states.shares:
        growth = None
        _refuse_multipliers(motion)
    rank, latch = watcher_of(motion, Bifurcation), watcher_of(motion, LatchPosition)
    duration = motion.scene.simulate.duration
    driver = Driver.of(dataclasses.replace(motion, options=options), supervisor_for(motion.choice))

    def judge(t: Array, x: Array) -> None:
        if multipliers and growth is not None:
            growth.judge(t, x, driver.parameters)

    driver.tick = lambda time: progress(time, duration)
    driver.start(0.0, motion.start)
    grid = Grid(0.0, GRID, int(min(duration / GRID * (1 + 1e-12), MOST_SAMPLES)) + 1)
    stopped: NumericalError | None = None
    pose: tuple[float, Array, str] | None = None
    try:
        driver.run(duration, grid, judge, block=BLOCK)
    except NumericalError as error:
        pose = _driven_pose(motion, driver)
        stopped = error if pose is not None else with_cause(error, motion.problem, driver)
    bifurcation, dead_points = rank.found if rank else None, list(dead.found) if dead else []
    if pose is not None and pose[2] == "bifurcation":
        bifurcation = pose[:2]
    elif pose is not None and pose[2] == "dead_point":
        dead_points.append(pose[:2])
    return Scan(
        dead_points, bifurcation, stopped, pose is not None, growth.monitor if growth else None, driver.time,
        driver.counters.steps, rank.clean_until if rank else driver.time, tuple(driver.changes),
        latch.found if latch else None,
    )  # fmt: skip


def _refuse_multipliers(motion: Motion) -> None:
    """Refuse multipliers as what ends a deployment, where joints that stick together do not determine them.

    Raises
    ------
    CapabilityError
    """
    criterion = motion.scene.deploy.criterion
    if criterion in ("multipliers", "either"):
        raise CapabilityError(
            f"{criterion!r} counts the multipliers, which are not determined while more joints stick "
            "than there are degrees of freedom; allowed: dead_point, latch, or 'transition_speed' in the friction of "
            "some joints",
            ("deploy.criterion",),
            key="deploy.criterion",
        )


def watcher_of(motion: Motion, kind: type[W]) -> W | None:
    """Return the one watcher of a kind, None where the motion has none."""
    return next((watcher for watcher in motion.watchers if isinstance(watcher, kind)), None)


def _driven_pose(motion: Motion, driver: Driver) -> tuple[float, Array, str] | None:
    """Return the singular pose that a prescribed motion has run into, if that is what stopped the scan."""
    state = driver.state
    q, _, _ = motion.system.split(state)
    pose = driven_dead_point(motion.problem, motion.passive, q, driver.time, motion.scene.simulate.duration)
    if pose is None:
        return None
    time, q, kind, _ = pose
    state[list(motion.system.q_places)] = q
    return time, state, kind


ALONG = 1001  # samples of a prescribed motion that is followed ahead


def driven_extremes() -> CapabilityError:
    """Return the error of extremes in a mechanism that a prescribed motion drives into a dead point."""
    return CapabilityError(
        "the mechanism is driven into a dead point, where rates have no bound; allowed: "
        "'simulate' with a duration that ends before it",
        ("outputs.extremes",),
        key="outputs.extremes",
    )


def refuse_driven_extremes(problem: Problem) -> None:
    """Refuse extremes where a prescribed motion, which is followed by its geometry alone, comes to a dead point.

    Raises
    ------
    CapabilityError
    """
    scene = problem.scene
    if not (scene.outputs.extremes and scene.prescribed and scene.deploy.criterion == "dead_point"):
        return
    try:
        planned = guided_motion(problem, lead_of(problem), np.linspace(0.0, scene.simulate.duration, ALONG))
    except RobodynError:  # not all of it is driven, or it does not begin: told where it is followed
        return
    if isinstance(planned.stopped, SingularConfigurationError):
        raise driven_extremes()


# -- what ends the deployment -------------------------------------------------------------------------------
@record
class ScanEnd:
    """What ends the recorded run: time [s] of the criterion (None: none fired) and which it was.

    bifurcated : a loss of rank came first.
    """

    time: float | None
    criterion: str
    bifurcated: bool


def decide(motion: Motion, scanned: Scan) -> ScanEnd:
    """Return what ends the run by the scene's criterion."""
    criterion = motion.scene.deploy.criterion
    dead = scanned.dead_point[0] if scanned.dead_point else None
    times = {"dead_point": dead, "multipliers": fired(scanned.growth, motion.scene.deploy.growth)}
    if criterion == "latch":
        times = {"latch": scanned.latched[0] if scanned.latched else None}
    counted = times if criterion == "either" else {criterion: times[criterion]}
    candidates = [(time, name) for name, time in counted.items() if time is not None]
    stop, name = min(candidates) if candidates else (None, criterion)
    bifurcated = scanned.bifurcation is not None and (stop is None or scanned.bifurcation[0] <= stop)
    return ScanEnd(stop, name, bifurcated)
