"""The families of random scenes: a seed gives a mechanism, and methods and tolerances to run it with."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pinocchio as pin

from tests.proof import scenes
from tests.proof.equations import Equations
from tests.proof.locks import deployments
from tests.proof.mechanism import Body, Branch, Bushing, Coupler, Loop, Mechanism, Point
from tests.proof.scenes import Rng, flat, rounded, unit

# methods, and the tightest tolerance that is asked of them; 0 where they take fixed steps
METHODS = {
    "auto": 1e-11, "gauss": 1e-11, "gauss8": 1e-11, "gauss12": 1e-11, "dop853": 1e-11, "dopri5": 1e-10,
    "rodas5p": 1e-9, "rosenbrock23": 1e-6, "radau": 1e-10, "radau9": 1e-11, "radau13": 1e-11, "bdf": 1e-8,
    "rk4": 0.0, "gauss4": 0.0, "gauss6": 0.0, "implicit_midpoint": 0.0, "generalized_alpha": 0.0,
}  # fmt: skip
WEIGHTS = np.array([3, 2, 1, 1, 3, 2, 1, 0.5, 0.7, 0.7, 1, 0.7, 0.7, 0.5, 0.5, 0.5, 0.3])
WEIGHTS = WEIGHTS / WEIGHTS.sum()
MOST_METHODS = 6  # of a scene, each of which is compiled


def smooth(rng: Rng) -> Mechanism:
    m = scenes.tree(rng)
    if rng.uniform() < 0.3:
        scenes.prescribe(rng, m)
    scenes.add_passive(rng, m)
    scenes.add_torques(rng, m, pulses=False)
    return m


def pulses(rng: Rng) -> Mechanism:
    m = scenes.tree(rng)
    scenes.add_passive(rng, m)
    scenes.add_torques(rng, m, pulses=True)
    return m


def compliant_stops(rng: Rng) -> Mechanism:
    m = scenes.tree(rng, 4, scenes.SCALAR)
    scenes.add_passive(rng, m)
    scenes.add_torques(rng, m, pulses=rng.uniform() < 0.3)
    scenes.add_stops(rng, m, rigid=False, most=2)
    return m


def rigid_stops(rng: Rng) -> Mechanism:
    m = scenes.tree(rng, 4, (*scenes.SCALAR, "revolute", "spherical", "universal"))
    if rng.uniform() < 0.2:
        scenes.prescribe(rng, m)
    scenes.add_passive(rng, m)
    scenes.add_torques(rng, m, pulses=rng.uniform() < 0.5)
    if scenes.scalars(m):
        scenes.add_stops(rng, m, rigid=True, most=2)
    return m


def dry_friction(rng: Rng) -> Mechanism:
    m = scenes.tree(rng, 4, scenes.SCALAR)
    if rng.uniform() < 0.2:
        scenes.prescribe(rng, m)
    scenes.add_passive(rng, m)
    scenes.add_torques(rng, m, pulses=rng.uniform() < 0.5)
    if scenes.scalars(m):
        scenes.add_dry_friction(rng, m, 3)
    return m


def contacts(rng: Rng) -> Mechanism:
    """Friction, stops and pulses together."""
    m = scenes.tree(rng, 4, scenes.SCALAR)
    scenes.add_passive(rng, m)
    scenes.add_torques(rng, m, pulses=True)
    scenes.add_stops(rng, m, rigid=rng.uniform() < 0.6, most=2)
    scenes.add_dry_friction(rng, m, 2)
    return m


def _carry_loop(rng: Rng, m: Mechanism) -> Mechanism:
    free = sum(len(scenes.VELOCITIES[b.kind]) for b in m.bodies) - sum(
        1 if loop.directions is None else len(loop.directions) for loop in m.loops
    )
    scenes.add_passive(rng, m)
    scenes.add_torques(rng, m, pulses=rng.uniform() < 0.4)
    kind = rng.uniform()
    if kind < 0.15 and free > 0:
        scenes.add_dry_friction(rng, m, 1)
    elif kind < 0.3:
        scenes.add_stops(rng, m, rigid=rng.uniform() < 0.5, most=1)
    how = rng.uniform()
    rests = any("set_valued" in str(b.extra) or "restitution" in str(b.extra) for b in m.bodies)
    m.simulate["stabilisation"] = (
        "projection" if how < 0.55 else "independent" if how < 0.8 and not rests else "none" if how < 0.9
        else {"alpha": 20.0, "beta": 20.0}
    )  # fmt: skip
    return m


def planar_loops(rng: Rng) -> Mechanism:
    return _carry_loop(rng, scenes.planar_loop(rng))


def spatial_loops(rng: Rng) -> Mechanism:
    return _carry_loop(rng, scenes.spatial_loop(rng))


# -- passages of poses in which all bars lie on one line ------------------------------------------------------------
def passages(rng: Rng) -> Mechanism:
    """Return a parallelogram with any number of legs, or an isosceles slider-crank, that swings through flat poses."""
    m = _parallelogram(rng) if rng.uniform() < 0.65 else _isosceles(rng)
    for body in m.bodies:
        if rng.uniform() < 0.4:
            body.extra["damper"] = {"damping": float(rounded(rng.uniform(0.01, 0.5)))}
        if rng.uniform() < 0.3:
            body.extra["spring"] = {
                "stiffness": float(rounded(rng.uniform(0.5, 5))),
                "rest": float(rounded(rng.normal())),
            }
    if rng.uniform() < 0.4:
        jumps = rng.uniform() < 0.5
        m.torques[0, 0] = (
            scenes.pulse_formula(rng, m.duration, 3.0)
            if jumps
            else scenes.smooth_formula(rng, 0, m.bodies[0].name, 3.0)
        )
    contact = rng.uniform()
    dry = contact < 0.15 and len(m.loops) == 1
    if dry:
        scenes.add_dry_friction(rng, m, 1)
    elif contact < 0.3:
        scenes.add_stops(rng, m, rigid=False, most=1)
    m.simulate |= {
        "singular": "pass",
        "stabilisation": "independent" if rng.uniform() < 0.33 and not dry else "projection",
    }
    return m


def _swinging(bodies: list[Body], loops: list[Loop], branch: Branch, start: float, rng: Rng) -> Mechanism:
    speed = float(rounded(rng.uniform(1.5, 5) * rng.choice((-1, 1))))
    x, xd = np.array([start]), np.array([speed])
    gravity = rounded(unit(rng) * rng.choice((0.0, 3.0, 9.81)))
    m = Mechanism(
        bodies,
        gravity,
        branch.at(x),
        branch.slope(x) @ xd,
        float(rounded(rng.uniform(0.6, 2.0), 2)),
        int(rng.integers(11, 42)),
    )
    m.loops, m.branch = loops, branch
    return m


def _parallelogram(rng: Rng) -> Mechanism:
    L = float(rounded(rng.uniform(0.3, 1.0)))
    count = int(rng.choice((2, 2, 2, 3)))
    apart = [0.0, *np.cumsum(rounded(rng.uniform(0.3, 1.0, count - 1)))]
    bodies = [flat(rng, "j0", "revolute", -1, (0, 0)), flat(rng, "j1", "revolute", 0, (L, 0))]
    loops = []
    for k in range(1, count):
        place = float(rounded(apart[k]))
        bodies.append(flat(rng, f"j{k + 1}", "revolute", -1, (place, 0.0)))
        loops.append(
            Loop(
                "revolute",
                Point(1, np.array([place, 0, 0])),
                Point(k + 1, np.array([L, 0, 0])),
                np.eye(3)[:2],
            )
        )
    P = np.array([[1.0], [-1.0], *[[1.0]] * (count - 1)])
    branch = Branch([0], lambda x: P @ x, lambda x: P, lambda x, xd: np.zeros(len(P)))
    return _swinging(bodies, loops, branch, float(rounded(rng.uniform(0.4, 2.7) * rng.choice((-1, 1)))), rng)


def _isosceles(rng: Rng) -> Mechanism:
    L = float(rounded(rng.uniform(0.3, 1.0)))
    bodies = [flat(rng, "j0", "revolute", -1, (0, 0)), flat(rng, "j1", "revolute", 0, (L, 0)),
              flat(rng, "j2", "prismatic", -1, (0, 0), (1, 0, 0))]  # fmt: skip
    loops = [Loop("revolute", Point(1, np.array([L, 0, 0])), Point(2, np.zeros(3)), np.eye(3)[:2])]
    branch = Branch(
        [0],
        lambda x: np.array([x[0], -2.0 * x[0], 2.0 * L * np.cos(x[0])]),
        lambda x: np.array([[1.0], [-2.0], [-2.0 * L * np.sin(x[0])]]),
        lambda x, xd: np.array([0.0, 0.0, -2.0 * L * np.cos(x[0]) * xd[0] ** 2]),
    )
    return _swinging(bodies, loops, branch, float(rounded(rng.uniform(-1.2, 1.2))), rng)


# -- gears and bushings ---------------------------------------------------------------------------------------------
def gears(rng: Rng) -> Mechanism:
    """Return a tree of joints some of which are coupled, with what joints carry and compliant stops."""
    m = scenes.tree(rng, 5, scenes.SCALAR)
    n = len(m.bodies)
    if n > 1:
        _couple(rng, m, int(rng.integers(1, n)))
    scenes.add_passive(rng, m)
    scenes.add_torques(rng, m, pulses=rng.uniform() < 0.5)
    if rng.uniform() < 0.3:
        scenes.add_stops(rng, m, rigid=False, most=2)
    m.simulate["stabilisation"] = str(rng.choice(("projection", "independent")))
    return m


def _couple(rng: Rng, m: Mechanism, count: int) -> None:
    """Make some coordinates functions of the others: q = q0 + P x."""
    n = len(m.bodies)
    order = [int(k) for k in rng.permutation(n)]
    led, free = order[:count], sorted(order[count:])
    P, constant = np.zeros((n, len(free))), np.zeros(n)
    P[free, range(len(free))] = 1.0
    for k in led:
        own, first, second = (float(x) for x in rounded(rng.uniform(0.3, 2.0, 3) * rng.choice((-1, 1), 3)))
        drivers = (
            {free[0]: first} if len(free) == 1 or rng.uniform() < 0.6 else {free[0]: first, free[-1]: second}
        )
        value = float(rounded(own * m.q[k] + sum(c * m.q[j] for j, c in drivers.items())))
        m.couplers.append(Coupler({k: own, **drivers}, value))
        constant[k] = value / own
        for j, c in drivers.items():
            P[k, free.index(j)] = -c / own
    m.q, m.v = constant + P @ m.q[free], P @ m.v[free]
    m.branch = Branch(free, lambda x: constant + P @ x, lambda x: P, lambda x, xd: np.zeros(n))


def bushings(rng: Rng) -> Mechanism:
    """Return a tree with bodies in bushings, whose frames nearly coincide at the start."""
    m = scenes.tree(rng)
    scenes.add_passive(rng, m)
    scenes.add_torques(rng, m, pulses=rng.uniform() < 0.4)
    eq = Equations(m)
    eq.gap(m.q)
    for _ in range(int(rng.integers(1, 3))):
        at = Point(int(rng.integers(len(m.bodies))), rounded(rng.normal(size=3) * 0.3))
        turned = eq.data.oMi[eq.ids[at.body]].rotation
        stiffness = 10.0 ** np.concatenate([rng.uniform(1, 3, 3), rng.uniform(0.5, 2, 3)])
        m.bushings.append(
            Bushing(
                rounded(eq.place(at) + rng.normal(size=3) * 0.1),
                rounded(pin.rpy.matrixToRpy(turned @ pin.exp3(rng.normal(size=3) * 0.3))),
                at,
                rounded(stiffness, 2),
                rounded(stiffness * rng.choice((0.0, 0.003, 0.03)), 4),
            )
        )
    return m


# -- controllers and payloads ---------------------------------------------------------------------------------------
def _controlled(rng: Rng, sampled: bool) -> Mechanism:
    m = scenes.planar_loop(rng) if rng.uniform() < 0.3 else scenes.tree(rng, 4, (*scenes.SCALAR, "spherical"))
    scenes.add_passive(rng, m)
    scenes.add_torques(rng, m, pulses=rng.uniform() < 0.3)
    if scenes.scalars(m):
        scenes.add_law(rng, m, sampled)
    return m


def controllers(rng: Rng) -> Mechanism:
    """Return a mechanism with a controller that acts at every instant."""
    return _controlled(rng, False)


def sampled_laws(rng: Rng) -> Mechanism:
    """Return a mechanism with a controller that is sampled."""
    return _controlled(rng, True)


def payloads(rng: Rng) -> Mechanism:
    """Return a tree or a loop that picks up masses and releases them."""
    m = scenes.planar_loop(rng) if rng.uniform() < 0.3 else scenes.tree(rng)
    scenes.add_passive(rng, m)
    scenes.add_torques(rng, m, pulses=rng.uniform() < 0.3)
    scenes.add_payloads(rng, m)
    return m


FAMILIES = {
    f.__name__: f
    for f in (
        smooth,
        pulses,
        compliant_stops,
        rigid_stops,
        dry_friction,
        contacts,
        planar_loops,
        spatial_loops,
        passages,
    )
}


# a second set with seeds of its own, so that those of the first stay what they are
SECOND = 1_000_000
SECOND_FAMILIES = {f.__name__: f for f in (gears, bushings)}
DEPLOYMENTS = 2_000_000
THIRD = 3_000_000
THIRD_FAMILIES = {f.__name__: f for f in (controllers, sampled_laws, payloads)}


def make(seed: int) -> tuple[str, Mechanism, Rng]:
    """Return the family and the mechanism of a seed, and the generator for the runs."""
    rng = np.random.default_rng(seed)
    if DEPLOYMENTS <= seed < THIRD:
        return deployments.__name__, deployments(rng), rng
    families = FAMILIES if seed < SECOND else SECOND_FAMILIES if seed < THIRD else THIRD_FAMILIES
    name = list(families)[seed % len(families)]
    return name, families[name](rng), rng


def settings(rng: Rng, runs: int) -> list[dict[str, Any]]:
    """Return what ``simulate`` is told for each of the runs of a scene: a few methods, since each is compiled anew."""
    found = []
    count = min(MOST_METHODS, max(1, runs // 4))
    methods = [str(x) for x in rng.choice(list(METHODS), count, replace=False, p=WEIGHTS)]
    for k in range(runs):
        method = methods[k % len(methods)]
        if METHODS[method] == 0.0:
            found.append({"integrator": method, "parts": int(10.0 ** rng.uniform(2.3, 3.7))})
            continue
        rtol = float(f"{10.0 ** rng.uniform(math.log10(METHODS[method]), -4):.2g}")
        found.append(
            {"integrator": method, "rtol": rtol, "atol": float(f"{rtol * 10.0 ** rng.uniform(-3, 0):.2g}")}
        )
    return found
