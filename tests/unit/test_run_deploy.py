"""Deployment: where and when a mechanism locks, what the multipliers do on the way, and what the latch costs."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robodyn_cli import deploy, load_scene, load_scene_text
from robodyn_cli.errors import CapabilityError, GeometryError, SingularConfigurationError
from robodyn_cli.results.result import Result
from tests.planar_bodies import GROUND, Motor, Pin, PlanarBodies, turned

CONFIGS = Path(__file__).parents[2] / "configs"
LOCK_TIME, LOCK_ANGLE = 12.282996, 150.46230
GROUND_LINK = CRANK = 1.241
ROD = 1.2
ROD_INERTIA = 0.06 + 8.25 * 0.6**2  # about its end
ALIGNED = 2 * np.arcsin(
    ROD / CRANK
)  # pure geometry: crank and ground are equal, so the rods align on the diagonal


@cache
def four_bar(*overrides: str, name: str = "four_bar_deploy") -> Result:
    return deploy(load_scene(CONFIGS / f"{name}.yaml", overrides))


def summary_of(result: Result) -> dict[str, Any]:
    return result.summary


# -- an independent model of the lecture's four-bar --------------------------------------------------------
def mechanism() -> PlanarBodies:
    """The pin that is cut comes last, so that its multipliers are the last two."""
    return PlanarBodies(
        masses=[20.15, 8.25, 8.25],
        inertias=[9.6, 0.06, 0.06],
        pins=[
            Pin(GROUND, (0, 0), 0, (-1.2, 0)),
            Pin(0, (CRANK - 1.2, 0), 1, (-0.6, 0)),
            Pin(GROUND, (GROUND_LINK, 0), 2, (-0.6, 0)),
            Pin(1, (0.6, 0), 2, (0.6, 0)),
        ],
        motors=[Motor(GROUND, 0, lambda t, angle, rate: 1.96 - 0.1 * angle)],
    )


def absolute(q: np.ndarray, qd: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return positions and rates of the centres of mass from (theta1, phi2, phi1)."""
    angles, rates = (np.array([x[0], x[0] + x[1], x[2]]) for x in (q, qd))

    def spin(k: int, p: tuple[float, float]) -> np.ndarray:
        r = turned(angles[k], p)
        return rates[k] * np.array([-r[1], r[0]])

    elbow = turned(angles[0], (CRANK, 0))
    places = [turned(angles[0], (1.2, 0)), elbow + turned(angles[1], (0.6, 0))]
    places.append(np.array([GROUND_LINK, 0]) + turned(angles[2], (0.6, 0)))
    speeds = [spin(0, (1.2, 0)), spin(0, (CRANK, 0)) + spin(1, (0.6, 0)), spin(2, (0.6, 0))]
    x = np.concatenate([[*p, a] for p, a in zip(places, angles)])
    return x, np.concatenate([[*s, w] for s, w in zip(speeds, rates)])


def follower_angles(theta: float, branch: int) -> tuple[float, float]:
    """Return the absolute angles of coupler and follower that close the loop."""
    elbow = CRANK * np.array([np.cos(theta), np.sin(theta)])
    foot = np.array([GROUND_LINK, 0.0])
    d = foot - elbow
    r = float(np.hypot(*d))
    pin = elbow + d / 2 + branch * np.sqrt(max(ROD**2 - r * r / 4, 0.0)) * np.array([-d[1], d[0]]) / r
    return float(np.arctan2(*(pin - elbow)[::-1])), float(np.arctan2(*(pin - foot)[::-1]))


def work_of_spring(theta: float) -> float:
    """Return the work [J] that the spring has done from the start to this angle of the crank."""
    return 1.96 * (theta - 0.01) - 0.05 * (theta**2 - 0.01**2)


