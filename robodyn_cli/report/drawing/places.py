"""Places and directions of a drawing, collected as expressions and evaluated at once for all instants.

Which instants of a motion are drawn.

Paths of the named points of a result.

Forces as arrows: those that act from outside, and recorded reactions of joints and closures.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from robodyn_cli.algorithms.kinematics import position_rates
from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.graph import Expr, Scalar
from robodyn_cli.expr.rebuild import Interpreter
from robodyn_cli.model.joints import joint_axes
from robodyn_cli.model.model import FixedFrame
from robodyn_cli.record import record
from robodyn_cli.report.drawing.record import Arrow, Drawing, Trail
from robodyn_cli.report.lines import finite
from robodyn_cli.results.result import Result, Variable
from robodyn_cli.results.sampling import too_far_apart
from robodyn_cli.spatial.algebra import Array, Matrix, Vector, identity, zeros

KNOWN = ("t", "q", "v")  # groups of symbols that a result has values of
DIGITS = 9  # after the point by which places on a body are told apart [m]


class KnownNodes:
    """Tell of one expression after another whether all its symbols are of known groups; looks at no node twice."""

    def __init__(self, groups: Iterable[str]) -> None:
        self.groups = frozenset(groups)
        self._known: dict[Expr, bool] = {}

    def __call__(self, outputs: Iterable[Scalar]) -> bool:
        """Tell whether every symbol that the outputs depend on is of a known group."""
        return all(self._is_known(e) for e in outputs if isinstance(e, Expr))

    def _is_known(self, output: Expr) -> bool:
        known, stack = self._known, [output]
        while stack:
            node = stack[-1]
            waiting = [a for a in node.args if a not in known]
            if waiting:
                stack += waiting
                continue
            known[stack.pop()] = (
                node.value[1] in self.groups if node.op == "sym" else all(map(known.get, node.args))
            )
        return known[output]


class DrawnExpressions:
    """Vertices, axes and forces in the world, as expressions of t, q and v. The same place has one number.

    entries : vectors (3,) by kind, in the order of their numbers.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self._vertices: dict[tuple[Any, ...], int] = {}
        self._axes: dict[tuple[Any, ...], int] = {}
        self._known = KnownNodes(KNOWN)
        self.entries: dict[str, list[Vector]] = {"vertices": [], "axes": [], "forces": []}

    def vertex(self, body: int, p: Vector) -> int | None:
        """Return the number of a place on a body, p (3,) in its coordinates; None if data for it are unknown."""
        return self._number("vertices", self._vertices, body, p)

    def own_vertex(self, body: int, p: Vector) -> int | None:
        """Return the number of a place on a body that it shares with no other, None likewise."""
        return self._store("vertices", self.problem.world_point(FixedFrame(body, p, identity())))

    def axis(self, body: int, direction: Vector) -> int | None:
        """Return the number of a direction (3,) in a body's coordinates, None likewise."""
        return self._number("axes", self._axes, body, direction)

    def force(self, f: Vector) -> int | None:
        """Return the number of a force (3,) in the world, None likewise."""
        return self._store("forces", f)

    def rotated(self, body: int, direction: Vector) -> Vector:
        """Return world components of a direction on a body."""
        turned: Vector = self.problem.model.base.E.T @ (self.problem.pose[body].R @ direction)
        return turned

    def _number(self, kind: str, table: dict[tuple[Any, ...], int], body: int, p: Vector) -> int | None:
        key = (body, *(round(x, DIGITS) + 0.0 if isinstance(x, float) else id(x) for x in p))
        if key not in table:
            frame = FixedFrame(body, p, identity())
            entry = self.problem.world_point(frame) if kind == "vertices" else self.rotated(body, p)
            number = self._store(kind, entry)
            if number is None:
                return None
            table[key] = number
        return table[key]

    def _store(self, kind: str, entry: Vector) -> int | None:
        if not self._known(entry):
            return None
        self.entries[kind].append(entry)
        return len(self.entries[kind]) - 1

    def count(self, kind: str) -> int:
        """Return how many ``vertices``, ``axes`` or ``forces`` there are."""
        return len(self.entries[kind])

    def evaluate(self, t: Array, q: Array, v: Array) -> tuple[Array, Array, Array]:
        """Return vertices (T, N, 3), axes (T, M, 3) and forces (T, F, 3) at times t (T,), q (T, nq), v (T, nv)."""
        entries: Sequence[Scalar] = [x for kind in self.entries.values() for e in kind for x in e]
        with np.errstate(all="ignore"):
            values = Interpreter(entries)({"t": t[None, :], "q": q.T, "v": v.T})
        table = np.empty((len(t), len(values)))
        for k, value in enumerate(values):
            table[:, k] = value
        ends = np.cumsum([3 * len(kind) for kind in self.entries.values()])[:-1]
        blocks = [block.reshape(len(t), -1, 3) for block in np.split(table, ends, axis=1)]
        return blocks[0], blocks[1], blocks[2]


