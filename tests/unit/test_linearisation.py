"""The factored matrices g E - J against differences and numpy."""

from __future__ import annotations

import dataclasses
from functools import cached_property
from typing import Any

import numpy as np
import pytest

from robodyn_cli.expr import functions as f
from robodyn_cli.expr.graph import Expr
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.formulations.events import EventFunction, Passing
from robodyn_cli.formulations.system import EVENT_FREE, System
from robodyn_cli.integrators.runtime.options import Grid
from robodyn_cli.kernels.program import Program
from tests.systems import samples, system


def rates(t: Any, q: Any, v: Any, z: Any, p: Any) -> Any:
    a = [f.sin(q[1]) * v[0] - z[0] * q[0], q[0] * q[0] * v[1] + f.cos(3.0 * t) - 0.3 * v[0] * v[1]]
    return a, [v[0] * v[1] + f.exp(-z[0]) * t]


BODY = system(2, rates, nz=1)
T, X = 0.7, np.array([0.4, -1.1, 0.9, 1.3, 0.2])


def derivative(t: float, x: np.ndarray) -> np.ndarray:
    groups: dict[str, Any] = {"t": [t], "q": x[:2], "v": x[2:4], "z": x[4:], "p": [0.0] * 4}
    return np.array([*x[2:4], *evaluate([*BODY.acceleration, *BODY.z_rate], groups)], dtype=float)


def by_differences(body: System) -> np.ndarray:
    h = 1e-6
    columns = [(derivative(T, X + h * e) - derivative(T, X - h * e)) / (2 * h) for e in np.eye(body.size)]
    return np.array(columns).T


def outputs(program: Program, g: list[float], **more: np.ndarray) -> dict[str, np.ndarray]:
    """Run a program by hand, instruction by instruction."""
    groups: dict[str, Any] = {"t": [T], "q": X[:2], "v": X[2:4], "z": X[4:], "g": g, **more}
    values: list[float] = []
    for i in program.instructions:
        args = [values[k] for k in i.args]
        if i.op == "const":
            values.append(float(i.value))
        elif i.op == "sym":
            values.append(float(groups[i.value[0]][i.value[1]]))
        else:
            simple = {
                "add": np.add,
                "sub": np.subtract,
                "mul": np.multiply,
                "div": np.divide,
                "neg": np.negative,
            }
            values.append(float({**simple, "sin": np.sin, "cos": np.cos, "exp": np.exp}[i.op](*args)))
    return {
        name: np.array([e if isinstance(e, float) else values[e] for e in entries])
        for name, entries in program.outputs.items()
    }


def product(lu: np.ndarray) -> np.ndarray:
    """Multiply factors, the diagonal of U being inverted."""
    n = BODY.size
    lu = lu.reshape(n, n)
    U = np.triu(lu, 1) + np.diag(1.0 / np.diag(lu))
    return np.asarray((np.tril(lu, -1) + np.eye(n)) @ U)


def test_the_jacobian_is_exact() -> None:
    found = BODY.jacobian
    groups: dict[str, Any] = {"t": [T], "q": X[:2], "v": X[2:4], "z": X[4:], "p": [0.0] * 4}
    entries = list(found.J.ravel())
    values = np.array(evaluate(entries, groups), dtype=float).reshape(5, 5)
    np.testing.assert_allclose(values, by_differences(BODY), atol=1e-8)
    t = np.array(evaluate(list(found.t), groups), dtype=float)
    np.testing.assert_allclose(t, (derivative(T + 1e-6, X) - derivative(T - 1e-6, X)) / 2e-6, atol=1e-8)
    # what cannot be there is a plain zero, so that nothing is computed for it
    assert not any(isinstance(e, Expr) for e in found.J[:2].ravel())


@pytest.mark.parametrize("g", [3.0, 4e5])
def test_real_factors(g: float) -> None:
    found = outputs(BODY.linearisation, [g])
    expected = g * np.eye(5) - by_differences(BODY)
    np.testing.assert_allclose(product(found["lu"]), expected, rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("g", [3.0 + 0.0j, 2.0 - 5.0j, 4e5 + 1e5j])
def test_complex_factors(g: complex) -> None:
    found = outputs(BODY.complex_linearisation, [g.real, g.imag])
    expected = g * np.eye(5) - by_differences(BODY)
    np.testing.assert_allclose(product(found["re"] + 1j * found["im"]), expected, rtol=1e-8, atol=1e-8)


def test_the_change_of_the_rates_along_a_direction() -> None:
    direction = np.array([0.3, -0.2, 0.7, 1.1, -0.5, 0.9])
    found = outputs(BODY.tangents, [], dx=direction)["d"]
    h = 1e-6
    ahead = derivative(T + h * direction[5], X + h * direction[:5])
    behind = derivative(T - h * direction[5], X - h * direction[:5])
    np.testing.assert_allclose(found, ((ahead - behind) / (2 * h))[2:], atol=1e-8)


def coupled(t: Any, q: Any, v: Any, z: Any, p: Any) -> Any:
    """A stiff system of 21 states: every rate depends on time and on its neighbours."""
    n = len(q)
    a = [
        f.sin(q[k - 1]) * v[(k + 1) % n] - 50.0 * v[k] * (1.0 + q[k] * q[k]) - q[k] + z[0] * f.cos(2.0 * t)
        for k in range(n)
    ]
    return a, [f.exp(-z[0]) * f.sin(t) - 30.0 * z[0] + v[0] * v[1], v[3], -200.0 * z[2] + q[2]]


@pytest.mark.parametrize("interpreted", [False, True])
@pytest.mark.parametrize("method", ["rodas5p", "rosenbrock23", "radau", "radau9", "radau13", "bdf"])
def test_factors_in_loops_give_the_same_motion(
    method: str, interpreted: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    start = tuple(np.random.default_rng(5).uniform(-1.0, 1.0, 21))
    body, grid = system(9, coupled, nz=3), Grid(0.0, 0.05, 7)
    rtol = 1e-4 if method == "rosenbrock23" else 1e-8
    _, expected, small = samples(body, method, start, grid, rtol=rtol)
    monkeypatch.setattr("robodyn_cli.formulations.linearisation.LARGE", 0)
    monkeypatch.setattr("robodyn_cli.integrators.runtime.engine.MANY", 0 if interpreted else 10**9)
    monkeypatch.setattr("robodyn_cli.kernels.lower.INLINE_LIMIT", 0)
    monkeypatch.setenv("ROBODYN_CACHE", "off")
    monkeypatch.setattr("robodyn_cli.kernels.compiler._loaded", {})
    assert body.in_columns
    _, found, large = samples(body, method, start, grid, rtol=rtol)
    # the same but for rounding, which may bring another round of Newton's: a hundredth of the tolerance
    assert large.counters.steps == small.counters.steps
    np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-11)


def test_other_owners_of_events_take_over_what_is_built() -> None:
    """All that a copy builds anew are the event functions."""
    with_event = dataclasses.replace(BODY, events=(EventFunction("q", BODY.rates[0], owner=Passing()),))
    built = {name: getattr(with_event, name) for name in EVENT_FREE}
    copy = with_event.watched_by(lambda function: None)
    assert copy.switching is None and with_event.switching is not None
    assert all(getattr(copy, name) is program for name, program in built.items())
    cached = {name for name, member in vars(System).items() if isinstance(member, cached_property)}
    assert cached - set(EVENT_FREE) == {"switching"}
