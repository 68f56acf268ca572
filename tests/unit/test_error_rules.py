"""The rules by which errors are put together, each alone: on functions and numbers whose errors are known."""

from __future__ import annotations

import itertools
import math
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy import stats

from robodyn_cli.integrators.runtime.options import Options, stride_of
from robodyn_cli.motion.error import Courses, First, Floor, remainder
from robodyn_cli.observe.observe import Observer
from robodyn_cli.observe.recorder import Recorder
from robodyn_cli.over.many.course import samplings
from robodyn_cli.over.sensitivity.differences import LEVELS, NARROWER, Sides, extrapolated
from robodyn_cli.over.sensitivity.led import _slopes as led_slopes
from robodyn_cli.over.study.statistics import Moments, SampleSpread, quantiles
from robodyn_cli.solve.extremes import Extreme, integral, largest, positive_integral, smallest, tops
from robodyn_cli.solve.quadrature import integrate, sampling_error, spaced, summed
from robodyn_cli.torques.checks import LEAST, settled, turns_of


def extreme(value: float, error: float, time: float, time_error: float = 0.0) -> Extreme:
    return Extreme(*(np.array([x]) for x in (value, error, time, time_error, time)))


# -- extremes and integrals ----------------------------------------------------------------------------------------
def test_the_error_of_the_larger_of_two_covers_that_the_other_is() -> None:
    for one, other in (((1.0, 0.0, 5.0), (0.99, 0.1, 2.0)), ((0.99, 0.1, 2.0), (1.0, 0.0, 5.0))):
        found = extreme(*one).or_larger(extreme(*other))
        assert found.value[0] == 1.0 and found.time[0] == 5.0
        assert found.error[0] == pytest.approx(0.09) and found.time_error[0] == pytest.approx(3.0)
    apart = extreme(1.0, 0.01, 5.0).or_larger(extreme(0.5, 0.1, 2.0))
    assert (apart.value[0], apart.error[0], apart.time_error[0]) == (1.0, 0.01, 0.0)


def test_errors_of_a_narrow_bump_cover_it() -> None:
    """Between the samples of a bump the polynomials are off where it is, and not at the ends."""
    for samples in [15, 21, 41, 42]:
        x = np.linspace(0.0, 1.0, samples)
        covered = []
        for centre in np.linspace(0.4, 0.6, 9):
            y = np.exp(-(((x - centre) / 0.07) ** 2))[:, None]
            (found,), (off,) = integral(x, y)
            assert abs(found - 0.07 * math.sqrt(math.pi)) <= off
            covered.append(off)
            for peak, sign in ((largest(x, y), 1.0), (smallest(x, -y), -1.0)):
                assert (
                    abs(peak.value[0] - sign) <= peak.error[0]
                    and abs(peak.time[0] - centre) <= peak.time_error[0] + 1e-9
                )
        assert max(covered) < {15: 1.0, 21: 0.3, 41: 0.03, 42: 0.03}[samples]


def test_the_integral_of_a_jump_in_the_middle() -> None:
    """Of a step from 0 to 1 between two samples nobody knows where it is: half a step off at most."""
    x = np.linspace(0.0, 1.0, 41)
    for at in (0.51, 0.515, 0.52):
        (found,), (off,) = integral(x, np.where(x > at, 1.0, 0.0)[:, None])
        assert abs(found - (1.0 - at)) <= off < 0.05


def test_the_error_of_an_integral_is_told_where_it_arises() -> None:
    """At kinks in the middle of the samples, far from both ends, where there is nothing."""
    x, covered = np.linspace(0.0, 1.0, 41), []
    for centre in np.linspace(0.45, 0.55, 9):
        y = np.maximum(1.0 - ((x - centre) / 0.2) ** 2, 0.0)[:, None]
        off = abs(summed(integrate, x, y)[0] - 0.8 / 3.0)
        covered.append(off)
        assert off <= summed(sampling_error, x, y)[0] < 0.01
    assert max(covered) > 1e-6


