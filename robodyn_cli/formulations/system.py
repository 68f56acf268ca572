"""What an integrator steps: the second-order system a = a(t, q, v, z), with everything it may ask for.

A formulation turns the equations of a mechanism into a ``System``. Integrators know nothing of joints or loops.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.expr.graph import Scalar
from robodyn_cli.formulations.dynamics import GROUPS as GROUPS
from robodyn_cli.formulations.dynamics import Dynamics
from robodyn_cli.formulations.layout import Layout
from robodyn_cli.kernels.program import Program, make_program
from robodyn_cli.record import record

if TYPE_CHECKING:
    from robodyn_cli.formulations.index3 import Index3
    from robodyn_cli.formulations.residual import Residual


@record
class EventFunction:
    """A scalar whose sign change is an event.

    direction : +1 for rising, -1 for falling, 0 for both. terminal : whether the run ends there.
    kink : the right-hand side is not smooth there; nothing happens but that a step ends.
    renewal : the system's chart is chosen anew there.
    mode : a joint is held or let go there, by whoever drives the run.
    """

    name: str
    value: Scalar
    direction: int = 0
    terminal: bool = True
    kink: bool = False
    renewal: bool = False
    mode: bool = False


class Chart(Protocol):
    """Parameters of the equations that fit a part of the motion only, and are chosen anew where they fit no more.

    first, count : their places among the parameters p.
    """

    first: int
    count: int

    def choose(self, t: float, q: NDArray[Any], before: NDArray[Any] | None) -> NDArray[Any]:
        """Return the parameters (count,) for the motion through (t, q); ``before`` : those in use so far."""


@record
class System:
    """State x = (q, v, z): q-dot = v, v-dot and z-dot by ``dynamics``, over symbols t, q, v, z, p.

    Here q, v and z are the integrator's. Where a joint has quasi-velocities (q-dot = N(q) v) they are not those of
    the mechanism, and ``layout`` says where those lie: integrators need not look at it, whoever wants positions and
    velocities of joints takes ``split``, ``join`` and ``groups``.

    position_correction : the mechanism's q corrected once onto the position constraints (one Newton step), or empty.
    velocity_correction : its v corrected onto the velocity constraints, or empty.
    normalisation : the entries at ``normalised`` places of x, put back on their joints' manifolds.
    breakpoints : times at which the right-hand side has a kink; steps end there.
    parameters : values of p that a run starts with.
    layout : None where q, v, z are the mechanism's.
    chart : chooses some of the parameters, at the start and at events that are renewals.
    sample_positions, sample_velocities : corrections of samples, where those of steps depend on the chart.
    index3 : the same motion as equations with multipliers, where there are such; built when asked for.
    residual : the same rates as corrections of a guess, where there are such; built when asked for.
    """

    nq: int
    nv: int
    dynamics: Dynamics
    nz: int = 0
    position_correction: tuple[Scalar, ...] = ()
    velocity_correction: tuple[Scalar, ...] = ()
    events: tuple[EventFunction, ...] = ()
    breakpoints: tuple[float, ...] = ()
    parameters: tuple[float, ...] = ()
    layout: Layout | None = None
    normalisation: tuple[Scalar, ...] = ()
    normalised: tuple[int, ...] = ()
    chart: Chart | None = None
    sample_positions: tuple[Scalar, ...] = ()
    sample_velocities: tuple[Scalar, ...] = ()
    index3: Index3 | None = None
    residual: Residual | None = None

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

    def split(self, x: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
        """Return the mechanism's q, v and z of states x (..., nx)."""
        if self.layout is None:
            return np.split(x, [self.nq, self.nq + self.nv], axis=-1)  # type: ignore[return-value]
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
        """Return what kernels of the mechanism's expressions take at times t (T,) and states x (T, nx)."""
        q, v, z = self.split(x)
        return {"t": t, "q": q, "v": v, "z": z, "p": p}

    def own_groups(self, t: Any, x: NDArray[Any], p: NDArray[Any]) -> dict[str, Any]:
        """Return what kernels of this system's own expressions (events, corrections) take; as ``groups``."""
        q, v, z = np.split(x, [self.nq, self.nq + self.nv], axis=-1)
        return {"t": t, "q": q, "v": v, "z": z, "p": p}

    # -- programs -------------------------------------------------------------------------------------
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
        """Output ``q``: the corrected positions, at ``q_places``."""
        return _program(q=self.position_correction) if self.position_correction else None

    @cached_property
    def velocities(self) -> Program | None:
        """Output ``v``: the corrected velocities, at ``v_places``."""
        return _program(v=self.velocity_correction) if self.velocity_correction else None

    @cached_property
    def normal_form(self) -> Program | None:
        """Output ``n``: the entries at ``normalised`` places, on their manifolds."""
        return _program(n=self.normalisation) if self.normalisation else None

    @cached_property
    def switching(self) -> Program | None:
        """Output ``g``: the event functions."""
        return _program(g=tuple(e.value for e in self.events)) if self.events else None

    @cached_property
    def linearisation(self) -> Program:
        """What a linearly implicit method needs at a point: see ``real_factors``."""
        from robodyn_cli.formulations.linearisation import real_factors

        return real_factors(self)

    @cached_property
    def complex_linearisation(self) -> Program:
        """The same for complex g: see ``complex_factors``."""
        from robodyn_cli.formulations.linearisation import complex_factors

        return complex_factors(self)

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
                str(self.normalised),
            ]
        return " ".join([size, str(self.nz), *code, *(str(e.direction) for e in self.events)])


def _program(**outputs: Sequence[Scalar]) -> Program:
    return make_program({k: v for k, v in outputs.items() if v}, GROUPS)