def time_by_energy(branch: int) -> float:
    """Return when the rods align, from the energy integral: t = int d theta / sqrt(2 W / M_eff).

    Substitutions theta = start + s^2 and theta = end - u^2 remove the singular ends.
    """
    from scipy.integrate import quad

    end, start = ALIGNED, 0.01
    J1 = 9.6 + 20.15 * 1.2**2 + 8.25 * CRANK**2
    J = ROD_INERTIA
    k = 8.25 * CRANK * 0.6

    def inertia(theta: float) -> float:
        b, c = follower_angles(theta, branch)
        rows = np.array([[-ROD * np.sin(b), ROD * np.sin(c)], [ROD * np.cos(b), -ROD * np.cos(c)]])
        rb, rc = np.linalg.solve(rows, -CRANK * np.array([-np.sin(theta), np.cos(theta)]))
        return float(J1 + 2 * k * np.cos(theta - b) * rb + J * (rb * rb + rc * rc))

    def slowness(theta: float) -> float:
        return float(np.sqrt(inertia(theta) / (2 * work_of_spring(theta))))

    middle = 1.3
    first = quad(
        lambda s: 2 * s * slowness(start + s * s), 0, np.sqrt(middle - start), epsabs=1e-11, limit=200
    )[0]
    tail = 1e-4
    second = quad(
        lambda u: 2 * u * slowness(end - u * u), tail, np.sqrt(end - middle), epsabs=1e-10, limit=200
    )[0]
    # towards the end the integrand tends to a constant
    return float(first + second + 2 * tail * tail * slowness(end - tail * tail))


# -- the lecture's lock ------------------------------------------------------------------------------------
def test_the_lock() -> None:
    result = four_bar()
    lock = result.summary["lock"]
    assert result.status == "locked" == result.summary["status"]
    assert round(lock["time"], 6) == LOCK_TIME
    assert round(lock["angles_deg"]["theta1"], 5) == LOCK_ANGLE
    assert lock["kind"] == "dead_point" and lock["criterion"] == "dead_point" and not lock["driven"]
    assert lock["time_error"] < 1e-10
    assert result.time[-1] == lock["time"]
    assert result.summary["termination"]["time"] == lock["time"]
    assert lock["angles"]["theta1"] == pytest.approx(ALIGNED, abs=1e-12)
    rates = lock["rates"]
    assert rates["theta1"] == pytest.approx(0.0, abs=1e-9)
    # the crank rests, and the rods share what the spring has done
    rate = np.sqrt(work_of_spring(ALIGNED) / ROD_INERTIA)
    assert [rates["phi2"], rates["phi1"]] == pytest.approx([-rate, rate], abs=1e-8)


def test_the_time_agrees_with_the_energy_integral() -> None:
    assert four_bar().summary["lock"]["time"] == pytest.approx(time_by_energy(1), abs=2e-6)


def test_the_other_branch() -> None:
    result = four_bar("initial.q={theta1: 0.01, phi1: 3.14}")
    lock = result.summary["lock"]
    assert round(lock["time"], 4) == 10.7160
    assert lock["time"] == pytest.approx(time_by_energy(-1), abs=2e-6)
    assert round(lock["angles_deg"]["theta1"], 5) == LOCK_ANGLE


@pytest.mark.parametrize(
    "overrides",
    [
        ("simulate.rtol=1e-4", "simulate.atol=1e-6"),
        ("simulate.rtol=1e-7", "simulate.atol=1e-9"),
        ("simulate.rtol=1e-13", "simulate.atol=1e-15"),
        ("simulate.integrator=dop853",),
        ("simulate.integrator=dopri5",),
        ("simulate.integrator=rk4", "simulate.step=2e-3"),
        ("simulate.stabilisation=none",),
        ("simulate.stabilisation={alpha: 5, beta: 5}",),
        ("simulate.samples=2",),
        ("simulate.samples=50001", "simulate.error_estimate=false"),
        ("simulate.duration=12.29",),
        ("simulate.duration=1000",),
    ],
    ids=lambda o: " ".join(o).replace("simulate.", ""),
)
def test_nothing_but_physics_moves_the_lock(overrides: tuple[str, ...]) -> None:
    lock = four_bar(*overrides).summary["lock"]
    assert round(lock["time"], 6) == LOCK_TIME
    assert round(lock["angles_deg"]["theta1"], 5) == LOCK_ANGLE
    assert lock["latch"]["energy_lost"] == pytest.approx(work_of_spring(ALIGNED), abs=1e-5)


