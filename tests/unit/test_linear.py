"""Small dense linear algebra against numpy, on numbers and on expressions."""

from __future__ import annotations

import numpy as np
import pytest

from robodyn_cli.algorithms.linear import LdlFactor
from robodyn_cli.expr.graph import Graph, count_operations
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.spatial.algebra import matrix, vector
from tests.numeric import EPS, assert_close, real


def definite(n: int, seed: int) -> np.ndarray:
    A = np.random.default_rng([n, seed]).normal(size=(n, n))
    return A @ A.T + 0.1 * np.eye(n)


sizes = pytest.mark.parametrize("n", [1, 2, 3, 5, 9])


def orders(n: int) -> list[list[int] | None]:
    return [None, list(range(n))[::-1], [int(k) for k in np.random.default_rng(n).permutation(n)]]


@sizes
def test_factors(n: int) -> None:
    A = definite(n, 0)
    for order in orders(n):
        f = LdlFactor.of(matrix(A.tolist()), order)
        L, D = real(f.L) + np.eye(n), np.diag(1.0 / real(f.inverse))
        assert np.allclose(real(f.L), np.tril(real(f.L), -1), rtol=0, atol=0), (
            "L is stored below the diagonal only"
        )
        p = order if order is not None else list(range(n))
        assert_close(L @ D @ L.T, A[np.ix_(p, p)], 1e-14)


@sizes
def test_solutions(n: int) -> None:
    A, b = definite(n, 1), np.random.default_rng(n).normal(size=n)
    for order in orders(n):
        f = LdlFactor.of(matrix(A.tolist()), order)
        expected = np.linalg.solve(A, b)
        assert_close(f.solve(b.tolist()), expected, 20 * EPS * np.linalg.cond(A))
        assert_close(A @ real(f.solve(vector(b.tolist()))), b, 20 * EPS * np.linalg.cond(A))
        # the halves: b^T A^-1 b = sum y^2 / D, and backward is forward's transpose
        y = real(f.forward(b.tolist()))
        assert_close(np.sum(y**2 * real(f.inverse)), b @ expected, 100 * EPS * np.linalg.cond(A))
        c = np.random.default_rng(n + 1).normal(size=n)
        back = real(f.backward(c.tolist()))
        assert_close(c @ y, back @ b, 1e-12, float(np.abs(c) @ np.abs(y)) + float(np.abs(back) @ np.abs(b)))


@sizes
def test_expressions_give_the_same(n: int) -> None:
    A, b = definite(n, 2), np.random.default_rng(n).normal(size=n)
    graph = Graph()
    entries = [
        [graph.symbol(f"a{min(i, j)}{max(i, j)}", "A", n * min(i, j) + max(i, j)) for j in range(n)]
        for i in range(n)
    ]
    f = LdlFactor.of(matrix(entries), orders(n)[2])
    x = f.solve(graph.symbols([f"b{k}" for k in range(n)], "b"))
    got = evaluate(list(x), {"A": A.ravel().tolist(), "b": b.tolist()})
    assert_close(got, np.linalg.solve(A, b), 20 * EPS * np.linalg.cond(A))


def test_zeros_that_stay_zero_cost_nothing() -> None:
    """A star (hub and leaves): leaves first leaves no fill-in, hub first fills everything."""
    n, graph = 8, Graph()
    A = np.zeros((n, n), dtype=object)
    A.fill(0.0)
    for k in range(n):
        A[k, k] = graph.symbol(f"d{k}", "d", k)
        if k:
            A[0, k] = A[k, 0] = graph.symbol(f"e{k}", "e", k)
    cost = {}
    for name, order in (("hub", range(n)), ("leaves", range(n - 1, -1, -1))):
        f = LdlFactor.of(A, list(order))
        cost[name] = count_operations([*f.L.ravel(), *f.inverse])
    assert cost["leaves"] <= 5 * n and cost["hub"] > 3 * cost["leaves"]


def test_a_singular_matrix_is_an_error_on_numbers() -> None:
    with pytest.raises(ZeroDivisionError):
        LdlFactor.of(matrix([[1.0, 1.0], [1.0, 1.0]]))
