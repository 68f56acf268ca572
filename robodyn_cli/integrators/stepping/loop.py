"""The compiled stepping loop that all methods share.

    samples -> end? -> attempt -> judge -> reject: shorter step | accept: look for events, commit, project -> samples

A method supplies the attempt and its dense output (``stepping/stepper.py``).
"""

from __future__ import annotations

from typing import Any

from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.event_location.locate_event import (
    locate_event_function,
    restart_function,
    run_to_event_function,
    switching_function,
    trial_step_function,
)
from robodyn_cli.integrators.runtime.memory import DoubleSlot, IntegerSlot, Status
from robodyn_cli.integrators.stepping.control import StepVerdict, judge, remember, shorter
from robodyn_cli.integrators.stepping.rounding import step_rounding
from robodyn_cli.integrators.stepping.stepper import SLACK, Method, Stepper
from robodyn_cli.integrators.stepping.writer import Exit, Writer
from robodyn_cli.kernels.arrays import Array
from robodyn_cli.kernels.ir import Block, Condition, Function, Value, module
from robodyn_cli.kernels.lower import Programs
from robodyn_cli.record import mutable_record

RESOLUTION = 4e-16  # of a time: shorter steps are lost in rounding
STRETCH = 1.0001  # a step that would leave less than this of itself is extended to the end
REJECTIONS = 60  # in a row, after which a step will not get shorter any more
PROJECTIONS = 6  # Newton steps
CLOSED = 1e-9  # change of q from which, with quadratic convergence, the next one is below rounding


@mutable_record
class Step:
    """A step that is tried: its start and length, and whether it ends the run."""

    t: Value
    h: Value
    last: Condition


def write_run(system: System, method: Method, programs: Programs) -> str:
    """Return the IR of ``i64 run(...)`` with ``ARGUMENTS``, whose result is a ``Status``, and of its helpers.

    w, n : see ``DoubleSlot`` and ``IntegerSlot``. y : the state. p : parameters. dense : what dense output keeps.
    out : block of samples, columns of CAPACITY rows. tables, scratch : of the dynamics. work : see ``memory_function``.
    numbers : see ``Tables``. registers : so many doubles as ``i64 registers()`` says.

    Raises
    ------
    CapabilityError : the method cannot do the system.
    """
    method.check(system)
    tables = method.tables(system)
    w = Writer(system, tables, programs, loops=not method.needs_jacobian or system.in_columns)
    _write_loop(w, method.stepper(w))
    count = len(system.events)
    functions = [w.f, w.memory_function(), run_to_event_function(count)]
    if count:
        functions += [
            switching_function(system, tables, programs),
            trial_step_function(),
            locate_event_function(system.events, system.closings is not None),
            restart_function(count),
        ]
    if system.closings is not None:
        from robodyn_cli.integrators.event_location.closings import close_latch_function

        functions.append(close_latch_function(system, system.closings, tables, programs))
    registers = Function("registers", [], result="i64")
    registers.ret(programs.room)
    return module([*functions, registers, *programs.functions.values()])


def _write_loop(w: Writer, stepper: Stepper[Any]) -> None:
    f, y = w.f, Array(w.f, "%y")
    for k in w.each(w.size):
        w.state[k] = y[k]
    with f.block() as ended:
        run = Exit(w.f, ended)
        jumps, rounding = None, step_rounding(w, stepper.method)
        if w.system.events:
            from robodyn_cli.integrators.stepping.jumps import jump_steps

            jumps = jump_steps(w, stepper.method.adaptive)
        with f.loop() as steps:
            if w.system.updates is not None:
                from robodyn_cli.integrators.stepping.updates import update_when_due

                update_when_due(w, w.system.updates, run)
            _write_samples(w, stepper, run)
            if jumps is not None:
                jumps.begin()
            if rounding is not None:
                rounding.begin()
            step = _next_step(w, stepper, run)
            if rounding is not None:
                rounding.allow(step.h)
            with f.block() as failed:
                attempt = stepper.attempt(step.t, step.h, failed)
                verdict = judge(w, stepper.method.adaptive, stepper.control, step.h, attempt)
                if jumps is not None:
                    jumps.check(step.t, step.h, verdict)
                _reject(w, stepper.method.adaptive, step, verdict, failed, run)
                remember(w, verdict)
                stepper.save_dense(step.t, step.h, attempt.kept)
                if w.system.events:
                    from robodyn_cli.integrators.event_location.events import find_event

                    find_event(w, stepper, step.t, step.h, run)
                _commit(w, step, verdict, stepper.method.adaptive)
                if jumps is not None:
                    jumps.commit()
                if rounding is not None:
                    rounding.commit(step.h)
                if stepper.method.projects(w.system):
                    _project(w)
                steps.again()
            if jumps is not None:
                jumps.try_unchecked(step.t, step.h, steps)
            _count_rejection(w, run)
    for k in w.each(w.size):
        y[k] = w.state[k]
    resumes = f.compare_int("eq", run.status, int(Status.FULL))
    with f.when(~(resumes | f.compare_int("eq", run.status, int(Status.MAX_STEPS)))):
        # parameters may change before the run goes on, or the right-hand side jumps here
        f.store_int(0, w.integer_at(IntegerSlot.RATE_KNOWN))
    f.ret(f.select_int(w.is_finite(w.state), run.status, int(Status.NOT_FINITE)))


