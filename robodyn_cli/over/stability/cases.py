"""The cases of the stability suite: a scene, what is hard about it, and what is expected of ``auto``."""

from __future__ import annotations

from collections.abc import Callable

from robodyn_cli.over.stability.scenes import (
    FOUR_BAR,
    LECTURE_ARM,
    PARALLELOGRAM,
    RAISED,
    arm,
    chain,
    governor,
    scene,
    slider,
    spinning,
    stiff_arm,
)
from robodyn_cli.record import record


@record
class Case:
    """One case.

    text(quick) : the scene as YAML; ``quick`` may shorten it. expects : in words. relative : largest error of auto
    over the range of its quantity, up to the time that the reference reaches. energy : largest drift of its
    energy balance over the energy exchanged. stops : class of the error that has to end the run, if one has to.
    peers : whether the scene is one that other engines can be given (``benchmarks/stability_peers.py``).
    """

    name: str
    text: Callable[[bool], str]
    expects: str
    relative: float = 1e-6
    energy: float | None = None
    stops: str | None = None
    peers: bool = True


def _stiff(stiffness: float) -> Case:
    power = f"1e{len(str(int(stiffness))) - 1}"
    return Case(
        f"spring_{power}",
        lambda quick: stiff_arm(
            f"Two-link arm, spring of {power} N m/rad and dampers of 1e4 N m s/rad", 10.0, stiffness
        ),
        "stable; time constants more than 1e6 apart, so only methods for stiff problems take few steps",
    )


def _rods(count: int, length: float) -> tuple[list[float], list[float]]:
    return [0.1 * length] * count, [length] * count