@pytest.mark.parametrize("rtol", [1e-4, 1e-6, 1e-8])
def test_the_error_of_the_time_is_bounded(rtol: float) -> None:
    exact = four_bar("simulate.rtol=1e-13", "simulate.atol=1e-15").summary["lock"]["time"]
    lock = four_bar(f"simulate.rtol={rtol}", f"simulate.atol={rtol / 100}").summary["lock"]
    assert abs(lock["time"] - exact) <= 3 * lock["time_error"] + 1e-12


# -- multipliers -------------------------------------------------------------------------------------------
def test_multipliers_are_those_of_the_saddle_point_system() -> None:
    result = four_bar()
    bodies = mechanism()
    for k in (0, 300, 600, 900, 1200, 1225, len(result.time) - 1):
        q, qd = result["q"][k], result["qd"][k]
        x, v = absolute(q, qd)
        eta, _, _ = bodies.constraints(x, v)
        a, lam = bodies.accelerations(result.time[k], x, v)
        assert np.abs(eta).max() < 1e-13
        np.testing.assert_allclose(result["constraints/multipliers"][k], lam[-2:], rtol=1e-7, atol=1e-9)
        np.testing.assert_allclose(result["qdd"][k][[0, 2]], a[[2, 8]], rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize(("time", "norm"), [(0.0, "26.69"), (6.0, "0.13"), (12.25, "364")])
def test_norm_of_the_multipliers(time: float, norm: str) -> None:
    result = four_bar()
    k = int(np.argmin(np.abs(result.time - time)))
    assert result.time[k] == pytest.approx(time, abs=1e-12)
    digits = len(norm.partition(".")[2])
    assert round(float(np.linalg.norm(result["constraints/multipliers"][k])), digits) == float(norm)


@pytest.mark.parametrize(("samples", "part"), [(2001, 0.01), (501, 0.05)])
def test_multipliers_are_largest_at_the_lock_which_samples_tell(samples: int, part: float) -> None:
    """They rise up to it; the error was twice the value, as large as the multipliers range."""
    found = four_bar(f"simulate.samples={samples}").summary["lock"]["multipliers"]
    assert found["largest_until_lock"] == pytest.approx(found["at_lock"], rel=1e-9)
    assert found["errors"]["largest_until_lock"] < part * found["at_lock"]


def test_multipliers_at_the_lock_are_large_and_finite() -> None:
    result = four_bar()
    last = result["constraints/multipliers"][-1]
    assert round(float(np.linalg.norm(last)), 2) == 1552.36
    np.testing.assert_allclose(np.abs(last), (1504.710, 381.671), atol=1e-2)
    multipliers = result.summary["lock"]["multipliers"]
    assert round(multipliers["at_lock"], 2) == 1552.36 and round(multipliers["start"], 2) == 26.69
    assert multipliers["rows"] == ["pin.x", "pin.y"] and not multipliers["diverge"]


@pytest.mark.parametrize(("level", "time"), [("10", 11.990), ("100", 12.196), ("1000", 12.268)])
def test_growth_over_the_running_median(level: str, time: float) -> None:
    assert abs(four_bar().summary["criteria"]["growth_times"][level] - time) <= 1e-3 + 1e-12


def test_growth_is_that_of_the_definition() -> None:
    """The norm on a 1 ms grid, against the median of all values so far."""
    result = four_bar("simulate.samples=12001", "simulate.duration=12", "simulate.error_estimate=false")
    norm = np.linalg.norm(result["constraints/multipliers"], axis=1)
    crossed = next(k for k in range(11_500, 12_001) if norm[k] > 10 * np.median(norm[: k + 1]))
    assert result.summary["criteria"]["growth_times"]["10"] == pytest.approx(crossed * 1e-3, abs=1e-12)
    assert result.status == "no_lock"


def test_singular_values_tell_the_kind() -> None:
    result = four_bar()
    psi, passive = result["singularity/psi"], result["singularity/passive"]
    assert psi[-1, -1] > 0.3 and passive[-1, -1] < 1e-12 and passive[:-1, -1].min() > 1e-3
    assert result["singularity/determinant"][-1] == pytest.approx(0.0, abs=1e-12)
    lock = result.summary["lock"]["singular_values"]
    np.testing.assert_allclose(lock["psi"], psi[-1], rtol=1e-9)
    # Psi by hand: columns theta1, phi2 (relative) and phi1
    a, b, c = result["q"][600][0], result["q"][600][:2].sum(), result["q"][600][2]
    crank, coupler = CRANK * np.array([-np.sin(a), np.cos(a)]), ROD * np.array([-np.sin(b), np.cos(b)])
    follower = ROD * np.array([-np.sin(c), np.cos(c)])
    by_hand = np.column_stack([crank + coupler, coupler, -follower])
    np.testing.assert_allclose(psi[600], np.linalg.svd(by_hand, compute_uv=False), rtol=1e-10)
    np.testing.assert_allclose(passive[600], np.linalg.svd(by_hand[:, 1:], compute_uv=False), rtol=1e-10)


# -- the latch ---------------------------------------------------------------------------------------------
def test_latch() -> None:
    latch = four_bar().summary["lock"]["latch"]
    # both rods turn about an end that rests, in opposite directions: by symmetry the pin has no part in stopping them
    stopped = np.sqrt(ROD_INERTIA * work_of_spring(ALIGNED))
    assert latch["angular_impulse"] == pytest.approx(stopped, abs=1e-8)
    assert max(abs(x) for x in latch["rates_after"].values()) < 1e-9
    assert latch["energy_lost"] == pytest.approx(work_of_spring(ALIGNED), abs=1e-8), (
        "all of the spring's work"
    )


@pytest.mark.parametrize("growth", [None, 300.0])
def test_latch_against_an_independent_impulse(growth: float | None) -> None:
    """At the dead point, and on the way to it, where the crank goes on turning after the latch has closed."""
    overrides = () if growth is None else ("deploy.criterion=multipliers", f"deploy.growth={growth}")
    result = four_bar(*overrides)
    q, qd = result["q"][-1], result["qd"][-1]
    x, v = absolute(q, qd)
    locked = np.zeros((1, 9))
    locked[0, 5], locked[0, 8] = 1.0, -1.0  # coupler and follower turn alike from now on
    bodies = mechanism()
    after, impulse = bodies.impulse(x, v, locked)
    latch = result.summary["lock"]["latch"]
    rates = [latch["rates_after"][name] for name in ("theta1", "phi2", "phi1")]
    np.testing.assert_allclose(rates, [after[2], after[5] - after[2], after[8]], atol=1e-8)
    assert latch["angular_impulse"] == pytest.approx(abs(impulse[-1]), rel=1e-6)
    np.testing.assert_allclose(
        [latch["impulse"]["pin.x"], latch["impulse"]["pin.y"]], impulse[6:8], rtol=1e-6, atol=1e-8
    )
    M = bodies.mass_matrix()
    assert latch["energy_lost"] == pytest.approx(0.5 * v @ M @ v - 0.5 * after @ M @ after, abs=1e-7)
    assert latch["energy_lost"] >= 0.0


def test_latch_to_the_ground() -> None:
    latch = four_bar("deploy.latch.between=[base, crank]").summary["lock"]["latch"]
    # at the dead point the crank stands still anyway: holding it takes nothing from the rods
    assert latch["energy_lost"] == pytest.approx(0.0, abs=1e-9)
    assert latch["rates_after"]["phi1"] == pytest.approx(latch["rates_before"]["phi1"], abs=1e-9)


def test_without_a_latch_there_is_none() -> None:
    lock = four_bar("deploy.latch=null").summary["lock"]
    assert "latch" not in lock or lock["latch"] is None


# -- criteria ----------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("overrides", "time", "criterion", "kind"),
    [
        (("deploy.criterion=dead_point",), LOCK_TIME, "dead_point", "dead_point"),
        (("deploy.criterion=multipliers",), 12.268, "multipliers", "approaching_dead_point"),
        (("deploy.criterion=multipliers", "deploy.growth=100"), 12.197, "multipliers", "approaching_dead_point"),
        (("deploy.criterion=multipliers", "deploy.growth=1e6", "deploy.limit=364"), 12.25, "multipliers",
         "approaching_dead_point"),
        (("deploy.criterion=either",), 12.268, "multipliers", "approaching_dead_point"),
        (("deploy.criterion=either", "deploy.growth=1e6"), LOCK_TIME, "dead_point", "dead_point"),
        (("deploy.criterion=either", "deploy.growth=1e6", "deploy.limit=1000"), 12.272, "multipliers",
         "approaching_dead_point"),
    ],
    ids=lambda x: " ".join(x).replace("deploy.", "") if isinstance(x, tuple) else "",
)  # fmt: skip
def test_criteria(overrides: tuple[str, ...], time: float, criterion: str, kind: str) -> None:
    result = four_bar(*overrides)
    lock = result.summary["lock"]
    assert lock["time"] == pytest.approx(time, abs=1e-3 if criterion == "multipliers" else 5e-7)
    assert (lock["criterion"], lock["kind"], result.status) == (criterion, kind, "locked")
    # both are reported whichever was chosen
    criteria = result.summary["criteria"]
    assert round(criteria["dead_point"], 6) == LOCK_TIME
    assert criteria["growth_times"]["1000"] == pytest.approx(12.268, abs=1e-3)
    if criterion == "multipliers":
        assert lock["time_error"] == pytest.approx(1e-3)
        assert "dead point" in result.summary["termination"]["reason"]
    assert result.time[-1] == pytest.approx(lock["time"], abs=1e-12)


