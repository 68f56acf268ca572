"""The rates of a system in two shapes: one expression graph, or loops over the bodies of a long tree.

    v-dot = a(t, q, v, z, p),  z-dot = r(t, q, v, z, p)

Checklist for another shape:

1. ``emit`` stores the nv accelerations, then the nz rates of z, for as many states as there are lanes.
2. Everything that decides the code is in ``digest``; numbers and sizes that need not be are in ``tables``.
3. ``values`` gives the same numbers without a compiler.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.decision import Decision
from robodyn_cli.expr.graph import Scalar
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.kernels.arrays import Array
from robodyn_cli.kernels.ir import Function, Int, Value
from robodyn_cli.kernels.lower import Programs
from robodyn_cli.kernels.program import Program, make_program
from robodyn_cli.model.model import STATE_GROUPS
from robodyn_cli.record import record

Groups = Mapping[str, Any]
Numbers = NDArray[np.float64]


class Emission(Protocol):
    """The function that the code of the rates is written into, and memory of the run.

    ``nv`` is a Python int, or an ``Int`` where the code is to serve systems of any size. The functions of
    ``programs`` go into the module too. The function has arguments ``%p`` (parameters), ``%tables`` and ``%scratch``.
    """

    f: Function
    nv: Int | int
    programs: Programs

    def numbers(self, program: Program) -> Array:
        """Return the table of numbers that a program reads."""

    def evaluate(self, program: Program, t: Value, x: Array, **more: list[Value]) -> dict[str, list[Value]]:
        """Emit a program at time t and state x = (q, v, z)."""

    def inside(self, t: Value) -> Value:
        """Return times put inside the stretch between two breakpoints."""

    def workspace(self, name: str, velocities: int, others: int, width: int) -> Array:
        """Return the memory called ``name``: so many vectors per velocity and per further state z; zero at first."""


class Dynamics(Protocol):
    """The rates of a system.

    any_size : the code serves systems of any number of velocities.
    """

    any_size: bool

    @property
    def decision(self) -> Decision | None:
        """Why the rates have another shape than straight-line code."""

    @property
    def program(self) -> Program:
        """The part of the rates that is written as expressions."""

    @property
    def digest(self) -> str:
        """Key of everything that decides the code."""

    @property
    def parameters(self) -> int:
        """How many parameters p are read."""

    def expressions(self) -> tuple[tuple[Scalar, ...], tuple[Scalar, ...]]:
        """Return accelerations and z rates as expressions.

        Raises
        ------
        CapabilityError : there are none to differentiate.
        """

    def memory(self) -> tuple[Numbers, Numbers]:
        """Return tables and scratch memory for the code, possibly empty."""

    def emit(self, w: Emission, t: Value, x: Array, rates: Array) -> None:
        """Emit the rates at time t (lanes) and state x = (q, v, z)."""

    def values(self, groups: Groups) -> Numbers:
        """Return the rates (nv + nz,) at one state, slowly; inputs are arrays (1,), by group.

        Not finite where there are none.
        """


@record
class Expanded:
    """Rates as expressions: straight-line code in which nothing is left that this system does not need."""

    acceleration: tuple[Scalar, ...]
    z_rate: tuple[Scalar, ...] = ()
    any_size = False
    decision = None

    @cached_property
    def program(self) -> Program:
        """Outputs ``a`` (nv) and ``z`` (nz)."""
        outputs = {"a": self.acceleration, "z": self.z_rate}
        return make_program({k: v for k, v in outputs.items() if v}, STATE_GROUPS)

    @property
    def digest(self) -> str:
        return self.program.digest

    @property
    def parameters(self) -> int:
        return self.program.inputs.get("p", 0)

    def expressions(self) -> tuple[tuple[Scalar, ...], tuple[Scalar, ...]]:
        return self.acceleration, self.z_rate

    def memory(self) -> tuple[Numbers, Numbers]:
        return np.zeros(0), np.zeros(0)

    def emit(self, w: Emission, t: Value, x: Array, rates: Array) -> None:
        outputs = w.evaluate(self.program, t, x)
        for k, value in enumerate([*outputs.get("a", []), *outputs.get("z", [])]):
            rates[k] = value

    def values(self, groups: Groups) -> Numbers:
        with np.errstate(all="ignore"):
            values = evaluate([*self.acceleration, *self.z_rate], groups)
        return np.array([np.broadcast_to(x, 1)[0] for x in values])
