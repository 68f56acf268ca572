"""What a method of integration supplies: the attempt of a step, its dense output and its own memory.

Tableaus are data. To add a method, write one file with a subclass of ``Stepper`` and one line in the registry.
Checklist for implementers:

1. ``attempt`` emits straight-line code or inner loops and leaves new values in ``new``; it returns the
   squared, scaled error (accept where < 1; NaN must come out as NaN) and the factor for the next step.
2. ``save_dense`` stores what dense output needs in ``%dense``; ``dense`` evaluates it at u in [-1, 0], where 0 is
   the end of the step.
3. Whatever is done for each velocity goes through ``Writer.each`` and ``Writer.array``: straight-line code for a
   small system, loops for a long chain.
4. Nothing is kept between steps outside ``%w``, ``%dense`` and the state, so that a run can stop and resume.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from robodyn_cli.formulations.residual import Residual
from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.runtime.layout import Whole
from robodyn_cli.integrators.stepping.writer import Writer
from robodyn_cli.kernels.arrays import Array
from robodyn_cli.kernels.ir import Value
from robodyn_cli.kernels.program import Program
from robodyn_cli.record import mutable_record, record

SLACK = 2e-15  # a sample this close beyond the end of a step belongs to it


@mutable_record
class Attempt:
    """Outcome of an attempted step: squared scaled error, and the factor by which to change the step."""

    error: Value
    factor: Value


@record
class StepProgram:
    """A program that the steps of a method evaluate; lanes : at how many states at once."""

    name: str
    program: Program
    lanes: int = 1


class Stepper:
    """A method of integration. ``order`` is that of the solution, ``dense_order`` that of the dense output.

    proportion : the global error falls at least as the tolerance to this power.
    """

    name = ""
    lanes = 1  # stages that are evaluated at once
    order = 0
    dense_order = 0
    adaptive = True
    proportion = 1.0
    symplectic = False
    needs_jacobian = False
    largest_growth = 5.0

    def digest(self, system: System) -> str:
        """Return a key of the code that the method takes from a system beyond ``System.digest``."""
        return ""

    def dense_size(self, system: System) -> int:
        """Return how many doubles dense output keeps."""
        raise NotImplementedError

    def linearisation(self, system: System) -> Program | None:
        """Return the program that a method with ``needs_jacobian`` evaluates in each step."""
        return None

    def residual_of(self, system: System) -> Residual | None:
        """Return the rates as corrections of a guess, where the method works with those."""
        return None

    def programs(self, system: System) -> list[StepProgram]:
        """Return what the steps evaluate beside events and corrections; for systems that are no loops over bodies."""
        found = [StepProgram("accelerations", system.dynamics.program)]
        derivatives = self.linearisation(system)
        if derivatives is not None:
            found.append(StepProgram("accelerations and their derivatives", derivatives))
        return found

    def obstacle(self, system: System) -> str:
        """Return why the method cannot do a system, or nothing."""
        return "it needs a Jacobian" if self.needs_jacobian and system.dynamics.any_size else ""

    def projects(self, system: System) -> bool:
        """Tell whether states are to be put back on manifolds and constraints after each step."""
        return True

    def prepare(self, w: Writer) -> None:
        """Emit what is needed once at entry (slots, constants)."""

    def attempt(self, w: Writer, t: Value, h: Value, failed: str) -> Attempt:
        """Emit one attempted step from the state; may jump to ``failed`` with the next step stored in ``%w``."""
        raise NotImplementedError

    def save_dense(self, w: Writer, t: Value, h: Value) -> None:
        """Emit the storing of dense output, after acceptance and before the state is replaced."""
        raise NotImplementedError

    @contextlib.contextmanager
    def used(self, w: Writer, t: Value, h: Value) -> Iterator[None]:
        """Emit the body so that it runs only if dense output is used: there is a sample or an event to find."""
        f = w.f
        wanted = f.compare_int(
            "sle", f.load_int(w.whole(Whole.NEXT_SAMPLE)), f.load_int(w.whole(Whole.LAST_SAMPLE))
        )
        watched = f.compare_int("ne", f.load_int(w.whole(Whole.WATCH)), 0)
        with f.when(wanted | watched), f.when(w.due(t + h, 2.0 * SLACK) | watched):
            yield

    def dense(self, w: Writer, u: Value, h: Value, out: Array) -> None:
        """Store the state at u in [-1, 0] of the step of length h."""
        raise NotImplementedError

    def sample(self, w: Writer, u: Value, h: Value, out: Array) -> None:
        """Store the state at a uniform sample; like ``dense`` unless a method has something better there."""
        self.dense(w, u, h, out)