def test_breaks_in_samples_of_two_steps() -> None:
    """t^2 up to a jump at a known place among the second, closer samples: pieces end there, to the last digits."""
    t = np.concatenate([np.linspace(0.0, 1.0, 21), np.linspace(1.0, 2.0, 41)[1:]])
    jump = 1.5125
    y = np.where(t < jump, t * t, 0.5)[:, None]
    peak = largest(t, y, [40.5])
    assert peak.value[0] == pytest.approx(jump**2, rel=1e-9) and peak.time[0] == pytest.approx(jump, rel=1e-9)
    assert peak.error[0] < 1e-6 and peak.time_error[0] < 1e-6
    (area,), (off,) = integral(t, y, [40.5])
    assert abs(area - (jump**3 / 3.0 + 0.5 * (2.0 - jump))) <= off < 0.02


def test_a_jump_in_the_first_interval() -> None:
    """Pieces end there too, on both sides by their own polynomials."""
    x = np.arange(12.0)
    for place in (0.4, 5.4, 9.4):
        y = np.where(x < place, 2.0, 1.0 + x)[:, None]
        exact = 2.0 * place + (11.0 - place) + (121.0 - place**2) / 2.0
        assert integral(x, y, [place])[0][0] == pytest.approx(exact, rel=1e-12)
        assert positive_integral(x, y, [place])[0][0] == pytest.approx(exact, rel=1e-12)


def test_places_of_breaks() -> None:
    """Those near others are left out; a sample at one stands alone."""
    assert spaced([10.25, 12.0, 1.0, 20.0, 38.5], 41) == pytest.approx(
        [10.25, 20.0 - 2e-14, 20.0 + 2e-14], rel=1e-15, abs=0.0
    )
    assert spaced([10.25, 30.5], 41, [12.0]) == [12.0, 30.5]


def test_where_a_rate_turns_back() -> None:
    """cos(3 t) at steps of 0.05 s: at odd multiples of pi / 6; and where it is 0 at a sample it is not between two."""
    t = np.arange(0.0, 3.01, 0.05)
    found = 0.05 * np.array(turns_of(t, np.cos(3.0 * t), -3.0 * np.sin(3.0 * t)))
    assert np.allclose(found, np.pi / 6.0 * np.array([1.0, 3.0, 5.0]), atol=1e-11)
    assert turns_of(np.arange(3.0), np.array([1.0, 0.5, 0.2]), np.zeros(3)) == []
    slopes = np.array([-0.8, 0.0, 0.6, 0.0, -0.8])
    assert turns_of(np.arange(5.0), np.array([0.0, -0.5, 0.0, 0.5, 0.0]), slopes) == [2.0]


@pytest.mark.parametrize("power", [1, 2, 3, 4])
@pytest.mark.parametrize("at", [0.3, 0.6, 0.95, np.inf])
def test_a_motion_that_begins_or_ends_at_rest_may_turn_back_beside_it(power: int, at: float) -> None:
    """v = t^n (at - t) beside the first sample and the last, whose neighbours are on the same side; or t^n alone."""
    t = np.arange(40.0)
    rate = np.polynomial.Polynomial([0.0] * power + ([1.0] if np.isinf(at) else [at, -1.0]))
    v, a = rate(t), rate.deriv()(t)
    v[0] = LEAST * np.sign(v[1])
    expected = [] if np.isinf(at) else [at]
    assert turns_of(t, v, a) == pytest.approx(expected, rel=1e-6)
    assert turns_of(t, v[::-1], -a[::-1]) == pytest.approx([39.0 - x for x in expected], rel=1e-6)


def test_rounding_beside_rest_turns_nothing_back() -> None:
    t = np.arange(40.0)
    v, a = np.maximum(t - 2.0, 0.0) ** 3, 3.0 * np.maximum(t - 2.0, 0.0) ** 2
    v[:3], a[:3] = [0.0, 1e-17, 2e-17], [-1e-16, 1e-16, 1e-17]
    assert turns_of(t, v, a) == []


def test_rounding_decides_no_sign_of_a_rate() -> None:
    """Of the second joint, which stands still, and where the first comes to rest; what it has from elsewhere stays."""
    v = np.array([[1e-17, 2e-17], [-1.0, -3e-17], [0.0, 1e-17], [1e-9, 0.0], [1.0, 4e-17], [-2e-16, 1e-17]])
    found = settled(v)
    assert not found[:, 1].any()
    np.testing.assert_array_equal(found[1:-1, 0], v[1:-1, 0])
    assert np.sign(found[[0, -1], 0]).tolist() == [-1.0, 1.0] and np.abs(found[[0, -1], 0]).max() == LEAST


