"""Close the loops of a mechanism and say how: positions, rates, accelerations, branches."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError
from robodyn_cli.expr.rebuild import Evaluator, evaluate
from robodyn_cli.results.result import Result
from robodyn_cli.run.driver.prepare import held_columns, initial_positions
from robodyn_cli.run.driver.singularity import loop_rows
from robodyn_cli.run.mechanism.loop_conditions import Lead, LoopConditions
from robodyn_cli.run.mechanism.mobility import mobility
from robodyn_cli.run.mechanism.prescribed import check_prescribed
from robodyn_cli.run.observation.places import add_places, place_outputs
from robodyn_cli.run.observation.units import joint_columns
from robodyn_cli.run.progress import Progress, no_progress
from robodyn_cli.run.stopwatch import Stopwatch
from robodyn_cli.scene.types import Scene
from robodyn_cli.solve.assembly import Assembled
from robodyn_cli.solve.assembly import assemble as close_loops
from robodyn_cli.solve.branches import Search, search
from robodyn_cli.solve.load_sharing import RANK

Array = NDArray[np.float64]


def assemble(scene: Scene, *, progress: Progress = no_progress, watch: Stopwatch | None = None) -> Result:
    """Close the loops at t = 0 at position, velocity and acceleration level.

    Rates that are not given, and accelerations, are those of least norm that the constraints allow.

    Returns
    -------
    A Result of one sample, and of all branches that were found where ``assemble.branches`` asks for them; held and
    solved coordinates, residuals and mobility in the summary.

    Raises
    ------
    CapabilityError : no loops, or branches of a mechanism that may still move. GeometryError : a loop cannot close;
    which, and by how much. SingularConfigurationError : the constraints lose rank there.
    """
    watch = watch or Stopwatch()
    if not scene.loops and not scene.couplers:
        raise CapabilityError(f"{scene.path}: assemble closes loops; this scene has none")
    with watch.stage("equations"):
        problem = Problem(scene)
        given = initial_positions(scene, problem)
        held = tuple(dict.fromkeys((*scene.initial.hold, *scene.prescribed)))
        check_prescribed(problem)
    with watch.stage("assemble"):
        stays = (*held_columns(scene, problem), *scene.prescribed)
        assembled = close_loops(problem, given, dict(scene.initial.qd), stays)
        conditions = LoopConditions(problem, _nothing(), np.zeros(1))
        _, b = conditions.rates(assembled.q, assembled.v, 0.0)
        _, J = conditions.at(assembled.q, 0.0)
        a, *_ = np.linalg.lstsq(J, b, rcond=RANK)
    result = Result("assemble", scene.title or "assemble", "ok", scene.text)
    model = problem.model
    result.add("time", np.zeros(1))
    columns = joint_columns(model)
    for path, data in (("q", assembled.q), ("qd", assembled.v), ("qdd", a)):
        result.add(path, data[None], **columns[path].described())
    _add_places(result, problem, assembled)
    summary = result.summary
    summary["status"] = "ok"
    summary["termination"] = {"reason": "closed", "time": 0.0}
    summary["samples"] = 1
    summary["configuration"] = dict(zip(model.q_names, assembled.q.tolist()))
    summary["rates"] = dict(zip(model.v_names, assembled.v.tolist()))
    summary["accelerations"] = dict(zip(model.v_names, a.tolist()))
    summary["held"] = list(held)
    summary["solved"] = [name for name in model.joint_names if name not in held]
    c, _ = conditions.rates(assembled.q, assembled.v, 0.0)
    F, _ = conditions.at(assembled.q, 0.0)
    levels = {"position": F, "velocity": J @ assembled.v - c, "acceleration": J @ a - b}
    summary["residual"] = {name: float(np.abs(x).max(initial=0.0)) for name, x in levels.items()}
    summary["residual_by_loop"] = _by_loop(problem, F)
    summary["redundant_rows"] = list(assembled.redundant)
    loops = loop_rows(problem)
    summary["mobility"] = mobility(problem, J[None, loops, :])
    if scene.assemble.branches:
        with watch.stage("branches"):
            _add_branches(result, problem, conditions, assembled, held)
    progress(0.0, 0.0)
    summary["wall_time_s"] = watch.report()
    return result


def _nothing() -> Lead:
    return Lead(lambda times: (np.zeros((len(times), 0)),) * 3)


def _by_loop(problem: Problem, F: Array) -> dict[str, float]:
    """Return the largest position residual of each loop."""
    found: dict[str, float] = {}
    for i in loop_rows(problem):
        loop = problem.constraints.rows[i].name.rsplit(".", 1)[0]
        found[loop] = max(found.get(loop, 0.0), float(abs(F[i])))
    return found


def _add_places(result: Result, problem: Problem, assembled: Assembled) -> None:
    values = {"q": assembled.q.tolist(), "v": assembled.v.tolist(), "t": [0.0], "p": []}
    places = place_outputs(problem)
    add_places(result, {path: np.array([evaluate(e, values)], dtype=float) for path, e in places.items()})


def _add_branches(
    result: Result, problem: Problem, conditions: LoopConditions, assembled: Assembled, held: tuple[str, ...]
) -> None:
    """Find the other branches with the held joints where they are, and add them."""
    model = problem.model
    stays = [b.v + j for b in model.bodies if b.joint_name in held for j in range(b.joint.nv)]
    free = [k for k in range(model.nv) if k not in stays]
    _, J = conditions.at(assembled.q, 0.0)
    loops = loop_rows(problem)
    s = np.linalg.svd(J[loops][:, free], compute_uv=False) if free else np.zeros(0)
    left = len(free) - int((s > RANK * max(float(s.max(initial=0.0)), 1e-300)).sum())
    if left > 0:
        raise CapabilityError(
            f"with {', '.join(held) or 'nothing'} held the mechanism keeps {left} degrees of freedom, so it closes in "
            f"infinitely many ways; hold {left} more joints (initial.hold, or --at) to find its branches"
        )
    kinds = [_is_angle(problem, k) for k in range(model.nq)]
    neutral = np.array(assembled.q)
    for body in model.bodies:
        if body.joint_name not in held:
            neutral[body.q : body.q + body.joint.nq] = body.joint.neutral()

    def start(point: Array) -> Array:
        dq = np.zeros(model.nv)
        dq[free] = (2.0 * point - 1.0) * np.where(
            conditions.lengths[free] == 1.0, np.pi, 1.5 * conditions.size
        )
        return conditions.step(neutral, dq)

    def signature(q: Array) -> Array:
        turns = np.concatenate([np.where(kinds, np.cos(q), q), np.where(kinds, np.sin(q), 0.0)])
        return np.concatenate([turns, *(_attitude(b, q) for b in model.bodies if b.joint.quasi)])

    cosines = Evaluator([row.cosine for row in problem.constraints.rows])

    def accepted(q: Array) -> bool:
        found = np.array(cosines({"q": q.tolist(), "t": [0.0], "p": []}), dtype=float)
        return bool(np.all(found > 0.5))

    searched = search(
        conditions, assembled.q, free, start, signature, accepted, problem.scene.assemble.starts
    )
    _describe_branches(result, problem, conditions, searched, free, kinds)


def _is_angle(problem: Problem, k: int) -> bool:
    return problem.model.q_units[k] == "rad"


def _attitude(body: Any, q: Array) -> Array:
    """Return the products of a quasi-velocity joint's coordinates: the same for a quaternion and its negative."""
    own = q[body.q : body.q + body.joint.nq]
    return np.outer(own, own).ravel()


