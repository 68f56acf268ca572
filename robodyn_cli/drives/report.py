"""From a motion and its torques to the datasets and figures of its drives."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np

from robodyn_cli.commands import COMMANDS
from robodyn_cli.drives.cycle import Duty, peak_use
from robodyn_cli.drives.figures import Evaluated
from robodyn_cli.equations.problem import Problem
from robodyn_cli.equations.torque_terms import torque_terms
from robodyn_cli.expr.graph import Scalar, free_symbols
from robodyn_cli.model.model import MOTION_GROUPS, PARAMETER_GROUP, UNKNOWN_GROUP
from robodyn_cli.model.parts import trains
from robodyn_cli.motors.drive import Train
from robodyn_cli.observe.evaluation import SampleFunction
from robodyn_cli.observe.units import JointColumns, joint_columns
from robodyn_cli.record import record
from robodyn_cli.results.result import Result
from robodyn_cli.scene.types import Scene
from robodyn_cli.solve.quadrature import breaks_at
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.apart import with_others
from robodyn_cli.summaries.drives import DriveFigures, DriveKeys
from robodyn_cli.summaries.facts import ABSENT, JOINT, warned
from robodyn_cli.torques.checks import breaks_of_joint, settled

EPS = float(np.finfo(float).eps)
UNBOUNDED = 1e8  # times as fast as a driven joint others move only at its dead point, but for rounding
UNDERSIZED = "undersized"  # status of a run with a drive that does not bear its duty


def with_drives(
    records: list[Any],
    result: Result,
    problem: Problem,
    moved: Moved,
    again: Accurate = None,
    instants: Sequence[float] = (),
) -> list[Any]:
    """Return the records of a motion's summary, the first with ``warnings``, and one of its drives behind them; add
    their datasets to the result, and its status.

    moved : the motion where figures are looked at. again : more accurate ones. instants : at which functions may jump
        beside events [s].

    A motion of a single sample has no figures of drives, and a warning instead.
    """
    summary, *others = records
    times, scene = result.time, problem.scene
    if len(times) < 2:
        return [warned(summary, ["there is one sample, so there are no figures of drives"]), *others]
    breaks = tuple(breaks_at(times, (float(event["time"]) for event in result.events), instants))
    Drives.of(scene, problem, Moved.of(result.__getitem__, breaks)).add_to(result)
    drives = Drives.of(scene, problem, moved)
    figures = drives.figures()
    if again is not None or moved.sparse:
        runs, factor = again or ((), 0.0)
        accurate = [Drives.of(scene, problem, run).figures() for run in runs]
        figures = with_others(figures, accurate, factor, ("drives", JOINT))
    figures = {name: drives.evaluated[name].with_rivals(one) for name, one in figures.items()}
    judge(result, all(one.passes for one in figures.values()))
    title = scene.catalogue.title or ABSENT
    return [warned(summary, list(_doubts(drives, figures))), *others, DriveKeys(figures, title)]


def judge(result: Result, suffices: bool) -> None:
    """Set the status of a result whose drives or margins do not suffice, if it ended as it should but for that."""
    if not suffices and result.status in ("ok", COMMANDS[result.command].good):
        result.status = UNDERSIZED


def _doubts(drives: Drives, figures: dict[str, DriveFigures]) -> Iterator[str]:
    """Yield what is not known of drives well enough."""
    for name, one in drives.evaluated.items():
        if one.train.brake is not None and "brake" not in one.uses:
            why = "data, payloads or loops leave open what holds it at rest"
            yield f"the brake of joint {name!r} is not checked: {why}"
    for name, drive in figures.items():
        if not drives.evaluated[name].cycle.settles:
            yield (
                f"the winding of joint {name!r} comes to no steady state: its losses grow faster than the heat leaves; "
                "what is told of it is with the resistance at its largest temperature, and too small"
            )
        error = drive.errors.margin
        if error is not None and abs(drive.margin - drive.least_margin) <= error:
            yield f"the margin of joint {name!r} is as near to what is asked for as its error; take more samples"


@record
class Moved:
    """A motion at times (T,): q (T, nq), and rates, accelerations and actuator torques (T, nv). breaks : where
    these jump, in steps from the first sample. sparse : whether nothing is known between the samples."""

    times: Array
    q: Array
    qd: Array
    qdd: Array
    tau: Array
    breaks: tuple[float, ...] = ()
    sparse: bool = False

    @staticmethod
    def of(dataset: Callable[[str], Array], breaks: tuple[float, ...]) -> Moved:
        """Return the motion of datasets by path."""
        time, q, qd, qdd, tau = (dataset(path) for path in ("time", "q", "qd", "qdd", "tau"))
        return Moved(time, q, qd, qdd, tau, breaks)

    def breaks_of(self, v: Array, a: Array) -> tuple[float, ...]:
        """Return the breaks of the motion with those of a joint with rates and accelerations (T,), see
        ``breaks_of_joint``; where each sample stands alone there are no others."""
        return self.breaks if self.sparse else breaks_of_joint(self.times, v, a, self.breaks)

    def at_samples(self) -> Moved:
        """Return the motion of which only the samples are known: each is a piece of its own."""
        breaks = tuple((np.arange(len(self.times) - 1.0) + 0.5).tolist())
        return dataclasses.replace(self, breaks=breaks, sparse=True)

    @staticmethod
    def joined(parts: Sequence[Moved]) -> Moved:
        """Return motions without breaks that follow one another as one."""
        times, q, qd, qdd, tau = (
            np.concatenate([getattr(part, name) for part in parts])
            for name in ("times", "q", "qd", "qdd", "tau")
        )
        joined = Moved(times, q, qd, qdd, tau)
        return joined.at_samples() if any(part.sparse for part in parts) else joined


# more accurate integrations of a motion, and times the difference of figures is the error of these; None: none is known
Accurate: TypeAlias = "tuple[Sequence[Moved], float] | None"


@record
class Drives:
    """The drives of a scene in a motion, by joint."""

    problem: Problem
    evaluated: dict[str, Evaluated]

    @staticmethod
    def of(scene: Scene, problem: Problem, moved: Moved, still: StandingStill | None = None) -> Drives:
        """Return the drives of a scene along a motion. still : of the problem, where it is known."""
        still = still or StandingStill(scene, problem, len(moved.times))
        return Drives.along(problem, still.trains, moved, still(moved))

    @staticmethod
    def along(problem: Problem, by_joint: Mapping[str, Train], moved: Moved, rest: Standstill) -> Drives:
        """Return some drives, by joint, along a motion of which it is known what the joints feel."""
        rates, drives = settled(moved.qd), {}
        for name, train in by_joint.items():
            k = problem.model.v_names.index(name)
            reflected = float(train.reflected)
            load = moved.tau[:, k] - reflected * moved.qdd[:, k]
            inertia = None if rest.inertia is None else rest.inertia[:, k] - reflected
            hold = None if rest.hold is None else rest.hold[:, k]
            breaks = moved.breaks_of(rates[:, k], moved.qdd[:, k])
            duty = Duty(moved.times, rates[:, k], moved.qdd[:, k], load, hold, inertia, breaks)
            drives[name] = Evaluated.of(train, duty)
        return Drives(problem, drives)

    def figures(self) -> dict[str, DriveFigures]:
        """Return the figures by joint."""
        model = self.problem.model
        return {
            name: one.figures(model.v_units[model.v_names.index(name)])
            for name, one in self.evaluated.items()
        }

    def add_to(self, result: Result) -> None:
        """Add the datasets of the drives; what a motor does not have is left out."""
        names = tuple(self.evaluated)
        every = list(self.evaluated.values())
        tau = joint_columns(self.problem.model)["tau"]
        units = tuple(dict(zip(tau.names, tau.column_units))[name] for name in names)
        loads = JointColumns(names, units, ("time", "drive"))
        result.add("drives/load", np.column_stack([x.duty.load for x in every]), **loads.described())
        result.add("drives/speed", np.column_stack([x.cycle.speed for x in every]), names=names)
        result.add("drives/torque", np.column_stack([x.cycle.torque for x in every]), names=names)
        use = [peak_use(x.curves, x.cycle) for x in every]
        result.add("drives/use", np.column_stack(use), names=names)
        for path, key in (("current", "current"), ("winding_temperature", "temperature")):
            columns = {n: getattr(x.cycle, key) for n, x in self.evaluated.items()}
            columns = {n: x for n, x in columns.items() if x is not None}
            if columns:
                result.add(f"drives/{path}", np.column_stack(list(columns.values())), names=tuple(columns))
        for name, one in self.evaluated.items():
            for kind in ("driving", "braking", "continuous"):
                curve = getattr(one.curves, kind)
                if curve is not None:
                    result.add(f"envelopes/{kind}/{name}", np.column_stack([curve.speeds, curve.torques]))


@record
class Standstill:
    """What the joints feel of the mechanism, (T, nv): inertia at each joint [kg m^2 or kg], rotors included, and the
    torque that holds each pose [N m or N]. None where data, payloads or the number of drives leave it open."""

    inertia: Array | None
    hold: Array | None


def standing_outputs(problem: Problem) -> dict[str, list[Scalar]]:
    """Return what ``Standstill`` follows from, of v = v-dot = 0: M, what holds, and Psi of the loops."""
    prescribed = problem.constraints.prescribed
    M, terms = problem.tree_mass_matrix, list(torque_terms(problem).values())
    hold: list[Any] = [sum((term[k] for term in terms[1:]), terms[0][k]) for k in range(problem.model.nv)]
    outputs: dict[str, list[Scalar]] = {"M": list(M.flat), "hold": hold}
    groups = {n: {symbol.value[1] for symbol in free_symbols(x)} for n, x in outputs.items()}
    outputs = {n: x for n, x in outputs.items() if not groups[n] & {UNKNOWN_GROUP, PARAMETER_GROUP}}
    rows = [row.psi for k, row in enumerate(problem.constraints.rows) if k not in prescribed]
    return {**outputs, "psi": [x for row in rows for x in row]}


def standstill(problem: Problem, arrays: Mapping[str, Array]) -> Standstill:
    """Return what joints feel, from samples (T, n) of ``standing_outputs``.

    With loops, the driven joints are the coordinates of the mechanism where they are as many as its degrees of
    freedom: the others follow by v = R v_driven, and inertia and torques are diag(R^T M R) and R^T g.
    """
    nv, names = problem.model.nv, problem.model.v_names
    samples, entries = arrays["psi"].shape
    driven = [names.index(name) for name in problem.scene.drives]
    R = following(arrays["psi"].reshape(samples, entries // nv, nv), driven)
    if R is None:
        return Standstill(None, None)
    M_t = arrays["M"].reshape(-1, nv, nv) if "M" in arrays else None
    inertia = None if M_t is None else np.einsum("tik,tij,tjk->tk", R, M_t, R)
    return Standstill(inertia, np.einsum("tik,ti->tk", R, arrays["hold"]) if "hold" in arrays else None)


class StandingStill:
    """``Standstill`` as a function of motions, for the drives of a scene.

    trains : by joint. function : ``standing_outputs`` of samples.
    """

    def __init__(self, scene: Scene, problem: Problem, samples: int) -> None:
        self.problem, self.trains = problem, trains(scene)
        self.function = SampleFunction(standing_outputs(problem), MOTION_GROUPS, samples)

    def __call__(self, moved: Moved) -> Standstill:
        """Return what joints feel along a motion."""
        still = np.zeros_like(moved.qd)
        return standstill(
            self.problem,
            self.function(
                t=moved.times[:, None], q=moved.q, v=still, a=still, p=np.zeros((len(moved.times), 0))
            ),
        )


def following(psi: Array, driven: Sequence[int]) -> Array | None:
    """Return R (T, nv, nv), whose column k is the motion of all joints while joint k moves and the other driven ones
    rest, with Psi (T, m, nv) of the loops; None where these motions are not unique.

    At a dead point of a joint the others move without bound, and rounding decides how far and which way: there they go
    as in the sample before.
    """
    samples, rows, nv = psi.shape
    if rows == 0:
        return np.broadcast_to(np.eye(nv), (samples, nv, nv))
    others = [k for k in range(nv) if k not in driven]
    if np.linalg.matrix_rank(psi[samples // 2]) != len(others):
        return None
    R = np.zeros((samples, nv, nv))
    R[:, driven, driven] = 1.0
    U, sizes, Vt = np.linalg.svd(psi[:, :, others], full_matrices=False)
    rounding = EPS * sizes.max(axis=1, initial=0.0, keepdims=True)
    sizes = np.maximum(sizes, rounding)
    follow = -Vt.transpose(0, 2, 1) @ (U.transpose(0, 2, 1) @ psi[:, :, driven] / sizes[:, :, None])
    for k in np.flatnonzero((np.abs(follow) > UNBOUNDED).any(axis=(1, 2))):
        follow[k] *= np.where(np.sum(follow[k] * follow[max(k - 1, 0)], axis=0) < 0.0, -1.0, 1.0)
    R[np.ix_(range(samples), others, driven)] = follow
    return R


def given_by_drives(problem: Problem, drives: Mapping[str, Train], v: Array) -> Array:
    """Return the torques (T, nv) that motors and gears can give joints with rates (T, nv), in the way they go."""
    torques, names = np.zeros_like(v), problem.model.v_names
    for name, train in drives.items():
        k = names.index(name)
        torques[:, k] = np.sign(v[:, k]) * train.available(v[:, k])
    return torques
