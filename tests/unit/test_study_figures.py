"""Samples and figures of studies: each made block by block as at once, and beside scipy's and closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from robodyn_cli.expr.statements import Variation
from robodyn_cli.over.study.design import (
    MARGIN,
    Correlated,
    Repeated,
    Saltelli,
    inside,
    make_samples,
    quantile,
    strata,
)
from robodyn_cli.over.study.report import influences, share, sobol
from robodyn_cli.over.study.rows import _mixed
from robodyn_cli.scene.nested_options import Correlation


def test_samples_in_blocks_are_those_at_once() -> None:
    """Forwards, again from the beginning, and with a gap."""
    for sampler in ["sobol", "random", "lhs"]:
        whole = make_samples(sampler, 64, 3, 7).rows(0, 64)
        assert whole.shape == (64, 3) and whole.min() >= 0.0 and whole.max() <= 1.0
        assert np.unique(whole.round(12), axis=0).shape == (64, 3)
        samples = make_samples(sampler, 64, 3, 7)
        for first, last in ((0, 10), (10, 33), (40, 64), (5, 6), (6, 64), (0, 64)):
            assert np.array_equal(samples.rows(first, last), whole[first:last]), (first, last)
        assert not np.array_equal(make_samples(sampler, 64, 3, 8).rows(0, 64), whole)
        assert np.abs(whole.mean(axis=0) - 0.5).max() < 0.15


def test_a_design_for_indices() -> None:
    """Blocks A, B and A with each column of B, whatever rows are asked for."""
    both = make_samples("sobol", 8, 6, 1)
    A, B = np.split(both.rows(0, 8), 2, axis=1)
    mixed = [np.where(np.arange(3) == k, B, A) for k in range(3)]
    design = Saltelli(both, 3)
    assert design.n == 40 and np.array_equal(design.rows(0, 40), np.vstack([A, B, *mixed]))
    assert np.array_equal(design.rows(5, 29), np.vstack([A, B, *mixed])[5:29])
    assert np.array_equal(Repeated(both).rows(6, 10), both.rows(0, 8)[[6, 7, 0, 1]])


def test_distributions() -> None:
    for name, arguments, known in [
        ("uniform", (-2.0, 5.0), stats.uniform(-2.0, 7.0)),
        ("triangular", (1.0, 2.0, 5.0), stats.triang(0.25, 1.0, 4.0)),
        ("normal", (3.0, 0.5), stats.norm(3.0, 0.5)),
    ]:
        u = np.array([0.001, 0.1, 0.25, 0.2501, 0.5, 0.9, 0.999])
        found = quantile(Variation(text="", distribution=name, arguments=arguments), u)
        assert np.allclose(found, known.ppf(u), rtol=1e-12)  # type: ignore[attr-defined]


def test_uniform_numbers_have_finite_scores() -> None:
    ends = inside(np.array([0.0, MARGIN, 0.3, 1.0]))
    assert 0.0 < ends[0] <= ends[1] and ends[2] == 0.3 and 0.9 < ends[3] < 1.0
    assert np.all(np.isfinite(stats.norm.ppf(ends)))


def test_one_run_of_each_part() -> None:
    for runs, most in [(10, 20), (20, 20), (1000, 20), (1001, 7)]:
        chosen = strata(runs, most)
        if runs <= most:
            assert chosen.tolist() == list(range(runs))
            continue
        edges = np.linspace(0, runs, most + 1).astype(int)
        assert len(chosen) == most and np.all((edges[:-1] <= chosen) & (chosen < edges[1:]))
        # at random within its part, not always the first
        assert 0.2 < np.mean((chosen - edges[:-1]) / np.diff(edges)) < 0.8


def test_influences_of_a_plane() -> None:
    """The swing is the slope times the range between 5 % and 95 %; ranks are those of Spearman, equal values too."""
    rng = np.random.default_rng(4)
    x = np.column_stack(
        [rng.uniform(2.0, 3.0, 400), rng.integers(0, 4, 400).astype(float), np.full(400, 7.0)]
    )
    y = 3.0 * x[:, 0] - 0.5 * x[:, 1] + 1.0
    y[5] = np.nan
    found = influences(("a", "b", "c"), x, y)
    assert list(found) == ["a", "b"] and "c" not in found
    there = np.isfinite(y)
    for key, k, slope in (("a", 0, 3.0), ("b", 1, -0.5)):
        low, high = np.quantile(x[there, k], (0.05, 0.95))
        assert found[key].swing == pytest.approx(slope * (high - low), rel=1e-9)
        assert found[key].rank_correlation == pytest.approx(
            stats.spearmanr(x[there, k], y[there])[0], rel=1e-12
        )


def test_indices_of_a_sum_of_squares() -> None:
    """y = x1 + 2 x2: a fifth and four fifths of the variance; none without variation or with gaps."""
    both = make_samples("sobol", 256, 4, 3)
    x = Saltelli(both, 2).rows(0, 1024)
    found = sobol(("a", "b"), x[:, 0] + 2.0 * x[:, 1])
    assert found is not None
    for key, part in (("a", 0.2), ("b", 0.8)):
        one = found[key]
        assert one.first == pytest.approx(part, abs=0.03) and one.total == pytest.approx(part, abs=0.03)
        assert one.first_low < one.first < one.first_high
    assert sobol(("a", "b"), np.ones(1024)) is None
    assert sobol(("a", "b"), np.where(np.arange(1024) == 9, np.nan, x[:, 0])) is None


def test_the_interval_of_a_share_is_that_of_clopper_and_pearson() -> None:
    for count, runs in [(0, 50), (7, 50), (50, 50)]:
        found = share(count, runs, runs)
        known = stats.binomtest(count, runs).proportion_ci(0.95, method="exact")
        assert found.share == count / runs
        assert (found.low, found.high) == pytest.approx((known.low, known.high), rel=1e-9)


def test_rows_are_told_apart_by_all_values_and_their_order() -> None:
    values = np.array(
        [[1.0, 2.0], [2.0, 1.0], [1.0, math.nextafter(2.0, 3.0)], [3.0, 3.0], [5.0, 5.0], [1.0, 2.0]]
    )
    mixed = _mixed(values)
    assert len(set(mixed[:5].tolist())) == 5 and mixed[5] == mixed[0]


def test_correlated_samples() -> None:
    samples = Correlated(
        make_samples("sobol", 512, 2, 1), ["a", "b"], [Correlation(between=("a", "b"), value=-0.7)]
    )
    scores = stats.norm.ppf(samples.rows(0, 512))
    assert np.corrcoef(scores.T)[0, 1] == pytest.approx(-0.7, abs=0.03)
    assert np.allclose(scores.mean(axis=0), 0.0, atol=0.03) and np.allclose(
        scores.std(axis=0), 1.0, atol=0.03
    )