def _describe_branches(
    result: Result,
    problem: Problem,
    conditions: LoopConditions,
    searched: Search,
    free: list[int],
    kinds: list[bool],
) -> None:
    model = problem.model
    loops = loop_rows(problem)
    branches, determinants = [], []
    states = []
    for k, q in enumerate(searched.found):
        q = np.where(kinds, (q + np.pi) % (2 * np.pi) - np.pi, q) if k else q
        states.append(q)
        F, J = conditions.at(q, 0.0)
        block = J[loops][:, free]
        s = np.linalg.svd(block, compute_uv=False)
        square = block.shape[0] == block.shape[1]
        determinant = float(np.linalg.det(block)) if square else None
        determinants.append(np.nan if determinant is None else determinant)
        ratio = float(s[-1] / s[0]) if len(s) else 1.0
        sign = None if determinant is None else int(np.sign(determinant)) if ratio > 1e-7 else 0
        branches.append({
            "configuration": dict(zip(model.q_names, q.tolist())),
            "determinant": determinant, "orientation": sign, "singular_ratio": ratio,
            "residual": float(np.abs(F).max()), "chosen": k == 0,
        })  # fmt: skip
    result.add("branches/q", np.array(states), units=joint_columns(model)["q"].units, names=model.q_names)
    if not np.any(np.isnan(determinants)):
        result.add("branches/determinant", np.array(determinants))
    outlines: dict[str, list[Any]] = {}
    for q in states:
        values = {"q": q.tolist(), "t": [0.0], "p": []}
        for name, outline in model.outlines.items():
            corners = [evaluate(list(problem.world_point(corner)), values) for corner in outline]
            outlines.setdefault(name, []).append(corners)
    for name, corners in outlines.items():
        result.add(f"branch_skeleton/{name}", np.array(corners, dtype=float))
    result.summary["branches"] = branches
    result.summary["branch_search"] = {
        "starts": searched.starts, "closed": searched.closed, "found": len(branches),
        "complete": "not proved: what many quasi-random starts of Newton's method found",
    }  # fmt: skip
