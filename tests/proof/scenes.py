"""Random scenes: trees of all joint types, loops, forces, stops, friction, pulses, prescribed motions."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from tests.proof.mechanism import (
    COORDINATES,
    VELOCITIES,
    Array,
    Body,
    Formula,
    Law,
    Load,
    Loop,
    Mechanism,
    Payload,
    Point,
    Spring,
)
from tests.random_models import random_inertia, random_rotation

KINDS = ("revolute", "revolute", "revolute", "prismatic", "prismatic", "helical", "cylindrical", "universal",
         "planar", "spherical", "floating")  # fmt: skip
SCALAR = ("revolute", "revolute", "prismatic", "helical")
Rng = np.random.Generator


def unit(rng: Rng) -> Array:
    x = rng.normal(size=3)
    return np.asarray(x / np.linalg.norm(x))


def rounded(x: Any, digits: int = 4) -> Any:
    return np.round(np.asarray(x, float), digits)


def random_body(rng: Rng, k: int, kinds: tuple[str, ...]) -> Body:
    """Return a body with a full inertia and an offset centre of mass, on a joint placed anyhow."""
    kind = str(rng.choice(kinds))
    parent = k - 1 if rng.uniform() < 0.7 else int(rng.integers(-1, k))
    if kind == "floating":
        parent = -1
    m, c, I = random_inertia(rng)
    axis = unit(rng)
    axis2 = np.cross(axis, unit(rng)) if kind in ("universal", "planar") else None
    if axis2 is not None:
        axis2 = axis2 / np.linalg.norm(axis2)
    return Body(
        f"j{k}", kind, parent, rounded(rng.normal(size=3) * 0.4), rounded(rng.uniform(-2, 2, 3)), axis, axis2,
        float(m), np.asarray(c), np.asarray(0.5 * (I + I.T)), float(rounded(rng.uniform(-0.2, 0.2))),
    )  # fmt: skip


def random_state(rng: Rng, bodies: list[Body]) -> tuple[Array, Array]:
    q: list[float] = []
    v: list[float] = []
    for body in bodies:
        n = len(COORDINATES[body.kind])
        if body.kind in ("spherical", "floating"):
            quaternion = rng.normal(size=4)
            q += [*rng.normal(size=n - 4) * 0.3, *(quaternion / np.linalg.norm(quaternion))]
        elif body.kind == "prismatic":
            q += [*rounded(rng.normal(size=n) * 0.3)]
        else:
            q += [*rounded(rng.uniform(-1.5, 1.5, n))]
        v += [*rounded(rng.normal(size=len(VELOCITIES[body.kind])) * rng.choice((0.0, 0.5, 1.5)))]
    return np.array(q, float), np.array(v, float)


# -- formulas -------------------------------------------------------------------------------------------------------
def smooth_formula(rng: Rng, own: int | None, name: str, size: float) -> Formula:
    """Return a formula of time, and of a joint's position and rate where one is given (place in q and v)."""
    A, w, p, c = (
        float(x)
        for x in rounded(
            (size * rng.uniform(0.2, 1), rng.uniform(1, 8), rng.uniform(0, 6), rng.uniform(0.05, 0.8))
        )
    )
    kind = int(rng.integers(5)) if own is not None else int(rng.integers(2))
    if kind == 0:
        return Formula(f"{A}*sin({w}*t + {p})", lambda t, s, q, v: A * math.sin(w * t + p))
    if kind == 1:
        return Formula(
            f"{A}*exp(-{c}*t)*cos({w}*t)", lambda t, s, q, v: A * math.exp(-c * t) * math.cos(w * t)
        )
    assert own is not None
    i, j = own, own
    if kind == 2:
        return Formula(f"{A}*cos({w}*t) - {c}*qd.{name}", lambda t, s, q, v: A * math.cos(w * t) - c * v[j])
    if kind == 3:
        return Formula(
            f"-{A}*tanh({c}*qd.{name}) + {p}*0.1", lambda t, s, q, v: -A * math.tanh(c * v[j]) + p * 0.1
        )
    return Formula(f"-{A}*sin(q.{name} - {c})", lambda t, s, q, v: -A * math.sin(q[i] - c))


