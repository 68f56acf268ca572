"""Compiled programs as the plan lists them."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Mapping, Sequence
from typing import Protocol

from robodyn_cli.expr.fixed import places
from robodyn_cli.expr.graph import Scalar
from robodyn_cli.kernels.compiler import machine
from robodyn_cli.kernels.lower import is_inlined
from robodyn_cli.kernels.program import Program
from robodyn_cli.summaries.checks import Kernel


class Code(Protocol):
    """Straight-line code, or loops over the bodies.

    inputs, sizes : of the arrays that it reads and gives. numbers : of the scene, in its table.
    """

    @property
    def operations(self) -> int: ...
    @property
    def inputs(self) -> Mapping[str, int]: ...
    @property
    def sizes(self) -> Mapping[str, int]: ...
    @property
    def numbers(self) -> Sequence[Scalar]: ...
    @property
    def digest(self) -> str: ...


def at_samples(name: str, code: Code, compiled: bool = True, beside: int = 0) -> Kernel:
    """Return a program that runs over samples; ``beside`` : operations of what goes with it."""
    if not compiled:
        return dataclasses.replace(_kernel(name, code, 1, "blocks of samples"), engine="interpreted")
    found = _kernel(name, code, machine().lanes, "samples")
    return dataclasses.replace(found, operations=found.operations + beside)


def in_steps(name: str, code: Code, lanes: int = 1, lanes_hold: str = "stages") -> Kernel:
    """Return a program of the stepping loop."""
    placed = "inlined" if isinstance(code, Program) and is_inlined(code) else "function"
    found = _kernel(name, code, lanes, "state" if lanes == 1 else lanes_hold)
    return dataclasses.replace(found, placed=placed)


def _kernel(name: str, code: Code, lanes: int, hold: str) -> Kernel:
    shape, digest = "unrolled", code.digest
    if not isinstance(code, Program):
        shape, digest = "rolled", hashlib.sha256(digest.encode()).hexdigest()
    reads = dict(code.inputs), places(code.numbers)
    return Kernel(
        name, code.operations, *reads, dict(code.sizes), "compiled", shape, lanes, hold, digest[:12]
    )
