"""Tests that go through all methods of integration leave out what a method refuses by name."""

from __future__ import annotations

from collections.abc import Generator
from typing import Any

import pytest

from robodyn_cli.errors import CapabilityError


@pytest.hookimpl(wrapper=True)
def pytest_pyfunc_call(pyfuncitem: Any) -> Generator[None, Any, Any]:
    """Skip where a symplectic partitioned method meets accelerations that it cannot split."""
    try:
        return (yield)
    except CapabilityError as error:
        chosen = getattr(pyfuncitem, "callspec", None)
        if chosen is None or "method" not in chosen.params or "partitioned" not in error.message:
            raise
        pytest.skip(error.message)
