"""What an integrator steps: the second-order system a = a(t, q, v, z), with everything it may ask for.

A formulation turns the equations of a mechanism into a ``System``. Integrators know nothing of joints or loops.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import cached_property

from robodyn_cli.expr.graph import Scalar
from robodyn_cli.formulations.dynamics import GROUPS as GROUPS
from robodyn_cli.formulations.dynamics import Dynamics
from robodyn_cli.formulations.linearisation import complex_factors, real_factors
from robodyn_cli.kernels.program import Program, make_program


@dataclasses.dataclass(frozen=True)
class EventFunction:
    """A scalar whose sign change is an event.

    direction : +1 for rising, -1 for falling, 0 for both. terminal : whether the run ends there.
    kink : the right-hand side is not smooth there; nothing happens but that a step ends.
    """

    name: str
    value: Scalar
    direction: int = 0
    terminal: bool = True
    kink: bool = False


@dataclasses.dataclass(frozen=True)
class System:
    """State x = (q, v, z): q-dot = v, v-dot and z-dot by ``dynamics``, over symbols t, q, v, z, p.

    position_correction : q corrected once onto the position constraints (one Newton step), or empty.
    velocity_correction : v corrected onto the velocity constraints, or empty.
    breakpoints : times at which the right-hand side has a kink; steps end there.
    """

    nq: int
    nv: int
    dynamics: Dynamics
    nz: int = 0
    position_correction: tuple[Scalar, ...] = ()
    velocity_correction: tuple[Scalar, ...] = ()
    events: tuple[EventFunction, ...] = ()
    breakpoints: tuple[float, ...] = ()

    @property
    def size(self) -> int:
        """Length of the state vector."""
        return self.nq + self.nv + self.nz

    @property
    def acceleration(self) -> tuple[Scalar, ...]:
        """v-dot as expressions, where there are such."""
        return self.dynamics.expressions()[0]

    @property
    def z_rate(self) -> tuple[Scalar, ...]:
        """z-dot as expressions, where there are such."""
        return self.dynamics.expressions()[1]

    @cached_property
    def positions(self) -> Program | None:
        """Output ``q`` (nq): the corrected positions."""
        return _program(q=self.position_correction) if self.position_correction else None

    @cached_property
    def velocities(self) -> Program | None:
        """Output ``v`` (nv): the corrected velocities."""
        return _program(v=self.velocity_correction) if self.velocity_correction else None

    @cached_property
    def switching(self) -> Program | None:
        """Output ``g``: the event functions."""
        return _program(g=tuple(e.value for e in self.events)) if self.events else None

    @cached_property
    def linearisation(self) -> Program:
        """What a linearly implicit method needs at a point: see ``real_factors``."""
        return real_factors(self)

    @cached_property
    def complex_linearisation(self) -> Program:
        """The same for complex g: see ``complex_factors``."""
        return complex_factors(self)

    @property
    def digest(self) -> str:
        """Key of everything that decides the compiled code."""
        parts = [self.dynamics, self.positions, self.velocities, self.switching]
        size = "any" if self.dynamics.any_size else f"{self.nq} {self.nv}"
        code = ["-" if p is None else p.digest for p in parts]
        return " ".join([size, str(self.nz), *code, *(str(e.direction) for e in self.events)])


def _program(**outputs: Sequence[Scalar]) -> Program:
    return make_program({k: v for k, v in outputs.items() if v}, GROUPS)
