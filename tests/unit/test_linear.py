"""Small dense linear algebra against numpy, on numbers and on expressions."""

from __future__ import annotations

import numpy as np
import pytest

from robodyn_cli.algorithms.linear import LdlFactor, minimum_degree
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
        L, D = np.eye(n), np.diag(1.0 / real(f.inverse))
        for i, row in enumerate(f.rows):
            assert all(k < i and f.columns[k][i] == x for k, x in row.items())
            L[i, list(row)] = list(row.values())
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
        cost[name] = count_operations([*(x for row in f.rows for x in row.values()), *f.inverse])
    assert cost["leaves"] <= 5 * n and cost["hub"] > 3 * cost["leaves"]


def test_a_singular_matrix_is_an_error_on_numbers() -> None:
    with pytest.raises(ZeroDivisionError):
        LdlFactor.of(matrix([[1.0, 1.0], [1.0, 1.0]]))


@sizes
def test_the_trace_of_the_inverse(n: int) -> None:
    A = definite(n, 5)
    for order in orders(n):
        found = LdlFactor.of(matrix(A.tolist()), order).inverse_trace()
        assert_close(found, np.trace(np.linalg.inv(A)), 100 * EPS * np.linalg.cond(A), 1.0)


def arrow_and_chain(n: int, seed: int) -> np.ndarray:
    """Return a chain in shuffled order, whose rows all meet a last one too."""
    A = 4.0 * np.eye(n)
    for k in range(n - 2):
        A[k, k + 1] = A[k + 1, k] = -1.0
    A[-1, :-1] = A[:-1, -1] = 0.1
    p = np.random.default_rng(seed).permutation(n)
    return A[np.ix_(p, p)]


@pytest.mark.parametrize("seed", range(3))
def test_an_order_that_keeps_the_factor_sparse(seed: int) -> None:
    n = 30
    A = arrow_and_chain(n, seed)
    order = minimum_degree(matrix(A.tolist()))
    assert sorted(order) == list(range(n))
    sparse, natural = LdlFactor.of(matrix(A.tolist()), order), LdlFactor.of(matrix(A.tolist()))
    assert sum(len(row) for row in sparse.rows) == 2 * n - 3  # nothing fills in
    assert sum(len(row) for row in natural.rows) > 3 * n
    b = np.random.default_rng(seed).normal(size=n)
    assert_close(sparse.solve(b.tolist()), np.linalg.solve(A, b), 1e-13)
    assert_close(sparse.inverse_trace(), np.trace(np.linalg.inv(A)), 1e-13, 30.0)


def fewest_neighbours_first(A: np.ndarray) -> tuple[int, ...]:
    """The order by definition: each row is looked at in each step."""
    near = [set(map(int, np.flatnonzero(row))) - {i} for i, row in enumerate(A)]
    left, order = set(range(len(A))), []
    while left:
        i = min(left, key=lambda j: (len(near[j]), j))
        left.remove(i)
        order.append(i)
        for j in near[i]:
            near[j] = (near[j] | near[i]) - {i, j}
    return tuple(order)


@pytest.mark.parametrize("seed", range(5))
def test_the_order_is_that_of_fewest_neighbours(seed: int) -> None:
    rng = np.random.default_rng(seed)
    A = np.triu(rng.uniform(size=(40, 40)) * (rng.uniform(size=(40, 40)) < 0.08), 1)
    A += A.T + np.eye(40)
    assert minimum_degree(matrix(A.tolist())) == fewest_neighbours_first(A)


@pytest.mark.parametrize("seed", range(3))
def test_few_entries_are_solved_for_by_the_rows_that_they_reach(seed: int) -> None:
    """Of many short chains an entry reaches its own, and what it gives is what the whole row gives."""
    chain = 5 * np.eye(4) - np.eye(4, k=1) - np.eye(4, k=-1)
    A, rng = np.kron(np.eye(25), chain), np.random.default_rng(seed)
    p = rng.permutation(100)
    factor = LdlFactor.of(matrix(A[np.ix_(p, p)].tolist()), [int(k) for k in rng.permutation(100)])
    looked: list[int] = []

    class Watched(tuple[dict[int, float], ...]):
        def __getitem__(self, i: int) -> dict[int, float]:  # type: ignore[override]
            looked.append(i)
            return super().__getitem__(i)

    b = np.zeros(100)
    b[7] = 2.0
    whole = factor.forward(b.tolist())
    watched = LdlFactor(Watched(factor.rows), factor.columns, factor.inverse, factor.order)
    assert watched.forward_entries({7: 2.0}) == {k: x for k, x in enumerate(whole) if x}
    assert len(looked) == len(set(looked)) <= 4
