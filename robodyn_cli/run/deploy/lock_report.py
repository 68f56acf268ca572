"""What a deployment reports: the criteria, the events, the lock and its latch."""

from __future__ import annotations

from typing import Any

import numpy as np

from robodyn_cli.errors import RobodynError, SingularConfigurationError
from robodyn_cli.formulations.index1 import multiplier_norm
from robodyn_cli.results.result import Result
from robodyn_cli.run.deploy.growth import GRID
from robodyn_cli.run.deploy.latch import close_latch, locked
from robodyn_cli.run.deploy.scan import Deployment, Found
from robodyn_cli.run.driver.second_run import other_steps, remainder, tighter
from robodyn_cli.run.driver.singularity import classify, culprit, loop_rows, psi_at
from robodyn_cli.run.observation.recorder import Recorder
from robodyn_cli.run.stopwatch import Stopwatch


def criteria(run: Deployment, found: Found) -> dict[str, Any]:
    """Say when each criterion fired, whichever was chosen."""
    times = {f"{level:g}": found.growth.times.get(level) for level in found.growth.levels}
    return {
        "chosen": run.scene.deploy.criterion,
        "dead_point": found.dead_point[0] if found.dead_point else None,
        "multipliers": run.multiplier_time(found),
        "growth_times": times,
        "limit_time": found.growth.limit_time,
        "grid": GRID,
    }


def events(run: Deployment, found: Found) -> list[dict[str, Any]]:
    found_events: list[dict[str, Any]] = []
    for time, _ in found.dead_points:
        found_events.append({"time": time, "name": "dead_point", "kind": "dead_point"})
    if found.bifurcation:
        found_events.append({"time": found.bifurcation[0], "name": "rank", "kind": "bifurcation"})
    for level, time in found.growth.times.items():
        found_events.append({"time": time, "name": f"multipliers {level:g} x median", "kind": "growth"})
    if found.growth.limit_time is not None:
        found_events.append(
            {"time": found.growth.limit_time, "name": "multipliers over the limit", "kind": "limit"}
        )
    return sorted(found_events, key=lambda e: float(e["time"]))


def bifurcation(run: Deployment, found: Found) -> RobodynError:
    assert found.bifurcation is not None
    time, state = found.bifurcation
    q, _, _ = run.system.split(state)
    kind = classify(run.problem, q, run.passive)
    named = culprit(run.problem, q, range(run.problem.model.nv), time)
    angles = dict(zip(run.problem.model.q_names, q.tolist()))
    return SingularConfigurationError(
        f"bifurcation instead of a lock at t = {time:.9g} s: the constraint Jacobian of loop {named.loop} loses rank "
        f"(singular values {kind.psi[0]:.3g} to {kind.psi[-1]:.1e}); the multipliers are not unique there and the "
        "mechanism may go on in more than one way",
        time=time, kind="bifurcation", singular_values=kind.psi.tolist(), angles=angles,
        loop=named.loop, joint=named.joint,
    )  # fmt: skip


