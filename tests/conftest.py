"""What tests in several folders share, and which of them are quick."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

SLOW = frozenset(Path(__file__).with_name("slow.txt").read_text(encoding="utf-8").split())


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark as ``quick`` the first case of each test function that ``slow.txt`` does not name."""
    met = set(SLOW)
    for item in items:
        if not isinstance(item, pytest.Function):
            continue
        name = f"{item.module.__name__}.{item.originalname}"
        if name not in met:
            met.add(name)
            item.add_marker(pytest.mark.quick)


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
