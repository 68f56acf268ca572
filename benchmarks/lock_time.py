"""The time at which the lecture's four-bar locks, without any integration of motion."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

# t [s] from the release to the dead point, as ``lock_time`` gives it
LOCK = 12.28299560962995475530


# numbers of the scene that the quadrature takes, by their keys; of formulas by their number
NUMBERS = {
    "robot.links.crank.mass": "20.15", "robot.links.crank.com.0": "1.2", "robot.links.crank.inertia.zz": "9.6",
    "robot.links.coupler.mass": "8.25", "robot.links.coupler.com.0": "0.6", "robot.links.coupler.inertia.zz": "0.06",
    "robot.links.follower.mass": "8.25", "robot.links.follower.com.0": "0.6", "robot.links.follower.inertia.zz": "0.06",
    "initial.q.theta1": "0.01", "torques.theta1#1": "1.96", "torques.theta1#2": "0.1",
}  # fmt: skip
# its derivatives by numbers of the scene, as ``lock_slope`` gives them [s over the number's unit]
SLOPES = {
    "robot.links.crank.mass": 0.16049769454775,
    "robot.links.crank.com.0": 5.39004757522862,
    "robot.links.crank.inertia.zz": 0.111456732324827,
    "robot.links.coupler.mass": 0.17598277667496,
    "robot.links.coupler.com.0": 0.0790843507034935,
    "robot.links.coupler.inertia.zz": 0.00394780067406652,
    "robot.links.follower.mass": 0.045788893514924,
    "robot.links.follower.com.0": 1.25919457166041,
    "robot.links.follower.inertia.zz": 0.127191370874789,
    "initial.q.theta1": -2.03836076491829,
    "torques.theta1#1": -3.20957153794615,
    "torques.theta1#2": 1.4926240955948,
}


def lock_slope(key: str, digits: int = 20) -> Any:
    """Return the derivative of the time of the lock by a number of the scene, by a difference with many digits."""
    import mpmath as mp

    with mp.workdps(2 * digits + 20):
        x, step = mp.mpf(NUMBERS[key]), mp.mpf(10) ** -digits
        high, low = (lock_time(2 * digits, {key: x + side * step}) for side in (1, -1))
        return (high - low) / (2 * step)


def lock_time(digits: int = 30, changed: Mapping[str, Any] | None = None) -> Any:
    """Return the time of the lock from energy: t = integral of sqrt(J / 2 W) dtheta, to so many digits.

    changed : numbers in place of those of the scene, by key.

    With one degree of freedom and a spring alone, J(theta) theta'^2 / 2 = W(theta). W vanishes at the start
    and J grows without bound at the dead point; theta = start + u^2 and theta = end - u^2 make both
    integrands smooth.
    """
    import mpmath as mp

    with mp.workdps(digits + 10):
        crank, link = mp.mpf("1.241"), mp.mpf("1.2")
        numbers = {key: mp.mpf(x) for key, x in NUMBERS.items()} | dict(changed or {})
        m1, c1, I1, m2, c2, I2, m3, c3, I3, first, preload, stiffness = numbers.values()
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
            return I1 + m1 * c1**2 + I2 * da**2 + m2 * v2 + (I3 + m3 * c3**2) * db**2

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
