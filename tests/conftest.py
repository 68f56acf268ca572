"""Tests that go through all methods of integration: what a method refuses by name is left out, and fixed steps."""

from __future__ import annotations

from collections.abc import Generator
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
    from robodyn_cli.integrators.stepping.stepper import Attempt

    monkeypatch.setenv("ROBODYN_CACHE", "off")
    for name, method in list(methods.items()):

        class Fixed(method):  # type: ignore[misc, valid-type]
            adaptive = False

            def attempt(self, w: Any, t: Any, h: Any, failed: str) -> Attempt:
                outcome = super().attempt(w, t, h, failed)
                with w.f.strict():
                    return Attempt(outcome.error * 0.0, w.f.constant(1.0))

        monkeypatch.setitem(methods, f"fixed {name}", Fixed)
