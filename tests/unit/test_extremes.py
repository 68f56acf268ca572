"""Extremes and integrals of functions known at samples: errors cover what lies between these, by much finer samples."""

from __future__ import annotations

import numpy as np
import pytest

from robodyn_cli.given.motion import looked_at
from robodyn_cli.solve.extremes import (
    integral,
    largest,
    largest_magnitude,
    positive_integral,
    root_mean_square,
    smallest,
    tops,
)
from robodyn_cli.solve.quadrature import gaps_between

FINE = 200_001


def waves(rng: np.random.Generator, kind: str, duration: float):
    """Return a function, its jump, and the shortest period in it."""
    a, w, phase = rng.normal(size=4), rng.uniform(0.5, 12.0, 4), rng.uniform(0.0, 6.0, 4)
    at, size = rng.uniform(0.0, duration), rng.normal()

    def function(t: np.ndarray) -> np.ndarray:
        y = np.sin(np.multiply.outer(t, w) + phase) @ a
        if kind == "bends":
            return np.abs(y)
        return y if kind == "smooth" else y + size * (t > at)

    return function, at, 2.0 * np.pi / w.max()


@pytest.mark.parametrize("kind", ["smooth", "bends", "jumps", "jumps somewhere"])
def test_errors_cover_what_lies_between_samples(kind: str) -> None:
    rng = np.random.default_rng(["smooth", "bends", "jumps", "jumps somewhere"].index(kind))
    ratios = []
    for _ in range(60):
        duration, samples = rng.uniform(0.5, 3.0), int(rng.choice([8, 11, 30, 51, 101, 500]))
        y, at, period = waves(rng, kind, duration)
        if (samples - 1) * period / duration < 5.0:
            continue  # too few samples to know anything of the function
        t = np.linspace(0.0, duration, samples)
        fine = np.sort(np.r_[np.linspace(0.0, duration, FINE), at - 1e-12, at + 1e-12])
        Y, steps = y(fine), np.diff(fine)
        breaks = [at / t[1]] if kind == "jumps" else []
        column, rounding = y(t)[:, None], 1e-8
        for found, true in (
            (largest(t, column, breaks), Y.max()), (smallest(t, column, breaks), Y.min()),
            (largest_magnitude(t, column, breaks), np.abs(Y).max()),
        ):  # fmt: skip
            ratios.append(abs(found.value[0] - true) / (found.error[0] + rounding))
        top = largest(t, column, breaks)
        ratios.append(abs(top.time[0] - fine[Y.argmax()]) / (top.time_error[0] + 2e-5))
        for (value, error), integrand in (
            (integral(t, column, breaks), Y), (positive_integral(t, column, breaks), np.maximum(Y, 0.0)),
        ):  # fmt: skip
            true = np.sum(steps * (integrand[1:] + integrand[:-1])) / 2.0
            ratios.append(abs(value[0] - true) / (error[0] + 1e-7))
        (rms,), (error,) = root_mean_square(t, column, breaks)
        true = np.sqrt(np.sum(steps * (Y[1:] ** 2 + Y[:-1] ** 2)) / 2.0 / duration)
        ratios.append(abs(rms - true) / (error + 1e-7))
    assert len(ratios) > 150 and max(ratios) < 10.0
    assert np.mean(np.array(ratios) > 1.0) < 0.01


def test_a_smooth_function_is_known_far_better_than_its_samples() -> None:
    t = np.linspace(0.0, 7.44, 101)
    y = np.column_stack([np.sin(t), 3.0 * np.cos(1.3 * t + 0.2)])
    top = largest_magnitude(t, y)
    assert (
        np.abs(top.value - [1.0, 3.0]).max() < 2e-8 < 1e-3 * np.abs(np.abs(y).max(axis=0) - [1.0, 3.0]).max()
    )
    assert top.error.max() < 1e-5 and abs(top.time[0] - np.pi / 2) < 1e-6
    value, time = tops(t, y)
    assert (
        np.abs(value - largest(t, y).value).max() < 1e-12 and np.abs(time - largest(t, y).time).max() < 1e-9
    )


@pytest.mark.parametrize("samples", range(1, 9))
def test_few_samples_and_constants(samples: int) -> None:
    t = np.linspace(0.0, 1.0, samples)
    zero = largest(t, np.zeros((samples, 2)))
    assert not zero.value.any() and not zero.error.any() and not zero.time.any()
    line = largest(t, np.column_stack([t, -t]))
    assert line.value[0] == pytest.approx(t[-1]) and line.value[1] == 0.0
    assert np.isfinite(line.error).all() and np.isfinite(line.time_error).all()


def test_uneven_samples() -> None:
    """A last sample off the grid, as a run that stops early has it."""
    t = np.append(np.linspace(0.0, 2.0, 201), 2.0034)
    y = np.sin(t)[:, None]
    (value,), (error,) = integral(t, y)
    assert abs(value - (1.0 - np.cos(t[-1]))) <= error < 3e-4
    assert abs(largest(t, y).value[0] - 1.0) < 1e-12


def test_what_does_not_change_is_its_own_extreme() -> None:
    """Exactly: its error is 0, and the polynomial between the samples has rounding of its own."""
    t = np.linspace(0.0, 3.0, 101)
    for value in (0.5, -1.0 / 3.0, 1e-7, 0.0):
        for found in (largest(t, np.full((101, 1), value)), smallest(t, np.full((101, 1), value))):
            assert found.value[0] == value and found.error[0] == 0.0
            assert not np.signbit(found.value[0]) or value < 0.0


