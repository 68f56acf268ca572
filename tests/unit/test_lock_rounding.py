"""Figures of a lock against the energy of a four-bar: what its motion to the dead point leaves is known without integration.

At the lock the crank is at rest and coupler and follower turn about their ends; their kinetic energy is the work of the
spring, so pose, rates and multipliers there follow from lengths and masses alone."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from robodyn_cli.scene.load import load_scene
from robodyn_cli.tools.progress import Stopwatch
from robodyn_cli.works.deploy.deploy import build_deployment, deploy
from robodyn_cli.works.deploy.growth import multiplier_norm

SCENE = Path(__file__).parents[2] / "configs" / "four_bar_deploy.yaml"
GROUND, START = 1.241, 0.1
STEINER = (
    0.06,
    0.6,
)  # inertia of coupler and follower about their centres of mass, and how far these are from the joints


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("method", ["gauss", "radau", "dop853"])
def test_errors_at_a_lock_cover_what_both_runs_share(seed: int, method: str) -> None:
    rng = np.random.default_rng(seed)
    a = GROUND * rng.uniform(0.9, 1.0)
    b = rng.uniform(1.0, 1.22)
    c = b + rng.uniform(-0.9, 0.9) * math.sqrt(a * a + GROUND**2 - 2.0 * a * GROUND * math.cos(START))
    masses, preload, n = rng.uniform(3.0, 12.0, 2).tolist(), rng.uniform(1.5, 3.0), int(rng.integers(21, 200))
    settings = [
        f"robot.joints.theta1.a={a!r}", f"robot.joints.phi2.a={b!r}", f"robot.joints.phi1.a={c!r}",
        f"robot.links.coupler.mass={masses[0]!r}", f"robot.links.follower.mass={masses[1]!r}",
        f"torques.theta1#1={preload!r}", f"initial={{q: {{theta1: {START}, phi1: 0.2}}, hold: [theta1]}}",
        "expect={}", "simulate.duration=60", f"simulate.integrator={method}",
    ]  # fmt: skip
    crank = math.acos((a * a + GROUND**2 - (b + c) ** 2) / (2.0 * a * GROUND))
    follower = math.atan2(a * math.sin(crank), a * math.cos(crank) - GROUND)
    inertia, arm = STEINER
    about = [inertia + m * arm**2 for m in masses]
    work = preload * (crank - START) - 0.05 * (crank**2 - START**2)
    speed = math.sqrt(2.0 * work / (about[1] + about[0] * (c / b) ** 2))
    for samples, rtol in ((n, 1e-8), (2 * n + 1, 1e-11), (3 * n - 1, 1e-12), (n, 1e-13)):
        scene = load_scene(SCENE, [*settings, f"simulate.samples={samples}", f"simulate.rtol={rtol}", f"simulate.atol={rtol / 100}"])  # fmt: skip
        lock = deploy(scene).summary["lock"]
        turns = {"theta1": crank, "phi1": follower, "phi2": follower + math.pi - crank}
        true = {
            x: y + 2.0 * math.pi * round((lock["angles"][x] - y) / (2.0 * math.pi)) for x, y in turns.items()
        }
        sign = math.copysign(speed, lock["rates"]["phi1"])
        rates = {"theta1": 0.0, "phi1": sign, "phi2": -c / b * sign}
        motion = build_deployment(scene, Stopwatch())
        model, system = motion.problem.model, motion.system
        q, v = (
            np.array([x[name] for name in names])
            for x, names in ((true, model.q_names), (rates, model.v_names))
        )
        state = system.join(q, v, system.split(motion.start)[2])[None]
        lam = motion.observer.multipliers(np.zeros(1), np.asfortranarray(state))
        norm = float(multiplier_norm(lam[:, motion.problem.constraints.of_loops])[0])
        kinetic, multipliers = lock["latch"], lock["multipliers"]
        figures = {
            "angles": (
                max(abs(lock["angles"][x] - y) for x, y in true.items()),
                lock["errors"]["angles"],
                1.0,
            ),
            "rates": (
                max(abs(lock["rates"][x] - y) for x, y in rates.items()),
                lock["errors"]["rates"],
                speed,
            ),
            "at_lock": (abs(multipliers["at_lock"] - norm), multipliers["errors"]["at_lock"], 10.0 * norm),
            "energy": (abs(kinetic["energy_lost"] - work), kinetic["errors"]["energy_lost"], work),
        }
        for name, (off, error, size) in figures.items():
            assert off <= error <= 10.0 * off + 1e-12 * size, (name, off, error, samples, rtol)
