"""``optimise``: optima that are known otherwise, and what is told of them; runs that fail, choices, what is refused."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robodyn_cli.errors import CapabilityError, SceneError
from robodyn_cli.expr.statements import parse_expectation, parse_variation
from robodyn_cli.over.findings import findings
from robodyn_cli.over.search.asked import options_of, prepare
from robodyn_cli.over.search.journal import SearchJournal
from robodyn_cli.over.search.lanes import Lanes
from robodyn_cli.over.search.points import PointMaker
from robodyn_cli.over.search.report import report
from robodyn_cli.over.search.search import EndedSearch, run_search
from robodyn_cli.over.study.runs import make_one
from robodyn_cli.results.result import Result
from robodyn_cli.scene.load import Family, load_scene_text
from robodyn_cli.works.deploy.deploy import deploy

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "configs" / "search"
STIFFNESS = "forces.spring.stiffness"
PEAK, NET = (
    14.715,
    math.sin(math.radians(70)) + math.sin(math.radians(60)),
)  # of the weight [N m], of its work

ARM = """
schema: 1
title: arm
command: inverse
gravity: [0, -9.81, 0]
robot:
  joints: [{name: arm, type: revolute, axis: [0, 0, 1], parent: base}]
  links: [{name: beam, mass: 3, com: [0.5, 0, 0], com_frame: joint, inertia: {zz: 0.1}}]
  points: {post: {link: base, at: [0, 0.4, 0]}, hook: {link: beam, at: [0.3, 0, 0]}}