def describe_lock(
    run: Deployment, found: Found, stop: float, criterion: str, recorder: Recorder, watch: Stopwatch
) -> dict[str, Any]:
    """Describe the lock: time and its error, configuration, kind, multipliers, latch."""
    problem, scene = run.problem, run.scene
    if found.dead_point and criterion == "dead_point":
        q, qd, _ = run.system.split(found.dead_point[1])
    else:
        q, qd = recorder.array("q")[-1], recorder.array("qd")[-1]
    here = classify(problem, q, run.passive)
    kind = here.kind
    if kind == "regular":
        kind = "approaching_dead_point" if _approaches(run, found, stop) else "overload"
    named = culprit(problem, q, run.passive, stop) if run.passive else None
    norm = multiplier_norm(recorder.array("constraints/multipliers")[:, loop_rows(problem)])
    growth = criteria(run, found)["growth_times"]
    error = None
    if scene.simulate.error_estimate:
        with watch.stage("error_estimate"):
            error = _time_error(run, found, stop, criterion)
    report: dict[str, Any] = {
        "time": stop,
        "time_error": error,
        "time_error_method": "not asked for"
        if error is None and not scene.simulate.error_estimate
        else "difference from a second, tighter integration; for growth, one grid interval",
        "angles": dict(zip(problem.model.q_names, q.tolist())),
        "angles_deg": {
            name: float(np.degrees(x))
            for name, x, unit in zip(problem.model.q_names, q, problem.model.q_units)
            if unit == "rad"
        },
        "rates": dict(zip(problem.model.v_names, qd.tolist())) if not found.driven else None,
        "kind": kind,
        "joint": named.joint if named else None,
        "loop": named.loop if named else None,
        "criterion": criterion,
        "driven": found.driven,
        "multiplier_growth": {
            "largest_ratio": found.growth.ratio, "times": growth, "median_grid": GRID,
        },
        "growth_times": growth,
        "multipliers": {
            "start": float(norm[0]), "at_lock": float(norm[-1]), "largest_until_lock": float(norm.max()),
            "rows": [problem.constraints.rows[i].name for i in loop_rows(problem)],
            "diverge": found.driven,
        },
        "singular_values": {
            "psi": np.linalg.svd(psi_at(problem, q), compute_uv=False).tolist(),
            "passive": here.passive.tolist(),
        },
    }  # fmt: skip
    latch = scene.deploy.latch
    if kind == "overload":
        report["latch"] = None
    elif latch is not None and not found.driven:
        run.latch = locked(problem, latch.between[0], latch.between[1], q, stop)
        run.impact = close_latch(problem, run.latch, q, qd, stop)
        report["latch"] = run.impact.as_dict(problem.model.v_names)
    elif latch is not None:
        report["latch"] = None
        report["latch_note"] = (
            "rates are unbounded at a dead point that is driven through, so no impulse exists"
        )
    return report


def _approaches(run: Deployment, found: Found, stop: float) -> bool:
    """Tell multipliers that rise from the stop to a dead point from an overload that passes by itself."""
    if all(time < stop for time, _ in found.dead_points):
        return False
    growth, own = found.growth, run.scene.deploy.growth
    fired = own if growth.times.get(own) == stop else "limit"
    return fired not in growth.calmed


def _time_error(run: Deployment, found: Found, stop: float, criterion: str) -> float | None:
    """Estimate the error of the lock's time from a second, tighter scan."""
    if criterion == "multipliers":
        return GRID
    if found.driven:  # pure geometry: the root of a smooth function, to rounding
        return 1e-15 * max(1.0, abs(stop)) * 10
    if not run.scene.simulate.error_estimate:
        return None
    mean_step = found.end / max(found.steps, 1)
    second, _ = tighter(run.options, mean_step, run.method)
    again = run.scan(second, multipliers=False)
    if again.steps <= 1.02 * found.steps and run.options.step is None:
        again = run.scan(other_steps(second, mean_step)[0], multipliers=False)
    if again.dead_point is None:
        return None
    # the scans may end at different times, so it is steps per second that count
    pace = found.end / max(again.end, 1e-300)
    apart = abs(again.dead_point[0] - stop) * remainder(run.method, found.steps, round(again.steps * pace))
    # an agreement below what rounding leaves over the steps of a run says nothing
    return max(apart, 1e-14 * stop)


def conclude(result: Result, run: Deployment, found: Found, stop: float, criterion: str) -> None:
    """Set status and the reason in words."""
    lock = result.summary["lock"]
    kind = lock["kind"]
    status = "overload" if kind == "overload" else "locked"
    if kind == "overload":
        reason = "the multipliers passed their threshold away from any singular configuration: overload"
    elif criterion == "multipliers":
        reason = "the multipliers passed their threshold"
        if kind == "approaching_dead_point":
            ahead = next(time for time, _ in found.dead_points if time >= stop)
            reason += f", on the way to the dead point at t = {ahead:.9g} s"
    elif found.driven:
        names = ", ".join(run.scene.prescribed or {})
        reason = (
            f"dead point under the prescribed motion of {names}: the passive joints cannot follow, and the "
            "multipliers diverge"
        )
    else:
        reason = "dead point: the passive block of Psi loses rank while Psi keeps it"
    result.status = result.summary["status"] = status
    result.summary["termination"] = {"reason": reason, "time": stop, "kind": kind}
