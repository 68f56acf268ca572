"""What a method of integration supplies: what it is, and the code of its steps and of its dense output.

A ``Method`` says what it is and what it asks of a system; its ``Stepper`` writes code for one system. Coefficients are
data. To add a method, write one file and one line in ``robodyn_cli/integration_methods.py``. Checklist:

1. ``attempt`` emits one step, leaves the new state in ``w.new`` and returns the error as it is, with NaN as NaN; how
   large the next step is to be follows from it in ``control``. What dense output needs of the step is handed on as a
   value (``StepAttempt.kept``). ``begin`` comes before it where the start of a step says how long it may be.
2. ``save_dense`` stores what dense output needs in ``%dense``; ``dense`` evaluates it at u in [-1, 0], where 0 is
   the end of the step.
3. Whatever is done for each velocity goes through ``Writer.each`` and ``Writer.array``: straight-line code for a
   small system, loops for a long chain.
4. Nothing is kept between steps outside ``%w``, ``%dense`` and the state, so that a run can stop and resume.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any, Generic

from robodyn_cli.decision import Decision
from robodyn_cli.errors import CapabilityError
from robodyn_cli.formulations.system import System
from robodyn_cli.integration_methods import METHODS, IntegrationMethod
from robodyn_cli.integrators.runtime.memory import IntegerSlot
from robodyn_cli.integrators.stepping.control import FIXED, Kept, StepAttempt, StepController
from robodyn_cli.integrators.stepping.writer import Tables, Writer, placement
from robodyn_cli.kernels.arrays import Array
from robodyn_cli.kernels.ir import Block, Value
from robodyn_cli.kernels.program import Program
from robodyn_cli.record import record

DERIVATIVES = "accelerations and their derivatives"
SLACK = 2e-15  # a sample this close beyond the end of a step belongs to it


@record
class StepProgram:
    """A program that the steps of a method evaluate; lanes : at how many states (or what ``hold`` says) at once."""

    name: str
    program: Program
    lanes: int = 1
    hold: str = "stages"


class Method:
    """A method of integration: what it is, and what it asks of a system.

    dense_order : of the dense output. proportion : the global error falls at least as the tolerance to this power.
    """

    dense_order = 0
    proportion = 1.0
    lanes = 1  # stages that are evaluated at once
    has_history = False  # whether a step needs those before it
    vectors = False  # whether steps can be written for vectors of runs (``stepping/lanes.py``)
    instead: tuple[str, ...] = ("auto", "gauss", "radau13")  # methods to name in a refusal that do the system

    def __init__(self, facts: IntegrationMethod) -> None:
        self.facts = facts
        self.name = facts.name
        self.order = facts.order
        self.adaptive = not facts.fixed_step
        self.needs_jacobian = facts.stiff
        self.symplectic = facts.symplectic

    def obstacle(self, system: System) -> str:
        """Return why the method cannot do a system, or nothing."""
        if self.has_history and system.updates is not None:
            return "it keeps a history of steps, and a sampled controller's torques jump at each sample"
        if self.needs_jacobian and system.dynamics.any_size:
            return f"a chain of {system.nv} joints is integrated by loops over its bodies, which have no exact Jacobian"
        return ""

    def check(self, system: System) -> None:
        """Raise CapabilityError where the method cannot do a system."""
        why = self.obstacle(system)
        if why:
            others = [
                name
                for name in self.instead
                if name not in METHODS or not (METHODS[name].stiff and system.dynamics.any_size)
            ]
            raise CapabilityError(
                f"{self.name!r} does not do this scene: {why}; allowed: {', '.join(others)}"
            )

    def tables(self, system: System) -> Tables:
        """Return the tables of all programs that a run's code reads."""
        others = [
            system.dynamics.program,
            system.positions,
            system.velocities,
            system.normal_form,
            system.switching,
            *(() if system.updates is None else system.updates.all_programs),
            None if system.closings is None else system.closings.program,
        ]
        return Tables([*others, *(step.program for step in self.programs(system))])

    def linearisation(self, system: System) -> StepProgram | None:
        """Return the program with the Jacobian that the method evaluates in each step, if any."""
        return None

    def programs(self, system: System) -> list[StepProgram]:
        """Return what the steps evaluate beside events and corrections; for systems that are no loops over bodies."""
        programs = [StepProgram("accelerations", system.dynamics.program)]
        derivatives = self.linearisation(system)
        return programs if derivatives is None else [*programs, derivatives]

    def choices(self, system: System) -> list[Decision]:
        """Return in which form the rates are evaluated, and where their code goes."""
        dynamics = system.dynamics
        return [dynamics.decision or placement(dynamics.program)]

    def projects(self, system: System) -> bool:
        """Tell whether states are to be put back on manifolds and constraints after each step."""
        return True

    def moves_state(self, system: System) -> bool:
        """Tell whether steps are corrected, so that the next one starts from another state."""
        corrections = (system.normal_form, system.positions, system.velocities)
        return self.projects(system) and any(c is not None for c in corrections)

    def dense_size(self, system: System) -> int:
        """Return how many doubles dense output keeps."""
        raise NotImplementedError

    def stepper(self, w: Writer) -> Stepper[Any]:
        """Return what writes the steps; it may emit what is needed once at entry (room, constants)."""
        raise NotImplementedError


class Stepper(Generic[Kept]):
    """Writes the steps of a method for one system; ``control`` : how the length of steps follows from errors."""

    control: StepController = FIXED
    knows_end = False  # whether an attempt leaves what the next step begins with

    def __init__(self, method: Method, w: Writer) -> None:
        self.method = method
        self.w = w
        self.f = w.f

    def begin(self, t: Value) -> Value | None:
        """Emit what a step from t takes whatever its length; return the longest that this allows, None: any."""
        return None

    def attempt(self, t: Value, h: Value, failed: Block) -> StepAttempt[Kept]:
        """Emit one attempted step from the state; may leave ``failed`` with the length to try next in ``%w``."""
        raise NotImplementedError

    def save_dense(self, t: Value, h: Value, kept: Kept) -> None:
        """Emit the storing of dense output, after acceptance and before the state is replaced."""
        raise NotImplementedError

    @contextlib.contextmanager
    def used(self, t: Value, h: Value) -> Iterator[None]:
        """Emit the body so that it runs only if dense output is used: there is a sample or an event to find."""
        f, w = self.f, self.w
        wanted = f.compare_int(
            "sle",
            f.load_int(w.integer_at(IntegerSlot.NEXT_SAMPLE)),
            f.load_int(w.integer_at(IntegerSlot.LAST_SAMPLE)),
        )
        watched = f.compare_int("ne", f.load_int(w.integer_at(IntegerSlot.WATCH)), 0)
        with f.when(wanted | watched), f.when(w.due(t + h, 2.0 * SLACK) | watched):
            yield

    def dense(self, u: Value, h: Value, out: Array) -> None:
        """Store the state at u in [-1, 0] of the step of length h."""
        raise NotImplementedError

    def sample(self, u: Value, h: Value, out: Array) -> None:
        """Store the state at a uniform sample; like ``dense`` unless a method has something better there."""
        self.dense(u, h, out)
