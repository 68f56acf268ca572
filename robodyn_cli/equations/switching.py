"""Where the equations of a scene switch: with the state (events), or at known times (breakpoints)."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol

from robodyn_cli.equations.discontinuities import is_of_time, switches, switching_times
from robodyn_cli.expr.graph import Expr, Scalar
from robodyn_cli.scene import types as sc
from robodyn_cli.trajectories.led import followed_by, given_by_formulas

if TYPE_CHECKING:
    from robodyn_cli.equations.constraints import Constraints
    from robodyn_cli.equations.control.control import Control
    from robodyn_cli.equations.elements import Elements, JointForces
    from robodyn_cli.equations.time_structure import TimeStructure
    from robodyn_cli.model.model import Model


class Equations(Protocol):
    """The equations that this module reads (satisfied by ``Problem``)."""

    scene: sc.Scene
    model: Model
    t: Expr

    control: Control | None

    @property
    def environment(self) -> dict[str, Any]: ...
    @property
    def constraints(self) -> Constraints: ...
    @property
    def elements(self) -> Elements: ...
    @property
    def forces_in_joints(self) -> JointForces: ...
    def gear_losses(self, smooth: bool) -> dict[int, Any]: ...


class Switching:
    """The discontinuities of a scene's equations, each part found when it is first used."""

    def __init__(self, equations: Equations) -> None:
        self.equations = equations

    @cached_property
    def formulas(self) -> list[tuple[str, list[Scalar]]]:
        """Values of the scene's formulas in the equations, with the key of each."""
        e = self.equations
        pairs: list[tuple[str, list[Scalar]]] = []
        for name, torque in e.scene.torques.items():
            if not _tabulated(torque):
                pairs.append((f"torques.{name}", [torque.evaluate(e.environment)]))
        known: set[str] = set()
        if e.scene.prescribed:
            from robodyn_cli.equations.prescribed import attitude_functions

            prescribed = e.scene.prescribed
            given = prescribed if self.followed is None else given_by_formulas(prescribed)
            attitudes = attitude_functions(given, e.scene.parameters, e.t)
            pairs += attitudes.items()
            names = [e.constraints.rows[i].name for i in e.constraints.prescribed]
            formulas = {f"prescribed.{name}" for name in given}
            known = {x for x in names if x not in formulas or x.rpartition(".")[0] in attitudes}
        rows = [e.constraints.rows[i] for i in e.constraints.rheonomic]
        for row in (row for row in rows if row.name not in known):
            pairs.append((row.name, [row.eta, row.eta_t, row.gamma]))
        if e.model.forces:
            pairs += [(key, [*place, *rate]) for key, place, rate in e.elements.moving]
            pairs += e.elements.formulas
        return pairs

    @property
    def followed(self) -> tuple[float, ...] | None:
        """Times at which the trajectory that prescribed joints follow is not smooth, where it knows them itself."""
        followed = followed_by(self.equations.scene.prescribed)
        return None if followed is None else followed.breakpoints

    @cached_property
    def switches(self) -> list[tuple[str, Expr]]:
        """Expressions at whose sign changes the equations switch, with their keys (see ``discontinuities``)."""
        e = self.equations
        gears = [("gear", [torque]) for torque in e.gear_losses(smooth=True).values()]
        of_formulas = [
            (key, switch) for key, entries in [*self.formulas, *gears] for switch in switches(entries)
        ]
        own = [] if e.control is None else e.control.switches
        return [*of_formulas, *own, *e.forces_in_joints.switches()]

    @property
    def with_state(self) -> list[tuple[str, Expr]]:
        """Those of ``switches`` that depend on more than time."""
        return [(key, switch) for key, switch in self.switches if not is_of_time(switch, self.equations.t)]

    @cached_property
    def time_structures(self) -> list[tuple[str, TimeStructure]]:
        """Where the scene's formulas of time are not smooth or have short features, with the key of each."""
        if not self.formulas:
            return []
        from robodyn_cli.equations.time_structure import functions_of_time, structure

        t, duration = self.equations.t, self.equations.scene.simulate.duration
        return [
            (key, structure(function, t, duration))
            for key, entries in self.formulas
            for function in functions_of_time(entries, t)
        ]

    @cached_property
    def of_time(self) -> list[tuple[str, Expr]]:
        """Functions of time alone in formulas, whose times steps end at, with the key of each."""
        if not self.formulas:
            return []
        from robodyn_cli.equations.time_structure import functions_of_time

        t = self.equations.t
        functions = [(key, f) for key, entries in self.formulas for f in functions_of_time(entries, t)]
        return [*functions, *((key, switch) for key, switch in self.switches if is_of_time(switch, t))]

    @cached_property
    def tabled(self) -> set[float]:
        """Times at which tables, trajectories and controllers are not smooth."""
        e = self.equations
        times = {
            float(row[0]) for torque in e.scene.torques.values() if _tabulated(torque) for row in torque.table
        }
        if e.model.forces:
            times |= e.elements.breakpoints
        if e.scene.prescribed:
            times.update(self.followed or ())
        if e.control is not None:
            times.update(x for x in e.control.breakpoints if 0.0 < x < e.scene.simulate.duration)
        return times

    @cached_property
    def breakpoints(self) -> tuple[float, ...]:
        """Times at which a step has to end: tables and formulas of time switch there, or change their time scale."""
        t, duration = self.equations.t, self.equations.scene.simulate.duration
        times = set(self.tabled)
        for _, switch in self.switches:
            if is_of_time(switch, t):
                times.update(switching_times(switch, t, duration))
        if self.time_structures:
            from robodyn_cli.equations.time_structure import beside

            times.update(*(beside(structure, times, duration) for _, structure in self.time_structures))
        return tuple(sorted(times))


def _tabulated(torque: Any) -> bool:
    """Tell whether a torque of the scene is a table."""
    return isinstance(torque, sc.Torque) and torque.table is not None
