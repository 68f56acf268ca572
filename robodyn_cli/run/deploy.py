"""Deployment of a mechanism until it locks."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.algorithms.constraints import determinant
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError, NumericalError, RobodynError, SingularConfigurationError
from robodyn_cli.expr.graph import Scalar
from robodyn_cli.formulations.index1 import index1, multiplier_norm
from robodyn_cli.formulations.system import GROUPS, EventFunction, System
from robodyn_cli.integrators.integrator import Event, Grid, Integrator, Options
from robodyn_cli.kernels.samples import SampleKernel
from robodyn_cli.results.result import Result
from robodyn_cli.results.writer import ResultWriter
from robodyn_cli.run.growth import GRID, GrowthMonitor, levels_with
from robodyn_cli.run.latch import close_latch
from robodyn_cli.run.method import choose
from robodyn_cli.run.observe import Observer, Recorder
from robodyn_cli.run.progress import Progress, no_progress
from robodyn_cli.run.simulate import (
    Setup,
    describe_run,
    estimate_error,
    fail,
    keep_last_state,
    kept_every,
    new_result,
    options_for,
    passive_coordinates,
    prepare,
    tighter,
)
from robodyn_cli.run.singularity import (
    NEAR_RANK_LOSS,
    classify,
    driven_dead_point,
    loop_rows,
    passive_determinant,
    psi_at,
    rank_loss_ahead,
    rank_loss_event,
)
from robodyn_cli.run.stopwatch import Stopwatch
from robodyn_cli.scene.types import Scene

Array = NDArray[np.float64]


# smallest singular value of the passive block, relative to the largest of Psi, that is still worth reporting
NEAR_SINGULAR = 1e-3


@dataclasses.dataclass
class Found:
    """What the scan of the whole motion met, by kind: time and state (q, v, z)."""

    dead_point: tuple[float, Array] | None = None
    bifurcation: tuple[float, Array] | None = None
    stopped: NumericalError | None = None
    driven: bool = False
    growth: GrowthMonitor = dataclasses.field(default_factory=lambda: GrowthMonitor(()))
    end: float = 0.0
    clean_until: float = 0.0
    norm_at_end: float = 0.0


class Deployment:
    """One deployment: the mechanism, its singularity functions, the scan and the run."""

    def __init__(self, scene: Scene, watch: Stopwatch) -> None:
        self.scene = scene
        if not scene.loops:
            raise CapabilityError(f"{scene.path}: deploy needs a mechanism with closed loops; this scene has none")
        self.setup: Setup = prepare(scene, watch)
        self.problem: Problem = self.setup.problem
        with watch.stage("equations"):
            self.passive = passive_coordinates(self.problem) or []
            self.determinant: Scalar | None = None
            try:
                self.determinant = passive_determinant(self.problem, self.passive)
            except CapabilityError:
                if scene.deploy.criterion != "multipliers":
                    raise
            events = rank_loss_event(self.problem)
            if self.determinant is not None:
                events = (*events, EventFunction("dead_point", self.determinant, terminal=False))
            self.system: System = index1(self.problem, scene.simulate.stabilisation, events)
            self.options: Options = options_for(scene)
            self.start = np.concatenate(
                [self.setup.assembled.q, self.setup.assembled.v, np.zeros(self.system.nz)]
            )
        with watch.stage("method"):
            self.choice = choose(scene, self.problem, self.system, self.start, self.options)
            self.method = self.choice.method

    def scan(self, options: Options, multipliers: bool = True, progress: Progress = no_progress) -> Found:
        """Integrate until everything that can stop the deployment has fired, or to the end of the duration.

        The motion is followed on the uniform 1 ms grid, free of the criterion, so that the report can say when
        each criterion fired. A dead point ends the scan once the multipliers have been judged up to it.
        """
        scene, problem = self.scene, self.problem
        found = Found(growth=GrowthMonitor(levels_with(scene.deploy.growth), scene.deploy.limit))
        lam = SampleKernel({"lam": self._loop_multipliers()}, GROUPS) if multipliers else None
        integrator = Integrator(self.system, self.method)
        integrator.reset(0.0, self.start, options)
        duration = scene.simulate.duration
        integrator.tick = lambda time: progress(time, duration)
        grid = Grid(0.0, GRID, int(duration / GRID * (1 + 1e-12)) + 1)

        def emit(t: Array, x: Array) -> None:
            if lam is None:
                return
            s = self.system
            values = lam.evaluate(
                len(t), {"t": t, "q": x[:, : s.nq], "v": x[:, s.nq : s.nq + s.nv], "z": x[:, s.nq + s.nv :],
                         "p": np.zeros(1)},
            )["lam"]  # fmt: skip
            norm = multiplier_norm(values)
            found.norm_at_end = float(norm[-1])
            found.growth.take(t, norm)

        def on_event(event: Event) -> bool:
            if event.name == NEAR_RANK_LOSS:
                found.clean_until = event.time
                found.bifurcation = rank_loss_ahead(problem, self.system, self.method, event, options)
                return found.bifurcation is None
            kind = classify(problem, event.state[: problem.model.nq], self.passive).kind
            if kind == "dead_point":
                found.dead_point = (event.time, event.state)
                # a criterion on the multipliers may still fire beyond the dead point
                return scene.deploy.criterion == "multipliers" and self._multiplier_time(found) is None
            return True

        try:
            integrator.run(duration, grid, emit, on_event, block=4096)
        except NumericalError as error:
            found.stopped = error
            self._driven_dead_point(found, integrator)
        found.end = integrator.time
        return found

    def _loop_multipliers(self) -> list[Scalar]:
        lam = self.problem.forward.lam
        return [lam[i] for i in loop_rows(self.problem)]

    def _multiplier_time(self, found: Found) -> float | None:
        """Return when the criterion on the multipliers fired."""
        times = [found.growth.times.get(self.scene.deploy.growth), found.growth.limit_time]
        fired = [t for t in times if t is not None]
        return min(fired) if fired else None

    def _driven_dead_point(self, found: Found, integrator: Integrator) -> None:
        """Note the singular pose that a prescribed motion has run into, if that is what stopped the scan."""
        nq = self.problem.model.nq
        state = integrator.state
        pose = driven_dead_point(
            self.problem, self.passive, state[:nq], integrator.time, self.scene.simulate.duration
        )
        if pose is None:
            return
        time, state[:nq], kind = pose
        found.driven = True
        if kind == "bifurcation":
            found.bifurcation = (time, state)
        elif kind == "dead_point":
            found.dead_point = (time, state)

    def stop_time(self, found: Found) -> tuple[float | None, str]:
        """Return when the scene's criterion stops the run, and which criterion it was."""
        dead = found.dead_point[0] if found.dead_point else None
        multipliers = self._multiplier_time(found)
        criterion = self.scene.deploy.criterion
        if criterion == "dead_point":
            return dead, "dead_point"
        if criterion == "multipliers":
            return multipliers, "multipliers"
        candidates = [(t, name) for t, name in ((dead, "dead_point"), (multipliers, "multipliers")) if t is not None]
        return min(candidates) if candidates else (None, "either")


