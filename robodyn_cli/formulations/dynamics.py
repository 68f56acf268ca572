"""The rates of a system in two shapes: one expression graph, or loops over the bodies of a long tree.

    v-dot = a(t, q, v, z, p),  z-dot = r(t, q, v, z, p)

Checklist for another shape:

1. ``emit`` stores the nv accelerations, then the nz rates of z, for as many states as there are lanes.
2. Everything that decides the code is in ``digest``; numbers and sizes that need not be are in ``tables``.
3. ``values`` gives the same numbers without a compiler.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.algorithms.aba import aba
from robodyn_cli.errors import CapabilityError
from robodyn_cli.expr.graph import Expr, Scalar
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.kernels.arrays import Array
from robodyn_cli.kernels.ir import RELAXED, Function, Int, Value
from robodyn_cli.kernels.lower import lower
from robodyn_cli.kernels.program import Program, make_program
from robodyn_cli.kernels.rolled_loops import rolled_function
from robodyn_cli.kernels.rolled_tables import RolledPlan
from robodyn_cli.model.model import Model
from robodyn_cli.record import record

GROUPS = ("t", "q", "v", "z", "p")
LANES = 8  # the most that an integrator evaluates at once
Groups = Mapping[str, Any]
Numbers = NDArray[np.float64]


class Emission(Protocol):
    """What code that evaluates rates is written into: the function, and memory of the run.

    ``nv`` is a Python int, or an ``Int`` where the code is to serve systems of any size. ``functions`` go into
    the module too. The function has arguments ``%p`` (parameters), ``%tables`` and ``%scratch``.
    """

    f: Function
    fused: bool
    nv: Int | int
    functions: dict[str, Function]

    def evaluate(self, program: Program, t: Value, x: Array, **more: list[Value]) -> dict[str, list[Value]]:
        """Emit a program at time t and state x = (q, v, z)."""

    def workspace(self, name: str, velocities: int, others: int, width: int) -> Array:
        """Return the memory called ``name``: so many vectors a velocity, and a further state z; zero at first."""


class Dynamics(Protocol):
    """The rates of a system. ``any_size``: the code serves systems of any number of velocities."""

    any_size: bool

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

    @cached_property
    def program(self) -> Program:
        """Outputs ``a`` (nv) and ``z`` (nz)."""
        outputs = {"a": self.acceleration, "z": self.z_rate}
        return make_program({k: v for k, v in outputs.items() if v}, GROUPS)

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
        found = w.evaluate(self.program, t, x)
        for k, value in enumerate([*found.get("a", []), *found.get("z", [])]):
            rates[k] = value

    def values(self, groups: Groups) -> Numbers:
        with np.errstate(all="ignore"):
            found = evaluate([*self.acceleration, *self.z_rate], groups)
        return np.array([np.broadcast_to(x, 1)[0] for x in found])


class Rolled:
    """Rates of an open tree by loops over its bodies; only the forces on the joints are expressions.

    Parameters
    ----------
    forces : what acts on the joints (nv,), as expressions of t, q, v, z, p.

    Raises
    ------
    CapabilityError : see ``RolledPlan``.
    """

    any_size = True

    def __init__(self, model: Model, forces: Sequence[Scalar], z_rate: Sequence[Scalar] = ()) -> None:
        self.model = model
        self.plan = RolledPlan(model, "forward")
        self.forces = tuple(forces)
        self.z_rate = tuple(z_rate)
        # joints that nothing acts on are left out, so that free chains of any length share their code
        self.places = tuple(k for k, x in enumerate(self.forces) if isinstance(x, Expr) or x != 0.0)

    @cached_property
    def program(self) -> Program:
        """Outputs ``f``, the forces at ``places``, and ``z``."""
        return make_program({"f": [self.forces[k] for k in self.places], "z": self.z_rate}, GROUPS)

    @property
    def digest(self) -> str:
        return f"rolled {self.plan.digest} {self.places} {self.program.digest}"

    @property
    def parameters(self) -> int:
        return self.program.inputs.get("p", 0)

    @property
    def operations(self) -> int:
        """Operations of one evaluation."""
        return self.plan.bodies * self.plan.recursion.operations + self.program.operations

    def expressions(self) -> tuple[tuple[Scalar, ...], tuple[Scalar, ...]]:
        raise CapabilityError(
            f"a chain of {self.model.nv} joints is integrated by loops over its bodies, which have no exact "
            "Jacobian, so methods that solve with one, such as 'rodas5p', 'radau' and 'bdf', are not for it; "
            "allowed: gauss (of any order), dop853, dopri5, rk4, implicit_midpoint"
        )

    def memory(self) -> tuple[Numbers, Numbers]:
        return self.plan.tables, self.plan.scratch(LANES)

    def emit(self, w: Emission, t: Value, x: Array, rates: Array) -> None:
        f, width = w.f, x.width
        forces = w.workspace(f"forces.{width}", 1, 0, width)
        v, z = x.part(w.nv), x.part(w.nv * 2)
        if self.places or self.z_rate:
            name = f"forces.{width}"
            if name not in w.functions:
                w.functions[name] = self._force_function(name, width, w.fused)
            time = f.slot(width)
            f.store(f.splat(t, width), time, 8 * width)
            arguments = (time, x.base, v.base, z.base, "%p", forces.base, rates.part(w.nv).base)
            f.raw(f"call void @{name}({', '.join(f'ptr {a}' for a in arguments)})")
        name = f"forward.{width}"
        if name not in w.functions:
            w.functions[name] = rolled_function(
                name, self.plan.recursion, self.plan.serial, width, w.fused, attributes="noinline"
            )
        tree = ("%tables", x.base, v.base, forces.base, rates.base, "%scratch")
        f.raw(f"call void @{name}({', '.join(f'ptr {a}' for a in tree)})")

    def _force_function(self, name: str, width: int, fused: bool) -> Function:
        """Return ``name(t, q, v, z, p, f, r)``: forces at their joints, and the rates of z."""
        arguments = [f"ptr noalias %{a}" for a in (*GROUPS, "f", "r")]
        f = Function(name, arguments, internal=True, attributes="noinline", flags=RELAXED)
        used = {i.value for i in self.program.instructions if i.op == "sym"}
        zero = f.constant(0.0, width)
        inputs: dict[str, list[Value]] = {}
        for group, count in self.program.inputs.items():
            row = Array(f, f"%{group}", 1 if group == "p" else width)
            inputs[group] = [row[k] if (group, k) in used else zero for k in range(count)]
        found = lower(f, self.program, inputs, width, fused)
        forces, rates = Array(f, "%f", width), Array(f, "%r", width)
        for k, value in zip(self.places, found["f"]):
            forces[k] = value
        for k, value in enumerate(found["z"]):
            rates[k] = value
        f.ret()
        return f

    def values(self, groups: Groups) -> Numbers:
        with np.errstate(all="ignore"):
            found = evaluate([*self.forces, *self.z_rate], groups)
        numbers = [float(np.broadcast_to(x, 1)[0]) for x in found]
        nv = self.model.nv
        q, v = ([float(x[0]) for x in groups[name]] for name in "qv")
        try:
            a = aba(self.model, q, v, numbers[:nv], self.model.gravity)
        except ArithmeticError:
            return np.full(len(numbers), np.nan)
        return np.array([*(float(x) for x in a), *numbers[nv:]])
