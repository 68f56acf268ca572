"""The system that an integrator steps, a = a(t, q, v, z), with its events, corrections and linearisation.

A formulation turns the equations of a mechanism into a ``System``. Integrators know nothing of joints or loops.
"""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.expr.graph import Scalar
from robodyn_cli.formulations.dynamics import Dynamics
from robodyn_cli.formulations.events import REPARTITION, Event, EventFunction, Outcome, Owner
from robodyn_cli.formulations.layout import Layout
from robodyn_cli.kernels.program import Program, make_program
from robodyn_cli.model.model import STATE_GROUPS
from robodyn_cli.record import record

if TYPE_CHECKING:
    from robodyn_cli.formulations.closings import Closings
    from robodyn_cli.formulations.index3 import Index3
    from robodyn_cli.formulations.linearisation import Jacobian
    from robodyn_cli.formulations.residual import Residual
    from robodyn_cli.formulations.updates import Updates


class Partition(ABC):
    """Parameters of the equations that suit a part of the motion only, and are chosen anew at events (re-partition).

    first, count : their places among the parameters p.
    """

    first: int
    count: int

    @property
    @abstractmethod
    def functions(self) -> tuple[EventFunction, ...]:
        """The events at which they are chosen anew."""

    @abstractmethod
    def choose(self, t: float, q: NDArray[Any], before: NDArray[Any] | None) -> NDArray[Any]:
        """Return the parameters (count,) for the motion through (t, q); ``before`` : those in use so far."""

    def handle(self, event: Event) -> Outcome:
        return REPARTITION

    def again(self) -> Partition:
        return self


@record
class Corrections:
    """Corrections that put a state back onto the joints' manifolds and the constraints, after each step and at
    samples.

    position : the mechanism's q corrected once onto the position constraints (one Newton step), or empty.
    velocity : its v corrected onto the velocity constraints, or empty.
    normalisation : the entries at ``normalised`` places of x, put back on their joints' manifolds.
    sample_position, sample_velocity : corrections of samples, where those of steps depend on the partition.
    """

    position: tuple[Scalar, ...] = ()
    velocity: tuple[Scalar, ...] = ()
    normalisation: tuple[Scalar, ...] = ()
    normalised: tuple[int, ...] = ()
    sample_position: tuple[Scalar, ...] = ()
    sample_velocity: tuple[Scalar, ...] = ()

    @property
    def acts(self) -> bool:
        """Whether there are any."""
        return bool(self.position or self.velocity or self.normalisation or self.sample_position)


NO_CORRECTIONS = Corrections()

# cached properties of a System that are the same whatever events it has
EVENT_FREE = (
    "positions",
    "velocities",
    "normal_form",
    "jacobian",
    "linearisation",
    "complex_linearisation",
    "tangents",
    "first_order_step",
)


class Forms(Protocol):
    """The same motion in forms that some methods use instead of the rates."""

    @property
    def index3(self) -> Index3 | None:
        """Positions and multipliers as unknowns."""

    @property
    def residual(self) -> Residual | None:
        """Accelerations as corrections of a guess, None where the equations cannot be written so."""


