"""Results with plausible content, made without the rest of robodyn: for tests of files and drawings."""

from __future__ import annotations

import numpy as np

from robodyn_cli.results.result import Result

# the mechanism of four_bar_result
FOUR_BAR = """\
schema: 1
gravity: [0, 0, 0]
robot:
  convention: standard
  joints:
    - {name: theta1, type: revolute, parent: base, link: crank, a: 1.0, alpha: 0, d: 0}
    - {name: phi1, type: revolute, parent: crank, link: coupler, a: 1.3, alpha: 0, d: 0}
    - {name: phi2, type: revolute, parent: base, link: follower, origin: {xyz: [2.0, 0, 0]}, a: 1.4, alpha: 0, d: 0}
  links: [{name: crank}, {name: coupler}, {name: follower}]
loops: [{name: pin, type: revolute, between: [coupler.end, follower.end]}]
deploy: {latch: {between: [coupler, follower]}}
"""
M, L, C, I, G = 12.456, 1.0, (0.773, 0.583), 1.042, 9.81


def inverse_result(samples: int = 1001) -> Result:
    """Planar 2R arm tracing a circle, elbow up."""
    time = np.linspace(0.0, 10.0, samples)
    phase = 0.2 * np.pi * time
    target = np.stack([1.2 + 0.2 * np.cos(phase), 1.2 + 0.2 * np.sin(phase), 0.0 * phase], axis=1)
    x, y = target[:, 0], target[:, 1]
    q2 = -np.arccos((x**2 + y**2 - 2.0) / 2.0)
    q1 = np.arctan2(y, x) - np.arctan2(np.sin(q2), 1.0 + np.cos(q2))
    q = np.stack([q1, q2], axis=1)
    qd = np.gradient(q, time, axis=0) if samples > 1 else 0.0 * q
    qdd = np.gradient(qd, time, axis=0) if samples > 1 else 0.0 * q
    m11 = I + M * C[0] ** 2 + I + M * (1 + C[1] ** 2 + 2 * C[1] * np.cos(q2))
    m12 = I + M * (C[1] ** 2 + C[1] * np.cos(q2))
    m22 = np.full_like(m12, I + M * C[1] ** 2)
    s = -M * C[1] * np.sin(q2)
    second = M * G * C[1] * np.cos(q1 + q2)
    terms = {
        "inertia": np.stack([m11 * qdd[:, 0] + m12 * qdd[:, 1], m12 * qdd[:, 0] + m22 * qdd[:, 1]], axis=1),
        "coriolis": np.stack([s * (2 * qd[:, 0] * qd[:, 1] + qd[:, 1] ** 2), -s * qd[:, 0] ** 2], axis=1),
        "gravity": np.stack([M * G * (C[0] + 1.0) * np.cos(q1) * 0.7 + second, second], axis=1),
    }
    tip = np.stack([np.cos(q1) + np.cos(q1 + q2), np.sin(q1) + np.sin(q1 + q2), 0 * q1], axis=1)
    result = Result("inverse", "Planar 2R arm tracing a circle", "ok", "schema: 1\ntitle: Planar 2R\n")
    names = ("theta1", "theta2")
    result.add("time", time)
    result.add("q", q, units="rad", names=names)
    result.add("qd", qd, units="rad/s", names=names)
    result.add("qdd", qdd, units="rad/s^2", names=names)
    result.add("tau", sum(terms.values()), units="N m", names=names)
    for name, data in terms.items():
        result.add(f"torque_terms/{name}", data, units="N m", names=names)
    result.add("points/tip", tip)
    result.add("targets/tip", target)
    result.summary = {"status": "ok", "termination": {"reason": "all samples computed", "time": 10.0}}
    return result


def pendulum_result(samples: int = 1001, duration: float = 10.0) -> Result:
    """Double pendulum of equal point masses, integrated by scipy."""
    from scipy.integrate import solve_ivp

    def rates(t: float, x: np.ndarray) -> list[float]:
        a, b, da, db = x
        c, s = np.cos(a - b), np.sin(a - b)
        m = np.array([[2.0, c], [c, 1.0]])
        f = [-(db**2) * s - 2 * G * np.cos(a), da**2 * s - G * np.cos(b)]
        return [da, db, *np.linalg.solve(m, f)]

    time = np.linspace(0.0, duration, samples)
    start = [-np.pi / 2, -np.pi / 4, 0.0, 0.0]
    a, b, da, db = solve_ivp(rates, (0.0, duration), start, "DOP853", time, rtol=1e-10, atol=1e-12).y
    kinetic = 0.5 * (2 * da**2 + db**2 + 2 * da * db * np.cos(a - b))
    potential = G * (2 * np.sin(a) + np.sin(b))
    elbow = np.stack([np.cos(a), np.sin(a), 0 * a], axis=1)
    tip = elbow + np.stack([np.cos(b), np.sin(b), 0 * b], axis=1)
    result = Result("simulate", "Double pendulum", "ok", "schema: 1\ntitle: Double pendulum\n")
    names = ("theta1", "theta2")
    result.add("time", time)
    result.add("q", np.stack([a, b - a], axis=1), units="rad", names=names)
    result.add("qd", np.stack([da, db - da], axis=1), units="rad/s", names=names)
    result.add("energy/kinetic", kinetic)
    result.add("energy/potential", potential)
    result.add("energy/total", kinetic + potential)
    result.add("energy/work", 0 * kinetic)
    result.add("points/tip", tip)
    result.add("points/elbow", elbow)
    result.summary = {
        "status": "ok",
        "termination": {"reason": "end of the time asked for", "time": duration},
    }
    return result