def pulse_formula(rng: Rng, duration: float, size: float) -> Formula:
    """Return a formula of time with jumps or kinks: pulses of any width, steps, ramps, tables."""
    A = float(rounded(size * rng.uniform(0.3, 2)))
    a = float(rounded(rng.uniform(0.05, 0.7) * duration))
    width = float(rounded(duration * 10.0 ** rng.uniform(-3.5, -0.7), 6))
    b = round(a + width, 6)
    kind = int(rng.integers(6))
    if kind <= 1:
        A = A * min(20.0, max(1.0, 0.05 * duration / width))  # short ones push harder, so that they count
        text = f"if(t < {a}, 0, if(t < {b}, {A}, 0))" if kind else f"{A}*(step(t - {a}) - step(t - {b}))"
        return Formula(text, lambda t, s, q, v: A if a <= s < b else 0.0, (a, b))
    if kind == 2:
        return Formula(
            f"if(t >= {a}, {A}*cos(t), -0.3)", lambda t, s, q, v: A * math.cos(t) if s >= a else -0.3, (a,)
        )
    if kind == 3:
        return Formula(f"{A}*max(0, t - {a})", lambda t, s, q, v: A * (t - a) if s > a else 0.0, (a,))
    if kind == 4:
        return Formula(f"{A}*abs(t - {a})", lambda t, s, q, v: A * (t - a) * (1.0 if s > a else -1.0), (a,))
    rows = [[0.0, 0.0], [a, A], [b, -A], [round(duration + 1.0, 4), 0.0]]

    def value(t: float, s: float, q: Array, v: Array) -> float:
        k = sum(s > row[0] for row in rows[1:-1])
        (t0, x0), (t1, x1) = rows[k], rows[k + 1]
        return x0 + (x1 - x0) * (t - t0) / (t1 - t0)

    return Formula({"table": rows}, value, (a, b))


def wave(rng: Rng, start: float) -> tuple[Formula, Formula, Formula]:
    """Return a prescribed motion from ``start``, its rate and its acceleration."""
    A, w = (float(x) for x in rounded((rng.uniform(0.1, 0.6), rng.uniform(1, 6))))
    return (
        Formula(f"{start} + {A}*sin({w}*t)", lambda t, s, q, v: start + A * math.sin(w * t)),
        Formula("", lambda t, s, q, v: A * w * math.cos(w * t)),
        Formula("", lambda t, s, q, v: -A * w * w * math.sin(w * t)),
    )


# -- what joints and bodies carry -----------------------------------------------------------------------------------
def add_passive(rng: Rng, m: Mechanism) -> None:
    """Add springs, dampers, smooth friction and rotors to joints, springs between points, and loads."""
    for k, body in enumerate(m.bodies):
        if not body.scalar or k in m.prescribed:
            continue
        at = float(m.q[m.first_q[k]])
        if rng.uniform() < 0.4:
            body.extra["spring"] = {
                "stiffness": float(rounded(rng.uniform(1, 60))),
                "rest": round(at + float(rounded(rng.normal())) * 0.4, 4),
            }
        if rng.uniform() < 0.5:
            body.extra["damper"] = {"damping": float(rounded(10.0 ** rng.uniform(-2, 0.7)))}
        if rng.uniform() < 0.2:
            body.extra |= {
                "gear_ratio": float(rounded(rng.uniform(-30, 30), 1)) or 1.0,
                "rotor_inertia": float(rounded(rng.uniform(1e-5, 1e-3), 6)),
            }
        if rng.uniform() < 0.2:
            body.extra["friction"] = {
                "viscous": 0.1,
                "coulomb": float(rounded(rng.uniform(0.1, 2))),
                "transition_speed": float(rounded(rng.uniform(0.05, 0.5))),
            }
    n = len(m.bodies)
    if rng.uniform() < 0.3:
        first, second = (
            Point(int(rng.integers(n)), rounded(rng.normal(size=3) * 0.3)),
            Point(-1, rounded(rng.normal(size=3) * 2.0 + 1.0)),
        )
        m.springs.append(
            Spring(
                first,
                second,
                float(rounded(rng.uniform(1, 50))),
                float(rounded(rng.uniform(0, 1))),
                float(rounded(rng.uniform(0, 1))),
            )
        )
    if rng.uniform() < 0.3:
        at = Point(int(rng.integers(n)), rounded(rng.normal(size=3) * 0.3))
        force = [smooth_formula(rng, None, "", 5.0) for _ in range(3)]
        moment = [smooth_formula(rng, None, "", 0.5) for _ in range(3)] if rng.uniform() < 0.5 else None
        m.loads.append(Load(at, force, moment, str(rng.choice(("world", "body")))))