def deploy(
    scene: Scene, progress: Progress = no_progress, watch: Stopwatch | None = None, writer: ResultWriter | None = None
) -> Result:
    """Simulate a mechanism until it locks.

    Parameters
    ----------
    writer : as for ``simulate``.

    Returns
    -------
    A Result with status ``locked``, ``no_lock`` or ``overload``, and ``summary["lock"]``.

    Raises
    ------
    RobodynError : with attribute ``result``; SingularConfigurationError at a bifurcation.
    """
    watch = watch or Stopwatch()
    run = Deployment(scene, watch)
    with watch.stage("scan"):
        found = run.scan(run.options, progress=progress)
    stop, criterion = run.stop_time(found)
    bifurcated = found.bifurcation is not None and (stop is None or found.bifurcation[0] <= stop)
    met = found.bifurcation[0] if bifurcated and found.bifurcation is not None else stop
    recorder, integrator = _record(run, found, met, progress, watch, writer)
    result = new_result(scene, "deploy", recorder, _events(run, found))
    describe_run(result, run.setup, recorder, integrator, run.choice)
    summary = result.summary
    summary["criteria"] = _criteria(run, found)
    if bifurcated and found.bifurcation is not None:
        raise fail(result, _bifurcation(run, found), watch)
    if stop is None and found.stopped is not None:
        raise fail(result, found.stopped, watch)
    if scene.simulate.error_estimate:
        with watch.stage("error_estimate"):
            grid = Grid.over(scene.simulate.duration, scene.simulate.samples)
            summary["error_estimate"] = estimate_error(
                run.setup, run.system, run.method, run.start, grid,
                float(recorder.array("time")[-1]), run.options, recorder, integrator.counters,
            )  # fmt: skip
    if stop is None:
        result.status = summary["status"] = "no_lock"
        summary["termination"] = {"reason": "duration: no lock", "time": scene.simulate.duration}
        summary["lock"] = None
    else:
        with watch.stage("lock"):
            summary["lock"] = _lock(run, found, stop, criterion, recorder, watch)
        _conclude(result, run, found, stop, criterion)
    summary["wall_time_s"] = watch.report()
    return result