@record
class System:
    """State x = (q, v, z): q-dot = v, v-dot and z-dot by ``dynamics``, over symbols t, q, v, z, p.

    Here q, v and z are the integrator's. With quasi-velocities (q-dot = N(q) v) they are not those of the mechanism,
    and ``layout`` says where those lie. Integrators ignore the layout; to get positions and velocities of joints, use
    ``split``, ``join`` and ``groups``.

    breakpoints : times at which the right-hand side or its slope jumps; steps end there.
    parameters : values of p that a run starts with, but for those that the ``partition`` chooses.
    work_done_by : what does the work whose rate is among the z-dot; none where that is not integrated.
    layout : None where q, v, z are the mechanism's.
    forms : the same motion in forms that some methods use instead of the rates. updates : of states that are constant
    but for known instants, the first of z. closings : of latches, which compiled code makes. numbers : gives those of
    another scene of this structure that programs read, one after another; None: they read their own.
    is_rounded : whether rounding puts rates off by more than is usual, so that it is measured on the way.
    """

    nq: int
    nv: int
    dynamics: Dynamics
    nz: int = 0
    corrections: Corrections = NO_CORRECTIONS
    events: tuple[EventFunction, ...] = ()
    breakpoints: tuple[float, ...] = ()
    parameters: tuple[float, ...] = ()
    partition: Partition | None = None
    work_done_by: tuple[str, ...] = ()
    layout: Layout | None = None
    forms: Forms | None = None
    updates: Updates | None = None
    closings: Closings | None = None
    numbers: Callable[[Sequence[Program]], NDArray[Any]] | None = None
    is_rounded: bool = False

    @property
    def size(self) -> int:
        """Length of the state vector."""
        return self.nq + self.nv + self.nz

    # -- the mechanism's coordinates --------------------------------------------------------------------
    @property
    def q_places(self) -> Sequence[int]:
        """Places in x of the mechanism's q."""
        return range(self.nq) if self.layout is None else self.layout.q

    @property
    def v_places(self) -> Sequence[int]:
        """Places in x of the mechanism's v."""
        return range(self.nq, self.nq + self.nv) if self.layout is None else self.layout.v

    @property
    def further(self) -> int:
        """How many states there are beside the mechanism's q and v."""
        return self.nz if self.layout is None else len(self.layout.z)

    @property
    def work_place(self) -> int | None:
        """Place in x of the work, the last of the further states; None where it is not integrated."""
        return self.size - 1 if self.work_done_by else None

    def split(self, x: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
        """Return the mechanism's q, v and z of states x (..., nx)."""
        if self.layout is None:
            end = self.nq + self.nv
            return x[..., : self.nq], x[..., self.nq : end], x[..., end:]
        q, v, z = (x[..., list(places)] for places in (self.layout.q, self.layout.v, self.layout.z))
        return q, v, z

    def join(self, q: NDArray[Any], v: NDArray[Any], z: NDArray[Any] | None = None) -> NDArray[np.float64]:
        """Return the state x (nx,) from the mechanism's q and v; z is zero where it is not given."""
        x = np.zeros(self.size)
        x[list(self.q_places)], x[list(self.v_places)] = q, v
        if z is not None:
            x[self.size - self.further :] = z
        return x

    def groups(self, t: Any, x: NDArray[Any], p: NDArray[Any]) -> dict[str, Any]:
        """Return the inputs of kernels of the mechanism's expressions at times t (T,) and states x (T, nx)."""
        q, v, z = self.split(x)
        return {"t": t, "q": q, "v": v, "z": z, "p": p}

    def own_groups(self, t: Any, x: NDArray[Any], p: NDArray[Any]) -> dict[str, Any]:
        """Return the inputs of kernels of this system's own expressions (events, corrections); as ``groups``."""
        q, v, z = np.split(x, [self.nq, self.nq + self.nv], axis=-1)
        return {"t": t, "q": q, "v": v, "z": z, "p": p}

    def parameters_at(
        self, t: float, q: NDArray[Any], given: NDArray[Any] | None = None
    ) -> NDArray[np.float64]:
        """Return the parameters p at q (nq,): those given, by default of a start, and what the partition chooses."""
        own = np.array(self.parameters if given is None else given, dtype=float)
        if self.partition is not None:
            own = np.append(own, self.partition.choose(t, q, None))
        return own if len(own) else np.zeros(1)

    def at(self, t: float, x: NDArray[Any], p: NDArray[Any]) -> dict[str, Any]:
        """Return the inputs of kernels at one state (nx,), with these parameters beside those of the partition."""
        return self.groups(np.array([[t]]), x[None, :], self.parameters_at(t, self.split(x)[0], p))

    def watched_by(self, owner_of: Callable[[EventFunction], Owner | None], every: bool = False) -> System:
        """Return the system with other owners of its events, without those that ``owner_of`` gives none for.

        every : those stay, too: steps end at them, and the compiled code is that of this system.
        """
        owners = [(e, owner_of(e)) for e in self.events]
        events = tuple(
            dataclasses.replace(e, owner=owner) for e, owner in owners if every or owner is not None
        )
        system = dataclasses.replace(self, events=events)
        # what is built already and does not depend on the events
        kept = EVENT_FREE if len(events) < len(self.events) else (*EVENT_FREE, "switching")
        vars(system).update({name: vars(self)[name] for name in kept if name in vars(self)})
        return system

    def with_numbers(self, numbers: Callable[[Sequence[Program]], NDArray[Any]]) -> System:
        """Return the system with the numbers of another scene of this structure."""
        system = dataclasses.replace(self, numbers=numbers)
        vars(system).update({name: value for name, value in vars(self).items() if name not in vars(system)})
        return system

    # -- programs -------------------------------------------------------------------------------------
    @property
    def acceleration(self) -> tuple[Scalar, ...]:
        """v-dot as expressions, where there are such."""
        return self.dynamics.expressions()[0]

    @property
    def z_rate(self) -> tuple[Scalar, ...]:
        """z-dot as expressions, where there are such."""
        return self.dynamics.expressions()[1]

    @property
    def rates(self) -> list[Scalar]:
        """v-dot, then z-dot, as expressions, where there are such."""
        return [*self.acceleration, *self.z_rate]

    @cached_property
    def positions(self) -> Program | None:
        """Output ``q``: the corrected positions, at ``q_places``."""
        corrected = self.corrections.position
        return _program(q=corrected) if corrected else None

    @cached_property
    def velocities(self) -> Program | None:
        """Output ``v``: the corrected velocities, at ``v_places``."""
        corrected = self.corrections.velocity
        return _program(v=corrected) if corrected else None

    @cached_property
    def normal_form(self) -> Program | None:
        """Output ``n``: the entries at ``corrections.normalised`` places, on their manifolds."""
        normalised = self.corrections.normalisation
        return _program(n=normalised) if normalised else None

    @cached_property
    def switching(self) -> Program | None:
        """Output ``g``: the event functions."""
        return _program(g=tuple(e.value for e in self.events)) if self.events else None

    @cached_property
    def jacobian(self) -> Jacobian:
        """The exact Jacobian of x-dot by x and t."""
        from robodyn_cli.formulations.linearisation import differentiate

        return differentiate(self.rates, self.nq, self.nv)

    @cached_property
    def linearisation(self) -> Program:
        """The factors that a linearly implicit method needs: see ``real_factors``."""
        from robodyn_cli.formulations.linearisation import real_factors

        return real_factors(self.jacobian)

    @cached_property
    def complex_linearisation(self) -> Program:
        """The same for complex g: see ``complex_factors``."""
        from robodyn_cli.formulations.linearisation import complex_factors

        return complex_factors(self.jacobian)

    @property
    def in_columns(self) -> bool:
        """Whether implicit methods take the Jacobian in columns (``tangents``), the system being large."""
        from robodyn_cli.formulations.linearisation import LARGE

        return self.size * self.dynamics.program.operations > LARGE

    @cached_property
    def tangents(self) -> Program:
        """The change of the rates along a direction: see ``tangents`` of ``linearisation``."""
        from robodyn_cli.formulations.linearisation import tangents

        return tangents(self.rates, self.nq, self.nv)

    @cached_property
    def first_order_step(self) -> Program:
        """A step of Newton's iteration for the rates: see ``first_order_step`` of ``index3``."""
        from robodyn_cli.formulations.index3 import first_order_step

        return first_order_step(self.rates, self.nv)

    @property
    def programs(self) -> dict[str, Program]:
        """The programs of the stepping loop beside the rates, by what they are for."""
        programs = {
            "positions back on the joints' manifolds": self.normal_form,
            "projection of positions": self.positions,
            "projection of velocities": self.velocities,
            "events": self.switching,
        }
        if self.updates is not None:
            names = ("controller at its samples", "delayed torques")
            programs |= dict(zip(names, self.updates.programs))
        if self.closings is not None:
            programs["latches that close"] = self.closings.program
        return {name: program for name, program in programs.items() if program is not None}

    @property
    def index3(self) -> Index3 | None:
        """The same motion as equations with multipliers, where there are such."""
        return None if self.forms is None else self.forms.index3

    @property
    def residual(self) -> Residual | None:
        """The same rates as corrections of a guess, where there are such."""
        return None if self.forms is None else self.forms.residual

    @property
    def digest(self) -> str:
        """Key of everything that decides the compiled code."""
        parts = [self.dynamics, self.positions, self.velocities, self.switching]
        size = "any" if self.dynamics.any_size else f"{self.nq} {self.nv}"
        code = ["-" if p is None else p.digest for p in parts]
        if self.layout is not None:
            code += [
                self.normal_form.digest if self.normal_form else "-",
                str(self.layout),
                str(self.corrections.normalised),
            ]
        if self.updates is not None:
            code.append(self.updates.digest)
        events = [f"{e.direction}{'j' * e.is_discontinuity}" for e in self.events]
        if self.closings is not None:
            code.append(self.closings.digest)
            events = [f"{text}{e.closing}" for text, e in zip(events, self.events)]
        measured = ["rounded"] if self.is_rounded else []
        return " ".join([size, str(self.nz), *code, *events, *measured])


def _program(**outputs: Sequence[Scalar]) -> Program:
    return make_program({k: v for k, v in outputs.items() if v}, STATE_GROUPS)