def add_torques(rng: Rng, m: Mechanism, pulses: bool) -> None:
    """Add torques to some joints: smooth ones, and pulses."""
    for k, body in enumerate(m.bodies):
        if k in m.prescribed:
            continue
        for c in range(len(VELOCITIES[body.kind])):
            if rng.uniform() < (0.5 if pulses else 0.4):
                name = body.name if body.scalar else ""
                own = int(m.first_v[k]) if body.scalar and m.first_q[k] == m.first_v[k] else None
                jumps = pulses and rng.uniform() < 0.7
                m.torques[k, c] = (
                    pulse_formula(rng, m.duration, 4.0) if jumps else smooth_formula(rng, own, name, 3.0)
                )


def scalars(m: Mechanism) -> list[int]:
    return [k for k, b in enumerate(m.bodies) if b.scalar and k not in m.prescribed]


def add_law(rng: Rng, m: Mechanism, sampled: bool) -> None:
    """Add a controller, PD or PID, of some joints; a sampled one with a delay or a limit."""
    places = [int(k) for k in rng.permutation(scalars(m))]
    joints = sorted(places[: int(rng.integers(1, len(places) + 1))])
    n = len(joints)
    followed = [wave(rng, float(m.q[m.first_q[k]]))[:2] for k in joints]
    kp = rounded(10.0 ** rng.uniform(0.5, 2.3, n), 2)
    kd = rounded(kp * rng.uniform(0.02, 0.3, n), 3)
    ki = rounded(kp * rng.uniform(0.2, 3.0, n), 2) if rng.uniform() < 0.5 else np.zeros(n)
    m.law = Law(joints, followed, kp, kd, ki)
    if not sampled:
        return
    m.law.period = float(rounded(10.0 ** rng.uniform(-2.3, -1.2)))
    if rng.uniform() < 0.5:
        m.law.delay = float(rounded(m.law.period * rng.choice((0.3, 0.7, 1.0, 1.6, 2.0)), 6))
    if rng.uniform() < 0.4 and not ki.any():
        m.law.limit = float(rounded(rng.uniform(1, 20)))


def add_payloads(rng: Rng, m: Mechanism) -> None:
    """Add masses that bodies carry for a while."""
    for _ in range(int(rng.integers(1, 3))):
        mass, com, inertia = random_inertia(rng)
        start, stop = sorted(float(rounded(x)) for x in rng.uniform(0.05, 0.95, 2) * m.duration)
        m.payloads.append(
            Payload(
                Point(int(rng.integers(len(m.bodies))), rounded(rng.normal(size=3) * 0.3)),
                float(mass), np.asarray(com), np.asarray(0.5 * (inertia + inertia.T)),
                None if rng.uniform() < 0.3 else start, None if rng.uniform() < 0.3 else stop,
                rounded(rng.normal(size=3) * rng.choice((0.0, 0.5))), rounded(rng.normal(size=3) * rng.choice((0.0, 0.5))),
            )
        )  # fmt: skip