def _record(
    run: Deployment, found: Found, stop: float | None, progress: Progress, watch: Stopwatch,
    writer: ResultWriter | None,
) -> tuple[Recorder, Integrator]:
    """Integrate to ``stop`` on the scene's grid and observe; the last sample is the stop itself.

    The events are those of the scan, so that the steps are the same and a singular configuration is met in the
    same way: by a step from afar, never by creeping up to it.
    """
    scene = run.scene
    duration = scene.simulate.duration
    located = [x[0] for x in (found.dead_point, found.bifurcation) if x is not None and not found.driven]
    at_event = stop is not None and stop in located
    with watch.stage("equations"):
        observer = Observer(run.problem, run.system, run.passive)
        integrator = Integrator(run.system, run.method)
    recorder = Recorder(observer, writer, kept_every(scene, writer))
    grid = Grid.over(duration, scene.simulate.samples)
    integrator.reset(0.0, run.start, run.options)
    end = duration if stop is None or at_event else stop
    if found.stopped is not None:
        end = min(end, found.end)
    integrator.tick = lambda time: progress(time, end)

    def emit(t: Array, x: Array) -> None:
        if found.driven:
            # close to the dead point the rates of the passive joints grow without bound: nothing to report there
            angle = observer.singular_ratio(t, x)
            t, x = t[angle > NEAR_SINGULAR], x[angle > NEAR_SINGULAR]
        if len(t):
            recorder.emit(t, x)
        progress(float(t[-1]) if len(t) else end, end)

    if found.bifurcation is not None and stop == found.bifurcation[0]:
        # the way from the threshold on was travelled by extrapolation; samples stop short of the pose
        end = stop - 1e-2 * (stop - found.clean_until)
        grid = dataclasses.replace(grid, count=int(end / grid.step) + 1)

    def on_event(event: Event) -> bool:
        return not (at_event and stop is not None and event.time >= stop - 1e-9 * max(1.0, stop))

    with watch.stage("integrate"):
        try:
            integrator.run(end, grid, emit, on_event)
        except NumericalError:
            if found.stopped is None:
                raise
        if found.bifurcation is not None and stop == found.bifurcation[0]:
            recorder.emit(np.array([stop]), found.bifurcation[1][None, :].copy(), project=False, extra=True)
            recorder.make_last_least_norm(stop)
        elif not found.driven:
            keep_last_state(recorder, integrator)
    return recorder, integrator


def _criteria(run: Deployment, found: Found) -> dict[str, Any]:
    """Say when each criterion fired, whichever was chosen."""
    times = {f"{level:g}": found.growth.times.get(level) for level in found.growth.levels}
    return {
        "chosen": run.scene.deploy.criterion,
        "dead_point": found.dead_point[0] if found.dead_point else None,
        "multipliers": run._multiplier_time(found),
        "growth_times": times,
        "limit_time": found.growth.limit_time,
        "grid": GRID,
    }


def _events(run: Deployment, found: Found) -> list[dict[str, Any]]:
    events: list[dict[str, Any]] = []
    if found.dead_point:
        events.append({"time": found.dead_point[0], "name": "dead_point", "kind": "dead_point"})
    if found.bifurcation:
        events.append({"time": found.bifurcation[0], "name": "rank", "kind": "bifurcation"})
    for level, time in found.growth.times.items():
        events.append({"time": time, "name": f"multipliers {level:g} x median", "kind": "growth"})
    if found.growth.limit_time is not None:
        events.append({"time": found.growth.limit_time, "name": "multipliers over the limit", "kind": "limit"})
    return sorted(events, key=lambda e: float(e["time"]))