def test_growth_that_is_never_reached() -> None:
    result = four_bar("deploy.criterion=multipliers", "deploy.growth=1e9")
    assert result.status == "no_lock" and result.summary["lock"] is None
    # the motion went on through the dead point
    assert result.time[-1] == 20.0
    assert [e["time"] for e in result.events if e["name"] == "dead_point"]
    assert round(result.summary["criteria"]["dead_point"], 6) == LOCK_TIME


@pytest.mark.parametrize("limit", [1.0, 10.0, 26.0])
def test_a_load_that_passes_by_itself_is_an_overload_and_no_lock(limit: float) -> None:
    result = four_bar("deploy.criterion=multipliers", "deploy.growth=1e9", f"deploy.limit={limit}")
    assert result.status == "overload" and result.summary["lock"]["kind"] == "overload"
    assert result.summary["lock"]["latch"] is None
    assert result.summary["criteria"]["limit_time"] == 0.0  # it starts with 26.69 N


def test_without_a_lock_the_run_goes_to_its_duration() -> None:
    result = four_bar("simulate.duration=5", "simulate.samples=51")
    assert result.status == "no_lock" and result.summary["lock"] is None
    assert result.time[-1] == 5.0 and len(result.time) == 51
    assert result.summary["criteria"]["dead_point"] is None
    assert "no lock" in result.summary["termination"]["reason"]