forces: [{name: spring, type: spring, between: [post, hook], stiffness: 50}]
trajectory: {type: joint, duration: 10, q: {arm: "-60 deg + 13 deg * t"}}
inverse: {samples: 101}
"""


def searched(
    family: Family, journal: SearchJournal | None = None, **changes: Any
) -> tuple[Result, EndedSearch, PointMaker]:
    """Return the result of a search, how it ended, and what made its runs."""
    read = {
        "vary": parse_variation,
        "keep": parse_expectation,
        "reach": lambda x: parse_expectation(x) if isinstance(x, (str, int, float)) else x,
    }
    own = {
        name: {key: read[name](x) for key, x in value.items()} if name in read else value
        for name, value in changes.items()
    }
    search = prepare(family, options_of(family.own.search, own))
    with journal or SearchJournal() as kept:
        maker = PointMaker(search, 1, kept, lambda runs: None)
        ended = run_search(search, maker)
    return report(ended, maker, 0.0), ended, maker


def arm(text: str = ARM) -> Family:
    return Family.of(load_scene_text(text))


# -- known answers ------------------------------------------------------------------------------------------
def test_outputs_that_do_not_change_take_few_runs() -> None:
    """A count that stays at its bound leaves nothing to follow but rounding, which has no end."""
    vary = {"robot.links.band.mass": "uniform(0.99, 1.01)"}
    keep = {"transitions.slip": ">= 3"}
    family = Family(ROOT / "configs" / "stick_slip.yaml")
    result, _, maker = searched(family, vary=vary, minimise="final.q.belt", keep=keep)
    assert len(maker.points) <= 60
    assert abs(result.summary["figures"]["final.q.belt"]["value"] - 2.4) < 1e-11


def test_a_spring_of_zero_free_length_carries_an_arm() -> None:
    result, *_ = searched(Family(EXAMPLES / "spring_balance.yaml"))
    key = result.summary["keys"][STIFFNESS]
    assert abs(key["value"] - 122.625) <= min(key["uncertainty"], 1e-9)
    assert result.status == "ok" and result.summary["figures"]["peak_torque.arm"]["met"]
    assert result.summary["search"]["same"] == result.summary["search"]["starts"] == 4


@pytest.mark.parametrize("seed", range(6))
def test_springs_carry_random_arms(seed: int) -> None:
    """k = m g r / (a b), whatever the arm; each value within the uncertainty that is stated, and all digits repeat."""
    rng = np.random.default_rng(seed)
    m, r, a, b, g = rng.uniform((0.5, 0.1, 0.1, 0.1, 1.0), (20.0, 1.5, 1.0, 0.8, 12.0)).tolist()
    first, turn, wide = rng.uniform((-90, 20, 2), (0, 90, 20)).tolist()
    family = arm(
        ARM.replace("mass: 3, com: [0.5", f"mass: {m!r}, com: [{r!r}").replace("[0, 0.4, 0]", f"[0, {a!r}, 0]")
        .replace("[0.3, 0, 0]", f"[{b!r}, 0, 0]").replace("-9.81", repr(-g))
        .replace("-60 deg + 13 deg", f"{first!r} deg + {turn / 10!r} deg")
    )  # fmt: skip
    wanted = m * g * r / (a * b)
    goal = {"reach": {"peak_torque.arm": 0}} if seed % 2 else {"minimise": "rms_torque.arm"}
    bounds = f"uniform({0.05 * wanted!r}, {wide * wanted!r})"
    result, ended, _ = searched(family, vary={STIFFNESS: bounds}, starts=3, **goal)
    key = result.summary["keys"][STIFFNESS]
    assert abs(key["value"] - wanted) <= 1e-7 * wanted
    assert abs(key["value"] - wanted) <= key["uncertainty"] + 1e-12 * wanted
    again, _ = make_one(ended.search.task, 0, np.array([float(repr(key["value"]))]))
    assert again.rows["outputs"][0, 0] == ended.own.y[0]


def test_counterweights_take_the_shaking_force() -> None:
    """m1 z1 = -m2 a1 (1 - z2/a2), m3 z3 = -m2 a3 z2/a2 (Berkof and Lowen 1969)."""
    result, _, _ = searched(Family(EXAMPLES / "counterweights.yaml"), starts=1)
    m1, m2, m3, a1, a2, a3, z2 = 4.0, 2.0, 5.0, 0.4, 1.2, 0.9, 0.5 + 0.1j
    wanted = [-m2 * a1 * (1 - z2 / a2) / m1, -m2 * a3 * z2 / a2 / m3]
    keys = list(result.summary["keys"].values())
    for one, x in zip(keys, [part for z in wanted for part in (z.real, z.imag)]):
        assert abs(one["value"] - x) <= 1e-9 and one["uncertainty"] <= 1e-8
    assert result.summary["search"]["runs"] <= 10
    assert not result.summary["not_exact"]


def test_the_least_time_to_a_lock_under_a_limit_of_its_latch() -> None:
    """The spring's work is the energy at the lock, 3.03 J for 1 rad/s; as stiff a spring as allowed gives it early."""
    result, *_ = searched(Family(EXAMPLES / "fastest_lock.yaml"))
    q0, q1 = 0.01, math.acos((2 * 1.241**2 - 2.4**2) / (2 * 1.241**2))
    preload, stiffness = result.summary["keys"].values()
    limit = result.summary["limits"]["lock.rates.phi1"]
    assert stiffness["value"] == 0.5 and stiffness["at"] == "upper bound" and stiffness["price"] < 0.0
    wanted = (3.03 + 0.25 * (q1**2 - q0**2)) / (q1 - q0)
    assert abs(preload["value"] - wanted) <= preload["uncertainty"] <= 1e-7
    # at the limit itself, which the search keeps a little room to, the lock is as much earlier as it says
    own = result.summary["figures"]["lock.time"]
    family = Family(EXAMPLES / "fastest_lock.yaml", [f"torques.theta1#1={wanted!r}", "torques.theta1#2=0.5"])
    exact = deploy(family.own).summary["lock"]
    assert abs(own["value"] - exact["time"]) <= own["from_optimum"] + exact["time_error"] <= 1e-7
    assert own["value"] > exact["time"]
    assert limit["holds"] and limit["active"] and result.status == "ok"
    assert result.summary["search"]["runs"] < 40
    # the price: with more speed allowed the preload follows the work, and the time follows the preload
    faster, *_ = searched(
        Family(EXAMPLES / "fastest_lock.yaml"), keep={"lock.rates.phi1": "<= 1.001"}, starts=1
    )
    change = (
        faster.summary["figures"]["lock.time"]["value"] - result.summary["figures"]["lock.time"]["value"]
    ) / 1e-3
    assert change == pytest.approx(limit["price"], rel=5e-3)
    assert abs(limit["price_error"]) < 1e-6


