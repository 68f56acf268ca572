"""Methods of integration as tests go through them: all, or one a family, without those that refuse a kind of system.

What a method refuses stands here once, as a table of families and reasons; ``tests/conformance/test_refusals.py`` holds the
methods to it. So a method that begins to refuse something fails a test instead of leaving others out.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import pytest

from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.registry import methods

METHODS = tuple(methods)
ADAPTIVE = tuple(m for m in METHODS if methods[m].adaptive)
FIXED_STEP = tuple(m for m in METHODS if not methods[m].adaptive)


def family(method: str) -> str:
    """Return the file that the method is written in."""
    return methods[method].facts.family


def _first_of_each(names: Iterable[str]) -> tuple[str, ...]:
    found: dict[tuple[str, bool], str] = {}
    for name in names:
        found.setdefault((family(name), methods[name].adaptive), name)
    return tuple(found.values())


# one a family, and one more where the family has members with a fixed step beside others
FAMILIES = _first_of_each(METHODS)
ADAPTIVE_FAMILIES = tuple(m for m in FAMILIES if methods[m].adaptive)

# -- what methods refuse ---------------------------------------------------------------------------------------
PARTITIONED = tuple(m for m in METHODS if family(m) == "symplectic")  # split a system into drift and kick
JACOBIAN = tuple(m for m in METHODS if methods[m].needs_jacobian)
TAYLOR = tuple(m for m in METHODS if family(m) == "taylor")  # write out series of all operations
INDEX3 = ("generalized_alpha",)  # has accelerations and multipliers of its own

# kind of system -> which methods refuse it, with words of the reason
REFUSALS: dict[str, dict[str, str]] = {
    "accelerations from positions and time": {},
    "accelerations from velocities": dict.fromkeys(PARTITIONED, "depend on velocities (v0)"),
    "accelerations from further states": dict.fromkeys(PARTITIONED, "depend on further states"),
    "a closed loop": dict.fromkeys(PARTITIONED, "depend on velocities"),
    "a ball joint": dict.fromkeys(PARTITIONED, "they depend on")
    | dict.fromkeys(INDEX3, "velocities that are not rates of its coordinates"),
    "independent coordinates": dict.fromkeys(PARTITIONED, "depend on velocities")
    | dict.fromkeys(INDEX3, "rows of the loops depend on each other")
    | dict.fromkeys(TAYLOR, "a Taylor series is written out for"),
    "set-valued friction": dict.fromkeys(INDEX3, "'law: set_valued' or a rigid stop"),
    "a rigid stop": dict.fromkeys(INDEX3, "'law: set_valued' or a rigid stop"),
    "a long chain": dict.fromkeys(PARTITIONED, "a long chain depend on its velocities")
    | dict.fromkeys(JACOBIAN, "Jacobian")
    | dict.fromkeys(TAYLOR, "no Taylor series"),
}


def obstacle(method: str, system: System) -> str:
    """Return why a method refuses a system, or nothing."""
    return methods[method].obstacle(system)


def taking(kind: str, names: Sequence[str] = METHODS) -> list[str]:
    """Return which of the methods take a kind of system."""
    return [m for m in names if m not in REFUSALS[kind]]


# -- parameters of tests -----------------------------------------------------------------------------------------
each_method = pytest.mark.parametrize("method", METHODS)
each_adaptive = pytest.mark.parametrize("method", ADAPTIVE)
each_family = pytest.mark.parametrize("method", FAMILIES)
each_adaptive_family = pytest.mark.parametrize("method", ADAPTIVE_FAMILIES)


def each_pair(*blocks: tuple[Sequence[str], Sequence[Any]]) -> pytest.MarkDecorator:
    """Return the parameters ``method`` and ``case``: each method of a block with each case of it that it takes."""
    pairs = [(m, case) for names, cases in blocks for case in cases for m in taking(case.kind, names)]
    return pytest.mark.parametrize(("method", "case"), pairs, ids=[f"{case}-{m}" for m, case in pairs])
