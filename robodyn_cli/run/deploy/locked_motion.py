"""After the latch: the run goes on as the locked structure, with the load in each joint and in the latch."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.equations.problem import Problem
from robodyn_cli.formulations.index1 import index1
from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.runtime.integrator import Grid, Integrator
from robodyn_cli.results.result import Result
from robodyn_cli.run.deploy.latch import LatchImpact, Locked
from robodyn_cli.run.deploy.scan import Deployment
from robodyn_cli.run.driver.second_run import estimate_error
from robodyn_cli.run.observation.observe import Column, Observer
from robodyn_cli.run.observation.reactions import ReactionSamples
from robodyn_cli.run.observation.recorder import Recorder
from robodyn_cli.run.stopwatch import Stopwatch

Array = NDArray[Any]

# what the locked structure says; all else is that of the mechanism without its latch
DYNAMIC = ("qdd", "tau", "constraints/", "reactions/", "loop_reactions/", "base_wrench")


class LockedObserver(Observer):
    """Observes the locked structure; places, energies and singular values are those of the mechanism."""

    def __init__(self, problem: Problem, system: System, before: Observer) -> None:
        super().__init__(problem, system)
        self.before = before
        self.reactions = ReactionSamples(problem, problem.scene.simulate.samples)

    def observe(self, t: Array, x: Array, project: bool = True) -> dict[str, Array]:
        x = self.project(t, x) if project else x
        own = super().observe(t, x, False)
        data = self.before.observe(t, x, False)
        data.update({path: block for path, block in own.items() if path.startswith(DYNAMIC)})
        return data

    def describe(self) -> dict[str, Column]:
        return {**self.before.describe(), **super().describe()}


def follow_locked(
    result: Result, run: Deployment, recorder: Recorder, latch: Locked, impact: LatchImpact, stop: float,
    state: Array, watch: Stopwatch,
) -> None:  # fmt: skip
    """Integrate the locked structure from the lock to the end of the duration, and add it to the result.

    Samples are those of the scene's grid after the lock, of which ``state`` is the state before the impulse.
    """
    scene, summary = run.scene, result.summary
    q, _, z = run.system.split(state)
    with watch.stage("equations"):
        system = index1(latch.problem, scene.simulate.stabilisation)
        observer = LockedObserver(latch.problem, system, recorder.observer)
    grid = Grid.over(scene.simulate.duration, scene.simulate.samples)
    first = grid.first_at(stop)
    if grid.times(first, first + 1)[:1].tolist() == [stop]:
        first += 1
    later = recorder if first >= grid.count else Recorder(observer, None, 1)
    facts: dict[str, Any] = {
        "degrees_of_freedom": latch.freedom, "rows": list(latch.rows), "closure": latch.name,
        "samples": 0, "until": stop,
    }  # fmt: skip
    summary["after_lock"] = facts
    if later is recorder:
        return
    start_time = float(grid.times(first, first + 1)[0])
    rest = Grid(start_time, grid.step, grid.count - first, grid.end)
    integrator = Integrator(system, run.method)
    start = system.join(q, impact.qd_after, z)
    with watch.stage("integrate"):
        integrator.reset(stop, start, run.options)
        integrator.advance(start_time)
        begun = integrator.state
        integrator.reset(start_time, begun, run.options)
        integrator.run(scene.simulate.duration, rest, lambda t, x: later.emit(t, x))
    with watch.stage("error_estimate"):
        facts["error_estimate"] = (
            estimate_error(
                latch.problem,
                system,
                run.method,
                begun,
                rest,
                integrator.time,
                run.options,
                later,
                integrator.counters,
            )
            if scene.simulate.error_estimate
            else None
        )
    if facts["error_estimate"] is not None and facts["error_estimate"].get("at_rounding"):
        facts["error_estimate"].pop(
            "meaningful_until", None
        )  # of what does not move, rounding is all there is
    for path, data in join(recorder, later).items():
        result.add(path, data, **later.described(path))
    facts |= {
        "samples": later.samples,
        "until": integrator.time,
        "energy_drift": later.drift,
        "constraint_residual": {"position": later.position_residual, "velocity": later.velocity_residual},
        "latch": _latch_load(later, latch.name),
        "largest": later.loads,
        "counters": integrator.counters.as_dict(),
    }
    summary["samples"] = len(result.time)
    summary["termination"]["reason"] += "; then followed as the locked structure"
    summary["termination"]["followed_until"] = integrator.time


def join(before: Recorder, after: Recorder) -> dict[str, Array]:
    """Return the samples of both phases by path; the latch bears nothing before it closes."""
    old, new = before.columns, after.columns
    found = {}
    for path in after.blocks:
        later = after.array(path)
        nothing = np.zeros((len(before.array("time")), *later.shape[1:]))
        earlier = before.array(path) if path in before.blocks else nothing
        if path in old and path in new and old[path].names != new[path].names:
            wide = np.zeros((len(earlier), len(new[path].names)))
            for k, name in enumerate(old[path].names):
                wide[:, new[path].names.index(name)] = earlier[:, k]
            earlier = wide
        found[path] = np.concatenate([earlier, later])
    return found


def _latch_load(recorder: Recorder, name: str) -> dict[str, Any]:
    """Return the largest force and moment in the latch, when, and those at the end."""
    path = f"loop_reactions/{name}"
    assert recorder.observer.reactions is not None
    names = recorder.observer.reactions.names[path]
    data, times = recorder.array(path), recorder.array("time")
    found: dict[str, Any] = {}
    for key, letter in (("force", "f"), ("moment", "m")):
        columns = [k for k, column in enumerate(names) if column.startswith(letter)]
        size = np.sqrt((data[:, columns] ** 2).sum(axis=1))
        at = int(np.argmax(size))
        found |= {f"peak_{key}": float(size[at]), f"peak_{key}_time": float(times[at])}
        found[f"{key}_at_end"] = float(size[-1])
    return found


def first_overload(result: Result, limits: dict[str, Any]) -> dict[str, Any] | None:
    """Return the first sample at which a joint or closure bears more than its limit; None if none does."""
    worst: dict[str, Any] | None = None
    for name, limit in limits.items():
        path = next((p for p in (f"reactions/{name}", f"loop_reactions/{name}") if p in result), None)
        if path is None:
            continue
        variable = result.variables[path]
        for quantity, letter in (("force", "f"), ("moment", "m")):
            most = getattr(limit, quantity)
            if most is None:
                continue
            columns = [k for k, column in enumerate(variable.names) if column.startswith(letter)]
            size = np.sqrt((variable.data[:, columns] ** 2).sum(axis=1))
            over = np.flatnonzero(size > most)
            if len(over) and (worst is None or result.time[over[0]] < worst["time"]):
                worst = {
                    "name": name, "quantity": quantity, "limit": most, "time": float(result.time[over[0]]),
                    "value": float(size[over[0]]), "largest": float(size.max()),
                }  # fmt: skip
    return worst