def four_bar_result(samples: int = 1229) -> Result:
    """Four-bar driven at its crank until coupler and follower align, by geometry alone."""
    ground, crank, coupler, follower = 2.0, 1.0, 1.3, 1.4
    last = np.arccos((crank**2 + ground**2 - (coupler + follower) ** 2) / (2 * crank * ground))
    time = np.linspace(0.0, 12.283, samples)
    theta = 0.01 + (last - 0.01) * (1 - np.cos(np.pi * time / 12.283 * 0.75)) / (1 - np.cos(0.75 * np.pi))
    a = crank * np.stack([np.cos(theta), np.sin(theta), 0 * theta], axis=1)
    d = np.array([ground, 0.0, 0.0])
    span = np.linalg.norm(d - a, axis=1)
    along = (d - a) / span[:, None]
    across = np.stack([-along[:, 1], along[:, 0], 0 * theta], axis=1)
    x = (span**2 + coupler**2 - follower**2) / (2 * span)
    height = np.sqrt(np.maximum(coupler**2 - x**2, 0.0))
    b = a + along * x[:, None] + across * height[:, None]
    phi1 = np.arctan2(b[:, 1] - a[:, 1], b[:, 0] - a[:, 0]) - theta
    phi2 = np.arctan2(b[:, 1], b[:, 0] - ground)
    sine = np.maximum(height / coupler, 1e-9)
    # Finite at alignment, as on the free motion.
    size = 25.0 * np.cos(3.0 * time / 12.283) ** 2 + 2.0 / (sine + 1.3e-3)
    lam = np.stack([size * np.cos(1.3 * theta), -size * np.sin(1.3 * theta)], axis=1)
    rng = np.random.default_rng(1)
    result = Result("deploy", "Four-bar linkage unfolding until it locks", "locked", FOUR_BAR)
    result.add("time", time)
    result.add("q", np.stack([theta, phi1, phi2], axis=1), units="rad", names=("theta1", "phi1", "phi2"))
    result.add("constraints/multipliers", lam, units="N", names=("pin.x", "pin.y"))
    drift = rng.normal(size=(samples, 2)) * 1e-15
    drift[::7] = 0.0
    result.add("constraints/position_residual", drift, units="m", names=("pin.x", "pin.y"))
    result.add("constraints/velocity_residual", 8 * drift[::-1], units="m/s", names=("pin.x", "pin.y"))
    result.add("singularity/psi", np.stack([1.9 + 0.2 * sine, 1.1 + 0.1 * sine], axis=1))
    result.add("singularity/passive", np.stack([1.5 + 0 * sine, sine], axis=1))
    result.add("singularity/determinant", 1.5 * sine)
    growth = {"10": 11.99, "100": 12.196, "1000": 12.268}
    result.summary["lock"] = {"time": 12.283, "kind": "dead_point", "growth_times": growth}
    result.events.append({"time": 12.283, "name": "pin", "kind": "lock", "energy_lost": 4.78})
    return result


def chain_result(joints: int, samples: int = 501) -> Result:
    """A long chain with a wave running along it."""
    time = np.linspace(0.0, 5.0, samples)
    wave = np.sin(2.0 * time[:, None] - 0.12 * np.arange(joints)) * (1.0 + 0.01 * np.arange(joints))
    names = tuple(f"joint{index + 1}" for index in range(joints))
    result = Result("inverse", f"Chain of {joints} joints", "ok", "schema: 1\n")
    result.add("time", time)
    for path, factor, units in (
        ("q", 1, "rad"),
        ("qd", 2, "rad/s"),
        ("qdd", -4, "rad/s^2"),
        ("tau", 80, "N m"),
    ):
        result.add(path, factor * wave, units=units, names=names)
    result.add("torque_terms/inertia", 30 * wave, units="N m", names=names)
    result.add("torque_terms/gravity", 50 * wave, units="N m", names=names)
    return result
