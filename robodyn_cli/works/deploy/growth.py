"""Growth of multipliers up to a lock, and the latch that holds it."""

from __future__ import annotations

import dataclasses
import heapq

import numpy as np

from robodyn_cli.algorithms.kinematics import transforms
from robodyn_cli.algorithms.reactions import loop_wrench
from robodyn_cli.equations.contact_joints import contact_joints, without_contacts
from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.fixed import literal
from robodyn_cli.formulations.system import System
from robodyn_cli.loops.pairs import FixedLoop
from robodyn_cli.model.model import BASE, FixedFrame, Loop, Model
from robodyn_cli.record import mutable_record, record
from robodyn_cli.spatial.algebra import Array, identity, snap, vector
from robodyn_cli.summaries.apart import ROUNDED
from robodyn_cli.summaries.deploy import ImpactErrors, LatchKeys

GRID = 1e-3  # s, the uniform grid on which the running median is taken
LEVELS = (10.0, 100.0, 1000.0)


class RunningMedian:
    """Median of all values so far, in O(log n) a value (two heaps)."""

    def __init__(self) -> None:
        self._low: list[float] = []  # negated, so that the largest is on top
        self._high: list[float] = []

    def add(self, value: float) -> float:
        """Take a value and return the median of all so far."""
        low, high = self._low, self._high
        if not low or value <= -low[0]:
            heapq.heappush(low, -value)
        else:
            heapq.heappush(high, value)
        if len(low) > len(high) + 1:
            heapq.heappush(high, -heapq.heappop(low))
        elif len(high) > len(low):
            heapq.heappush(low, -heapq.heappop(high))
        if len(low) > len(high):
            return -low[0]
        return 0.5 * (high[0] - low[0])


@mutable_record
class GrowthMonitor:
    """Follows the norm of the multipliers on the 1 ms grid and notes when it passes its thresholds.

    times : for each level, the first grid time at which norm > level x running median (which must not be zero).
    limit_time : the first grid time at which norm > limit.
    calmed : the levels (and the limit, as ``limit``) below which the norm has fallen again since.
    """

    levels: tuple[float, ...]
    limit: float | None = None
    times: dict[float, float] = dataclasses.field(default_factory=dict)
    limit_time: float | None = None
    calmed: set[float | str] = dataclasses.field(default_factory=set)
    ratio: float = 0.0
    median: RunningMedian = dataclasses.field(default_factory=RunningMedian)

    def take(self, t: Array, norm: Array) -> None:
        """Take a block of grid samples."""
        pending = [level for level in self.levels if level not in self.times]
        for time, value in zip(t.tolist(), norm.tolist()):
            middle = self.median.add(value)
            if pending and value > pending[0] * middle > 0.0:
                for level in [x for x in pending if value > x * middle]:
                    self.times[level] = round(time, 9)  # a grid time: shed the rounding of k x 1 ms
                    pending.remove(level)
            for level in self.times:
                if value <= level * middle:
                    self.calmed.add(level)
            if self.limit is not None and value > self.limit and self.limit_time is None:
                self.limit_time = round(time, 9)
            elif self.limit is not None and value <= self.limit and self.limit_time is not None:
                self.calmed.add("limit")
            if middle > 0.0 and value > self.ratio * middle:
                self.ratio = value / middle


def levels_with(growth: float) -> tuple[float, ...]:
    """Return the levels that are reported, the scene's own among them, in increasing order."""
    return tuple(sorted({*LEVELS, float(growth)}))


SHARES = (
    0.0,
    1.0,
    -1.0,
    0.5,
    -0.5,
)  # of the way from a start to another one: draws of what rounding makes of it


def starts_beside(own: Array, other: Array) -> Array:
    """Return starts (5, ..., nx) around one's ``own``, the first of them, as far away as another is."""
    return np.array([own + share * (other - own) for share in SHARES])


# parts of the largest position and of the largest rate that rounding leaves at a lock: both runs to it begin in one
# pose, and may share as much (random four-bars against their energy, by three methods: up to 5e-14 of the rates)
POSE_ROUNDED, RATES_ROUNDED = ROUNDED, 5e-14
DRAWS = 4


def rounding_at_lock(system: System, x: Array) -> Array:
    """Return what rounding leaves of states (..., nx) at locks; nothing of what is no position or rate."""
    floor = np.zeros_like(x)
    for places, part in ((system.q_places, POSE_ROUNDED), (system.v_places, RATES_ROUNDED)):
        own = list(places)
        floor[..., own] = part * np.abs(x[..., own]).max(axis=-1, keepdims=True, initial=0.0)
    return floor