def test_pieces_between_known_jumps_are_known_however_short_they_are() -> None:
    """Parabolas between jumps, of pieces of which the shortest is 1e-4 of the longest: from samples on both sides."""
    rng = np.random.default_rng(5)
    knots = np.cumsum(np.concatenate([10.0 ** rng.uniform(-4.0, 0.0, 40), [0.5]]))
    ends = np.concatenate([[0.0], knots])
    c, middle = rng.normal(size=(3, 41)), 0.5 * (ends[1:] + ends[:-1])

    def value(t: np.ndarray) -> np.ndarray:
        k = np.clip(np.searchsorted(ends, t, side="right") - 1, 0, 40)
        return c[0, k] + c[1, k] * (t - middle[k]) + c[2, k] * (t - middle[k]) ** 2

    half = 0.5 * np.diff(ends)
    exact = np.sum(2.0 * half * c[0] + c[2] * half**3 / 1.5)
    tops_of_pieces = [c[0] + way * c[1] * half + c[2] * half**2 for way in (-1.0, 1.0)]
    inner = np.abs(c[1]) < -2.0 * c[2] * half
    highest = max(np.max(tops_of_pieces), np.max((c[0] - c[1] ** 2 / (4.0 * c[2]))[inner], initial=-np.inf))
    for samples in (2, 31, 2000):
        t = looked_at(np.linspace(0.0, ends[-1], samples), knots[:-1].tolist())
        y = value(t)[:, None]
        peak, (area,), (off,) = largest(t, y), *integral(t, y)
        assert (
            abs(peak.value[0] - highest) <= peak.error[0] + 1e-12 < 1e-5
            and abs(area - exact) <= off + 1e-12 < 1e-3
        )
        assert tops(t, y)[0][0] == pytest.approx(highest, abs=1e-9)


def test_where_figures_are_looked_at() -> None:
    """Nowhere else where the samples suffice; else from knot to knot, in 4 n intervals each, with both ends."""
    for samples, knots, count in ((65, (), 65), (64, (), 65), (11, (0.5,), 2 * 65), (2001, (0.5,), 2 * 1001)):
        t = looked_at(np.linspace(0.0, 1.0, samples), knots)
        assert len(t) == count and t[0] == 0.0 and t[-1] == 1.0 and np.all(np.diff(t) > 0.0)
        assert gaps_between(t).tolist() == ([count // 2 - 1] if knots else [])
    many = looked_at(np.linspace(0.0, 1.0, 11), np.linspace(0.0, 1.0, 1001)[1:-1].tolist())
    assert len(many) == 1000 * 9
    assert len(looked_at(np.linspace(0.0, 1.0, 2), [0.5, 0.5 + 1e-12])) == 2 * 65


def test_columns_together_are_what_each_is_alone() -> None:
    """Smooth ones, with jumps in places of their own, with a bend, of rounding alone; uniform and in stretches."""
    rng = np.random.default_rng(11)
    for t, breaks in (
        (np.linspace(0.0, 2.0, 120), [30.5]), (looked_at(np.linspace(0.0, 2.0, 11), [0.7, 1.3]), []),
    ):  # fmt: skip
        smooth = np.sin(np.multiply.outer(t, rng.uniform(1.0, 4.0, 6)) + rng.uniform(0.0, 6.0, 6))
        jumps = 0.3 * (t[:, None] > [0.4, 0.4, 1.1])
        noise = 1e-14 * rng.normal(size=(len(t), 2))
        y = np.column_stack([smooth, smooth[:, :3] + jumps, np.abs(smooth[:, :1]), noise])
        for figure in (largest, smallest, largest_magnitude):
            found = figure(t, y, breaks)
            for k in range(y.shape[1]):
                alone = figure(t, y[:, [k]], breaks)
                for name in ("value", "error", "time", "time_error", "at"):
                    own, other = getattr(found, name)[k], getattr(alone, name)[0]
                    assert own == pytest.approx(other, rel=1e-9, abs=1e-12 * np.abs(y[:, k]).max()), (k, name)


def test_a_time_is_as_uncertain_as_the_pieces_that_may_hold_the_largest_value() -> None:
    """A top counts that rounding alone tells from the largest one; a top that lies lower does not."""
    t = np.linspace(0.0, 3.0, 301)
    top = 1.0 - 4.0 * (t[:, None] % 1.0 - 0.5) ** 2
    for sizes, apart in (([1.0, 0.2, 0.999], False), ([1.0, 0.2, 1.0 + 1e-13], True)):
        y = top * np.array(sizes)[np.minimum(t.astype(int), 2)][:, None]
        found = largest(t, y, [100.0, 200.0])
        assert found.time[0] == pytest.approx(0.5) and (found.time_error[0] > 1.9) == apart


def test_tops_of_smooth_functions_are_no_better_than_the_rounding_of_polynomials() -> None:
    """100 + cos(w (t - s)) is 101 at most, whatever the samples are."""
    for samples in range(200, 1200, 7):
        times = np.linspace(0.0, 2.0, samples)
        found = largest(times, 100.0 + np.cos(3.0 * np.subtract.outer(times, np.linspace(0.3, 1.7, 30))))
        off = np.abs(found.value - 101.0)
        assert np.all(off <= found.error) and found.error.max() < 1e-6, samples