def add_stops(rng: Rng, m: Mechanism, rigid: bool, most: int) -> None:
    """Add stops to some joints, close enough to be hit."""
    places = scalars(m)
    for k in rng.permutation(places)[: int(rng.integers(1, most + 1))]:
        body, at = m.bodies[int(k)], float(m.q[m.first_q[int(k)]])
        if "friction" in body.extra and body.extra["friction"].get("law"):
            continue
        stop: dict[str, Any] = {"restitution": float(rounded(rng.uniform(0.2, 0.9), 2))}
        if not rigid:
            law = str(rng.choice(("spring_damper", "hunt_crossley")))
            k_stop = 10.0 ** rng.uniform(1.5, 4)
            stop = {
                "stiffness": float(rounded(k_stop, 1)),
                "damping": float(rounded(k_stop * rng.choice((0.0, 0.002, 0.02)))),
                "law": law,
            }
            if law == "hunt_crossley":
                stop["exponent"] = float(rng.choice((1.0, 1.5, 2.0)))
        limits = {}
        sides = int(rng.integers(3))
        if sides != 1:
            limits["lower"] = round(at - float(rng.uniform(0.02, 0.5)), 4)
        if sides != 0:
            limits["upper"] = round(at + float(rng.uniform(0.02, 0.5)), 4)
        body.extra["limits"] = {**limits, "stop": stop}


def add_dry_friction(rng: Rng, m: Mechanism, most: int) -> None:
    """Add set-valued friction to some joints."""
    places = scalars(m)
    for k in rng.permutation(places)[: int(rng.integers(1, most + 1))]:
        body = m.bodies[int(k)]
        if "limits" in body.extra and "restitution" in body.extra["limits"]["stop"]:
            continue
        level = float(rounded(10.0 ** rng.uniform(-0.7, 1)))
        friction: dict[str, Any] = {"law": "set_valued", "coulomb": level}
        if rng.uniform() < 0.5:
            friction["viscous"] = float(rounded(rng.uniform(0, 0.5)))
        if rng.uniform() < 0.5:
            friction["static"] = round(level * 1.5, 4)
            if rng.uniform() < 0.7:
                friction["stribeck_speed"] = float(rounded(rng.uniform(0.05, 0.5)))
        body.extra["friction"] = friction


# -- kinds of scenes ------------------------------------------------------------------------------------------------
def tree(rng: Rng, most: int = 4, kinds: tuple[str, ...] = KINDS) -> Mechanism:
    """Return a random open chain or tree without forces."""
    count = int(rng.integers(1, most + 1))
    bodies: list[Body] = []
    while len(bodies) < count and sum(len(VELOCITIES[b.kind]) for b in bodies) < 6:
        bodies.append(random_body(rng, len(bodies), kinds))
    q, v = random_state(rng, bodies)
    gravity = rounded(unit(rng) * rng.choice((0.0, 9.81)))
    duration = float(rounded(rng.uniform(0.6, 2.0), 2))
    return Mechanism(bodies, gravity, q, v, duration, int(rng.integers(11, 42)))


def prescribe(rng: Rng, m: Mechanism) -> None:
    places = scalars(m)
    if len(places) < 2:
        return
    k = int(rng.choice(places))
    m.prescribed[k] = wave(rng, float(m.q[m.first_q[k]]))
    for key in ("spring", "damper", "friction", "limits"):
        m.bodies[k].extra.pop(key, None)
    m.torques = {place: f for place, f in m.torques.items() if place[0] != k}


