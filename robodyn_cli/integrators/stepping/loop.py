"""The compiled stepping loop that all methods share.

    attempt a step -> reject: shorter step | accept: look for events, project, write samples -> next step

A method supplies the attempt, its dense output and its own memory (``integrators/stepping/stepper.py``).
"""

from __future__ import annotations

from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.event_location.locate import drive_function, narrow_function
from robodyn_cli.integrators.event_location.trial import switching_function, trial_function
from robodyn_cli.integrators.runtime.layout import Real, Status, Whole
from robodyn_cli.integrators.stepping.stepper import SLACK, Stepper
from robodyn_cli.integrators.stepping.writer import LANES, Writer
from robodyn_cli.kernels.arrays import Array, Total
from robodyn_cli.kernels.ir import Condition, Function, Int, Value, module

SHORTEST = 32 * 2.3e-16  # of the time: steps that may pass a jump unchecked
DIPS = 4  # times that it is looked at where a function nearly touches zero
TOUCHING = 1e-9  # of its neighbours, below which a value says nothing about what lies beyond zero
CLOSER = 2  # times that dense output is looked at again around an event


def write_run(system: System, method: Stepper, fused: bool) -> str:
    """Return the IR of ``i64 run(...)`` with ``ARGUMENTS``, whose result is a ``Status``, and of ``memory``.

    w, n : see ``Real`` and ``Whole``. y : the state. p : parameters. dense : what dense output keeps. out : block
    of samples, columns of CAPACITY rows. tables, scratch : of the dynamics. work : see ``memory_function``.
    """
    w = Writer(system, fused, loops=not method.needs_jacobian)
    f = w.f
    method.prepare(w)
    loop, accepted, rejected, samples, leave = (
        f.label(x) for x in ("step", "accept", "reject", "samples", "leave")
    )
    retry = f.label("retry")
    status = f.int_slot()
    f.store_int(Status.DONE, status)
    y = Array(f, "%y")
    for k in w.each(w.size):
        w.state[k] = y[k]
    f.branch(f.compare_int("ne", f.load_int(w.whole(Whole.PENDING)), 0), samples, loop)

    f.place(loop)
    t, end = w.get(Real.T), w.get(Real.T_END)
    with f.arithmetic(""):
        left = end - t
        tiny = f.abs(end) * 4e-16
        more = f.label("more")
        f.branch(f.compare("ogt", left, tiny), more, leave)
    f.place(more)
    taken = f.load_int(w.whole(Whole.ACCEPTED)) + f.load_int(w.whole(Whole.REJECTED))
    go = f.label("go")
    f.store_int(Status.MAX_STEPS, status)
    f.branch(f.compare_int("slt", taken, f.load_int(w.whole(Whole.MAX_STEPS))), go, leave)
    f.place(go)
    f.store_int(Status.DONE, status)
    wanted = f.min(w.get(Real.H), w.get(Real.H_MAX))
    with f.strict():
        # a last step that would leave almost nothing is stretched to the end; two even ones replace a long and a stub
        last = f.compare("oge", wanted * 1.0001, left)
        even = f.compare("ogt", wanted * 2.0, left)
        h = (
            f.select(last, left, f.select(even, left * 0.5, wanted))
            if method.adaptive
            else f.select(last, left, wanted)
        )
    h_slot, full_slot = f.slot(), f.slot()
    f.store(h, h_slot)
    f.store(f.select(last, f.constant(1.0), f.constant(0.0)), full_slot)
    outcome = method.attempt(w, t, h, retry)
    factor_slot = f.slot()
    f.store(outcome.factor, factor_slot)
    f.branch(f.compare("olt", outcome.error, 1.0), accepted, rejected)

    f.place(rejected)
    if method.adaptive:
        h = f.load(h_slot)
        if any(e.is_discontinuity for e in system.events):
            _step_over_jump(w, h, accepted)
        broken = f.compare("uno", outcome.error, 0.0)
        shrink = f.select(broken, f.constant(0.1), f.min(f.max(f.load(factor_slot), 0.1), 0.9))
        w.put(Real.H, h * shrink)
        f.jump(retry)
    else:
        broken = f.compare("uno", outcome.error, 0.0)
        f.store_int(f.select_int(broken, int(Status.NOT_FINITE), int(Status.NOT_SOLVED)), status)
        f.jump(leave)
    f.place(retry)
    w.count(Whole.REJECTED)
    in_row = f.bump(w.whole(Whole.REJECTED_IN_ROW))
    floor = f.max(f.abs(w.get(Real.T)) * 4e-16, 1e-300)
    too_small = f.compare("ult", w.get(Real.H), floor) | f.compare_int("sgt", in_row, 60)
    f.store_int(Status.STEP_TOO_SMALL, status)
    f.branch(too_small, leave, loop)

    f.place(accepted)
    h = f.load(h_slot)
    t = w.get(Real.T)
    method.save_dense(w, t, h)
    if system.events:
        _find_event(w, method, t, h, status, leave)
    w.put(Real.H, h * f.load(factor_slot))
    f.store_int(0, w.whole(Whole.REJECTED_IN_ROW))
    with f.strict():
        reached = f.select(f.compare("ogt", f.load(full_slot), 0.5), w.get(Real.T_END), t + h)
    w.put(Real.T_OLD, t)
    w.put(Real.H_OLD, h)
    w.put(Real.T, reached)
    w.count(Whole.ACCEPTED)
    for k in w.each(w.size):
        w.state[k] = w.new[k]
    if method.projects(system):
        _project(w, reached)
    f.jump(samples)

    f.place(samples)
    f.store_int(0, w.whole(Whole.PENDING))
    _write_samples(w, method, status, leave)
    f.jump(loop)

    f.place(leave)
    spread = Total(f)
    for k in w.each(w.size):
        x = w.state[k]
        y[k] = x
        with f.strict():
            spread.add_product(x, 0.0)
    f.ret(f.select_int(f.compare("uno", spread.value, 0.0), int(Status.NOT_FINITE), f.load_int(status)))
    entries = [f, w.memory_function(), drive_function(len(system.events))]
    if system.events:
        entries += [switching_function(system, fused), trial_function(), narrow_function(len(system.events))]
    return module([*entries, *w.functions.values()])