def locks_beside(system: System, x: Array) -> Array:
    """Return states (DRAWS, ..., nx) around those at locks, as far away as rounding may have moved these."""
    draws = np.random.default_rng(0).standard_normal((DRAWS, *(1,) * (x.ndim - 1), x.shape[-1]))
    return np.asarray(x + draws * rounding_at_lock(system, x))


def farthest(values: Array) -> Array:
    """Return the value (...,) that is farthest from the first of values (S, ...)."""
    place = np.argmax(np.abs(values - values[0]), axis=0)
    return np.take_along_axis(values, place[None], axis=0)[0]


def multiplier_norm(lam: Array) -> Array:
    """Return the Euclidean norm over the rows of multipliers lam (T, m): (T,)."""
    return np.asarray(np.sqrt((lam**2).sum(axis=1)))


NEW = 1e-6  # part of a row that must be independent of the others for it to count as a further constraint


@record
class Locked:
    """A mechanism with its latch closed.

    problem : the equations with the latch as one more closure. name : of that closure. rows : names of the latch's
    rows that do not follow from the others. freedom : degrees of freedom that are left.
    """

    problem: Problem
    name: str
    rows: tuple[str, ...]
    freedom: int


@record
class LatchImpact:
    """What the latch does at the instant it closes.

    qd_after : rates after it. impulse : of each constraint row [N s or N m s]. angular_impulse and linear_impulse : of
    the latch on its second link, about the latch's point, base axes [N m s, N s]. energy_lost [J].
    """

    qd_before: Array
    qd_after: Array
    rows: tuple[str, ...]
    impulse: Array
    angular_impulse: Array
    linear_impulse: Array
    energy_lost: float

    def keys(self, joints: tuple[str, ...]) -> LatchKeys:
        """Return what the summary says of it."""
        return LatchKeys(
            rates_before=dict(zip(joints, self.qd_before.tolist())),
            rates_after=dict(zip(joints, self.qd_after.tolist())),
            impulse=dict(zip(self.rows, self.impulse.tolist())),
            angular_impulse=float(np.linalg.norm(self.angular_impulse)),
            angular_impulse_vector=self.angular_impulse.tolist(),
            linear_impulse=float(np.linalg.norm(self.linear_impulse)),
            energy_lost=self.energy_lost,
            errors=ImpactErrors(),
        )

    def rounding(self) -> ImpactErrors:
        """Return what rounding of the rates before leaves: impulses are linear in them, energies quadratic."""
        arrays = (self.qd_before, self.impulse, self.angular_impulse, self.linear_impulse)
        rates, impulse, angular, linear = (RATES_ROUNDED * float(np.linalg.norm(x)) for x in arrays)
        return ImpactErrors(rates, impulse, angular, linear, 2.0 * RATES_ROUNDED * abs(self.energy_lost))


def locked(problem: Problem, first: str, second: str, q: Array, t: float) -> Locked:
    """Return the mechanism with two links fixed to each other as they are at q.

    The latch is a closure of type ``fixed`` at the joint between the links (the second link's origin where there is
    none). Of its rows only those stay that the joints and closures leave open: a latch on a hinge bears the moment
    about the hinge, and the hinge goes on bearing what it bore.
    """
    model = problem.model
    names = {loop.name for loop in model.loops}
    name = "latch"
    while name in names:
        name += "_"
    ends = _ends(problem, first, second, q, t)
    element = FixedLoop(name=name, type="fixed", between=(first, second))
    loops = (*model.loops, Loop(name, element, *ends))
    whole = Problem(
        problem.scene,
        model=dataclasses.replace(model, loops=loops),
        dependent=problem.dependent,
        braces=problem.braces,
    )
    rows = whole.constraints.rows
    psi = whole.numbers(whole.psi, q, t)
    before = set(problem.constraints.names)
    basis = _basis(psi[[i for i, row in enumerate(rows) if row.name in before]])
    added: list[int] = []
    candidates = [i for i, row in enumerate(rows) if row.closure == name]
    # moments before forces: a joint between the links bears forces already
    candidates.sort(key=lambda i: rows[i].kind != "moment")
    for kind in ("moment", "force"):
        left = [i for i in candidates if rows[i].kind == kind]
        while left:
            rest = {i: psi[i] - basis.T @ (basis @ psi[i]) for i in left}
            best = max(left, key=lambda i: float(np.linalg.norm(rest[i])))
            size = float(np.linalg.norm(rest[best]))
            if size <= NEW * max(float(np.linalg.norm(psi[best])), 1e-300):
                break
            basis = np.vstack([basis, rest[best] / size])
            added.append(best)
            left.remove(best)
    keep = [i for i, row in enumerate(rows) if row.name in before or i in added]
    problem_locked = Problem(
        problem.scene,
        keep_rows=keep,
        model=_without_contact(whole.model, basis),
        dependent=problem.dependent,
        braces=problem.braces,
    )
    new = tuple(rows[i].name for i in sorted(added))
    return Locked(problem_locked, name, new, model.nv - len(basis))