def pairs_of_points(P: np.ndarray, turns: np.ndarray) -> list[tuple[complex, complex]]:
    """Return pivots O and pins W, as complex numbers, with |P_j - O - W exp(i turn_j)| the same for five positions j.

    Squared and subtracted the conditions are linear in O, W and c = conj(O) W; what is left are two conics in two
    numbers, whose intersections are roots of a quartic (closed form, as Freudenstein and Sandor 1959 have one).
    """
    e = np.exp(1j * turns)
    p, pe = P, np.conj(P) * e
    rows = np.column_stack([p.real, p.imag, pe.real, -pe.imag, -e.real, e.imag])
    A, b = rows[1:] - rows[0], 0.5 * (np.abs(P[1:]) ** 2 - np.abs(P[0]) ** 2)
    x0 = np.linalg.lstsq(A, b, rcond=None)[0]
    N = np.linalg.svd(A)[2][4:].T

    def conic(values: Any) -> np.ndarray:
        """Return coefficients of 1, s, t, s^2, s t, t^2 from six values."""
        places = np.array([(0, 0), (1, 0), (0, 1), (-1, 0), (0, -1), (1, 1)], dtype=float)
        s, t = places.T
        basis = np.column_stack([np.ones(6), s, t, s * s, s * t, t * t])
        return np.linalg.solve(basis, [values(x0 + N @ place) for place in places])

    def off(x: np.ndarray) -> complex:
        return complex(np.conj(x[0] + 1j * x[1]) * (x[2] + 1j * x[3]) - (x[4] + 1j * x[5]))

    f, g = conic(lambda x: off(x).real), conic(lambda x: off(x).imag)
    poly = np.polynomial.polynomial
    first, second = (([q[0], q[1], q[3]], [q[2], q[4]], [q[5]]) for q in (f, g))
    cross = [poly.polysub(poly.polymul(first[i], second[j]), poly.polymul(first[j], second[i]))
             for i, j in ((2, 0), (2, 1), (1, 0))]  # fmt: skip
    roots = poly.polyroots(poly.polysub(poly.polymul(cross[0], cross[0]), poly.polymul(cross[1], cross[2])))
    found = []
    for s in roots[np.abs(roots.imag) < 1e-6].real:
        t = -poly.polyval(s, cross[0]) / poly.polyval(s, cross[1])
        x = x0 + N @ np.array([s, t])
        found.append((complex(x[0], x[1]), complex(x[2], x[3])))
    return found


def test_a_four_bar_through_five_points_is_that_of_the_closed_form() -> None:
    """Crank and rocker are both pairs of the closed form for the five points, with the turns of crank and coupler."""
    result, ended, _ = searched(Family(EXAMPLES / "five_point_four_bar.yaml"), starts=20)
    assert result.status == "ok"
    x = [key["value"] for key in result.summary["keys"].values()]
    O1, W, O2, b, c, trace = (
        complex(x[0], x[1]), complex(x[2], x[3]), complex(x[4], x[5]), x[6], x[7], complex(x[8], x[9])
    )  # fmt: skip
    goal = ended.search.goal.targets
    P = np.array([complex(goal[2 * k].low, goal[2 * k + 1].low) for k in range(5)])
    turns = np.radians(20.0) * np.arange(5)
    cranks = pairs_of_points(P, turns)
    assert min(abs(o - O1) + abs(w - W) for o, w in cranks) <= 1e-9
    attitude = (P - O1 - W * np.exp(1j * turns)) / trace  # of the coupler
    assert np.abs(np.abs(attitude) - 1.0).max() <= 1e-10
    rockers = pairs_of_points(P, np.angle(attitude / attitude[0]))
    pin = (trace - b) * attitude[
        0
    ]  # from the rocker's pin to the point, in the attitude of the first position
    assert min(abs(o - O2) + abs(w - pin) for o, w in rockers) <= 1e-9
    assert abs(abs(O1 + W + b * attitude[0] - O2) - c) <= 1e-10