def _dips(f: Function, first: Value, before: Value, g: Value) -> Int:
    """Return the lanes, as bits, in which a function comes nearest to zero and may cross it and come back.

    A parabola through the lane and its neighbours (the last neighbour, and that of the ``first`` value, by
    extrapolation) goes beyond zero, or most of the way.
    """
    width = g.width

    def extrapolated(a: Value, b: Value, c: Value) -> Value:
        return (a - b) * 3.0 + c

    def near(before: Value, g: Value, after: Value) -> Condition:
        size = f.abs(g)
        nearest = f.compare("ogt", f.abs(before), size) & f.compare("ogt", f.abs(after), size)
        together = f.compare("ogt", before * g, 0.0) & f.compare("ogt", after * g, 0.0)
        slope, bend = after - before, (before + after) - (g + g)
        # g - slope^2 / (8 bend) < g / 4, where g and bend have the same sign
        deep = f.compare("ogt", slope * slope, f.abs(bend) * size * 6.0)
        # one that stands at zero but for rounding has been looked at
        return nearest & together & deep & f.compare("ogt", size, f.abs(after) * TOUCHING)

    lane = [f.lane(g, k) for k in (0, 1, width - 3, width - 2, width - 1)]
    beyond = f.splat(extrapolated(lane[4], lane[3], lane[2]), width)
    vec = f"<{width} x double>"
    order = ", ".join(f"i32 {j + 1}" for j in range(width))
    after = f.emit(f"shufflevector {vec} {g.ref}, {vec} {beyond.ref}, <{width} x i32> <{order}>", width)
    at_start = near(extrapolated(first, lane[0], lane[1]), first, lane[0])
    return near(before, g, after).mask() | f.select_int(at_start, 1, 0)


def _step_over_jump(w: Writer, h: Value, accepted: str) -> None:
    """Accept a rejected step that is as short as steps can be and passes a jump of the right-hand side.

    No step over a jump is short enough for a tight tolerance; what a step of a few roundings of time makes of a wrong
    right-hand side is rounding.
    """
    f, s = w.f, w.system
    assert s.switching is not None
    t = w.get(Real.T)
    look, on = f.label("jump"), f.label("no.jump")
    f.branch(f.compare("ole", h, f.abs(t) * SHORTEST), look, on)
    f.place(look)
    values = w.evaluate(s.switching, t + h, w.new)["g"]
    least = f.constant(0.0)
    for k, (g, event) in enumerate(zip(values, s.events)):
        if event.is_discontinuity:
            product = g * w.get(Real.SIZE + k)
            least = f.select(f.compare("olt", product, least), product, least)
    f.branch(f.compare("olt", least, 0.0), accepted, on)
    f.place(on)