def test_tops_of_many_columns_are_those_of_each() -> None:
    """Without their errors: for sizing, beside the extremes of one column; a peak at rough samples stays a sample."""
    rng = np.random.default_rng(8)
    x = np.linspace(0.0, 1.0, 60)
    y = (1.0 + x[:, None]) * np.sin(
        2.0 * np.pi * (rng.uniform(0.5, 3.0, 12) * x[:, None] + rng.uniform(size=12))
    )
    value, at = tops(np.arange(60.0), y)
    one = largest(np.arange(60.0), y)
    assert np.allclose(value, one.value, atol=1e-7) and np.allclose(at, one.at, atol=1e-3)
    rough = rng.normal(size=(60, 5))
    value, at = tops(np.arange(60.0), rough)
    assert np.array_equal(value, rough.max(axis=0)) and np.array_equal(at, rough.argmax(axis=0))


# -- differences ---------------------------------------------------------------------------------------------------
def test_a_derivative_is_no_better_than_the_noise_of_its_outputs() -> None:
    noise = 1e-3 * NARROWER ** np.arange(LEVELS)
    value, error = extrapolated(np.full(LEVELS, 2.0), noise)
    assert value == pytest.approx(2.0, rel=1e-12) and 1e-3 <= error < 0.1
    exact = np.array([2.0 + 3.0 * 0.01 * NARROWER ** (-2.0 * k) for k in range(LEVELS)])
    value, error = extrapolated(exact, np.full(LEVELS, 1e-15))
    assert abs(value - 2.0) < 1e-12 and abs(value - 2.0) <= error < 1e-2


def test_differences_that_do_not_come_nearer_prove_nothing() -> None:
    """Those of an extreme that moves over parts of a thousandth of a key, whose derivative is -0.0858."""
    raw = np.array([1.28044221, 6.81512705, 47.20268803, 135.22031327, 80.84502799])
    value, error = extrapolated(raw, np.full(LEVELS, 1e-9))
    assert abs(value + 0.0858) <= error


def sides(good: list[bool], told: float = 1e-9, scale: float = 1.0) -> Sides:
    """Return runs of y = 3 x^3 at both sides of 1, of which some levels failed."""
    steps = 1e-2 / NARROWER ** np.arange(LEVELS)
    values = 1.0 + np.outer(steps, (1.0, -1.0))
    rows = np.zeros((LEVELS, 2), dtype=[("code", int), ("outputs", float, (1,)), ("errors", float, (1,))])
    rows["outputs"][..., 0], rows["errors"][..., 0] = scale * 3.0 * values**3, told
    rows["code"][~np.array(good), 0] = 3
    return Sides(values, rows, "failed")


def test_a_slope_follows_from_the_runs_without_a_gap() -> None:
    for good in ([True] * LEVELS, [False] * 2 + [True] * 3, [True, False, True, True, True]):
        for scale in (1.0, -1.0):
            slope = sides(good, 1e-12, scale).slope(0)
            assert abs(slope.value - 9.0 * scale) <= slope.error < 1e-6
    rough = sides([True] * LEVELS, 1e-5).slope(0)
    assert 1e-4 < rough.error < 1e-1
    still = sides([True] * LEVELS, 0.0, 0.0)
    still.rows["outputs"][...] = -1.0
    assert still.slope(0).value == 0.0 and still.slope(0).error > 1e-15
    failed = sides([True] * (LEVELS - 1) + [False]).slope(0)
    assert math.isnan(failed.value) and failed.reason == "failed"


def test_a_motion_that_does_not_change_has_no_jumps() -> None:
    """What rounding alone changes has a slope of nothing, on the negative side too."""
    question: Any = SimpleNamespace(values=(1.0,), changed=lambda numbers, part: part)
    for value in (1.0, -1.0):
        values = itertools.cycle([value, np.nextafter(value, 2.0 * value), value])
        (slope,) = led_slopes(question, 0, lambda part, values=values: [np.full(3, next(values))])
        assert np.abs(slope).max() < 1e-9


