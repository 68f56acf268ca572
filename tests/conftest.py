"""What tests in several folders share, and which of them are quick."""

from __future__ import annotations

import copy
import gc
import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from robodyn_cli.threads import single_thread

# as the command line does: before numpy is imported, and as graphs make many objects and hardly any garbage
single_thread(os.environ)
gc.set_threshold(100_000, 10, 3)  # and what garbage there is does not fill the memory over all tests

SLOW, FURTHER = (
    frozenset(Path(__file__).with_name(name).read_text(encoding="utf-8").splitlines())
    for name in ("slow.txt", "further.txt")
)

BEGUN, SHARED, OWN = pytest.StashKey[float](), pytest.StashKey[float](), pytest.StashKey[bool]()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark as ``quick`` the first case of each test function that ``slow.txt`` does not name, ``further`` as listed."""
    met, values = set(SLOW), set[tuple[str, str, str | int]]()
    for item in items:
        if not isinstance(item, pytest.Function) or item.get_closest_marker("benchmarks"):
            continue
        name = ".".join(
            [item.module.__name__, *([item.cls.__qualname__] if item.cls else []), item.originalname]
        )
        item.stash[OWN] = _brings_a_value(item, name, values)
        if name + item.name.removeprefix(item.originalname) in FURTHER:
            item.add_marker(pytest.mark.further)
        if name not in met:
            met.add(name)
            item.add_marker(pytest.mark.quick)


def _brings_a_value(item: pytest.Function, name: str, met: set[tuple[str, str, str | int]]) -> bool:
    """Tell whether a case is the first of its function with one of its values; numbers are samples of one branch."""
    given = item.callspec.params if hasattr(item, "callspec") else {}
    new = {
        (name, argument, value if isinstance(value, str) else id(value))
        for argument, value in given.items()
        if isinstance(value, bool) or not isinstance(value, int | float)
    } - met
    met |= new
    return bool(new)


def pytest_collection_finish() -> None:
    """Leave what collection has made, ten thousand tests, out of all later searches for garbage."""
    gc.collect()
    gc.freeze()


def processor_time() -> float:
    """Return how long this process and those that it has waited for have computed so far [s]."""
    so_far = os.times()
    return time.process_time() + so_far.children_user + so_far.children_system


@pytest.hookimpl(wrapper=True)
def pytest_fixture_setup(fixturedef: pytest.FixtureDef[Any], request: pytest.FixtureRequest) -> Any:
    """Note what several tests share: it is no time of the one that happens to be the first."""
    begun = processor_time()
    try:
        return (yield)
    finally:
        if fixturedef.scope != "function":
            request.config.stash[SHARED] = request.config.stash.get(SHARED, 0.0) + processor_time() - begun


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    item.stash[BEGUN] = processor_time()
    item.config.stash[SHARED] = 0.0


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]) -> None:
    """Add to the last report of a test what ``slow.py`` asks for: how long it has computed, and a value of its own."""
    if call.when == "teardown":
        if item.stash.get(OWN, False):
            item.user_properties.append(("own", "yes"))
        own = processor_time() - item.stash[BEGUN] - item.config.stash[SHARED]
        item.user_properties.append(("processor", f"{own:.3f}"))


@pytest.fixture(scope="module")
def source_trees() -> Iterator[None]:
    """Free what ``tests/source.py`` keeps when a file of tests has ended."""
    from tests import source

    yield
    source.forget()


@pytest.fixture
def lasting_code(monkeypatch: pytest.MonkeyPatch) -> None:
    """Lasting code from the first step and sample on, as many runs have it: single runs round as these do then."""
    from robodyn_cli.integrators.runtime import engine
    from robodyn_cli.kernels import compiler, samples

    for module in (engine, samples):
        monkeypatch.setattr(module, "QUICK", compiler.LASTING)


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
