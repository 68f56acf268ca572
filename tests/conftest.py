"""What tests in several folders share."""

from __future__ import annotations

from typing import Any

import pytest


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