def _project(w: Writer, t: Value) -> None:
    """Put the state back on manifolds and constraints: Newton steps for q until they no longer matter, then v."""
    f, s = w.f, w.system
    if s.normal_form is not None:
        for place, x in zip(s.corrections.normalised, w.evaluate(s.normal_form, t, w.state)["n"]):
            w.state[place] = x
    if s.positions is not None:
        again, done = f.label("again"), f.label("closed")
        rounds = f.int_slot()
        f.store_int(0, rounds)
        f.jump(again)
        f.place(again)
        moved: Value | None = None
        for k, q in zip(s.q_places, w.evaluate(s.positions, t, w.state)["q"]):
            d = q - w.state[k]
            moved = d * d if moved is None else moved + d * d
            w.state[k] = q
        w.count(Whole.PROJECTIONS)
        assert moved is not None
        # quadratic convergence: after a step below 1e-9 the next would be below rounding
        onward = f.compare("ogt", moved, 1e-18) & f.compare_int("slt", f.bump(rounds), 6)
        f.branch(onward, again, done)
        f.place(done)
    if s.velocities is not None:
        for k, v in zip(s.v_places, w.evaluate(s.velocities, t, w.state)["v"]):
            w.state[k] = v


def _write_samples(w: Writer, method: Stepper, status: str, leave: str) -> None:
    """Write every uniform sample that the last step has passed."""
    f = w.f
    head, body, room, done = (f.label(x) for x in ("sample", "due", "room", "written"))
    f.jump(head)
    f.place(head)
    k = f.load_int(w.whole(Whole.NEXT_SAMPLE))
    with f.strict():
        time = w.get(Real.SAMPLE_START) + f.to_double(k) * w.get(Real.SAMPLE_STEP)
        limit = w.get(Real.T)
    f.branch(w.due(limit, SLACK), body, done)
    f.place(body)
    rows = f.load_int(w.whole(Whole.ROWS))
    f.store_int(1, w.whole(Whole.PENDING))
    f.store_int(Status.FULL, status)
    f.branch(f.compare_int("slt", rows, f.load_int(w.whole(Whole.CAPACITY))), room, leave)
    f.place(room)
    f.store_int(0, w.whole(Whole.PENDING))
    f.store_int(Status.DONE, status)
    h = w.get(Real.H_OLD)
    with f.strict():
        u = f.min((time - limit) / h, 0.0)
    capacity = f.load_int(w.whole(Whole.CAPACITY))
    method.sample(w, u, h, Array(f, f.offset("%out", rows), stride=capacity))
    f.store_int(rows + 1, w.whole(Whole.ROWS))
    f.store_int(k + 1, w.whole(Whole.NEXT_SAMPLE))
    f.jump(head)
    f.place(done)


