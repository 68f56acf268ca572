"""Reference solutions of the arms that swing freely, by a method and an arithmetic that no engine here uses.

    python benchmarks/reference.py          # writes benchmarks/reference.json; a minute
    python benchmarks/reference.py --quick  # one variant and the arm on coarser meshes, beside what is written there

Radau collocation with 7 and with 9 stages in extended precision (``longdouble``, 64 bits of mantissa on x86), on
meshes that grow geometrically from the start, where stiff variants have their transient. Stage equations are
solved by Newton's method with a matrix in double precision and residuals in extended precision; those of the
7-joint arm, which is smooth, by fixed-point iteration on Newton-Euler in extended precision (``arms.py``). What the
two runs agree to is kept beside the values.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import measure
import numpy as np
from cases import ARM_DURATION, ARM_START, START, VARIANTS

Real = np.longdouble
FILE = Path(__file__).with_name("reference.json")
# seconds; each engine is judged at those of them that its steps reach
JUDGED = tuple(round(m * 10.0**e, 9) for e in range(-4, 2) for m in (1, 2, 5) if m * 10.0**e <= 10)


def rates(variant: str) -> Any:
    """Return y' = f(y) of the lecture's arm, y = (theta1, theta2, rates), from the textbook's closed form."""
    ratio, stiffness, damping = (Real(repr(x)) for x in VARIANTS[variant])
    m1, I1, c1, c2, g = map(Real, ("12.456", "1.042", "0.773", "0.583", "9.81"))
    m2, I2 = m1 * ratio, I1 * ratio
    b, a3 = m2 * c2, I2 + m2 * c2 * c2
    a1 = I1 + m1 * c1 * c1 + m2

    def f(y: Any) -> Any:
        q1, q2, w1, w2 = y
        cosine, sine = np.cos(q2), np.sin(q2)
        M11, M12 = a1 + 2 * b * cosine + a3, a3 + b * cosine
        lower = b * g * np.cos(q1 + q2)
        f1 = b * sine * (2 * w1 * w2 + w2 * w2) - (m1 * c1 + m2) * g * np.cos(q1) - lower - damping * w1
        f2 = -b * sine * w1 * w1 - lower - damping * w2 - stiffness * q2
        # det M = a1 a3 - (b cos)^2, without the cancellation of M11 a3 - M12^2
        det = a1 * a3 - b * b * cosine * cosine
        return np.array([w1, w2, (a3 * f1 - M12 * f2) / det, (M11 * f2 - M12 * f1) / det])

    return f


def radau(stages: int) -> Any:
    """Return the matrix of Radau IIA, whose nodes are the zeros of P_s - P_(s-1) on [0, 1]."""
    import mpmath as mp

    with mp.workdps(50):

        def polynomial(x: Any) -> Any:
            return mp.legendre(stages, x) - mp.legendre(stages - 1, x)

        guesses = np.polynomial.legendre.Legendre([0.0] * (stages - 1) + [-1.0, 1.0]).roots()
        zeros = [mp.findroot(polynomial, mp.mpf(float(x))) for x in sorted(guesses.real)[:-1]] + [mp.mpf(1)]
        c = [(x + 1) / 2 for x in zeros]
        powers = mp.matrix(stages, stages)
        integrals = mp.matrix(stages, stages)
        for i in range(stages):
            for k in range(stages):
                powers[i, k] = c[i] ** k
                integrals[i, k] = c[i] ** (k + 1) / (k + 1)
        A = integrals * powers**-1
        entries = [[Real(mp.nstr(A[i, j], 40)) for j in range(stages)] for i in range(stages)]
        return np.array(entries)


def solve(variant: str, stages: int, first: float, longest: float) -> Any:
    """Return the states at the times ``JUDGED``."""
    f, A = rates(variant), radau(stages)
    small = np.asarray(A, dtype=float)
    pi = Real("3.14159265358979323846264338327950288")
    y = np.array([pi * Real(x) for x in (*START, 0.0, 0.0)])
    t, h, found = Real(0), first, []
    for stop in JUDGED:
        end = Real(repr(stop))
        while t < end:
            left = float(end - t)
            pieces = max(1, int(np.ceil(left / h)))
            step = (end - t) / pieces
            y = _step(f, y, step, small, A)
            t = end if pieces == 1 else t + step
            h = min(1.15 * h, longest)
        found.append(y.copy())
    return np.array(found)


