"""Instants of a motion at which its equations are linearised: where steps end, so that no spike is missed."""

from __future__ import annotations

import dataclasses

import numpy as np

from robodyn_cli.errors import RobodynError
from robodyn_cli.integrators.runtime.grid import Grid
from robodyn_cli.integrators.runtime.options import Options
from robodyn_cli.motion.build import build_motion
from robodyn_cli.motion.driver import Driver, MethodChange
from robodyn_cli.over.numerics.trial import Reference
from robodyn_cli.ready.integrable import integrable
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import Array

TOLERANCE = 1e-6  # of the run whose steps are looked at: loose steps follow every spike too
EVENLY = 65  # instants at equal distances, too
MOST = 1024  # ends of steps that are kept
WORK = 3e7  # instants times the cube of the states: what eigenvalues of all of them may cost
LONG_CHAIN, FEW = 30, 3  # velocities beyond which so few instants are worth their time


class StepEnds:
    """Supervisor that notes where steps end: each of them, or each 2nd, 4th, ... once there are very many."""

    def __init__(self, most: int) -> None:
        self.most, self.every, self.steps = most, 1, 1
        self.times: list[float] = []
        self.states: list[Array] = []

    def reconsider(self, driver: Driver) -> MethodChange | None:
        """Note the present state."""
        self.steps = driver.attempts + self.every
        if not self.times or driver.time > self.times[-1]:
            self.times.append(driver.time)
            self.states.append(driver.state)
        if len(self.times) >= 2 * self.most:
            del self.times[::2], self.states[::2]
            self.every *= 2
        return None


def instants(scene: Scene, ref: Reference, nq: int, nv: int) -> tuple[Array, Array, Array]:
    """Return times (T,), q (T, nq) and v (T, nv) of the reference at equal distances and where steps end."""
    count = EVENLY if nv <= LONG_CHAIN else FEW
    places = np.unique(np.linspace(0, len(ref.times) - 1, count).round().astype(int))
    q, v = np.split(ref.states[places], [nq], axis=1)
    if nv > LONG_CHAIN:
        return ref.times[places], q, v
    try:
        times, more_q, more_v = step_ends(scene, ref, int(max(EVENLY, min(MOST, WORK / (nq + nv) ** 3))))
    except RobodynError:
        return ref.times[places], q, v
    times = np.concatenate([ref.times[places], times])
    order = np.argsort(times, kind="stable")
    return times[order], np.concatenate([q, more_q])[order], np.concatenate([v, more_v])[order]


def step_ends(scene: Scene, ref: Reference, most: int) -> tuple[Array, Array, Array]:
    """Return times, q and v where steps of the reference's method end, ``most`` at most.

    Raises
    ------
    RobodynError : the method does not get through.
    """
    method = ref.methods[0].partition(" ")[0]
    changed = dataclasses.replace(scene.simulate, integrator=method, step=None)
    motion = build_motion(integrable(dataclasses.replace(scene, simulate=changed)), work=False)
    looks = StepEnds(most)
    options = Options(TOLERANCE, TOLERANCE, max_steps=scene.simulate.max_steps)
    driver = Driver(motion.system, method, options, motion.watchers, looks)
    driver.start(0.0, motion.start)
    driver.run(ref.until, Grid(ref.until, 0.0, 0), lambda t, x: None)
    kept = np.unique(np.linspace(0, len(looks.times) - 1, most).round().astype(int))
    q, v, _ = motion.system.split(np.array(looks.states)[kept])
    return np.array(looks.times)[kept], q, v