def test_derivatives_at_a_zero_come_from_the_structure_in_which_it_is_a_number(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The scene as it stands has zeros among its lengths; other starts have none."""
    family = Family(EXAMPLES / "five_point_four_bar.yaml")
    search = prepare(family, options_of(family.own.search, {}))
    with SearchJournal() as kept:
        maker = PointMaker(search, 1, kept, lambda runs: None)
        stands = np.array(search.stands)
        points = maker.runs([stands, stands + 0.01])
        assert (stands == 0.0).any() and all(point.compiled for point in points)
        alone = maker._exactly(points[0])
        monkeypatch.setattr(PointMaker, "_exactly", None)
        at_zero, _ = maker.slopes(points)
    np.testing.assert_allclose(at_zero.values, alone.values, rtol=1e-9, atol=1e-11)


# -- bounds, constraints, choices ------------------------------------------------------------------------------
def test_a_bound_that_holds_has_its_price() -> None:
    result, *_ = searched(arm(), vary={STIFFNESS: "uniform(10, 100)"}, minimise="peak_torque.arm", starts=2)
    key = result.summary["keys"][STIFFNESS]
    assert key["value"] == 100 and key["at"] == "upper bound" and key["uncertainty"] == 0.0
    assert key["price"] == pytest.approx(-0.12, abs=1e-9)
    assert "bounds and constraints decide" in result.summary["proof"]["text"]


def test_a_goal_that_a_key_does_not_change_is_told_so() -> None:
    """A beam that turns about z does not know how far along z its mass is."""
    text, key = ARM.replace("com: [0.5, 0, 0]", "com: [0.5, 0, 0.2]"), "robot.links.beam.com.2"
    result, *_ = searched(arm(text), vary={key: "uniform(0.1, 1)"}, minimise="peak_torque.arm")
    assert result.summary["proof"]["text"].startswith(f"the output does not depend on {key}")


def test_a_constraint_that_binds_has_its_price_and_holds() -> None:
    result, ended, _ = searched(
        arm(),
        vary={STIFFNESS: "uniform(10, 500)"},
        minimise="energy_net.arm",
        keep={"peak_torque.arm": "<= 5"},
    )
    limit, key = result.summary["limits"]["peak_torque.arm"], result.summary["keys"][STIFFNESS]
    assert limit["holds"] and limit["active"] and limit["value"] <= 5.0
    assert key["value"] == pytest.approx((PEAK + 5.0) / 0.12, abs=2.0 * key["uncertainty"])
    assert key["uncertainty"] < 1e-5
    assert limit["price"] == pytest.approx(-NET, rel=1e-6) and limit["price_error"] < 1e-5
    assert result.status == "ok" and ended.search.goal.sign == 1.0


def test_the_largest_value_is_found_and_its_price_has_its_sign() -> None:
    result, *_ = searched(
        arm(),
        vary={STIFFNESS: "uniform(10, 500)"},
        maximise="energy_net.arm",
        keep={"peak_torque.arm": "<= 5"},
    )
    assert result.summary["keys"][STIFFNESS]["value"] == pytest.approx((PEAK - 5.0) / 0.12, abs=1e-5)
    assert result.summary["limits"]["peak_torque.arm"]["price"] == pytest.approx(NET, rel=1e-6)


def test_inequalities_of_expect_count_and_values_are_left_out() -> None:
    text = ARM + "expect: {peak_torque.arm: <= 5, energy_net.arm: 3 +- 1, round_trip: < 1e-8, status: ok}\n"
    result, *_ = searched(arm(text), vary={STIFFNESS: "uniform(10, 500)"}, minimise="energy_net.arm")
    assert result.summary["limits"]["peak_torque.arm"]["source"] == "expect"
    assert set(result.summary["left_out"]) == {"energy_net.arm", "round_trip"}
    assert result.status == "ok"


def test_what_a_scene_expects_of_how_a_run_goes_holds_at_the_optimum_or_is_told() -> None:
    text = ARM + "expect: {error_estimate.torque_rounding: < 1e-300}\n"
    result, *_ = searched(
        arm(text), vary={STIFFNESS: "uniform(10, 500)"}, minimise="rms_torque.arm", starts=1
    )
    assert result.status == "missed" and "torque_rounding" in result.summary["not_held"][0]


def test_constraints_that_no_point_holds_and_targets_that_none_reaches_are_missed() -> None:
    vary = {STIFFNESS: "uniform(10, 100)"}
    for goal in (
        {"minimise": "rms_torque.arm", "keep": {"peak_torque.arm": "<= 1"}},
        {"reach": {"peak_torque.arm": 0}},
    ):
        result, *_ = searched(arm(), vary=vary, starts=2, **goal)
        assert result.status == "missed"
        assert result.summary["keys"][STIFFNESS]["value"] == pytest.approx(100, abs=1e-6)
        assert "peak_torque.arm" in result.summary["not_held"][0]
        assert "optimum" not in result.summary["proof"]["text"]
        for limit in result.summary["limits"].values():
            assert not (limit["holds"] or limit["active"]) and "price" not in limit


def test_all_combinations_of_choices_are_run() -> None:
    vary = {STIFFNESS: "[50, 100, 120, 150]", "robot.links.beam.mass": "[2, 3]"}
    result, _, maker = searched(arm(), vary=vary, minimise="peak_torque.arm")
    assert [key["value"] for key in result.summary["keys"].values()] == [120, 3]
    assert len(maker.points) == 8 and result.summary["search"]["combinations"] == 8
    assert "all 8 combinations" in result.summary["proof"]["text"]


def test_choices_and_bounds_together() -> None:
    vary = {STIFFNESS: "uniform(10, 500)", "robot.links.beam.mass": "[2, 3]"}
    result, ended, _ = searched(
        arm(), vary=vary, minimise=STIFF_GOAL, keep={"peak_torque.arm": "<= 1"}, starts=2
    )
    mass, other = result.summary["keys"]["robot.links.beam.mass"], result.summary["other"]
    assert mass["choices"] == "[2, 3]"
    # work and peak are both that of the torque that the spring leaves over: each arm does as much
    assert {mass["value"], other["values"]["robot.links.beam.mass"]} == {2, 3}
    assert other["goal"] == pytest.approx(result.summary["figures"][STIFF_GOAL]["value"], abs=1e-7)
    assert len(ended.ways) == 4


STIFF_GOAL = "energy_net.arm"


def test_targets_that_do_not_determine_the_keys_say_so() -> None:
    vary = {STIFFNESS: "uniform(10, 500)", "robot.links.beam.mass": "uniform(1, 5)"}
    result, *_ = searched(arm(), vary=vary, reach={"energy_net.arm": 2}, starts=2)
    assert result.status == "ok"
    assert all(key["uncertainty"] is None for key in result.summary["keys"].values())
    assert "do not determine" in result.summary["proof"]["text"]


def test_targets_that_derivatives_do_not_show_to_determine_the_keys_are_tried_beside() -> None:
    """Two means of squares that are to be zero determine four keys, though they have two derivatives."""
    target = {"rms_torque.east": 0, "rms_torque.north": 0}
    result, *_ = searched(Family(EXAMPLES / "counterweights.yaml"), starts=1, reach=target)
    assert result.status == "ok"
    assert "do not determine" not in result.summary["proof"]["text"]


def test_a_target_has_the_tolerance_that_is_asked_for() -> None:
    vary = {STIFFNESS: "uniform(10, 100)"}  # up to 2.715 N m
    for text, status in (("2 +- 1", "ok"), ("2 +- 0.5", "missed")):
        result, *_ = searched(arm(), vary=vary, reach={"peak_torque.arm": text}, starts=1)
        assert result.status == status
        assert result.summary["figures"]["peak_torque.arm"]["tolerance"] == float(text.split()[-1])


# -- runs that fail ---------------------------------------------------------------------------------------------
def test_starts_whose_run_fails_are_replaced_and_counted() -> None:
    """A rocker too short for the crank's turn does not assemble."""
    family = Family(EXAMPLES / "five_point_four_bar.yaml")
    vary = {"robot.points.tip.at#1": "uniform(0.05, 1.1)"}
    # what the first point asks for, with the other nine numbers as they stand
    own = prepare(
        family, options_of(family.own.search, {"vary": {k: parse_variation(v) for k, v in vary.items()}})
    )
    wanted, _ = make_one(own.task, 0, np.array([0.8]))
    target = {
        "at.0.points.trace.x": float(wanted.rows["outputs"][0, own.task.outputs.index("at.0.points.trace.x")])
    }
    result, ended, maker = searched(family, vary=vary, reach=target, starts=6)
    assert len(ended.ways) == 6 and result.status == "ok"
    assert maker.failures[5] > 0 and "does not close" in result.summary["search"]["reasons"]["5"]
    assert result.summary["keys"]["robot.points.tip.at#1"]["value"] == pytest.approx(0.8, abs=1e-8)
    assert sum(result["runs/exit_code"] != 0) == maker.failures[5]


def test_a_search_without_any_run_that_ends_well_is_refused_with_the_reason() -> None:
    family = Family(EXAMPLES / "five_point_four_bar.yaml")
    with pytest.raises(CapabilityError, match="no run ends as it should at any of the .* does not close"):
        searched(family, vary={"robot.points.tip.at#1": "uniform(0.01, 0.02)"}, starts=1)


def test_a_solver_goes_on_where_runs_fail_beyond_the_optimum() -> None:
    """The optimum lies at the edge of what assembles: steps beyond it are shortened."""
    family = Family(EXAMPLES / "five_point_four_bar.yaml")
    vary = {"robot.points.tip.at#1": "uniform(0.05, 1.1)"}
    _, ended, maker = searched(family, vary=vary, minimise="at.0.points.trace.x", starts=2)
    assert ended.own.is_good and np.isfinite(ended.own.y).all()
    best = min(p.y[0] for p in maker.points if p.is_good)
    assert ended.own.y[0] == pytest.approx(best, abs=1e-12)


# -- going on, order, refusals ------------------------------------------------------------------------------------
def test_an_interrupted_search_goes_on_to_the_same_result(tmp_path: Path) -> None:
    vary = {STIFFNESS: "uniform(10, 500)"}
    (tmp_path / "a").mkdir()
    whole, *_ = searched(
        arm(), SearchJournal(tmp_path / "a", "x"), vary=vary, minimise="rms_torque.arm", starts=2
    )
    lines = (tmp_path / "a" / "unfinished.search").read_text().splitlines()
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / "unfinished.search").write_text("\n".join(lines[:9]) + "\n" + lines[9][:11])
    journal = SearchJournal(tmp_path / "b", "x")
    again, *_ = searched(arm(), journal, vary=vary, minimise="rms_torque.arm", starts=2)
    assert journal.taken == sum('"code"' in line for line in lines[1:9]) > 0
    assert (
        again.summary["keys"] == whole.summary["keys"]
        and again.summary["figures"] == whole.summary["figures"]
    )
    other = SearchJournal(tmp_path / "a", "another search")
    with other:
        assert other.taken == 0


