"""From a stored result to its drawing: the scene in it says what there is, its samples where it is."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Iterator, Sequence

import numpy as np

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError, RobodynError
from robodyn_cli.expr.graph import Graph
from robodyn_cli.model.build import build_model, moved_link, parent_link
from robodyn_cli.model.model import Model
from robodyn_cli.report.drawing.parts import (
    OF_PAYLOADS,
    Connections,
    Links,
    flown,
    payload_parts,
    put_payloads,
)
from robodyn_cli.report.drawing.places import (
    FINE,
    STILL,
    DrawnExpressions,
    arrows,
    loads,
    motion_between,
    moving_paths,
)
from robodyn_cli.report.drawing.record import Drawing, Pin, Stretches, Trail
from robodyn_cli.report.lines import finite
from robodyn_cli.report.looks import POINTS, looks_of
from robodyn_cli.results.moments import lock_time
from robodyn_cli.results.result import Result, evenly
from robodyn_cli.results.sampling import too_far_apart
from robodyn_cli.scene.load import load_scene_text
from robodyn_cli.scene.nested_options import DeployLatch
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import Array

NEVER = math.inf
THIN = 0.1  # of the drawing's size: a mechanism that extends less along an axis is drawn flat
TRAIL = 2000  # places of a path
FLOWN = 200  # places of the path of a payload in flight
INSTANTS = 9  # at which distances of joints are measured
FAR = 1e30  # distance of the nearest other joint, where there is none [m]


def scene_of(result: Result) -> Scene:
    """Return the scene of a result.

    Raises
    ------
    CapabilityError : this version cannot read it.
    """
    return _stored_scene(result.scene_text) if result.problem is None else result.problem.scene


@functools.lru_cache(maxsize=2)  # a result is asked whether it can be drawn, and then drawn
def _stored_scene(text: str) -> Scene:
    try:
        return load_scene_text(text)
    except RobodynError as error:
        raise CapabilityError(f"the scene stored in the result cannot be read: {error.message}") from error


@functools.lru_cache(maxsize=2)
def _model_of(text: str) -> Model:
    return build_model(_stored_scene(text))


def problem_of(result: Result) -> Problem:
    """Return the equations of the scene of a result: those that it holds, or else some in a graph of their own; their
    model, which takes most of the time, is built once for all drawings.

    Raises
    ------
    CapabilityError : this version cannot read it.
    """
    if result.problem is not None:
        return result.problem
    scene, model = _stored_scene(result.scene_text), _model_of(result.scene_text)
    # symbols of missing data are in the model's own graph
    return Problem(scene, model=None if model.graph.nodes else dataclasses.replace(model, graph=Graph()))


def can_draw(result: Result) -> bool:
    """Tell whether a result has poses and the scene that they are of."""
    try:
        require_poses(result)
    except CapabilityError:
        return False
    return True


def has_poses(result: Result) -> bool:
    """Tell whether a result has poses, whatever its scene."""
    return "q" in result and "time" in result and len(result["q"]) > 0


def require_poses(result: Result) -> None:
    """Refuse a result of which no mechanism can be drawn.

    Raises
    ------
    CapabilityError : the result has no poses, or its scene cannot be read by this version.
    """
    if not has_poses(result):
        raise CapabilityError(
            f"a result of '{result.command}' has no poses to draw; allowed: a result of inverse, simulate, deploy, "
            "kinematics, reach, statics or assemble"
        )
    scene_of(result)


def gravity_of(result: Result) -> Array:
    """Return gravity (3,) in the world [m/s^2] by the scene of a result that can be drawn."""
    return np.array(scene_of(result).gravity, dtype=float)


def make_drawing(result: Result, samples: Sequence[int] | Array | None = None) -> Drawing:
    """Return the drawing of a result at some of its samples, by default at all.

    Raises
    ------
    CapabilityError : the result has no poses, or its scene cannot be read by this version.
    """
    require_poses(result)
    chosen = np.arange(len(result.time)) if samples is None else np.asarray(samples)
    rates = result["qd"][chosen] if "qd" in result else None
    return drawing_of(result, result.time[chosen], result["q"][chosen], rates, chosen)


def drawing_of(
    result: Result, t: Array, q: Array, v: Array | None = None, samples: Array | None = None
) -> Drawing:
    """Return the drawing of a result's scene at times t (T,), positions q (T, nq) and rates v (T, nv; 0 by default).

    samples : where in the result these are, if they are samples of it; then loads and paths are drawn too.
    """
    scene = scene_of(result)
    problem = problem_of(result)
    model = problem.model
    if q.shape[1] != model.nq:
        raise CapabilityError(f"the result has {q.shape[1]} joint coordinates, its scene {model.nq}")
    expressions, links, connections = drawn_things(scene, problem)
    parts, masses, bobs = links.all
    acting = loads(result, expressions, samples)
    of_mechanism = expressions.count("vertices")
    payloads = payload_parts(model, expressions) if model.payloads else []
    vertices, axes, forces = expressions.evaluate(t, q, np.zeros((len(t), model.nv)) if v is None else v)
    vertices = finite(vertices)
    boxes = {vertex for part in parts if part.kind == "solid" for vertex in part.vertices}
    slim = [vertex for vertex in range(of_mechanism) if vertex not in boxes]
    flat, normal = plane_of(vertices[:, :of_mechanism], slim)
    if payloads:
        put_payloads(result, model, payloads, t, vertices)
    return Drawing(
        times=t,
        vertices=vertices,
        axes=finite(axes),
        parts=(*parts, *connections.parts, *payloads),
        pins=_with_room(connections.pins, vertices),
        masses=tuple(masses),
        bobs=tuple(bobs),
        arrows=arrows(acting, axes, forces),
        trails=_trails(result, problem) if samples is not None else (),
        latches=tuple(
            drawn
            for between, closed in _latches(result, scene)
            if (drawn := connections.latch(between, closed))
        ),
        gravity=np.array(scene.gravity, dtype=float),
        flat=flat,
        normal=normal,
    )


def drawn_things(scene: Scene, problem: Problem) -> tuple[DrawnExpressions, Links, Connections]:
    """Return the links of a scene, what connects them, and where all of this is, by the numbers of its problem."""
    expressions = DrawnExpressions(problem)
    links = Links(scene, problem.model, expressions)
    return expressions, links, Connections(scene, problem.model, links, expressions)


def _latches(result: Result, scene: Scene) -> Iterator[tuple[Sequence[str], Stretches]]:
    """Yield the two links of each latch, and when it is closed."""
    if scene.deploy.latch is not None:
        locked = lock_time(result)
        yield scene.deploy.latch.between, () if locked is None else ((locked, NEVER),)
    for latch in scene.deploy.latches:
        starts, ends = (
            [float(e["time"]) for e in result.events if e["kind"] in kinds and e["name"] == latch.name]
            for kinds in (("latched", "carried"), ("opened",))
        )
        yield _held_links(scene, latch), tuple(zip(starts, [*ends, NEVER]))


def _held_links(scene: Scene, latch: DeployLatch) -> Sequence[str]:
    if latch.between is not None:
        return latch.between
    names = [joint.name for joint in scene.robot.joints]
    k = names.index(str(latch.joint).partition(".")[0])
    return parent_link(scene.robot, k), moved_link(scene.robot, k)


def _with_room(pins: Sequence[Pin], vertices: Array) -> tuple[Pin, ...]:
    """Return pins with how near the nearest other one comes, at places (T, N, 3)."""
    few = vertices[evenly(len(vertices), INSTANTS)]
    kept: list[Pin] = []
    for pin in pins:
        if pin.about:
            others = sorted({other.vertex for other in pins} - {pin.vertex})
            gaps = np.linalg.norm(few[:, others] - few[:, [pin.vertex]], axis=2)
            # another joint that passes by leaves room at other times
            room = float(np.nan_to_num(gaps).max(axis=0, initial=0.0).min(initial=FAR))
            pin = dataclasses.replace(pin, room=room)
        kept.append(pin)
    return tuple(kept)


def _trails(result: Result, problem: Problem) -> tuple[Trail, ...]:
    """Return the paths of the named points that move, and of payloads in flight."""
    trails = []
    looks = looks_of(result)
    for name, (times, path) in paths_of(result, problem).items():
        trails.append(Trail(name, *thinned(times, path, TRAIL), looks.colour(name, POINTS)))
    for payload in problem.model.payloads:
        if f"flights/{payload.name}/time" in result:
            known = result[f"flights/{payload.name}/time"]
            times = np.linspace(known[0], known[-1], FLOWN)
            trails.append(Trail(payload.name, times, flown(result, payload.name, times), OF_PAYLOADS, True))
    return tuple(trails)


def thinned(times: Array, path: Array, most: int) -> tuple[Array, Array]:
    """Return ``most`` places (K, 3) of a path at most with their times (K,), and one nan between stretches of it."""
    known = np.isfinite(path).all(axis=1)
    kept = np.flatnonzero(known)[evenly(int(known.sum()), most)]
    behind = np.flatnonzero(np.diff(np.cumsum(~known)[kept])) + 1
    return np.insert(times[kept], behind, times[kept[behind - 1]]), np.insert(
        path[kept], behind, np.nan, axis=0
    )


def paths_of(result: Result, problem: Problem | None = None) -> dict[str, tuple[Array, Array]]:
    """Return times (K,) and places (K, 3) of the named points that move, between samples where these are few; nan
    where that is not known."""
    paths = {name: _broken(result, name, path) for name, path in moving_paths(result).items()}
    if not paths or len(result.time) >= FINE or not can_draw(result):
        return paths
    problem = problem or problem_of(result)
    between = motion_between(result, problem)
    if between is None:
        return paths
    expressions, frames = DrawnExpressions(problem), problem.model.points
    own = {name: expressions.vertex(frames[name].body, frames[name].p) for name in paths if name in frames}
    t, q = between
    places, _, _ = expressions.evaluate(t, q, np.zeros((len(t), problem.model.nv)))
    fine = {name: (t, finite(places[:, k])) for name, k in own.items() if k is not None}
    return {**paths, **fine}


def _broken(result: Result, name: str, path: Array) -> tuple[Array, Array]:
    """Return times (K,) and places (K, 3) of a point at the samples, with nan where these are too far apart."""
    behind = np.flatnonzero(too_far_apart(result, f"points/{name}").any(axis=1)) + 1
    return np.insert(result.time, behind, result.time[behind - 1]), np.insert(path, behind, np.nan, axis=0)


def plane_of(points: Array, slim: Sequence[int]) -> tuple[int | None, Array | None]:
    """Return across which of the world's axes a mechanism is planar, by its places (T, N, 3), or else the normal (3,)
    of its plane; None of both in space.

    Across a plane nothing moves, and little extends of the ``slim`` places: not of boxes that stand for bodies. A
    mechanism that turns about other axes only by chance (a pendulum of a ball joint swinging in a plane) counts as
    planar: that is how it is seen best. z comes first, then y.
    """
    points = points[np.isfinite(points).all(axis=(1, 2))]
    if not points.size:
        return None, None
    for axis in (2, 1, 0):
        if _is_normal(np.eye(3)[axis], points, slim):
            return axis, None
    normal = _normal(points)
    return None, normal if normal is not None and _is_normal(normal, points, slim) else None


def _is_normal(normal: Array, points: Array, slim: Sequence[int]) -> bool:
    """Tell whether places (T, N, 3) do not move along a unit vector, and the ``slim`` ones extend little along it."""
    along = points @ normal
    across = points - along[..., None] * normal
    size = float(np.ptp(across.reshape(-1, 3), axis=0).max(initial=0.0))
    moved = float(np.ptp(along, axis=0).max(initial=0.0))
    thick = float(np.ptp(along[:, list(slim)])) if slim else 0.0
    return moved <= STILL * size and thick <= THIN * size


def _normal(points: Array) -> Array | None:
    """Return the normal (3,) of the plane that places (T, N, 3) move in, or lie in where they move along a line or not
    at all; None where a line holds all."""
    moves, lies = (x.reshape(-1, 3) for x in (points - points[:1], points - points.mean(axis=(0, 1))))
    size = np.abs(lies).max()
    ways, along = _axes(moves, size)
    if ways < 2:
        held = along[:ways]
        more, across = _axes(lies - lies @ held.T @ held, size)
        ways, along = ways + more, np.concatenate([held, across])
    return np.cross(along[0], along[1]) if ways >= 2 else None


def _axes(vectors: Array, size: float) -> tuple[int, Array]:
    """Return along how many directions vectors (K, 3) extend, and unit vectors (3, 3) along these, longest first."""
    _, sizes, axes = np.linalg.svd(vectors, full_matrices=False)
    return int(np.sum(sizes > STILL * size)), axes