def spatial_loop(rng: Rng) -> Mechanism:
    """Return a random tree, a point of which is tied to the ground where it is."""
    from tests.proof.equations import Equations

    bodies = [
        random_body(rng, k, ("revolute", "revolute", "prismatic", "universal", "spherical", "cylindrical"))
        for k in range(3)
    ]
    q, v = random_state(rng, bodies)
    m = Mechanism(
        bodies,
        rounded(unit(rng) * 9.81),
        q,
        np.zeros(len(v)),
        float(rounded(rng.uniform(0.4, 1.2), 2)),
        int(rng.integers(11, 32)),
    )
    eq = Equations(m)
    eq.gap(q)
    point = Point(len(bodies) - 1, rounded(rng.normal(size=3) * 0.3))
    place = eq.place(point)
    chain, k = 0, len(bodies) - 1
    while k >= 0:
        chain += len(VELOCITIES[bodies[k].kind])
        k = bodies[k].parent
    kinds = (
        ["distance", "point_on_plane"]
        + (["point_on_line"] if chain > 2 else [])
        + (["spherical"] if chain > 3 else [])
    )
    kind = str(rng.choice(kinds))
    anchor = Point(-1, place)
    if kind == "spherical":
        m.loops.append(Loop(kind, anchor, point, np.eye(3)))
    elif kind == "distance":
        anchor = Point(-1, place + unit(rng) * rng.uniform(0.5, 1.5))
        m.loops.append(Loop(kind, anchor, point, None, float(np.linalg.norm(anchor.at - place))))
    else:
        frame = random_rotation(rng)
        rows = frame[2:] if kind == "point_on_plane" else frame[:2]
        m.loops.append(Loop(kind, anchor, point, rows, axis=frame[2]))
    return m


def flat(
    rng: Rng,
    name: str,
    kind: str,
    parent: int,
    at: tuple[float, float],
    axis: tuple[float, float, float] = (0, 0, 1),
) -> Body:
    """Return a body of a plane mechanism, with an inertia of its own."""
    m, c, I = random_inertia(rng)
    return Body(
        name,
        kind,
        parent,
        np.array([*at, 0.0]),
        np.zeros(3),
        np.array(axis, float),
        None,
        float(m),
        np.asarray(c),
        np.asarray(0.5 * (I + I.T)),
    )


def planar_loop(rng: Rng) -> Mechanism:
    """Return a four-bar, a five-bar or a slider-crank that is closed where it starts."""
    from tests.proof.equations import Equations

    kind = str(rng.choice(("four_bar", "five_bar", "slider")))
    L = [float(x) for x in rounded(rng.uniform(0.4, 1.0, 3))]
    bodies = [flat(rng, "j0", "revolute", -1, (0, 0)), flat(rng, "j1", "revolute", 0, (L[0], 0))]
    q = [float(x) for x in rounded((rng.uniform(0.4, 1.4), rng.uniform(-1.2, -0.4)))]
    tip = Point(1, np.array([L[1], 0, 0]))
    if kind == "five_bar":
        bodies.append(flat(rng, "j2", "revolute", 1, (L[1], 0)))
        q.append(float(rounded(rng.uniform(-1.2, -0.3))))
        tip = Point(2, np.array([L[2], 0, 0]))
    probe = Mechanism(list(bodies), np.zeros(3), np.array(q), np.zeros(len(q)), 1.0, 2)
    eq = Equations(probe)
    eq.gap(np.array(q))
    place = eq.place(tip)
    k = len(bodies)
    if kind == "slider":
        bodies.append(flat(rng, f"j{k}", "prismatic", -1, (0.0, float(place[1])), (1, 0, 0)))
        q.append(float(place[0]))
        end = Point(k, np.zeros(3))
    else:
        pivot = rounded((place[0] + rng.uniform(0.1, 0.6), place[1] - rng.uniform(0.4, 0.9)))
        bodies.append(flat(rng, f"j{k}", "revolute", -1, (float(pivot[0]), float(pivot[1]))))
        q.append(math.atan2(place[1] - pivot[1], place[0] - pivot[0]))
        end = Point(k, np.array([float(np.hypot(*(place[:2] - pivot))), 0, 0]))
    gravity = rounded(unit(rng) * 9.81)
    m = Mechanism(
        bodies,
        gravity,
        np.array(q),
        np.zeros(len(q)),
        float(rounded(rng.uniform(0.3, 1.2), 2)),
        int(rng.integers(11, 32)),
    )
    m.loops.append(Loop("revolute", tip, end, np.eye(3)[:2]))
    return m
