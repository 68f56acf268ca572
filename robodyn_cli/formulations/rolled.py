"""The rates of a long open tree, by loops over its bodies."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from robodyn_cli.algorithms.aba import aba
from robodyn_cli.decision import RATES, Decision
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError
from robodyn_cli.expr.graph import Scalar, is_nonzero
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.formulations.dynamics import Emission, Groups, Numbers
from robodyn_cli.formulations.index1 import Formulated
from robodyn_cli.kernels.arrays import Array
from robodyn_cli.kernels.ir import RELAXED, Function, Value
from robodyn_cli.kernels.lower import LANES, lower
from robodyn_cli.kernels.program import NUMBERS, Program, make_program
from robodyn_cli.kernels.rolled.kernels import RolledPlan
from robodyn_cli.kernels.rolled.loops import rolled_function, tree_function
from robodyn_cli.model.model import STATE_GROUPS, Model


class Rolled:
    """Rates of an open tree by loops over its bodies; only the forces on the joints are expressions.

    Parameters
    ----------
    forces : on the joints (nv,), as expressions of t, q, v, z, p.

    Raises
    ------
    CapabilityError : see ``RolledPlan``.
    """

    any_size = True
    shape = "loops over the bodies"

    def __init__(self, model: Model, forces: Sequence[Scalar], z_rate: Sequence[Scalar] = ()) -> None:
        self.model = model
        self.plan = RolledPlan(model, "forward")
        self.forces = tuple(forces)
        self.z_rate = tuple(z_rate)
        # joints without a force are left out, so that free chains of any length share their code
        self.places = tuple(k for k, x in enumerate(self.forces) if is_nonzero(x))

    @cached_property
    def program(self) -> Program:
        """Outputs ``f``, the forces at ``places``, and ``z``."""
        return make_program({"f": [self.forces[k] for k in self.places], "z": self.z_rate}, STATE_GROUPS)

    @property
    def digest(self) -> str:
        return f"rolled {self.plan.digest} {self.places} {self.program.digest}"

    @property
    def parameters(self) -> int:
        return self.program.inputs.get("p", 0)

    @property
    def inputs(self) -> dict[str, int]:
        """Sizes of what is read."""
        return {"q": self.plan.nq, "v": self.plan.nv, **self.program.inputs}

    @property
    def sizes(self) -> dict[str, int]:
        """Sizes of the outputs."""
        return {"a": self.plan.nv, **({"z": len(self.z_rate)} if self.z_rate else {})}

    @property
    def numbers(self) -> tuple[Scalar, ...]:
        """Numbers of the scene that are read."""
        return (*self.plan.numbers, *self.program.numbers)

    @property
    def operations(self) -> int:
        """Operations of one evaluation."""
        return self.plan.operations + self.program.operations

    @property
    def decision(self) -> Decision:
        """Why the rates go by loops."""
        reason = f"{self.model.nv} joints: straight-line code would take longer to compile than to run"
        return Decision(RATES, self.shape, reason, {self.shape: self.operations})

    def expressions(self) -> tuple[tuple[Scalar, ...], tuple[Scalar, ...]]:
        raise CapabilityError(
            f"a chain of {self.model.nv} joints is integrated by loops over its bodies, which have no exact "
            "Jacobian, so methods that solve with one, such as 'rodas5p', 'radau' and 'bdf', are not for it; "
            "allowed: gauss (of any order), dop853, dopri5, rk4, implicit_midpoint",
            key="simulate.integrator",
        )

    def memory(self) -> tuple[Numbers, Numbers]:
        return self.plan.tables, self.plan.scratch(LANES)

    def emit(self, w: Emission, t: Value, x: Array, rates: Array) -> None:
        f, width, functions = w.f, x.width, w.programs.functions
        forces = w.workspace(f"forces.{width}", 1, 0, width)
        v, z = x.part(w.nv), x.part(w.nv * 2)
        if self.places or self.z_rate:
            name = f"forces.{width}"
            if name not in functions:
                functions[name] = self._force_function(name, width, w.programs.fused)
            time = f.slot(width)
            f.store(f.splat(w.inside(t), width), time, 8 * width)
            numbers = w.numbers(self.program).base
            arguments = (time, x.base, v.base, z.base, "%p", numbers, forces.base, rates.part(w.nv).base)
            f.raw(f"call void @{name}({', '.join(f'ptr {a}' for a in arguments)})")
        name = f"forward.{width}"
        if name not in functions:
            tree_code = tree_function(name, internal=True, attributes="noinline")
            functions[name] = rolled_function(
                tree_code, self.plan.recursion, self.plan.serial, width, w.programs.fused
            )
        tree = ("%tables", x.base, v.base, forces.base, rates.base, "%scratch")
        f.raw(f"call void @{name}({', '.join(f'ptr {a}' for a in tree)})")

    def _force_function(self, name: str, width: int, fused: bool) -> Function:
        """Return ``name(t, q, v, z, p, numbers, f, r)``: forces at their joints, and the rates of z."""
        arguments = [f"ptr noalias %{a}" for a in (*STATE_GROUPS, NUMBERS, "f", "r")]
        f = Function(name, arguments, internal=True, attributes="noinline", flags=RELAXED)
        used = {i.value for i in self.program.instructions if i.op == "sym"}
        zero = f.constant(0.0, width)
        inputs: dict[str, list[Value] | Array] = {NUMBERS: Array(f, f"%{NUMBERS}")}
        for group, count in self.program.inputs.items():
            row = Array(f, f"%{group}", 1 if group == "p" else width)
            inputs[group] = [row[k] if (group, k) in used else zero for k in range(count)]
        values = lower(f, self.program, inputs, width, fused)
        forces, rates = Array(f, "%f", width), Array(f, "%r", width)
        for k, value in zip(self.places, values["f"]):
            forces[k] = value
        for k, value in enumerate(values["z"]):
            rates[k] = value
        f.ret()
        return f

    def values(self, groups: Groups) -> Numbers:
        with np.errstate(all="ignore"):
            entries = evaluate([*self.forces, *self.z_rate], groups)
        numbers = [float(np.broadcast_to(x, 1)[0]) for x in entries]
        nv = self.model.nv
        q, v = ([float(x[0]) for x in groups[name]] for name in "qv")
        try:
            a = aba(self.model, q, v, numbers[:nv], self.model.gravity)
        except ArithmeticError:
            return np.full(len(numbers), np.nan)
        return np.array([*(float(x) for x in a), *numbers[nv:]])


def rolled(problem: Problem, z_rate: Sequence[Scalar], asked: object = None) -> Formulated:
    """Return the equations of a long open tree, by loops over its bodies."""
    return Formulated(Rolled(problem.rigid, list(problem.applied), z_rate))