def test_a_mechanism_at_rest_without_load_meets_nothing() -> None:
    result = four_bar("torques.theta1=0", "simulate.duration=1", "deploy.criterion=either")
    assert result.status == "no_lock" and np.ptp(result["q"], axis=0).max() < 1e-15
    assert set(result.summary["criteria"]["growth_times"].values()) == {None}


def test_load_that_sets_in_late_is_no_growth() -> None:
    """The multipliers are zero at first; nothing is a multiple of a median that is zero."""
    result = four_bar(
        'torques.theta1="if(t < 1, 0, 1)"', "simulate.duration=1.5", "deploy.criterion=multipliers"
    )
    assert result.status == "no_lock"


# -- other mechanisms --------------------------------------------------------------------------------------
def test_the_parallelogram_bifurcates() -> None:
    with pytest.raises(SingularConfigurationError) as caught:
        four_bar(name="parallelogram")
    error = caught.value
    exact = np.sqrt(2 * np.radians(150) * (1 / 3 + 1 / 3 + 2))
    assert error.exit_code == 4 and "bifurcation" in error.message and "pin" in error.message
    assert error.details["time"] == pytest.approx(exact, abs=1e-7)
    assert error.details["angles"]["theta1"] == pytest.approx(np.pi, abs=1e-7)
    result = error.result  # type: ignore[attr-defined]
    assert result.status == "failed" and result.time[-1] == error.details["time"]
    assert result.summary["termination"]["kind"] == "bifurcation"
    assert result["singularity/psi"][-1, -1] < 1e-8 and np.all(np.isfinite(result["constraints/multipliers"]))
    assert [e["kind"] for e in result.events if e["kind"] == "bifurcation"] == ["bifurcation"]