def _without_contact(model: Model, basis: Array) -> Model:
    """Return the model without sticking friction and rigid stops in coordinates that constraints hold.

    What such a coordinate's stop or friction bears beside the latch is not determined, and changes no motion.

    basis : orthonormal rows (r, nv) that span those of Psi.
    """
    held = np.einsum("ij,ij->j", basis, basis) > 1.0 - NEW
    return without_contacts(model, {joint.v for joint in contact_joints(model) if held[joint.v]})


def _basis(psi: Array) -> Array:
    """Return orthonormal rows that span those of Psi."""
    if not len(psi):
        return psi
    _, s, Vt = np.linalg.svd(psi, full_matrices=False)
    return np.asarray(Vt[s > NEW * s[0]])


def _ends(problem: Problem, first: str, second: str, q: Array, t: float) -> tuple[FixedFrame, FixedFrame]:
    """Return one frame in the two links' bodies, where the links are joined, in the attitude of the first body."""
    model = problem.model
    one, two = model.links[first].body, model.links[second].body
    pose = {}
    for body in (one, two):
        here = problem.pose[body]
        pose[body] = (problem.numbers(here.R, q, t), problem.numbers(here.p, q, t))

    def placed(frame: FixedFrame) -> Array:
        R, p = pose[frame.body]
        return np.asarray(p + R @ problem.numbers(frame.p, q, t))

    where = placed(model.links[second])
    if two != BASE:
        where = pose[two][1]
    if one != BASE and model.bodies[one].parent == two:
        where = pose[one][1]
    for loop in model.loops:
        if {loop.first.body, loop.second.body} == {one, two}:
            where = placed(loop.first)
    R1, p1 = pose[one]
    R2, p2 = pose[two]
    ends = []
    for link, body, R, p in ((first, one, R1, p1), (second, two, R2, p2)):
        axes = identity() if body == one else _numbers(R.T @ R1, f"latch.{link}.R")
        ends.append(FixedFrame(body, _numbers(R.T @ (where - p), f"latch.{link}.p"), axes))
    return ends[0], ends[1]


def _numbers(values: Array, place: str) -> Array:
    """Return what the pose of the lock decides as numbers of the scene; zeros, and ones of attitudes, are structure."""
    snapped = [snap(float(x)) for x in values.flat]
    entries = [
        x if values.ndim == 2 and abs(x) == 1.0 else literal(x, f"{place}.{k}") for k, x in enumerate(snapped)
    ]
    return vector(entries).reshape(values.shape)


def close_latch(problem: Problem, latch: Locked, q: Array, qd: Array, t: float) -> LatchImpact:
    """Lock two links to each other by an impulse (momentum balance, no bounce).

    M (v+ - v-) = Psi^T I with Psi v+ = Psi v- in the rows of joints and loops, and Psi v+ = 0 in those of the latch.
    Least norm where rows depend on each other.
    """
    rows = latch.problem.constraints.rows
    M = problem.numbers(problem.mass_matrix, q, t)
    psi = latch.problem.numbers(latch.problem.psi, q, t)
    closes = np.array([row.name in latch.rows for row in rows])
    target = np.where(closes, -psi @ qd, 0.0)
    # in the metric of M: Psi M^-1 Psi^T, solved with least norm
    spread = np.linalg.solve(M, psi.T)
    impulse, *_ = np.linalg.lstsq(psi @ spread, target, rcond=1e-12)
    after = qd + spread @ impulse
    lost = 0.5 * qd @ M @ qd - 0.5 * after @ M @ after
    by_name = {row.name: float(x) for row, x in zip(rows, impulse) if row.name in latch.rows}
    angular, linear = _latch_wrench(latch, q, t, by_name)
    names = [row.name for row in rows if row.name not in latch.rows]
    own = np.array([x for x, closing in zip(impulse, closes) if not closing])
    return LatchImpact(qd, after, tuple(names), own, angular, linear, float(lost))


def _latch_wrench(latch: Locked, q: Array, t: float, impulse: dict[str, float]) -> tuple[Array, Array]:
    """Return moment and force of the latch on its second link, base axes."""
    model = latch.problem.model
    X = transforms(model, q.tolist())
    loop = next(loop for loop in model.loops if loop.name == latch.name)
    wrench = loop_wrench(model, loop, X, impulse)
    R = np.eye(3)
    for body in reversed(model.path_to(wrench.root)):
        R = np.array(X[body].E.T, dtype=float) @ R
    moment, force = (latch.problem.numbers(part, q, t) for part in (wrench.on_second.n, wrench.on_second.f))
    return R @ moment, R @ force