def _find_event(w: Writer, method: Stepper, t: Value, h: Value, status: str, leave: str) -> None:
    """Look for the first sign change of any event function at eight points of the step, all lanes at once.

    Where there is one, its eighth is looked at in the same way, ``CLOSER`` times, and the loop returns without
    committing the step, with a guess of the time and of the slope there. The event is then located by steps that end
    there, which have the full order of the method.
    """
    f, s = w.f, w.system
    assert s.switching is not None
    width, count = LANES, len(s.events)
    quiet, look, scan = f.label("quiet"), f.label("look"), f.label("scan")
    f.branch(f.compare_int("ne", f.load_int(w.whole(Whole.WATCH)), 0), look, quiet)
    f.place(look)
    base, span, closer, dips = f.slot(), f.slot(), f.int_slot(), f.int_slot()
    # of each function the value before the first lane, and those in the lanes
    passed = f.slot(1, (width + 1) * count)
    f.store(-1.0, base)
    f.store(1.0, span)
    f.store_int(0, closer)
    f.store_int(0, dips)
    ends = f.slot(1, count)
    for k in range(count):
        f.store(w.get(Real.SIZE + k), f.offset(passed, (width + 1) * k))
    f.jump(scan)
    f.place(scan)
    fractions = f.constant([k / width for k in range(1, width + 1)])
    u = f.splat(f.load(base), width) + f.splat(f.load(span), width) * fractions
    x = w.array(2, 1, width)
    method.dense(w, u, h, x)
    values = w.evaluate(s.switching, t + h + h * u, x)["g"]
    first = f.int_slot()
    which = f.int_slot()
    f.store_int(width, first)
    f.store_int(0, which)
    dipping, dipping_at = f.int_slot(), f.int_slot()
    f.store_int(0, dipping)
    for k, (g, event) in enumerate(zip(values, s.events)):
        g = f.splat(g, width)
        row = f.offset(passed, (width + 1) * k)
        before = f.load(row)
        f.store(g, f.offset(row, 1))
        order = "i32 " + f"{width}, " + ", ".join(f"i32 {j}" for j in range(width - 1))
        vec = f"<{width} x double>"
        shifted = f.emit(
            f"shufflevector {vec} {g.ref}, {vec} {f.splat(before, width).ref}, <{width} x i32> <{order}>",
            width,
        )
        rising = f.compare("ole", shifted, 0.0) & f.compare("ogt", g, 0.0)
        falling = f.compare("oge", shifted, 0.0) & f.compare("olt", g, 0.0)
        crossing: Condition
        if event.direction > 0:
            crossing = rising
        elif event.direction < 0:
            crossing = falling
        else:
            crossing = rising | falling
        mask = crossing.mask() | (1 << width)
        lane = f.lowest_bit(mask)
        sooner = f.compare_int("slt", lane, f.load_int(first))
        f.store_int(f.select_int(sooner, lane, f.load_int(first)), first)
        f.store_int(f.select_int(sooner, f.emit_int(f"add i64 0, {k}"), f.load_int(which)), which)
        # what is much shorter than a fixed step is not resolved by it, nor by half of it for the estimate
        if method.adaptive:
            lane = f.lowest_bit(_dips(f, before, shifted, g) | (1 << width))
            deeper = f.compare_int("slt", lane, width)
            f.store_int(f.select_int(deeper, lane, f.load_int(dipping_at)), dipping_at)
            f.store_int(f.select_int(deeper, 1, f.load_int(dipping)), dipping)
        at_end = f.compare_int("eq", f.load_int(dips), 0)
        last = f.offset(ends, k)
        f.store(f.select(at_end, f.lane(g, width - 1), f.load(last)), last)
    found, none, enough, nothing = (f.label(x) for x in ("found", "none", "enough", "nothing"))
    f.branch(f.compare_int("slt", f.load_int(first), width), found, none)
    f.place(found)
    lane_number = f.to_double(f.load_int(first))
    part = f.load(span) * (1.0 / width)
    low_u = f.load(base) + part * lane_number
    low = t + h * (low_u + 1.0)
    known = f.load_int(closer)
    with f.when(f.compare_int("eq", known, 0)):
        w.put(Real.EVENT_LOW, low)
        w.put(Real.EVENT_HIGH, low + h * part)
    f.store_int(f.load_int(which), w.whole(Whole.EVENT))
    beside = f.offset(passed, f.load_int(which) * (width + 1) + f.load_int(first))
    g_low, g_high = f.load(beside), f.load(f.offset(beside, 1))
    slope = (g_high - g_low) / (h * part)
    w.put(Real.EVENT_SLOPE, slope)
    w.put(Real.EVENT_GUESS, low - g_low / slope)
    for k in range(count):
        row = f.offset(passed, (width + 1) * k)
        f.store(f.load(f.offset(row, f.load_int(first))), row)
    f.store(low_u, base)
    f.store(part, span)
    f.store_int(known + 1, closer)
    f.branch(f.compare_int("slt", known, CLOSER), scan, enough)
    f.place(none)
    dip, plain = f.label("dip"), f.label("plain")
    may = f.compare_int("eq", f.load_int(dipping), 1) & f.compare_int("eq", f.load_int(closer), 0)
    f.branch(may & f.compare_int("slt", f.bump(dips), DIPS + 1), dip, plain)
    f.place(dip)
    # once more between the neighbours of the lane that is nearest to zero
    at = f.load_int(dipping_at)
    part = f.load(span) * (1.0 / width)
    start = f.load(base) + part * f.to_double(at)
    f.store(start, base)
    f.store(f.min(part * 2.0, -start), span)
    for k in range(count):
        row = f.offset(passed, (width + 1) * k)
        f.store(f.load(f.offset(row, at)), row)
    f.jump(scan)
    f.place(plain)
    f.branch(f.compare_int("eq", f.load_int(closer), 0), nothing, enough)
    f.place(enough)
    f.store_int(Status.EVENT, status)
    f.jump(leave)
    f.place(nothing)
    for k in range(count):
        g = f.load(f.offset(ends, k))
        # a function that ends the step at zero keeps its sign: whether it crosses shows in the next step
        w.put(Real.SIZE + k, f.select(f.compare("oeq", g, 0.0), w.get(Real.SIZE + k), g))
    f.jump(quiet)
    f.place(quiet)