def along_motion(drawing: Drawing, most: int) -> list[int]:
    """Return at most ``most`` instants equally far apart along the motion, the first and the last included.

    The length of a step is how far the vertex has moved that has moved furthest. Where a motion comes back to its
    poses in step with the instants, a swing to its ends, they come ever closer, so that they show other poses.
    """
    count = len(drawing.times)
    steps = np.nan_to_num(np.linalg.norm(np.diff(drawing.vertices, axis=0), axis=2), posinf=0.0)
    # the way of a payload that flies says little of the mechanism
    own = [k for k in range(steps.shape[1]) if k not in drawing.carried]
    moved = (steps[:, own] if steps[:, own].any() else steps).max(axis=1, initial=0.0)
    length = np.concatenate([[0.0], np.cumsum(moved)])
    if not length[-1] > 0.0:
        return [0] if count == 1 else [0, count - 1]
    spread = {}
    for bend in BENDS:
        marks = length[-1] * np.linspace(0.0, 1.0, most) ** bend
        chosen = sorted({int(np.argmin(np.abs(length - mark))) for mark in marks} | {0, count - 1})
        spread[bend] = _apart(drawing.vertices[np.ix_(chosen, own)]), chosen
    best = max(spread.values(), key=lambda one: one[0])
    return (spread[1.0] if spread[1.0][0] >= ENOUGH * best[0] else best)[1]


BENDS = (1.0, 0.85, 0.7, 0.6)  # powers of the part of the way at which instants lie
ENOUGH = 0.5  # of the largest distance between poses that instants reach: those in equal steps will do


def _apart(places: Array) -> float:
    """Return how far poses (K, n, 3) are from the nearest other one, in the mean; those at both ends from the inner
    ones, for a motion may close."""
    off = np.nan_to_num(np.linalg.norm(places[:, None] - places[None], axis=3), posinf=0.0)
    far = off.max(axis=2, initial=0.0)
    far[np.arange(len(far)), np.arange(len(far))] = np.inf
    far[0, -1] = far[-1, 0] = np.inf
    return float(np.mean(far.min(axis=1))) if len(far) > 2 else 0.0


def nearest(times: Array, wanted: Array) -> Array:
    """Return the samples (K,) whose times (T,), in order, are nearest to those wanted (K,)."""
    right = np.clip(np.searchsorted(times, wanted), 1, max(1, len(times) - 1))
    if len(times) == 1:
        return np.zeros(len(wanted), dtype=int)
    left = right - 1
    return np.asarray(np.where(wanted - times[left] <= times[right] - wanted, left, right))


ROUNDING = 1e-12  # of the distance from the origin: less is no motion
STILL = 1e-6  # of the largest extent: less is no motion
SAME = 1e-9  # [m]


def moving_paths(result: Result) -> dict[str, Array]:
    """Return the places (T, 3) of the named points that move; of points that go the same way the first."""
    paths: dict[str, Array] = {}
    for name, item in result.group("points").items():
        path = finite(item.data)
        same = (np.allclose(path, other, rtol=0.0, atol=SAME, equal_nan=True) for other in paths.values())
        if _extent(path) > ROUNDING * float(np.nanmax(np.abs(path), initial=0.0)) and not any(same):
            paths[name] = path
    size = max((_extent(path) for path in paths.values()), default=0.0)
    return {name: path for name, path in paths.items() if _extent(path) > STILL * size}


