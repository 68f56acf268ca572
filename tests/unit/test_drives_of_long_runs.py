"""Drives and margins of long simulations against closed forms, and pieces of functions that are worked on many at once."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest

from robodyn_cli import load_scene_text, simulate
from robodyn_cli.algorithms.polynomials import real_roots
from robodyn_cli.drives.cycle import CycleSamples, Use
from robodyn_cli.drives.rivals import limit_with_rivals, ratios_with_rivals, side_with_rivals
from robodyn_cli.solve import extremes, quadrature
from robodyn_cli.solve.crossings import crossing
from robodyn_cli.summaries.drives import (
    MotorisationFigures,
    Ratio,
    RatioErrors,
    Side,
    SideErrors,
    UsedLimit,
)
from robodyn_cli.summaries.facts import ABSENT
from robodyn_cli.torques.checks import turns_of

SLIDE = """
schema: 1
gravity: [0, 0, 0]
robot:
  joints:
    - {{name: x, type: prismatic, axis: [1, 0, 0], spring: {{stiffness: 8}}}}
  links: [{{name: cart, mass: 1.5}}]
catalogue:
  motors: {{m: {{type: dc, torque_constant: 0.2, resistance: 0.9, voltage: 90, max_current: 60, rated_current: 20, rotor_inertia: 1.0e-5}}}}
  gears: {{s: {{type: ball_screw, lead: 0.02, efficiency: 0.8, back_driving: 0.6}}}}
drives: {{x: {{motor: m, gear: s, mass_on: none}}}}
torques: {{x: 3*cos(1.1*t)}}
initial: {{q: {{x: 0.6}}}}
motorisation: {{}}
simulate: {{duration: {duration}, samples: 101}}
"""


def run(duration: float) -> dict[str, Any]:
    summary: dict[str, Any] = simulate(load_scene_text(SLIDE.format(duration=duration))).summary
    return summary


def close(duration: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return times, speed and load of the gear in closed form: a forced oscillator of the cart and the rotor."""
    turns = 2.0 * math.pi / 0.02
    reflected = 1.0e-5 * turns**2
    mass, stiffness = 1.5 + reflected, 8.0
    w, forced = math.sqrt(stiffness / mass), 3.0 / (stiffness - mass * 1.1**2)
    t = np.linspace(0.0, duration, 400_001)
    own = 0.6 - forced
    v = -own * w * np.sin(w * t) - forced * 1.1 * np.sin(1.1 * t)
    a = -own * w * w * np.cos(w * t) - forced * 1.21 * np.cos(1.1 * t)
    return t, v, 3.0 * np.cos(1.1 * t) - reflected * a


@pytest.mark.parametrize("duration", [20.0, 600.0])
def test_figures_of_a_drive_are_those_of_the_closed_form(duration: float) -> None:
    """However many times it turns back, with losses that jump there: errors cover the closed form, and tell something."""
    t, v, load = close(duration)
    side = run(duration)["drives"]["x"]
    joint, shaft = side["joint"], side["shaft"]
    screw = 0.02 / (2.0 * math.pi)
    into = load * screw * np.where(load * v > 0.0, 1.0 / 0.8, 0.6)
    torque = into + 1.0e-5 * np.gradient(v, t, edge_order=2) / screw
    for figures, key, exact, fine in (
        (joint, "peak_torque", np.abs(load).max(), 3e-6),
        (joint, "peak_speed", np.abs(v).max(), 3e-6),
        (joint, "rms_torque", math.sqrt(np.trapezoid(load**2, t) / duration), 1e-5),
        (shaft, "rms_torque", math.sqrt(np.trapezoid(torque**2, t) / duration), 1e-4),
        (shaft, "mean_torque", np.trapezoid(np.abs(torque), t) / duration, 1e-4),
    ):  # fmt: skip
        assert abs(figures[key] - exact) <= figures["errors"][key] + fine * exact, key
        assert figures["errors"][key] < 2e-3 * exact, key


