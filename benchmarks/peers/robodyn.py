"""robodyn itself: a run from ``reset`` to the end state, or to the lock."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from cases import CONFIGS, Chain, Entry, FourBar

TOLERANCES = {
    "gauss": tuple(10.0**-k for k in range(2, 15)),
    "rodas5p": tuple(10.0**-k for k in range(3, 12)),
    "radau13": tuple(10.0**-k for k in range(3, 12)),
}


def chain_system(case: Chain) -> tuple[Any, np.ndarray]:
    """Return the system and its state at t = 0."""
    from robodyn_cli.formulations.build import build_system
    from robodyn_cli.ready.prepare import prepare
    from robodyn_cli.scene.load import load_scene_text

    setup = prepare(load_scene_text(case.scene_text()))
    return build_system(setup.problem, work=False), np.concatenate([setup.assembled.q, setup.assembled.v])


def four_bar_system() -> tuple[Any, np.ndarray]:
    """Return the system, with the dead point as its event, and the closed state at t = 0."""
    from robodyn_cli import load_scene
    from robodyn_cli.formulations.build import build_system
    from robodyn_cli.formulations.events import EventFunction, Stopping
    from robodyn_cli.ready.prepare import passive_coordinates, prepare
    from robodyn_cli.ready.singularity import passive_determinant

    setup = prepare(load_scene(CONFIGS / "four_bar_deploy.yaml"))
    determinant = passive_determinant(setup.problem, passive_coordinates(setup.problem))
    system = build_system(
        setup.problem, events=(EventFunction("dead_point", determinant, owner=Stopping()),), work=False
    )
    return system, np.concatenate([setup.assembled.q, setup.assembled.v])


def entries(case: Any, methods: Any = ()) -> Iterator[Entry]:
    """Yield a run for each tolerance: Gauss for smooth cases, Rodas5P and Radau IIA for stiff ones.

    A short run at a coarse tolerance is one for fewer stages.
    """
    from robodyn_cli.integrators.runtime.integrator import Integrator
    from robodyn_cli.integrators.runtime.options import Options

    smooth = ("gauss", "gauss8") if isinstance(case, FourBar) else ("gauss",)
    for method in methods or (("rodas5p", "radau13") if case.stiff else smooth):
        system, start = four_bar_system() if isinstance(case, FourBar) else chain_system(case)
        integrator = Integrator(system, method)
        for rtol in TOLERANCES.get(method, TOLERANCES["gauss"]):
            options = Options(rtol, 1e-2 * rtol)
            if isinstance(case, FourBar):
                yield Entry(f"robodyn {method}", f"rtol {rtol:.0e}", to_lock(integrator, start, options))
            else:
                run, path = swing(integrator, start, options, case)
                yield Entry(f"robodyn {method}", f"rtol {rtol:.0e}", run, path)


def to_lock(integrator: Any, start: np.ndarray, options: Any) -> Any:
    from robodyn_cli.integrators.runtime.options import Grid

    grid = Grid(0.0, 20.0, 2)

    def run() -> tuple[float, int]:
        integrator.reset(0.0, start, options)
        integrator.run(20.0, grid, lambda t, x: None)
        return integrator.time, integrator.counters.steps

    return run


def swing(integrator: Any, start: np.ndarray, options: Any, case: Chain) -> tuple[Any, Any]:
    from robodyn_cli.integrators.runtime.options import Grid

    def run() -> tuple[np.ndarray, int]:
        integrator.reset(0.0, start, options)
        integrator.advance(case.duration)
        return integrator.state, integrator.counters.steps

    def path() -> tuple[np.ndarray, np.ndarray]:
        """Samples every 0.1 ms, of which those are kept at which engines are judged."""
        times, states = [np.zeros(1)], [start[None]]
        wanted = np.round(case.times * 1e4).astype(int)

        def emit(t: np.ndarray, x: np.ndarray) -> None:
            keep = np.isin(np.round(t * 1e4).astype(int), wanted)
            times.append(t[keep])
            states.append(x[keep])

        integrator.reset(0.0, start, options)
        integrator.run(case.duration, Grid(0.0, 1e-4, round(case.duration * 1e4) + 1), emit, watch=False)
        return np.concatenate(times), np.concatenate(states)

    return run, path