FINE = 1500  # places of a path, about, where samples are fewer
# part of a way by which rates at its ends may miss it, where a curve through them shows the motion
STRAY = 0.2
ROUNDED = 1e-6  # part of the largest position, below which it does not matter how a joint goes


def motion_between(result: Result, problem: Problem) -> tuple[Array, Array] | None:
    """Return times (K,) and positions (K, nq) at samples and between them, on the cubic polynomials that have the rates
    there, too; None where samples are near enough, or too few.

    Positions go straight where something happened on the way, and are nan there where rates do not fit them, or where
    plots of the positions draw dots: samples are too far apart. Where that is so of attitudes alone, there is one nan
    between samples.
    """
    t, q, model = result.time, result["q"], problem.model
    qd = result["qd"] if "qd" in result else np.zeros((0, 0))
    if not 2 <= len(t) < FINE or (q.shape[1], *qd.shape) != (model.nq, len(t), model.nv):
        return None
    if not (np.isfinite(q).all() and np.isfinite(qd).all()):
        return None
    pieces, h = -(-FINE // (len(t) - 1)), np.diff(t)[:, None]
    columns = Interpreter(position_rates(model, problem.q, problem.v))({"q": q.T, "v": qd.T})
    rates = np.column_stack([np.broadcast_to(column, len(t)) for column in columns])
    way, first, last = np.diff(q, axis=0), h * rates[:-1], h * rates[1:]
    attitudes = [slice(k, k + 4) for k, name in enumerate(model.q_names) if name.endswith(".qw")]
    ways = [np.abs(x) for x in (way - 0.5 * (first + last), way, first, last)]
    for x in ways:
        for four in attitudes:
            x[:, four] = np.linalg.norm(x[:, four], axis=1)[:, None]
    off = ways[0] > STRAY * (sum(ways[1:]) + ROUNDED * np.abs(q).max())
    known = ~off[:, [k for four in attitudes for k in range(*four.indices(model.nq))]].any(axis=1)
    strays = off.any(axis=1)
    happened = np.searchsorted(t, [float(event["time"]) for event in result.events]) - 1
    happened = happened[(happened >= 0) & (happened < len(strays))]
    unknown = (strays | too_far_apart(result, "q").any(axis=1)) & ~np.isin(np.arange(len(strays)), happened)
    strays[happened] = True
    first, last = (np.where(strays[:, None], way, x)[:, None] for x in (first, last))
    s = (np.arange(pieces) / pieces)[None, :, None]
    x = q[:-1, None] + s * (
        first + s * (3.0 * way[:, None] - 2.0 * first - last + s * (first + last - 2.0 * way[:, None]))
    )
    for four in attitudes:
        x[:, :, four] /= np.linalg.norm(x[:, :, four], axis=2)[:, :, None]
    x[unknown, 1:] = np.nan
    kept = (s[0, :, 0] == 0.0) | known[:, None] | (np.arange(pieces) == 1) & unknown[:, None]
    return np.append((t[:-1, None] + s[0, :, 0] * h)[kept], t[-1]), np.vstack([x[kept], q[-1:]])


def drawing_of_paths(paths: list[Array], gravity: Array) -> Drawing:
    """Return a drawing of nothing but paths (T, 3)."""
    trails = tuple(
        Trail(str(k), np.arange(len(path), dtype=float), path, "#000000") for k, path in enumerate(paths)
    )
    nothing = np.zeros((1, 0, 3))
    drawing = Drawing(np.zeros(1), nothing, nothing, (), (), (), (), (), trails, (), gravity)
    extents = np.ptp(drawing.everything, axis=0) if len(drawing.everything) else np.zeros(3)
    thin = [axis for axis in (2, 1, 0) if extents[axis] <= STILL * extents.max()]
    return dataclasses.replace(drawing, flat=thin[0] if thin else None)


def _extent(points: Array) -> float:
    rows = points[np.isfinite(points).all(axis=1)]
    return float(np.ptp(rows, axis=0).max()) if len(rows) else 0.0


COMPONENTS = ("fx", "fy", "fz")


@record
class Load:
    """A force at a vertex.

    entry : its number among the forces of ``DrawnExpressions``; or components : (T, 3) along axes. axes : numbers of
    three directions of ``DrawnExpressions``; None for those of the world.
    """

    name: str
    vertex: int
    entry: int | None = None
    components: Array | None = None
    axes: tuple[int, ...] | None = None


def loads(result: Result, expressions: DrawnExpressions, samples: Array | None) -> list[Load]:
    """Return the forces of a scene at some samples of its result; without samples only those from outside."""
    forces = outside(expressions)
    if samples is not None:
        forces += reactions(result, expressions, samples)
    return forces


def outside(expressions: DrawnExpressions) -> list[Load]:
    """Return the forces that act from outside the mechanism, as expressions."""
    problem, forces = expressions.problem, []
    for force, effect in zip(problem.model.forces, problem.elements.effects):
        if force.element.term != "external":
            continue
        end = force.ends[0]
        vertex = expressions.vertex(end.body, end.p)
        for action in effect.actions:
            f = action.wrench.f
            world = expressions.rotated(end.body, end.R @ f) if action.local else problem.model.base.E.T @ f
            entry = expressions.force(world)
            if vertex is not None and entry is not None:
                forces.append(Load(force.name, vertex, entry))
    return forces


def reactions(result: Result, expressions: DrawnExpressions, samples: Array) -> list[Load]:
    """Return the recorded forces in joints (of the parent on the link) and closures (on the first link)."""
    problem = expressions.problem
    in_world = problem.scene.outputs.reaction_axes == "world"
    joints = {joint.name: joint for joint in problem.scene.robot.joints}
    places: list[tuple[str, int, Array, Matrix]] = []
    for k, body in enumerate(problem.model.bodies):
        places.append((f"reactions/{body.joint_name}", k, zeros(3), joint_axes(joints[body.joint_name])))
    for loop in problem.model.loops:
        places.append((f"loop_reactions/{loop.name}", loop.first.body, loop.first.p, loop.first.R))
    forces = []
    for path, body_index, p, R in places:
        vertex = expressions.vertex(body_index, p)
        if path not in result.variables or vertex is None:
            continue
        axes = None
        if not in_world:
            numbers = [expressions.axis(body_index, R[:, k]) for k in range(3)]
            axes = tuple(number for number in numbers if number is not None)
        components = _forces(result.variables[path], samples)
        forces.append(Load(path.partition("/")[2], vertex, None, components, axes))
    return forces


def _forces(wrench: Variable, samples: Array) -> Array:
    """Return the components (T, 3) of a recorded force; those that the scene's data leave open are 0."""
    columns = [wrench.data[samples, wrench.names.index(c)] if c in wrench.names else None for c in COMPONENTS]
    return np.stack([np.zeros(len(samples)) if c is None else c for c in columns], axis=1)


def arrows(shown: Sequence[Load], axes: Array, forces: Array) -> tuple[Arrow, ...]:
    """Return the arrows from evaluated axes (T, M, 3) and forces (T, F, 3); those that are never there left out."""
    drawn = []
    for load in shown:
        force = _world(load, axes, forces)
        if np.any(np.nan_to_num(force) != 0.0):
            drawn.append(Arrow(load.name, load.vertex, force, load.entry is None))
    return tuple(drawn)


def _world(load: Load, axes: Array, forces: Array) -> Array:
    """Return a force (T, 3) in the world."""
    if load.components is None:
        force: Array = forces[:, load.entry]
        return force
    if load.axes is None:
        return load.components
    turned: Array = np.einsum("tk,tkx->tx", load.components, axes[:, list(load.axes)])
    return turned