def test_where_nothing_is_known_between_samples_figures_are_those_of_samples(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    full = run(900.0)
    monkeypatch.setattr("robodyn_cli.motion.between.extremes.MOST", 2**10)
    summary = run(900.0)
    assert any("figures of drives and margins are those at samples" in text for text in summary["warnings"])
    drive, sure = summary["drives"]["x"], full["drives"]["x"]
    for side in ("joint", "shaft"):
        assert set(drive[side]["errors"].values()) == {None}
        for key in ("peak_torque", "peak_speed"):
            least = 0.7 * sure[side][key]
            assert least <= drive[side][key] <= sure[side][key] + sure[side]["errors"][key]
        assert drive[side]["rms_torque"] == pytest.approx(sure[side]["rms_torque"], rel=0.1)
    assert drive["errors"]["margin"] is None and sure["errors"]["margin"] < 1e-4
    for limit in drive["limits"].values():
        assert limit["use_error"] is None
    margin = summary["motorisation"]["x"]
    assert set(margin["errors"].values()) == {None}
    assert set(margin["static"]["errors"].values()) == {None}


# -- pieces -----------------------------------------------------------------------------------------------------------
def sampled(rng: np.random.Generator, columns: int) -> tuple[np.ndarray, np.ndarray, list[float]]:
    """Return stretches of samples of other steps, functions that jump at breaks, and these."""
    ends = np.cumsum(np.concatenate([[0.0], rng.uniform(0.2, 1.5, 7)]))
    t = np.unique(
        np.concatenate([np.linspace(a, b, int(rng.integers(6, 30))) for a, b in itertools.pairwise(ends)])
    )
    places = np.sort(rng.uniform(0.0, len(t) - 1.0, 12)).tolist()
    jumps = np.searchsorted(places, np.arange(len(t)), side="left")
    w, phase = rng.uniform(0.5, 3.0, columns), rng.uniform(0.0, 6.0, columns)
    return t, np.sin(np.outer(t, w) + phase) + rng.normal(size=13)[jumps, None], places


FIGURES = (
    lambda *x: extremes.largest(*x).value,
    lambda *x: extremes.largest(*x).error,
    lambda *x: extremes.largest(*x).time,
    lambda *x: extremes.tops(*x)[0],
    lambda *x: extremes.integral(*x)[0],
    lambda *x: extremes.integral(*x)[1],
    lambda *x: extremes.positive_integral(*x)[0],
)  # fmt: skip


@pytest.mark.parametrize("seeds", [range(10)])
def test_pieces_together_and_in_small_blocks_are_the_same(
    seeds: range, monkeypatch: pytest.MonkeyPatch
) -> None:
    for seed in seeds:
        t, y, places = sampled(np.random.default_rng(seed), 3)
        with monkeypatch.context() as patch:
            whole = [figure(t, y, places) for figure in FIGURES]
            patch.setattr(quadrature, "BLOCK", 1)
            patch.setattr(extremes, "BLOCK", 1)
            single = [figure(t, y, places) for figure in FIGURES]
        for one, two in zip(whole, single):
            np.testing.assert_allclose(one, two, rtol=1e-12, atol=1e-13)


def test_every_sample_is_in_one_piece_and_every_end_of_a_stretch_in_two() -> None:
    for seed in range(20):
        t, _, places = sampled(np.random.default_rng(seed), 1)
        counts, reached = np.zeros(len(t), dtype=int), 0.0
        for part in quadrature.pieces(t, places):
            np.add.at(counts, part.first + np.arange(part.samples)[:, None], 1)
            reached += float((part.step * (part.samples - 1 + part.low + part.high)).sum())
        first, last, *_ = quadrature.stretches(t)
        assert (counts == 1 + np.isin(np.arange(len(t)), last[:-1]) * np.isin(np.arange(len(t)), first)).all()
        assert reached == pytest.approx(t[-1] - t[0], rel=1e-12)


def test_more_pieces_take_no_more_calls(monkeypatch: pytest.MonkeyPatch) -> None:
    """Turns of a wave at any phase: pieces of each length are worked on at once."""
    made = {}
    for turns in (30, 900):
        t = np.linspace(0.0, turns * math.pi, 16 * turns + 1)
        calls: list[int] = []
        own = extremes._largest_of_piece
        monkeypatch.setattr(
            extremes, "_largest_of_piece", lambda *x, own=own, calls=calls: (calls.append(1), own(*x))[1]
        )
        y = np.sin(1.01 * t + 0.2)[:, None]
        places = turns_of(t, y[:, 0], 1.01 * np.cos(1.01 * t + 0.2))
        extremes.largest(t, np.abs(y), places)
        monkeypatch.undo()
        made[turns] = len(calls)
    assert made[900] <= made[30] + 2


# -- roots ------------------------------------------------------------------------------------------------------------
def test_roots_of_many_polynomials_are_those_of_each() -> None:
    rng = np.random.default_rng(4)
    for degree in range(1, 6):
        c = rng.normal(size=(degree + 1, 200)) * (rng.random((degree + 1, 200)) < 0.8)
        end = rng.uniform(0.1, 3.0, 200)
        found = real_roots(c, end)
        for k in range(200):
            if not c[1:, k].any():
                continue
            roots = np.roots(c[::-1, k])
            real = np.sort(
                roots.real[(np.abs(roots.imag) < 1e-9) & (roots.real > 1e-12) & (roots.real < end[k])]
            )
            own = np.sort(found[:, k][found[:, k] < end[k]])
            assert len(own[own > 1e-12]) == len(real)
            np.testing.assert_allclose(own[own > 1e-12], real, rtol=1e-6)


@pytest.mark.parametrize("small", 10.0 ** -np.arange(4.0, 18.0))
def test_small_terms_of_the_highest_powers_take_no_roots_away(small: float) -> None:
    """They add roots far away: with terms of 1e-16, as rounding leaves them, those nearby were lost."""
    rng = np.random.default_rng(5)
    for _ in range(50):
        root, more = rng.uniform(0.1, 0.9), rng.uniform(0.1, 1.0, rng.integers(1, 5))
        c = np.concatenate([[root, -1.0], small * more * rng.choice([-1.0, 1.0], len(more))])
        own = root
        for _ in range(4):  # Newton
            own -= np.polyval(c[::-1], own) / np.polyval(np.polyder(c[::-1]), own)
        for more_roots in ([], [0.0], [0.0, 0.0]):  # at zero
            found = real_roots(np.concatenate([more_roots, c])[:, None], np.ones(1))[:, 0]
            assert found[(found > 1e-6) & (found < 1.0)] == pytest.approx([own], rel=1e-8)


def test_turns_and_crossings_of_waves() -> None:
    t = np.linspace(0.0, 40.0, 1201)
    v, a = np.cos(1.3 * t + 0.4), -1.3 * np.sin(1.3 * t + 0.4)
    exact = ((np.arange(1, 18) - 0.5) * math.pi - 0.4) / 1.3
    turns = np.interp(turns_of(t, v, a), np.arange(len(t)), t)
    np.testing.assert_allclose(turns, exact[exact < 40.0], rtol=0, atol=1e-11)
    k = np.flatnonzero(v[:-1] * v[1:] < 0.0)
    part, off = crossing(t, v, k)
    gone = np.abs(t[k] + part * (t[1] - t[0]) - exact[exact < 40.0])
    assert np.all(gone <= off * (t[1] - t[0]) + 1e-13) and off.max() < 1e-4


# -- ties ---------------------------------------------------------------------------------------------------------------
def places(tree: Any, path: tuple[str, ...] = ()) -> dict[tuple[str, ...], tuple[float, float]]:
    """Return the times and angles of the figures of a summary's part, each with its error."""
    found: dict[tuple[str, ...], tuple[float, float]] = {}
    for key, value in tree.items() if isinstance(tree, dict) else ():
        if isinstance(value, dict):
            found |= places(value, (*path, key))
        elif isinstance(value, float) and key.removeprefix("peak_torque_") in ("time", "angle"):
            errors = tree.get("errors", {})
            error = tree["time_error"] if "time_error" in tree else errors.get(key)
            if error is not None:
                found[(*path, key)] = value, error
    return found


@pytest.mark.parametrize("rtol", ["1e-4", "1e-6", "1e-9"])
def test_of_places_that_are_alike_errors_cover_each(rtol: str) -> None:
    """An oscillator comes back to each pose: integration decides when a torque is largest, or a margin least."""
    free = SLIDE.replace("torques: {{x: 3*cos(1.1*t)}}\n", "actuated: [x]\n").format(duration=12.0)
    one, two = (
        simulate(
            load_scene_text(free, overrides=[f"simulate.rtol={given}", f"simulate.samples={samples}"])
        ).summary
        for given, samples in ((rtol, 101), ("1e-11", 257))
    )
    for part in ("drives", "motorisation"):
        own, other = places(one[part]["x"]), places(two[part]["x"])
        assert own.keys() & other.keys()
        for key in own.keys() & other.keys():
            (a, off), (b, more) = own[key], other[key]
            assert abs(a - b) <= off + more, (part, key, own[key], other[key])
    period = 2.0 * math.pi * math.sqrt((1.5 + 1.0e-5 * (2.0 * math.pi / 0.02) ** 2) / 8.0)
    assert (
        places(one["drives"]["x"])["joint", "peak_torque_time"][1]
        > 12.0 // period * period / 2.0 - 0.5 * period
    )


@pytest.mark.parametrize("seed", range(8))
def test_a_place_covers_those_that_an_error_of_its_value_leaves_open(seed: int) -> None:
    """Humps of about the same height, each off by no more than the error: wherever the highest is then, it is told of."""
    rng = np.random.default_rng(seed)
    t, error = np.linspace(0.0, 4.0, 401), 1e-3
    centres, heights = np.arange(0.5, 4.0) + rng.uniform(-0.2, 0.2, 4), 1.0 - rng.uniform(0.0, 3e-3, 4)
    humps = np.exp(-30.0 * (t[:, None] - centres) ** 2)
    y = (humps * heights).max(axis=1)
    k = int(np.argmax(heights))
    others = [float(centres[np.argmax(heights + rng.uniform(-1.0, 1.0, 4) * error)]) for _ in range(200)]
    off, value, time = 1e-9, float(heights[k]), float(centres[k])
    side = Side(
        value, time, 0.5, 0.5, 1.0, 1.0, 0.0, 1.0, 0.0, SideErrors(error, off, off, off, off, off, off)
    )
    limit = UsedLimit(value, error, time, off)
    ratio = Ratio(
        -math.tan(value), time, time, "mass", RatioErrors(error * (1.0 + math.tan(value) ** 2), off, off)
    )
    own = {name: getattr(ratio, name) for name in ("ratio", "time", "angle", "decides", "errors")}
    margin = MotorisationFigures(**own, required=0.0, met=False, static=ratio, dynamic=ABSENT)
    used = Use(np.float64(value), np.float64(time), CycleSamples(t), y)
    told = ratios_with_rivals(margin, t, {"static": -y}, t)
    away = max(abs(other - time) for other in others) - 0.01  # samples
    assert side_with_rivals(side, t, -y).errors.peak_torque_time >= away
    assert limit_with_rivals(limit, used).time_error >= away
    for one in (told, told.static):
        assert min(one.errors.time, one.errors.angle) >= away
