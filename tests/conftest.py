"""Tests that go through all methods of integration: what a method refuses by name is left out, and fixed steps."""

from __future__ import annotations

import copy
from collections.abc import Callable, Generator
from typing import Any

import pytest

from robodyn_cli.errors import CapabilityError


@pytest.hookimpl(wrapper=True)
def pytest_pyfunc_call(pyfuncitem: Any) -> Generator[None, Any, Any]:
    """Skip where a partitioned method meets accelerations it cannot split, or one at index 3 a joint it cannot do."""
    try:
        return (yield)
    except CapabilityError as error:
        chosen = getattr(pyfuncitem, "callspec", None)
        refused = any(words in error.message for words in ("partitioned", "does not do this scene"))
        if chosen is None or "method" not in chosen.params or not refused:
            raise
        pytest.skip(error.message)


@pytest.fixture
def fixed_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """Methods named ``fixed NAME`` that take every step as it comes."""
    from robodyn_cli.integrators.registry import methods

    monkeypatch.setenv("ROBODYN_CACHE", "off")
    for name, method in list(methods.items()):
        fixed = copy.copy(method)
        fixed.adaptive = False
        monkeypatch.setattr(fixed, "stepper", _accepting(fixed.stepper))
        monkeypatch.setitem(methods, f"fixed {name}", fixed)


def _accepting(make: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Return what makes steppers whose steps count whatever their error, if it is finite."""

    def stepper(w: Any) -> Any:
        made = make(w)
        attempt = made.attempt

        def accepted(*arguments: Any) -> Any:
            outcome = attempt(*arguments)
            if outcome.square is not None:
                with w.f.strict():
                    outcome.square = outcome.square * 0.0
            return outcome

        made.attempt = accepted
        return made

    return stepper