CASES: tuple[Case, ...] = (
    *(_stiff(10.0**k) for k in (6, 7, 8, 9)),
    Case(
        "spring_1e6_transient",
        lambda quick: stiff_arm(
            "The first milliseconds of the two-link arm with a spring of 1e6 N m/rad", 5e-3
        ),
        "stable, the fast transient included",
    ),
    Case(
        "tip_1e6_lighter",
        lambda quick: stiff_arm(
            "Two-link arm, second link 1e6 times lighter, spring of 1e6 N m/rad and dampers of 1e4 N m s/rad",
            10.0,
            ratio=1e-6,
        ),
        "stable; the fastest mode decays in 1e-10 s, far below what explicit steps could follow",
    ),
    Case(
        "tip_1e6_heavier",
        lambda quick: arm("Two-link arm, second link 1e6 times heavier", 10.0, ratio=1e6),
        "stable, energy kept",
        energy=1e-9,
    ),
    Case(
        "chain_growing",
        lambda quick: chain(
            "Chain of seven rods, each ten times heavier than the one before",
            0.5 if quick else 2.0,
            [10.0 ** (k - 3) for k in range(7)],
            [0.5] * 7,
            {"q1": -1.2, "q2": 0.1, "q5": -0.1},
        ),
        "stable: light links under heavy load oscillate fast and undamped",
        energy=1e-8,
        relative=1e-5,
    ),
    Case(
        "chain_shrinking",
        lambda quick: chain(
            "Chain of seven rods, each ten times lighter than the one before",
            0.5 if quick else 1.5,
            [10.0 ** (3 - k) for k in range(7)],
            [0.5] * 7,
            {"q1": -0.5},
        ),
        "stable; the light end is whipped about, so the comparable time is short",
        energy=1e-8,
        relative=1e-5,
    ),
    Case(
        "nearly_singular_mass",
        lambda quick: chain(
            "Three rods, the middle one almost without mass and inertia",
            1.0,
            [1.0, 1e-9, 1.0],
            [0.5, 0.5, 0.5],
            {"q1": -1.0, "q2": 0.4, "q3": 0.9},
        ),
        "stable; the mass matrix is close to singular where the rods align",
        energy=1e-8,
        relative=1e-5,
    ),
    Case(
        "links_1e-6_m",
        lambda quick: chain(
            "Two rods of a micrometre", 0.01, [1e-15, 1e-15], [1e-6, 1e-6], {"q1": -1.0, "q2": 0.5}
        ),
        "stable; masses of 1e-15 kg and inertias of 1e-28 kg m^2 are numbers like others",
        energy=1e-8,
    ),
    Case(
        "links_1e3_m",
        lambda quick: chain(
            "Two rods of a kilometre", 300.0, [1e6, 1e6], [1e3, 1e3], {"q1": -1.0, "q2": 0.5}
        ),
        "stable",
        energy=1e-8,
    ),
    Case(
        "links_mixed",
        lambda quick: chain(
            "A rod of a kilometre with one of a micrometre at its end",
            0.05 if quick else 0.5,
            [1.0, 1e-15],
            [1e3, 1e-6],
            {"q1": -1.0, "q2": 0.5},
        ),
        "stable; frequencies 3e4 apart and nothing damped",
        relative=1e-4,
    ),
    Case(
        "start_near_singular",
        lambda quick: scene(
            "Parallelogram started 1e-8 rad from its flat pose",
            PARALLELOGRAM,
            "{q: {theta1: 3.14159264358979, phi2: -3.14159264358979, phi1: 3.14159264358979}, hold: [theta1]}",
            1.0,
            "[0, 0, 0]",
            "{theta1: 1.0}",
        ),
        "refused or stopped as a singular configuration: branches cannot be told apart there",
        stops="SingularConfigurationError",
    ),
    Case(
        "four_bar_folded",
        lambda quick: scene(
            "Four-bar started folded, theta1 = 1e-6",
            FOUR_BAR,
            "{q: {theta1: 1e-6, phi1: 1.02e-6}, hold: [theta1]}",
            20.0,
            "[0, 0, 0]",
            '{theta1: "1.96 - 0.1*theta1"}',
        ),
        "stable: close to a singular pose, but not at it",
        energy=1e-8,
    ),
    Case(
        "pendulum_1e5_s",
        lambda quick: arm("Double pendulum over 1e5 s", 1e3 if quick else 1e5),
        "energy kept for 1e5 s; states are compared as long as the references agree",
        relative=1e-3,
        energy=1e-6,
    ),
    Case(
        "sticking_friction",
        lambda quick: arm(
            "Two-link arm that friction stops and holds",
            10.0,
            ", friction: {coulomb: 150, viscous: 1, transition_speed: 1e-5}",
            ", friction: {coulomb: 80, viscous: 1, transition_speed: 1e-5}",
            start="{q: {theta1: -60 deg, theta2: 45 deg}, qd: {theta1: 3, theta2: -2}}",
        ),
        "stable: slides, stops and creeps with rates of 1e-5 rad/s where it sticks",
        relative=1e-5,
    ),
    Case(
        "sticking_set_valued",
        lambda quick: arm(
            "Two-link arm that set-valued friction stops and holds",
            10.0,
            ", friction: {law: set_valued, coulomb: 150, viscous: 1}",
            ", friction: {law: set_valued, coulomb: 80, viscous: 1}",
            start="{q: {theta1: -60 deg, theta2: 45 deg}, qd: {theta1: 3, theta2: -2}}",
        ),
        "stable: sticks exactly, so nothing creeps and nothing is stiff",
        relative=1e-5,
    ),
    Case(
        "rigid_stops",
        lambda quick: arm(
            "Two-link arm swinging into rigid stops",
            3.0,
            second=", limits: {lower: -1, upper: 1, stop: {restitution: 0.6}}",
            start=RAISED,
        ),
        "stable: every impact is met at its instant, and the joint comes to rest on its stop",
        relative=1e-4,
    ),
    Case(
        "stiff_stops",
        lambda quick: arm(
            "Two-link arm swinging into stiff, damped stops",
            2.0 if quick else 5.0,
            torques='{theta2: "-1e6*max(theta2 - 1, 0) - 1e6*min(theta2 + 1, 0)'
            ' - if(abs(theta2) > 1, 300*qd.theta2, 0)"}',
            start=RAISED,
        ),
        "stable: every impact is met at its instant",
        relative=1e-4,
    ),
    Case(
        "spring_opening",
        lambda quick: slider(
            "Mass bouncing on a spring of 1e8 N/m that opens and closes",
            2.0 if quick else 10.0,
            1.0,
            "if(y < 0, -1e8*y, 0)",
            "{q: {y: 1.0}}",
        ),
        "stable, energy kept over every contact of 0.3 ms",
        energy=1e-7,
        relative=1e-4,
    ),
    Case(
        "governor",
        lambda quick: governor("Governor whose spring stiffens tenfold every second", 8.0),
        "stable; turns stiff on the way, to time constants of 1e-8 s",
    ),
    Case(
        "long_chain",
        lambda quick: chain(
            f"Chain of {100 if quick else 1000} rods let go at an angle",
            0.05 if quick else 0.1,
            *_rods(100 if quick else 1000, 0.01),
            {"q1": -1.0},
        ),
        "stable; work grows with the length only",
        energy=1e-8,
        relative=1e-5,
    ),
    Case(
        "spin_1e4",
        lambda quick: spinning("Rotor at 1e4 rad/s with a swinging blade", 0.02 if quick else 0.5, 1e4),
        "stable; angles of many thousand turns keep their digits",
        energy=1e-8,
    ),
    Case(
        "weightless",
        lambda quick: scene(
            "Two-link arm without gravity",
            LECTURE_ARM % ("", "", 12.456, 1.042, 12.456, 1.042),
            "{q: {theta1: 0, theta2: 1}, qd: {theta1: 1, theta2: -2}}",
            100.0,
            "[0, 0, 0]",
        ),
        "stable, energy kept",
        energy=1e-9,
    ),
    Case(
        "gravity_alone",
        lambda quick: slider("Mass in free fall", 10.0, 1.0, "", "{q: {y: 0}}"),
        "exact: y = -g t^2 / 2",
        relative=1e-12,
        energy=1e-12,
    ),
)
