"""Equations for engines that take formulas: derived by hand where that is fastest, otherwise robodyn's graph."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from cases import Chain, FourBar


def pendulum_rates(case: Chain, x: Sequence[Any], sin: Any, cos: Any, spring: Any = None) -> list[Any]:
    """Return y' of the planar arm, y = (theta1, theta2, rates); ``spring`` : stiffness in place of the case's."""
    arm = case.arm
    m1, m2 = arm.mass.tolist()  # numbers, or symbols of an ensemble
    I1, I2 = (float(I[2, 2]) for I in arm.inertia)
    c1, c2 = map(float, arm.com[:, 0])
    g, length = -float(arm.gravity[1]), float(arm.a[1])
    k, (d1, d2) = float(case.k[1]) if spring is None else spring, map(float, case.c)
    q1, q2, w1, w2 = x
    b, a3 = m2 * length * c2, I2 + m2 * c2**2
    a1 = I1 + m1 * c1**2 + m2 * length**2
    cosine, sine = cos(q2), sin(q2)
    M11, M12 = (a1 + a3) + (2.0 * b) * cosine, a3 + b * cosine
    lower = (b / length * g) * cos(q1 + q2)
    f1 = b * sine * (2.0 * w1 * w2 + w2 * w2) - ((m1 * c1 + m2 * length) * g) * cos(q1) - lower
    f2 = -(b * sine * (w1 * w1)) - lower
    if d1 or d2:
        f1, f2 = f1 - d1 * w1, f2 - d2 * w2
    if case.k[1]:
        f2 = f2 - k * q2
    det = (a1 * a3) - (b * b) * (cosine * cosine)
    return [w1, w2, (a3 * f1 - M12 * f2) / det, (M11 * f2 - M12 * f1) / det]


def four_bar_rates(case: FourBar, x: Sequence[Any], sin: Any, cos: Any) -> list[Any]:
    """Return y' of the four-bar in directions (crank, coupler, follower): index 1, its 2 x 2 system by hand."""
    a, b, c, u, v, w = x
    _, l1, l2, l3 = case.lengths
    m, r, I = case.mass, case.com, case.inertia
    J1, J2, J3 = (I[k] + m[k] * r[k] ** 2 for k in range(3))
    J1, k = J1 + m[1] * l1**2, m[1] * l1 * r[1]
    ca, sa, cb, sb, cc, sc = cos(a), sin(a), cos(b), sin(b), cos(c), sin(c)
    kc, ks = k * cos(a - b), k * sin(a - b)
    det = J1 * J2 - kc * kc
    f1, f2 = case.torque[0] - case.torque[1] * a - ks * (v * v), ks * (u * u)
    X, Y = (-l1 * sa, -l2 * sb, l3 * sc), (l1 * ca, l2 * cb, -l3 * cc)

    def inverse(row: Any) -> tuple[Any, Any, Any]:
        return (J2 * row[0] - kc * row[1]) / det, (J1 * row[1] - kc * row[0]) / det, row[2] / J3

    def dot(p: Any, q: Any) -> Any:
        return p[0] * q[0] + p[1] * q[1] + p[2] * q[2]

    free = ((J2 * f1 - kc * f2) / det, (J1 * f2 - kc * f1) / det)
    MX, MY = inverse(X), inverse(Y)
    S11, S12, S22 = dot(X, MX), dot(X, MY), dot(Y, MY)
    r1 = l1 * ca * (u * u) + l2 * cb * (v * v) - l3 * cc * (w * w) - (X[0] * free[0] + X[1] * free[1])
    r2 = l1 * sa * (u * u) + l2 * sb * (v * v) - l3 * sc * (w * w) - (Y[0] * free[0] + Y[1] * free[1])
    D = S11 * S22 - S12 * S12
    lx, ly = (S22 * r1 - S12 * r2) / D, (S11 * r2 - S12 * r1) / D
    return [
        u, v, w, free[0] + MX[0] * lx + MY[0] * ly, free[1] + MX[1] * lx + MY[1] * ly, MX[2] * lx + MY[2] * ly
    ]  # fmt: skip


def graph_rates(case: Chain, x: Sequence[Any], sin: Any, cos: Any) -> list[Any]:
    """Return y' of a chain by robodyn's articulated-body graph, operation by operation."""
    from peers.robodyn import chain_system
    from robodyn_cli.kernels.program import make_program
    from robodyn_cli.model.model import STATE_GROUPS

    system, _ = chain_system(case)
    program = make_program({"a": system.acceleration}, STATE_GROUPS)
    inputs = {"q": x[: case.n], "v": x[case.n :]}
    table: dict[str, Callable[..., Any]] = {
        "add": lambda a, b: a + b, "sub": lambda a, b: a - b, "mul": lambda a, b: a * b, "div": lambda a, b: a / b,
        "neg": lambda a: -a, "sin": sin, "cos": cos,
    }  # fmt: skip
    numbers = program.table.tolist()
    values: list[Any] = []
    for i in program.instructions:
        if i.op == "const":
            values.append(i.value)
        elif i.op == "number":
            values.append(numbers[i.value])
        elif i.op == "sym":
            group, place = i.value
            values.append(inputs[group][place])
        else:
            values.append(table[i.op](*(values[k] for k in i.args)))
    return [*x[case.n :], *(values[e] if isinstance(e, int) else e for e in program.outputs["a"])]
