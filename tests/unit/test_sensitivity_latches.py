"""Derivatives through the closings of latches: a closed form, and differences of tight runs."""

from __future__ import annotations

import mpmath
import pytest

from robodyn_cli.over.sensitivity.asked import prepare
from robodyn_cli.over.sensitivity.differences import differences
from robodyn_cli.over.sensitivity.report import exact_slopes
from robodyn_cli.scene.load import Family
from tests.unit.test_sensitivity import CONFIGS, asked, exact

HINGE = """
schema: 1
command: deploy
gravity: [0, 0, 0]
robot:
  joints:
    - {name: a, type: revolute, axis: [0, 0, 1], spring: {stiffness: 3, rest: 0.8}}
  links: [{name: panel, mass: 2, com: [0.5, 0, 0], inertia: {zz: 0.3}}]
initial: {q: {a: -1}}
deploy: {latches: [{name: stop, joint: a, at: 0.2}]}
simulate: {duration: 5, samples: 11, rtol: 1e-11, atol: 1e-13}
"""


def test_a_hinge_that_latches_has_a_closed_form() -> None:
    """I q'' = -k (q - r): it comes to its latch at cos(w t) = (p - r) / (q0 - r)."""
    keys = [
        "robot.joints.a.spring.stiffness",
        "robot.links.panel.mass",
        "initial.q.a",
    ]
    at = (3.0, 2.0, -1.0)

    def parts(k, m, start):  # type: ignore[no-untyped-def]
        inertia = mpmath.mpf("0.3") + m / 4
        w, rest = mpmath.sqrt(k / inertia), mpmath.mpf("0.8")
        phase = mpmath.acos((mpmath.mpf("0.2") - rest) / (start - rest))
        return inertia, phase / w, (rest - start) * w * mpmath.sin(phase)

    true = {
        "lock.time": lambda *x: parts(*x)[1],
        "locks.stop.time": lambda *x: parts(*x)[1],
        "locks.stop.speed": lambda *x: parts(*x)[2],
        "locks.stop.angular_impulse": lambda *x: parts(*x)[0] * parts(*x)[2],
        "locks.stop.energy_lost": lambda *x: parts(*x)[0] * parts(*x)[2] ** 2 / 2,
        "lock.rates.a": lambda *x: parts(*x)[2],
        "extremes.qdd.a.largest": lambda k, m, start: k * (mpmath.mpf("0.8") - start) / parts(k, m, start)[0],
    }
    found = exact(asked(HINGE, keys, list(true)))
    for name, function in true.items():
        for k, key in enumerate(keys):
            slope = found[name, key]
            expected = float(mpmath.diff(function, at, tuple(int(j == k) for j in range(3))))
            assert abs(slope.value - expected) <= slope.error + 1e-13 and slope.error <= 1e-7, (
                name,
                key,
                slope,
                expected,
            )


@pytest.mark.parametrize(
    ("name", "keys"),
    [
        ("solar_array", ["robot.joints.hinge2.spring.stiffness", "robot.links.panel4.mass"]),
        ("solar_array", ["robot.joints.hinge3.origin.xyz.0", "robot.joints.hinge4.damper.damping"]),
    ],
)
def test_figures_behind_impulses_agree_with_differences(name: str, keys: list[str]) -> None:
    outputs = [
        "lock.time",
        "locks.latch5.time",
        "locks.latch5.angular_impulse",
        "locks.latch8.energy_lost",
        "locks.latch7.speed",
        "lock.rates.hinge1",
        "extremes.qdd.hinge1.smallest",
    ]
    family = Family(
        CONFIGS / "mechanisms" / f"{name}.yaml", ("expect={}", "simulate.rtol=1e-12", "simulate.atol=1e-14")
    )
    question = prepare(family, keys, outputs)
    found, _ = exact_slopes(question)
    others = differences(question, range(len(keys)), 1)
    for k, key in enumerate(keys):
        for output, other in zip(outputs, others[k]):
            slope = found[output, k]
            apart = abs(slope.value - other.value)
            assert apart <= 3.0 * (slope.error + other.error), (output, key, slope, other)
            assert other.error <= 1e-5 * max(abs(other.value), 1e-3), (output, key, slope, other)