def _next_step(w: Writer, stepper: Stepper[Any], run: Exit) -> Step:
    """Choose the step to try; the run ends where there is none."""
    f = w.f
    t, end = w.get(DoubleSlot.T), w.get(DoubleSlot.T_END)
    with f.strict():
        left = end - t
        run.leave(Status.DONE, unless=f.compare("ogt", left, f.abs(end) * RESOLUTION))
    taken = f.load_int(w.integer_at(IntegerSlot.ACCEPTED)) + f.load_int(w.integer_at(IntegerSlot.REJECTED))
    most = f.load_int(w.integer_at(IntegerSlot.MAX_STEPS))
    run.leave(Status.MAX_STEPS, unless=f.compare_int("slt", taken, most))
    if w.system.updates is not None:
        from robodyn_cli.integrators.stepping.updates import bound

        with f.strict():
            left = bound(w) - t
    return step_over(w, stepper, t, left)


def step_over(w: Writer, stepper: Stepper[Any], t: Value, left: Value) -> Step:
    """Return the step to try at t with so much time left."""
    f, adaptive = w.f, stepper.method.adaptive
    wanted, longest = f.min(w.get(DoubleSlot.H), w.get(DoubleSlot.H_MAX)), stepper.begin(t)
    if adaptive and longest is not None:
        wanted = f.min(wanted, longest)
    with f.strict():
        last = f.compare("oge", wanted * STRETCH, left)
        if adaptive:
            # two even steps in place of a long one and a stub
            wanted = f.select(f.compare("ogt", wanted * 2.0, left), left * 0.5, wanted)
        return Step(t, f.select(last, left, wanted), last)


def _reject(w: Writer, adaptive: bool, step: Step, verdict: StepVerdict, failed: Block, run: Exit) -> None:
    """Leave ``failed``, with a shorter step to try, unless the step counts; with a fixed step the run ends."""
    f = w.f
    with f.block() as counts:
        counted = f.compare("olt", verdict.square, 1.0)
        if adaptive:
            counts.leave(counted)
            w.put(DoubleSlot.H, shorter(w, verdict, step.h))
            failed.leave()
        else:
            finite = w.is_finite(w.new)
            counts.leave(counted & finite)
            run.leave(Status.NOT_FINITE, f.compare("uno", verdict.square, 0.0))
            run.leave(Status.NOT_FINITE, unless=finite)
            run.leave(Status.NOT_SOLVED)


def _count_rejection(w: Writer, run: Exit) -> None:
    """Count a rejected step; the run ends where steps get too short."""
    f = w.f
    w.count(IntegerSlot.REJECTED)
    in_row = f.bump(w.integer_at(IntegerSlot.REJECTED_IN_ROW))
    too_small = is_too_small(w, w.get(DoubleSlot.H)) | f.compare_int("sgt", in_row, REJECTIONS)
    run.leave(Status.STEP_TOO_SMALL, too_small)


def is_too_small(w: Writer, h: Value) -> Condition:
    """Return whether a step of length h is lost in rounding of the time, or no number."""
    f = w.f
    return f.compare("ult", h, f.max(f.abs(w.get(DoubleSlot.T)) * RESOLUTION, 1e-300))