# -- motions -------------------------------------------------------------------------------------------------------
def test_what_rounding_leaves_is_the_largest_of_what_there_is() -> None:
    """Of states of size 2 after 10 000 steps sqrt(10 000) half units; of equations what they leave, where it counts."""
    system: Any = SimpleNamespace(q_places=(0,), v_places=(1,))
    first = np.array([[[2.0, 4.0], [-1.0, 1.0]]])

    def floor(apart: float, leaves: tuple[float, float], watched: float = 0.0) -> tuple[float, float]:
        conditioning: Any = SimpleNamespace(leaves=lambda lasted: leaves)
        courses = Courses(system, first, np.full_like(first, apart), np.array([1.0]))
        found = courses.floor(np.array([10_000]), np.array([1.0]), lambda k: conditioning, watched)
        return float(found.q[0]), float(found.qd[0])

    own = 2.0 * 1.1e-14, 4.0 * 1.1e-14
    assert floor(1e-14, (0.0, 0.0)) == pytest.approx(own, rel=1e-12, abs=0.0)
    assert floor(1e-14, (1e-12, 1e-13)) == pytest.approx((1e-12, 1e-13), rel=1e-12, abs=0.0)
    assert floor(1e-14, (1e-13, 1e-20)) == pytest.approx((1e-13, own[1]), rel=1e-12, abs=0.0)
    assert floor(1e-3, (1e-6, 1e-6)) == pytest.approx(own, rel=1e-12, abs=0.0)
    assert floor(1e-3, (0.0, 0.0), 1e-9) == pytest.approx((1e-9, 1e-9), rel=1e-12, abs=0.0)


def courses_of(errors: np.ndarray, scale: float = 1.26) -> Any:
    """Return courses of one position and one rate whose differences are these (T,)."""
    system: Any = SimpleNamespace(q_places=(0,), v_places=(1,))
    apart = np.stack([errors, errors], axis=1)[None]
    return Courses(system, np.ones_like(apart), apart, np.array([scale]))


def test_where_rounding_is_amplified_the_end_errs_as_much_as_what_comes_before() -> None:
    """An order makes the second run's error no smaller there, and an agreement at the end is chance."""
    floor = Floor(np.array([1e-15]), np.array([1e-15]))
    amplified = np.append(np.geomspace(1e-15, 1e-9, 32), 1e-12)
    steady = np.append(np.full(32, 1e-9), 1e-12)
    for errors, least, most in ((amplified, 2.4e-9, 2.6e-9), (steady, 0.02e-9, 0.03e-9)):
        end = courses_of(errors).settled(floor)[0].at_end(floor)
        assert (end > least).all() and (end < most).all(), (errors[-2:], end)


def test_a_third_run_that_tells_another_error_says_how_large_the_second_ones_is() -> None:
    floor = Floor(np.array([1e-15]), np.array([1e-15]))
    wave = 1e-9 * (2.0 + np.sin(np.arange(33.0)))
    wave[-1] = 1e-12
    for third, least in ((1.01 * wave, 0.04e-9), (0.5 * wave, 7.0e-9)):
        apart = np.stack([third, third], axis=1)[None]
        beside = courses_of(wave).beside(apart, np.ones(1, dtype=bool))
        assert least < beside.at_end(floor).max() < 1.1 * least
        assert courses_of(wave).beside(apart, np.zeros(1, dtype=bool)).at_end(floor).max() < 0.05e-9


def test_at_the_finest_tolerances_both_runs_err_alike() -> None:
    steps, more = np.array([100]), np.array([190])
    for rtol, expected in ((1e-10, 1.25), (1e-13, 2.5)):
        first = First(Options(rtol=rtol, atol=rtol), "gauss", steps, np.ones(1))
        assert remainder(first, more) == pytest.approx(expected, rel=0.01)


