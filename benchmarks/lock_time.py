"""The time at which the lecture's four-bar locks, without any integration of motion."""

from __future__ import annotations

from typing import Any

# t [s] from the release to the dead point, as ``lock_time`` gives it
LOCK = 12.28299560962995475530


def lock_time(digits: int = 30) -> Any:
    """Return the time of the lock from energy: t = integral of sqrt(J / 2 W) dtheta, to so many digits.

    With one degree of freedom and a spring alone, J(theta) theta'^2 / 2 = W(theta). W vanishes at the start
    and J grows without bound at the dead point; theta = start + u^2 and theta = end - u^2 make both
    integrands smooth.
    """
    import mpmath as mp

    with mp.workdps(digits + 10):
        crank, link = mp.mpf("1.241"), mp.mpf("1.2")
        m1, c1, I1, m2, c2, I2 = map(mp.mpf, ("20.15", "1.2", "9.6", "8.25", "0.6", "0.06"))
        first, preload, stiffness = map(mp.mpf, ("0.01", "1.96", "0.1"))
        last = 2 * mp.asin(link / crank)

        def inertia(theta: Any, gap: Any) -> Any:
            """Twice the kinetic energy at theta' = 1; gap = last - theta, not left to cancellation."""
            x, y = crank * mp.cos(theta), crank * mp.sin(theta)
            # pin, crank's end and ground pivot make an isosceles triangle; ``base`` is the angle at its base
            cosine = mp.sin(theta / 2) / mp.sin(last / 2)
            sine = mp.sqrt(mp.sin((last + theta) / 2) * mp.sin(gap / 2)) / mp.sin(last / 2)
            across, base = mp.atan2(-y, crank - x), mp.atan2(sine, cosine)
            a, b = across + base, across + mp.pi - base  # directions of coupler and follower
            da = -crank * mp.sin(theta - b) / (link * mp.sin(a - b))
            db = crank * mp.sin(theta - a) / (link * mp.sin(b - a))
            v2 = crank**2 + (c2 * da) ** 2 + 2 * crank * c2 * da * mp.cos(a - theta)
            return I1 + m1 * c1**2 + I2 * da**2 + m2 * v2 + (I2 + m2 * c2**2) * db**2

        def work_rate(x: Any) -> Any:
            """Work of the spring from the start over the angle x, divided by x."""
            return preload - stiffness / 2 * (2 * first + x)

        def early(u: Any) -> Any:
            return 2 * mp.sqrt(inertia(first + u**2, last - first - u**2) / (2 * work_rate(u**2)))

        def late(u: Any) -> Any:
            x = last - u**2 - first
            return 2 * u * mp.sqrt(inertia(last - u**2, u**2) / (2 * x * work_rate(x)))

        half = mp.sqrt((last - first) / 2)
        pieces = [half * k / 8 for k in range(9)]
        return mp.quad(early, pieces) + mp.quad(late, pieces)