def test_a_crank_prescribed_through_the_dead_point() -> None:
    result = four_bar(name="four_bar_prescribed")
    lock = result.summary["lock"]
    assert result.status == "locked" and lock["driven"] and lock["kind"] == "dead_point"
    assert lock["time"] == pytest.approx(np.sqrt((2 * np.arcsin(ROD / CRANK) - 0.01) / 0.02), abs=1e-11)
    assert lock["multipliers"]["diverge"] and lock["latch"] is None and "unbounded" in lock["latch_note"]
    reason = result.summary["termination"]["reason"]
    assert "theta1" in reason and "diverge" in reason and "dead point" in reason
    norm = np.linalg.norm(result["constraints/multipliers"][:, :2], axis=1)
    assert norm[-1] > 10 * norm.min() and norm[-1] == norm.max() > 1e4
    np.testing.assert_allclose(result["q"][:, 0], 0.01 + 0.02 * result.time**2, atol=1e-12)
    assert result.summary["error_estimate"]["state_max"] < 1e-9


def test_prescribed_crank_stopped_by_the_multipliers() -> None:
    result = four_bar("deploy.criterion=multipliers", name="four_bar_prescribed")
    lock = result.summary["lock"]
    assert lock["kind"] == "approaching_dead_point" and lock["time_error"] == pytest.approx(1e-3)
    assert lock["time"] < result.summary["criteria"]["dead_point"] < 11.44


# a toggle: slider-crank whose crank is free and whose slider is pushed locks when crank and rod are in line
TOGGLE = """
schema: 1
gravity: [0, 0, 0]
robot:
  convention: standard
  joints:
    - {name: crank, type: revolute, a: 0.3, alpha: 0, d: 0}
    - {name: rod, type: revolute, a: 0.8, alpha: 0, d: 0}
    - {name: slide, type: prismatic, parent: base, link: piston, a: 0, alpha: 0, theta: 0, origin: {rpy: [0, 90 deg, 0]}}
  links:
    - {name: disc, mass: 3, com: [0.1, 0, 0], com_frame: joint, inertia: {zz: 0.2}}
    - {name: bar, mass: 1, com: [0.4, 0, 0], com_frame: joint, inertia: {zz: 0.07}}
    - {name: piston, mass: 2, com: [0, 0, 0], com_frame: joint, inertia: {zz: 0.1}}
loops: [{name: pin, type: revolute, between: [bar.end, piston.origin], axis2: [-1, 0, 0]}]
actuated: [slide]
torques: {slide: 5}
initial: {q: {crank: 90 deg, rod: -100 deg, slide: 0.75}, hold: [crank]}
simulate: {duration: 10, samples: 101}
deploy: {latch: {between: [disc, bar]}}
"""