def _step(f: Any, y: Any, h: Any, small: Any, A: Any) -> Any:
    n, s = len(y), len(A)
    J = np.zeros((n, n))
    for k in range(n):
        d = Real(1e-9) * max(Real(1), abs(y[k]))
        moved = y.copy()
        moved[k] += d
        J[:, k] = np.asarray((f(moved) - f(y)) / d, dtype=float)
    inverse = np.linalg.inv(np.eye(n * s) - float(h) * np.kron(small, J))
    Z = np.zeros((s, n), dtype=Real)
    before = np.inf
    for _ in range(60):
        F = np.array([f(y + z) for z in Z])
        residual = h * (A @ F) - Z
        change = (inverse @ np.asarray(residual, dtype=float).ravel()).reshape(s, n)
        Z = Z + change
        size = float(np.max(np.abs(change) / (1e-3 + np.abs(np.asarray(y, dtype=float)))))
        if size == 0.0 or (size < 1e-16 and size > 0.3 * before):
            break
        before = size
    return y + Z[-1]


def arm_rates(arm: Any) -> Any:
    """Return f of states (samples, 2 n): accelerations solve M a = -bias, M column by column from Newton-Euler."""
    import dataclasses

    from arms import newton_euler

    n = arm.n
    still = dataclasses.replace(arm, gravity=np.zeros(3))

    def f(y: Any) -> Any:
        q, v = y[:, :n], y[:, n:]
        zero = np.zeros_like(q)
        b = -newton_euler(arm, q, v, zero)
        columns = []
        for k in range(n):
            unit = zero.copy()
            unit[:, k] = 1
            columns.append(newton_euler(still, q, zero, unit))
        M = np.stack(columns, axis=2)
        for k in range(n):  # Gauss's elimination of a positive definite matrix needs no pivoting
            for i in range(k + 1, n):
                factor = M[:, i, k] / M[:, k, k]
                M[:, i] = M[:, i] - factor[:, None] * M[:, k]
                b[:, i] = b[:, i] - factor * b[:, k]
        a = np.zeros_like(b)
        for k in reversed(range(n)):
            a[:, k] = (b[:, k] - np.einsum("tj,tj->t", M[:, k], a)) / M[:, k, k]
        return np.concatenate([v, a], axis=1)

    return f


def solve_arm(stages: int, steps: int) -> Any:
    """Return the state of the 7-joint arm at its end."""
    from arms import seven_joint_arm

    f, A = arm_rates(seven_joint_arm()), radau(stages)
    y = np.array([Real(repr(x)) for x in ARM_START] + [Real(0)] * len(ARM_START))
    h = Real(repr(ARM_DURATION)) / steps
    Z = np.zeros((stages, len(y)), dtype=Real)
    for _ in range(steps):
        before = np.inf
        for _ in range(100):
            new = h * (A @ f(y + Z))
            size = float(np.abs(new - Z).max())
            Z = new
            if size == 0.0 or (size < 1e-16 and size > 0.3 * before):
                break
            before = size
        y = y + Z[-1]
    return y


def main() -> None:
    options = measure.command_line(__doc__).parse_args()
    with measure.reporting(options.json) as report:
        if options.quick:
            check(report)
            return
        found: dict[str, Any] = {"times": JUDGED}
        for variant in VARIANTS:
            first = 1e-13 if VARIANTS[variant][1] else 1e-2
            x = solve(variant, 9, first, 0.01)
            other = solve(variant, 7, 0.7 * first, 0.007)
            apart = np.abs(x - other)
            angles, rates_apart = float(apart[:, :2].max()), float(apart[:, 2:].max())
            print(f"{variant}: angles agree to {angles:.1e} rad, rates to {rates_apart:.1e} rad/s")
            report.rows.append({"case": variant, "angles_agree": angles, "rates_agree": rates_apart})
            states = [[float(v) for v in row] for row in x]
            found[variant] = {"states": states, "angles_agree": angles, "rates_agree": rates_apart}
        x, other = solve_arm(9, 200), solve_arm(8, 240)
        apart = float(np.abs(x - other).max())
        print(f"arm: agrees to {apart:.1e}")
        report.rows.append({"case": "arm", "agree": apart})
        found["arm"] = {"states": [[float(v) for v in x]], "agree": apart}
        FILE.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


def check(report: measure.Report) -> None:
    """Compare solutions on coarser meshes with those that are written."""
    written = json.loads(FILE.read_text(encoding="utf-8"))
    for case, end in (
        ("plain", lambda: solve("plain", 7, 2e-2, 0.02)[-1]),
        ("arm", lambda: solve_arm(8, 100)),
    ):
        apart = float(np.abs(end() - np.array(written[case]["states"][-1])).max())
        print(f"{case}: {apart:.1e} from what is written")
        report.rows.append({"case": case, "apart": apart})


if __name__ == "__main__":
    main()