def _bifurcation(run: Deployment, found: Found) -> RobodynError:
    assert found.bifurcation is not None
    time, state = found.bifurcation
    nq = run.problem.model.nq
    kind = classify(run.problem, state[:nq], run.passive)
    loops = ", ".join(loop.name for loop in run.problem.model.loops)
    angles = dict(zip(run.problem.model.joint_names, state[:nq].tolist()))
    return SingularConfigurationError(
        f"bifurcation instead of a lock at t = {time:.9g} s: the constraint Jacobian of loop {loops} loses rank "
        f"(singular values {kind.psi[0]:.3g} to {kind.psi[-1]:.1e}); the multipliers are not unique there and the "
        "mechanism may go on in more than one way",
        time=time, kind="bifurcation", singular_values=kind.psi.tolist(), angles=angles,
    )  # fmt: skip


def _lock(
    run: Deployment, found: Found, stop: float, criterion: str, recorder: Recorder, watch: Stopwatch
) -> dict[str, Any]:
    """Describe the lock: time and its error, configuration, kind, multipliers, latch."""
    problem, scene = run.problem, run.scene
    nq, nv = problem.model.nq, problem.model.nv
    if found.dead_point and criterion == "dead_point":
        state = found.dead_point[1]
        q, qd = state[:nq], state[nq : nq + nv]
    else:
        q, qd = recorder.array("q")[-1], recorder.array("qd")[-1]
    here = classify(problem, q, run.passive)
    kind = here.kind
    if kind == "regular":
        kind = "approaching_dead_point" if _approaches(run, found, stop) else "overload"
    norm = multiplier_norm(recorder.array("constraints/multipliers")[:, loop_rows(problem)])
    growth = _criteria(run, found)["growth_times"]
    error = None
    if scene.simulate.error_estimate:
        with watch.stage("error_estimate"):
            error = _time_error(run, found, stop, criterion)
    report: dict[str, Any] = {
        "time": stop,
        "time_error": error,
        "time_error_method": "difference from a second, tighter integration; for growth, one grid interval",
        "angles": dict(zip(problem.model.joint_names, q.tolist())),
        "angles_deg": {
            n: float(np.degrees(x)) for n, x, u in zip(problem.model.joint_names, q, problem.model.q_units) if u == "rad"
        },
        "rates": dict(zip(problem.model.joint_names, qd.tolist())) if not found.driven else None,
        "kind": kind,
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
        report["latch"] = close_latch(problem, latch.between[0], latch.between[1], q, qd, stop).as_dict(
            problem.model.joint_names
        )
    elif latch is not None:
        report["latch"] = None
        report["latch_note"] = "rates are unbounded at a dead point that is driven through, so no impulse exists"
    return report


def _approaches(run: Deployment, found: Found, stop: float) -> bool:
    """Tell multipliers that rise from the stop to a dead point from an overload that passes by itself."""
    if found.dead_point is None or found.dead_point[0] < stop:
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
    second, _ = tighter(run.options, stop / 50)
    again = run.scan(second, multipliers=False)
    if again.dead_point is None:
        return None
    return max(abs(again.dead_point[0] - stop), 2e-16 * stop)


def _conclude(result: Result, run: Deployment, found: Found, stop: float, criterion: str) -> None:
    """Set status and the reason in words."""
    lock = result.summary["lock"]
    kind = lock["kind"]
    status = "overload" if kind == "overload" else "locked"
    if kind == "overload":
        reason = "the multipliers passed their threshold away from any singular configuration: overload"
    elif criterion == "multipliers":
        reason = "the multipliers passed their threshold"
        if kind == "approaching_dead_point":
            reason += f", on the way to the dead point at t = {found.dead_point[0] if found.dead_point else 0:.9g} s"
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


def passive_block_determinant(problem: Problem) -> Scalar:
    """Return the determinant that ``deploy`` follows, for plots and the plan."""
    passive = passive_coordinates(problem) or []
    value: Scalar = determinant(problem.psi[loop_rows(problem)][:, passive])
    return value