def test_a_slider_crank_locks_where_crank_and_rod_align() -> None:
    result = deploy(load_scene_text(TOGGLE))
    lock = result.summary["lock"]
    assert result.status == "locked" and lock["kind"] == "dead_point"
    assert lock["angles"]["crank"] == pytest.approx(0.0, abs=1e-9)
    assert lock["angles"]["slide"] == pytest.approx(1.1, abs=1e-9)
    assert set(lock["angles_deg"]) == {"crank", "rod"}
    assert lock["rates"]["slide"] == pytest.approx(0.0, abs=1e-9)
    # the work of the force on the slider is all there is
    work = 5 * (1.1 - float(result["q"][0, 2]))
    assert result["energy/kinetic"][-1] == pytest.approx(work, rel=1e-9)
    before, after = lock["latch"]["rates_before"], lock["latch"]["rates_after"]
    assert before["rod"] > 0 and after["rod"] == pytest.approx(0.0, abs=1e-9)


def test_a_six_bar_locks_at_the_dead_point_of_its_second_loop() -> None:
    from tests.mechanisms import SIX_BAR

    text = "schema: 1\n" + SIX_BAR.replace("gravity: [0, -9.81, 0]", "gravity: [0, 0, 0]")
    for old, new in (
        ("duration: 2", "duration: 20"),
        ("a: 1.1, alpha", "a: 0.8, alpha"),
        ("base, a: 0.8", "base, a: 0.5"),
        ("xyz: [2.1", "xyz: [1.9"),
    ):
        assert text.count(old) == 1
        text = text.replace(old, new)
    result = deploy(load_scene_text(text + "actuated: [crank]\n"))
    lock = result.summary["lock"]
    assert lock["kind"] == "dead_point"
    # a dead point of the crank: coupler and output of the second loop are in line, those of the first are not
    q = lock["angles"]
    assert abs(np.sin(q["rocker"] + q["c2"] - q["out"])) < 1e-9
    assert abs(np.sin(q["crank"] + q["c1"] - q["rocker"])) > 0.01
    assert lock["singular_values"]["passive"][-1] < 1e-9 < lock["singular_values"]["psi"][-1]


# -- what must fail, and how -------------------------------------------------------------------------------
def test_open_chains_do_not_deploy() -> None:
    with pytest.raises(CapabilityError, match="closed loops"):
        four_bar(name="double_pendulum")


@pytest.mark.parametrize(
    "overrides",
    [("actuated=null", "torques=null"), ("actuated=[theta1, phi1]", "torques=null")],
    ids=["none", "two"],
)
def test_a_dead_point_needs_as_many_actuators_as_freedoms(overrides: tuple[str, ...]) -> None:
    with pytest.raises(CapabilityError, match="degrees of freedom") as caught:
        four_bar(*overrides)
    assert "actuated" in caught.value.message


def test_multipliers_can_be_followed_whatever_is_actuated() -> None:
    result = four_bar("actuated=null", "torques=null", "initial.qd={theta1: 0.2}", "deploy.criterion=multipliers",
                      "deploy.growth=50")  # fmt: skip
    assert result.status in ("locked", "overload", "no_lock")


def test_a_loop_that_cannot_close_says_which_and_by_how_much() -> None:
    with pytest.raises(GeometryError) as caught:
        four_bar("robot.joints.phi1.origin.xyz=[10, 0, 0]")
    elbow = CRANK * np.array([np.cos(0.01), np.sin(0.01)])
    gap = float(np.hypot(*(np.array([10.0, 0.0]) - elbow))) - 2 * ROD
    assert caught.value.exit_code == 5 and "'pin'" in caught.value.message
    assert caught.value.details["gap"] == pytest.approx(gap, rel=1e-6)
    assert f"{gap:.6g}" in caught.value.message


def test_a_start_in_the_dead_point() -> None:
    """Aligned rods: the crank cannot move them, and the run says so at once or starts away from it."""
    with pytest.raises(GeometryError):
        four_bar("initial.q={theta1: 2.7}")
    result = four_bar("initial.q={theta1: 2.62, phi1: 2.8}", "simulate.duration=3")
    assert result.status == "locked" and result.summary["lock"]["time"] < 3.0