def test_many_runs_are_judged_at_the_samples_of_one() -> None:
    """At each stride-th sample of a run up to the last, whatever samples are asked for."""
    one = SimpleNamespace(scene=SimpleNamespace(simulate=SimpleNamespace(samples=11)))
    for count in (10, 37, 100, 999, 1000, 5000):
        stride = stride_of(count + 1)
        batch: Any = SimpleNamespace(structure=SimpleNamespace(motion=one))
        sampling, wanted, judged = samplings(batch, "gauss", count)
        times = np.arange(1, sampling.count + 1) * count / sampling.count  # in samples
        assert np.allclose(times[wanted], np.arange(1, count + 1))
        assert len(times[judged]) == math.ceil(count / stride)
        assert np.allclose(times[judged], count - stride * np.arange(len(times[judged]))[::-1]), count
        if stride >= 1:
            alone = Recorder(SimpleNamespace(problem=None), samples=count + 1)  # type: ignore[arg-type]
            own = np.flatnonzero(alone.is_judged(np.arange(count + 1)))
            assert np.allclose(own, [0, *times[judged]]) and own[-1] == count
            few: Any = SimpleNamespace(
                scene=SimpleNamespace(simulate=SimpleNamespace(samples=count + 1)), choice=None
            )
            batch.structure = SimpleNamespace(motion=few, fleet=lambda method: SimpleNamespace(lanes=1))
            batch.ends = np.array([2.0])
            taken = samplings(batch, "gauss", 0)[0]
            assert np.allclose(
                taken.before + taken.step * np.arange(1, taken.count + 1), times[judged] * 2.0 / count
            )


def test_a_correction_that_opens_another_row_is_not_taken() -> None:
    """The largest residual of a state decides."""
    x = np.zeros((3, 2))
    left = {
        0.0: np.array([[3.0, 4.0], [3.0, 4.0], [1.0, 4.0]]),
        1.0: np.array([[1.0, 9.0], [5.0, 1.0], [3.9, 2.0]]),
    }
    observer: Any = SimpleNamespace(
        residuals=SimpleNamespace(evaluate=lambda count, states: {"q": left[float(states[1, 0])]}),
        system=SimpleNamespace(own_groups=lambda *given: None), parameters=None, _groups=lambda t, states: states,
    )  # fmt: skip
    kernel: Any = SimpleNamespace(evaluate=lambda count, groups: {"q": np.ones((3, 1))})
    assert Observer._corrected(observer, np.zeros(3), x, kernel, "q", [0]) == 1.0
    assert x[:, 0].tolist() == [0.0, 0.0, 1.0]


# -- studies -------------------------------------------------------------------------------------------------------
def test_moments_of_blocks_are_those_of_all() -> None:
    rng = np.random.default_rng(3)
    values, errors = rng.normal(5.0, 2.0, 300), rng.uniform(0.0, 1e-3, 300)
    values[[7, 250]] = np.nan
    moments = Moments()
    for first in (0, 100, 200):
        moments.add(first, values[first : first + 100], errors[first : first + 100])
    there = values[np.isfinite(values)]
    spread: Any = moments.spread(4.0, "m", SampleSpread.of(there, 298), partial(np.quantile, there))
    assert spread.runs == 298 and spread.mean == pytest.approx(there.mean(), rel=1e-14)
    assert spread.sd == pytest.approx(there.std(ddof=1), rel=1e-13)
    normal = stats.t.ppf(0.975, 297) * there.std(ddof=1) / math.sqrt(298) + np.nanmean(errors)
    assert spread.mean_error == pytest.approx(normal, rel=0.05)
    assert spread.largest_error == errors.max()
    assert moments.least_run == np.nanargmin(values) and moments.greatest_run == np.nanargmax(values)


def test_quantiles_of_more_values_than_are_held() -> None:
    """From any sample, one that misses the quantile too; of values of which many are equal."""
    for places in [(0, 500), (0, 20), (480, 500), (240, 260)]:
        rng = np.random.default_rng(5)
        for values in (
            rng.normal(size=5000),
            np.round(rng.normal(size=5000), 1),
            np.repeat([1.0, 2.0], 2500),
        ):
            values[::50] = np.nan
            runs = int(np.isfinite(values).sum())
            sample = np.sort(values[np.isfinite(values)])[::10][places[0] : places[1]]
            blocks = np.split(values, 10)
            found = quantiles(partial(iter, blocks), runs, sample, (0.05, 0.25, 0.5, 0.95))
            assert np.allclose(found, np.nanquantile(values, (0.05, 0.25, 0.5, 0.95)), rtol=1e-13)