def test_what_solvers_are_answered_does_not_depend_on_their_pace() -> None:
    import time

    batches: list[list[int]] = []

    def answer(questions: Any) -> list[int]:
        batches.append(list(questions))
        return [10 * x for x in questions]

    def solver(number: int) -> Any:
        def solve(ask: Any) -> int:
            total = 0
            for k in range(number + 1):
                time.sleep(0.002 * (3 - number))
                total += ask(100 * number + k)
            return total

        return solve

    ended: list[int] = []
    lanes: Lanes[int, int, int] = Lanes(answer, ended.append)
    assert lanes.run([solver(k) for k in range(3)]) == [0, 2010, 6030]
    assert batches == [[0, 100, 200], [101, 201], [202]] and ended == [0, 1, 2, 3]


def test_what_a_solver_raises_is_raised() -> None:
    def fail(ask: Any) -> int:
        ask(1)
        raise ZeroDivisionError

    lanes: Lanes[int, int, int] = Lanes(lambda questions: [0 for _ in questions])
    with pytest.raises(ZeroDivisionError):
        lanes.run([fail, lambda ask: ask(2)])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"minimise": "peak_torque.arm"}, "nothing varies"),
        ({"vary": {STIFFNESS: "uniform(1, 2)"}}, "there is no goal"),
        ({"vary": {STIFFNESS: "normal(1, 2)"}, "minimise": "peak_torque.arm"}, "no bounds to search between"),
        ({"vary": {"forces.spring.x": "uniform(1, 2)"}, "minimise": "peak_torque.arm"}, "--vary forces.spring.x"),
        ({"vary": {STIFFNESS: "uniform(-1, 2)"}, "minimise": "peak_torque.arm"}, "stiffness"),
        ({"vary": {STIFFNESS: "uniform(1, 2)"}, "minimise": "peak_torque.leg"}, "no such key.*peak_torque.arm"),
        ({"vary": {STIFFNESS: "uniform(1, 2)"}, "reach": {"peak_torque.arm": "<= 2"}}, "is no value to reach"),
        (
            {"vary": {STIFFNESS: "uniform(1, 2)"}, "minimise": "energy.arm", "keep": {"peak_torque.arm": "2 +- 1"}},
            "is no inequality",
        ),
        (
            {"vary": {STIFFNESS: "uniform(1, 2)"}, "minimise": "energy.arm", "keep": {"peak_torque.arm": "<= 1 kg"}},
            "--keep peak_torque.arm: '<= 1 kg' does not fit: torque in N m expected, <= 1 kg is a mass",
        ),
        ({"vary": {STIFFNESS: "uniform(1, 2)"}, "reach": {"peak_torque.arm": "0 kg"}}, "--reach .* is a mass"),
        (
            {"vary": {STIFFNESS: "uniform(1, 2)"}, "minimise": "energy.arm", "maximise": "energy.arm"},
            "stands beside 'minimise'",
        ),
        (
            {"vary": {STIFFNESS: "linspace(1, 2, 200)", "robot.links.beam.mass": "linspace(1, 2, 200)"},
             "minimise": "energy.arm"},
            "40000 combinations",
        ),
    ],
)  # fmt: skip
def test_searches_that_make_no_sense_are_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(SceneError, match=message):
        searched(arm(), **changes)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("minimise: peak_torque.leg", "search.minimise: the summary of inverse has no such key"),
        ("{minimise: peak_torque.arm, maximise: peak_torque.arm}", "search.maximise: stands beside 'minimise'"),
        ("reach: {peak_torque.arm: < 3}", "search.reach.peak_torque.arm: '< 3' is no value to reach"),
        ("keep: {peak_torque.arm: 3}", "search.keep.peak_torque.arm: '3' is no inequality"),
        ("vary: {forces.spring.stiffness: 'normal(1, 2)'}", "search.vary.forces.spring.stiffness: .*no bounds"),
        ("starts: 0", "search.starts"),
    ],
)  # fmt: skip
def test_a_scene_says_where_its_search_is_wrong(text: str, message: str) -> None:
    section = f"search: {text}\n" if text.startswith("{") else f"search: {{{text}}}\n"
    with pytest.raises(SceneError, match=message):
        load_scene_text(ARM + section)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("vary: {forces.spring.stiffnes: 'uniform(1, 2)'}", "search.vary.forces.spring.stiffnes: .*stiffness"),
        ("vary: {robot.links.beam.mass: '[-1, 2]'}", "search.vary.robot.links.beam.mass: .*is too small"),
        ("vary: {robot.links.beam.mass: 'uniform(1 mm, 2 mm)'}", "mass in kg expected"),
        ("{vary: {robot.links.beam.mass: 'uniform(-1, 2)'}, minimise: energy.arm}", "robot.links.beam.mass.*is too small"),
        ("{vary: {robot.links.beam.mass: 'uniform(1, 2)'}, minimise: title}", "search: title: is not a number|search.minimise: is not a number"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("section", ["search", "study"])
def test_validate_says_which_key_cannot_vary(section: str, text: str, message: str, tmp_path: Path) -> None:
    if section == "study" and text.startswith("{"):
        return
    (tmp_path / "arm.yaml").write_text(
        ARM + (f"{section}: {text}\n" if text.startswith("{") else f"{section}: {{{text}}}\n")
    )
    errors = [x for x in findings(tmp_path / "arm.yaml") if x.severity == "error"]
    assert (
        len(errors) == 1
        and errors[0].line
        and re.search(message.replace("search", section), errors[0].message)
    )


TRIANGLE = """
schema: 1
command: assemble
gravity: [0, 0, 0]
robot:
  joints:
    - {name: crank, type: revolute, axis: [0, 0, 1], parent: base}
    - {name: rocker, type: revolute, axis: [0, 0, 1], parent: base, origin: {xyz: [1, 0, 0]}}
    - {name: slide, type: prismatic, axis: [1, 0, 0], parent: arm, origin: {xyz: [0.5, 0, 0]}}
  links: [{name: arm}, {name: bar}, {name: rod}]
  points: {tip: {link: bar, at: [0.8, 0, 0]}, eye: {link: rod, at: [0.1, 0, 0]}}
loops: [{name: pin, type: revolute, between: [eye, tip]}]
initial: {q: {crank: 0.7, rocker: 2.0, slide: 0.3}, hold: [crank]}
"""


def test_dimensions_with_which_loops_close_in_a_pose() -> None:
    """The sine rule of the triangle between both pivots and the pin: b sin(rocker - crank) = sin(crank)."""
    result, *_ = searched(
        arm(TRIANGLE),
        vary={"robot.points.tip.at#1": "uniform(0.7, 1.3)"},
        reach={"configuration.rocker": 1.6},
    )
    found = result.summary["keys"]["robot.points.tip.at#1"]["value"]
    assert result.status == "ok" and found == pytest.approx(math.sin(0.7) / math.sin(0.9), abs=1e-6)


def test_the_same_from_python() -> None:
    from robodyn_cli import optimise

    result = optimise(
        load_scene_text(ARM), {STIFFNESS: "uniform(10, 500)"}, minimise="energy_net.arm",
        keep={"peak_torque.arm": "<= 5"}, starts=1,
    )  # fmt: skip
    assert result.summary["limits"]["peak_torque.arm"]["active"]
    result = optimise(EXAMPLES / "spring_balance.yaml", starts=1)
    assert result.summary["goal"] == "peak_torque.arm = 0" and result.status == "ok"
