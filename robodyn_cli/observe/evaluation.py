"""Evaluate expressions at many samples, interpreted where that takes less time than compiling; refuse numbers that are
not finite, and say where they come from."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from robodyn_cli.decision import Decision
from robodyn_cli.errors import NumericalError, unknown_data
from robodyn_cli.expr.calculus import substitute
from robodyn_cli.expr.graph import Expr, Scalar, count_operations, free_symbols, reachable
from robodyn_cli.expr.rebuild import Interpreter, apply
from robodyn_cli.kernels.program import Program, make_program
from robodyn_cli.model.model import UNKNOWN_GROUP
from robodyn_cli.results.catalogue import lookup
from robodyn_cli.results.result import Result
from robodyn_cli.spatial.algebra import Array

if TYPE_CHECKING:
    from robodyn_cli.kernels.samples import SampleKernel
    from robodyn_cli.trajectories.motion import JointMotion

CONSTANT = "a number of the scene, or a product of some, exceeds the range of a double (1.8e308)"
TOO_LARGE = "it exceeds the range of a double (1.8e308), or is 0 / 0"
SIGNS = {"add": "+", "sub": "-", "mul": "*", "div": "/"}
# names of a motion's symbol groups in results
MOTION = {"t": ("time", "time"), "q": ("q", "position"), "v": ("qd", "rate"), "a": ("qdd", "acceleration")}


def first_fault(arrays: Mapping[str, Array]) -> tuple[str, tuple[int, ...]] | None:
    """Return name and index of the first number that is not finite, sample by sample of the first such array."""
    for name, array in arrays.items():
        # a finite sum has finite entries; one that overflows is examined entry by entry
        if not np.isfinite(array.sum()) and not np.isfinite(array).all():
            at = np.argwhere(~np.isfinite(array))[0]
            return name, tuple(int(k) for k in at)
    return None


def refuse_sampled(
    inputs: Mapping[str, Array], outputs: Mapping[str, Sequence[Scalar]], arrays: Mapping[str, Array]
) -> None:
    """Refuse outputs (T, n), evaluated from inputs (T, n) by symbol group, that are not finite.

    Raises
    ------
    NumericalError : names dataset, time and the operation that has no value.
    """
    fault = first_fault(inputs)
    if fault is not None:
        name, (sample, *_) = fault
        path, quantity = MOTION[name]
        raise not_finite(path, float(inputs["t"][sample, 0]), f"the motion has no finite {quantity} there")
    fault = first_fault(arrays)
    if fault is not None:
        name, (sample, *_) = fault
        values = {group: array[sample] for group, array in inputs.items()}
        raise not_finite(name, float(inputs["t"][sample, 0]), cause(outputs[name], values))


def cause(entries: Sequence[Scalar], values: Mapping[str, Sequence[float]]) -> str:
    """Return in words the first operation, in the order of evaluation, without a finite value of finite arguments.

    Parameters
    ----------
    entries : expressions. values : of their symbols, by group.
    """
    value: dict[int, Any] = {}
    for node in reachable(list(entries)):
        if node.op == "sym":
            _, group, position = node.value
            value[node.index] = np.atleast_1d(values[group][position])
            continue
        given = [value[a.index] for a in node.args]
        with np.errstate(all="ignore"):
            value[node.index] = np.atleast_1d(node.value if node.op == "const" else apply(node, given))
        if not np.isfinite(value[node.index][0]) and all(np.isfinite(x[0]) for x in given):
            return _operation(node, [float(x[0]) for x in given])
    return CONSTANT


def _operation(node: Expr, given: Sequence[float]) -> str:
    numbers = [f"{x:.6g}" for x in given]
    if node.op == "const":
        return CONSTANT
    sign = SIGNS.get(node.op)
    text = f"{node.op}({', '.join(numbers)})" if sign is None else f" {sign} ".join(numbers)
    undefined = (node.op == "div" and given[1] == 0.0) or node.op in ("sqrt", "log", "asin", "acos", "pow")
    return f"{text} has no value" if undefined else f"{text} exceeds the range of a double (1.8e308)"


def refuse_result(result: Result) -> None:
    """Refuse a result in which a number of a dataset or of the summary is not finite.

    Raises
    ------
    NumericalError : names dataset, column and time, or the key.
    """
    arrays = {path: item.data for path, item in result.variables.items()}
    fault = first_fault({path: _without_gaps(path, data) for path, data in arrays.items()})
    if fault is not None:
        path, at = fault
        item = result.variables[path]
        time = float(result.time[at[0]]) if item.dims[0] == "time" else float(result.time[0])
        column = f" of {item.names[at[-1]]!r}" if item.names else ""
        raise not_finite(path, time, TOO_LARGE, column)
    key = _not_finite(result.summary)
    if key is not None:
        raise NumericalError(
            f"{key} in the summary is not finite: {TOO_LARGE}",
            key=key, status="not_finite",
        )  # fmt: skip


def _without_gaps(path: str, data: Array) -> Array:
    """Return a dataset with 0 in place of those nan that it may have."""
    entry = lookup(path)
    return np.where(np.isnan(data), 0.0, data) if entry is not None and entry.has_gaps else data


def _not_finite(value: Any, key: str = "") -> str | None:
    """Return the dotted key of the first number that is not finite."""
    if isinstance(value, float):
        return None if np.isfinite(value) else key
    if isinstance(value, Mapping):
        entries = value.items()
    elif isinstance(value, (list, tuple)):
        entries = {str(k): x for k, x in enumerate(value)}.items()
    else:
        return None
    paths = (_not_finite(x, f"{key}.{name}" if key else str(name)) for name, x in entries)
    return next((x for x in paths if x is not None), None)


def not_finite(path: str, time: float, why: str, column: str = "") -> NumericalError:
    """Return the error that names a dataset, the time [s] and why a number of it is not finite."""
    message = f"{path}{column} is not finite at t = {time:.9g} s: {why}"
    return NumericalError(message, dataset=path, time=time, status="not_finite")


Outputs = Mapping[str, Sequence[Scalar]]

# measured: a numpy operation costs about 1.3 us and 2 ns a sample, compiling 35 ms (half of it the import)
# and 80 us an operation; a compiled operation is too cheap to count
CALL, ENTRY = 1.3e-6, 2e-9
COMPILER, OPERATION = 35e-3, 80e-6
BLOCK = 2048  # samples interpreted at a time, so that the intermediate results stay in the cache


def compiling(operations: int) -> float:
    """Return the time that compiling so many operations takes [s]."""
    return COMPILER + OPERATION * operations


def worth_compiling(operations: int, samples: int) -> bool:
    """Tell whether compiling so many operations takes less time than interpreting them at so many samples."""
    return operations * (CALL + ENTRY * samples) > compiling(operations)


class SampleFunction:
    """Named expressions as a function of samples.

    Parameters
    ----------
    outputs : arrays of expressions by name. known : symbol groups that calls will give.
    samples : how many samples are expected in all, which decides whether to compile.

    Raises
    ------
    SceneError : the outputs depend on data that the scene does not give.
    """

    def __init__(self, outputs: Outputs, known: Sequence[str], samples: int) -> None:
        self.outputs = {name: list(entries) for name, entries in outputs.items()}
        entries = list(itertools.chain(*self.outputs.values()))
        missing = [s.value[0] for s in free_symbols(entries) if s.value[1] not in known]
        if missing:
            raise unknown_data(missing)
        self.operations = count_operations(entries)
        self.samples = samples
        self.compiled = worth_compiling(self.operations, samples)
        self._known = tuple(known)
        # constants need no kernel; without names from the scene, scenes with equal equations share their code
        varying = [n for n, a in self.outputs.items() if any(isinstance(e, Expr) for e in a)]
        self._names = {f"o{k}": name for k, name in enumerate(varying)}
        self._constant = {
            name: np.array(a, dtype=float) for name, a in self.outputs.items() if name not in varying
        }
        # made by the first call: a plan makes none, and it is nearly as large as the expressions
        self._interpreter: Interpreter | None = None

    @cached_property
    def _kernel(self) -> SampleKernel:
        from robodyn_cli.kernels.samples import SampleKernel

        return SampleKernel(self._varying, self._known)

    @property
    def numbers(self) -> list[Sequence[Any]]:
        """The numbers that it reads: those of its program, and outputs that are numbers alone."""
        constant = [self.outputs[name] for name in self._constant]
        return [self._kernel.program.numbers or (0.0,), *constant]

    def take(self, numbers: Sequence[Array]) -> None:
        """Take the numbers of another scene of this structure in place of ``numbers``; it is compiled from then on."""
        self.compiled = True
        self._kernel.take(numbers[:1])
        self._constant = dict(zip(self._constant, numbers[1:]))

    @property
    def decision(self) -> Decision:
        """Whether the outputs are compiled, or interpreted."""
        taken, other = ("compiled", "interpreting") if self.compiled else ("interpreted", "compiling")
        reason = f"that takes less time than {other}"
        return Decision(f"evaluation at {self.samples} samples", taken, reason)

    @property
    def _varying(self) -> dict[str, list[Scalar]]:
        return {o: self.outputs[name] for o, name in self._names.items()}

    @property
    def program(self) -> Program:
        """The outputs as a program, whether compiled or interpreted."""
        return self._kernel.program if self.compiled else make_program(dict(self._varying), self._known)

    def __call__(self, **groups: Array) -> dict[str, Array]:
        """Return {output: (T, n)} in column order, from arrays (T, n) by symbol group."""
        samples = len(next(iter(groups.values())))
        if self.compiled:
            arrays = {self._names[o]: array for o, array in self._kernel(**groups).items()}
            return {
                name: arrays[name] if name in arrays else np.tile(self._constant[name], (samples, 1))
                for name in self.outputs
            }
        if self._interpreter is None:
            self._interpreter = Interpreter(list(itertools.chain(*self.outputs.values())))
        out = {name: np.empty((samples, len(a)), order="F") for name, a in self.outputs.items()}
        for start in range(0, samples, BLOCK):
            part = slice(start, min(start + BLOCK, samples))
            values = iter(self._interpreter({group: array[part].T for group, array in groups.items()}))
            for name, entries in self.outputs.items():
                for k in range(len(entries)):
                    out[name][part, k] = next(values)
        return out

    def along(self, times: Array, motion: JointMotion, p: Array | None = None) -> dict[str, Array]:
        """Return {output: (T, n)} along a motion, with parameters p (T, n) where there are any.

        Raises
        ------
        NumericalError : a number is not finite; says which, when and why.
        """

        inputs = {"t": times[:, None], "q": motion.q, "v": motion.qd, "a": motion.qdd}
        arrays = self(**inputs) if p is None else self(**inputs, p=p)
        refuse_sampled(inputs, self.outputs, arrays)
        return arrays


def unknowns(outputs: Sequence[Scalar]) -> list[Expr]:
    """Return the symbols of unknown data that the outputs depend on."""
    return [s for s in free_symbols(outputs) if s.value[1] == UNKNOWN_GROUP]


def without_idle_unknowns(outputs: Sequence[Scalar], needed: Iterable[Scalar]) -> list[Scalar]:
    """Return outputs with those unknown data set to zero that ``needed`` does not depend on. For quantities that
    depend on such data by an additive constant only, or by terms that cancel: a potential energy, where ``needed`` are
    the torques that are its gradient. ``needed`` is gone through only where there are unknown data.
    """
    unknown = unknowns(outputs)
    if not unknown:
        return list(outputs)
    used = {s.index for s in free_symbols(needed)}
    idle = {s.index: 0.0 for s in unknown if s.index not in used}
    return substitute(list(outputs), dict(idle)) if idle else list(outputs)