def end_of(w: Writer, step: Step) -> tuple[Value, Value]:
    """Return the time at the end of a step, and what rounding has left out of it.

    Time is summed with its rounding (Kahan, two-sum of Knuth): k steps of length h end at k h.
    """
    f = w.f
    with f.strict():
        more = step.h + w.get(DoubleSlot.T_REST)
        total = step.t + more
        added = total - step.t
        rest = (step.t - (total - added)) + (more - added)
        end = w.get(DoubleSlot.T_END)
        if w.system.updates is not None:
            from robodyn_cli.integrators.stepping.updates import bound

            end = bound(w)
        reached = f.select(step.last, end, total)
        return reached, f.select(step.last, f.constant(0.0), rest)


def _commit(w: Writer, step: Step, verdict: StepVerdict, adaptive: bool) -> None:
    """Take the new state over."""
    f = w.f
    # a fixed step is as long again after one that had to be shorter
    longer = step.h * verdict.factor if adaptive else w.get(DoubleSlot.H_MAX)
    if adaptive and w.system.updates is not None:
        # a step that an update has cut says nothing against the one that was wanted
        longer = f.select(step.last, f.max(longer, w.get(DoubleSlot.H)), longer)
    w.put(DoubleSlot.H, longer)
    f.store_int(0, w.integer_at(IntegerSlot.REJECTED_IN_ROW))
    reached, rest = end_of(w, step)
    w.put(DoubleSlot.T_REST, rest)
    w.put(DoubleSlot.T_OLD, step.t)
    w.put(DoubleSlot.H_OLD, step.h)
    w.put(DoubleSlot.T, reached)
    w.count(IntegerSlot.ACCEPTED)
    for k in w.each(w.size):
        w.state[k] = w.new[k]


def _project(w: Writer) -> None:
    """Put the state back on manifolds and constraints: Newton steps for q until they no longer matter, then v."""
    f, s = w.f, w.system
    t = w.get(DoubleSlot.T)
    if s.normal_form is not None:
        for place, x in zip(s.corrections.normalised, w.evaluate(s.normal_form, t, w.state)["n"]):
            w.state[place] = x
    if s.positions is not None:
        rounds = f.int_slot()
        f.store_int(0, rounds)
        with f.loop() as newton:
            moved = f.constant(0.0)
            for k, q in zip(s.q_places, w.evaluate(s.positions, t, w.state)["q"]):
                d = q - w.state[k]
                moved = moved + d * d
                w.state[k] = q
            w.count(IntegerSlot.PROJECTIONS)
            near = f.compare("ule", moved, CLOSED**2)
            newton.leave(near | f.compare_int("sge", f.bump(rounds), PROJECTIONS))
    if s.velocities is not None:
        for k, v in zip(s.v_places, w.evaluate(s.velocities, t, w.state)["v"]):
            w.state[k] = v


def _write_samples(w: Writer, stepper: Stepper[Any], run: Exit) -> None:
    """Write every uniform sample that the last step has passed; the run is interrupted where there is no room."""
    f = w.f
    with f.loop() as samples:
        limit = w.get(DoubleSlot.T)
        samples.leave(unless=w.due(limit, SLACK))
        rows = f.load_int(w.integer_at(IntegerSlot.ROWS))
        capacity = f.load_int(w.integer_at(IntegerSlot.CAPACITY))
        run.leave(Status.FULL, unless=f.compare_int("slt", rows, capacity))
        k = f.load_int(w.integer_at(IntegerSlot.NEXT_SAMPLE))
        h = w.get(DoubleSlot.H_OLD)
        with f.strict():
            time = w.sample_time(k)
            u = f.min((time - limit) / h, 0.0)
        out = Array(f, f.offset("%out", rows), stride=capacity)
        stepper.sample(u, h, out)
        if w.system.updates is not None:
            from robodyn_cli.integrators.stepping.updates import held_at_sample

            held_at_sample(w, w.system.updates, time, out)
        f.store_int(rows + 1, w.integer_at(IntegerSlot.ROWS))
        f.store_int(k + 1, w.integer_at(IntegerSlot.NEXT_SAMPLE))
