"""What is compiled of a structure for elsewhere: the stepping loop, the numbers of other values of keys, and equations.

All functions work on memory of the caller:

    i64 drive(places, job)              one run: ``many`` with the functions of this module
    i64 numbers(given, numbers)         sets what varies in the tables; 1 where Python would build these equations
    void NAME(x, numbers, out)          equations at a state x and t = 0
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from robodyn_cli.errors import CapabilityError, listed
from robodyn_cli.expr.fixed import CANCELLED, places
from robodyn_cli.expr.functions import absolute, maximum, where
from robodyn_cli.expr.graph import Expr, Graph
from robodyn_cli.expr.many import CONSTANT, Decision, Recipe
from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.event_location.locate_event import load_places
from robodyn_cli.integrators.runtime.memory import DoubleSlot, IntegerSlot, LatchAnswer
from robodyn_cli.integrators.stepping.loop import write_run
from robodyn_cli.integrators.stepping.many import JOB, write_many
from robodyn_cli.integrators.stepping.stepper import Method
from robodyn_cli.integrators.stepping.writer import Tables
from robodyn_cli.kernels.arrays import Array
from robodyn_cli.kernels.compiler import Target
from robodyn_cli.kernels.ir import Function, Int, module
from robodyn_cli.kernels.lower import Programs
from robodyn_cli.kernels.program import NUMBERS, Program, make_program
from robodyn_cli.record import record

BEHIND = "numbers follow from it by a function in Python (base inertial parameters, a principal axis)"
PASSED = "passed"  # a function of the caller
# comparisons with zero of a difference that hold where it is positive, or where it is not
POSITIVE = {"gt": (1.0, True), "le": (1.0, False), "lt": (-1.0, True), "ge": (-1.0, False)}


def loop_texts(system: System, method: Method, target: Target) -> list[str]:
    """Return the IR of the stepping loop and of what makes runs with it."""
    f = Function("drive", ["ptr %places", "ptr %job"], result="i64")
    f.store_address("@run_to_event", f.offset("%job", JOB.index("run")))
    declared = ["declare i64 @run_to_event(ptr)", "declare i64 @many(ptr, ptr, i64, i64)"]
    if system.events:
        f.store_address("@trial_step", f.offset("%job", JOB.index("trial")))
        declared.append("declare i64 @trial_step(ptr, double, i64)")
    f.ret(f.call_int("many", ["ptr %places", "ptr %job", "i64 0", "i64 1"]))
    return [
        write_run(system, method, Programs(target.fused)),
        write_many(),
        "\n".join([*declared, module([f])]),
    ]


def notes_text() -> str:
    """Return the IR of ``watch(job)``: from then on runs tell their caller the events that they pass, by calls of
    ``passed(time, number of the event)``."""
    f = Function("note_event", ["ptr %places"], result="i64")
    load_places(f, "w", "n")
    time = f.load(f.offset("%w", DoubleSlot.T))
    event = f.to_double(f.load_int(f.offset("%n", IntegerSlot.EVENT)))
    f.call(PASSED, [f"double {time.ref}", f"double {event.ref}"])
    f.ret(Int(f, str(int(LatchAnswer.GOES_ON))))
    watch = Function("watch", ["ptr %job"])
    watch.store_address("@note_event", watch.offset("%job", JOB.index("close")))
    watch.ret()
    return "\n".join([f"declare void @{PASSED}(double, double)", module([f, watch])])


@record
class StateEquations:
    """Equations of a state x, at t = 0 if that is no group. places : in x, of the entries of each group of symbols."""

    program: Program
    places: Mapping[str, Sequence[int]]


def equations_text(equations: Mapping[str, StateEquations], tables: Tables, target: Target) -> str:
    """Return the IR of equations, by name of their function."""
    programs, functions = Programs(target.fused), []
    for name, own in equations.items():
        f, program = Function(name, ["ptr %x", f"ptr %{NUMBERS}", "ptr %out"]), own.program
        inputs: dict[str, Any] = {
            group: [f.load(f.offset("%x", k)) for k in places] for group, places in own.places.items()
        }
        inputs.setdefault("t", [f.constant(0.0)])
        inputs[NUMBERS] = Array(f, f.offset(f"%{NUMBERS}", tables.start(program)))
        values = [x for part in programs.evaluate(f, program, inputs, 1).values() for x in part]
        for k, x in enumerate(values):
            f.store(x, f.offset("%out", k))
        f.ret()
        functions.append(f)
    return module([*functions, *programs.functions.values()])


def numbers_text(
    recipe: Recipe,
    entries: Sequence[Any],
    places: Sequence[str],
    deciding: Sequence[Decision],
    target: Target,
) -> str:
    """Return the IR of ``numbers``.

    Parameters
    ----------
    entries : of the tables, one after another. places : of the keys that are numbers of the scene, in the order in
    which they are given. deciding : comparisons of numbers that have to turn out as they did.

    Raises
    ------
    CapabilityError : a number follows from a key by a function in Python.
    """
    varying = [(k, recipe.value_of(x)) for k, x in enumerate(entries) if recipe.varies(x)]
    graph = Graph()
    symbols = {place: graph.symbol(place, "given", k) for k, place in enumerate(places)}
    compared = [(compare, a, b, outcome) for compare, a, b, outcome in deciding]
    values = _values(
        recipe, symbols, {v for _, v in varying} | {v for _, a, b, _ in compared for v in (a, b)}
    )
    alike: Any = 1.0
    for compare, a, b, outcome in compared:
        alike = where(_positive(compare.__name__, values[a], values[b], outcome), alike, 0.0)
    program = make_program({"table": [values[v] for _, v in varying], "alike": [alike]}, ("given",))
    programs = Programs(target.fused)
    # as they are written: comparisons decide as those of Python
    f = Function("numbers", ["ptr %given", f"ptr %{NUMBERS}"], result="i64", flags="")
    own = Array(f, f.table("numbers.own", program.numbers or (0.0,)))
    results = programs.evaluate(f, program, {"given": Array(f, "%given"), NUMBERS: own}, 1)
    for (k, _), x in zip(varying, results["table"]):
        f.store(x, f.offset(f"%{NUMBERS}", k))
    f.ret(f.select_int(f.compare("ogt", results["alike"][0], 0.0), 1, 0))
    return module([f, *programs.functions.values()])


def behind_python(keys: Iterable[str]) -> CapabilityError:
    """Return the error of keys from which numbers follow otherwise than by arithmetic; its details name them."""
    names = sorted(set(keys))
    return CapabilityError(BEHIND, (listed(names),), keys=names)


def _values(recipe: Recipe, symbols: Mapping[str, Expr], wanted: set[int]) -> list[Any]:
    """Return the steps of a recipe that lead to wanted values as expressions of the keys."""
    needed = set(wanted)
    for k in reversed(range(len(recipe.steps))):
        if k in needed:
            needed.update(recipe.steps[k][2])
    derived = [data for k, (op, data, _) in enumerate(recipe.steps) if k in needed and op == "derived"]
    if derived:
        raise behind_python(place for inputs in derived for place in places(inputs) if place in symbols)
    values: list[Any] = []
    for k, (op, data, args) in enumerate(recipe.steps):
        if k not in needed:
            values.append(None)
        elif op == CONSTANT:
            values.append(data)
        elif op == "literal":
            values.append(symbols[data])
        else:
            values.append(_operation(op, [values[a] for a in args]))
    return values


def _operation(op: str, args: Sequence[Any]) -> Any:
    """Return one step of a recipe: an expression, a number where all arguments are."""
    a, b = args[0], args[-1]
    if op in ("add", "sub"):
        total = a + b if op == "add" else a - b
        # what cancels is zero, as in Python
        return where(absolute(total) - CANCELLED * maximum(absolute(a), absolute(b)), total, 0.0)
    if op == "mul":
        return a * b
    if op == "div":
        return a / b
    if op == "neg":
        return -a
    graph = next(x.graph for x in args if isinstance(x, Expr))
    return graph.unary(op, a) if len(args) == 1 else graph.binary(op, *args)


def _positive(name: str, a: Any, b: Any, outcome: bool) -> Any:
    """Return an expression that is positive where a comparison turns out as it did."""
    if name in POSITIVE:
        sign, holds = POSITIVE[name]
        apart = sign * (a - b)
    else:
        apart, holds = absolute(a - b), name == "ne"
    return where(apart, 1.0, 0.0) if holds == bool(outcome) else where(apart, 0.0, 1.0)
