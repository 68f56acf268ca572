"""Expressions of a state as compiled functions, of one state or of many, a row each; inverse and forward dynamics of
open chains among them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from robodyn_cli.equations.gears import geared
from robodyn_cli.equations.linear.residuals import LAMBDA
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError
from robodyn_cli.expr.graph import free_symbols
from robodyn_cli.kernels.crossover import prefer_rolled
from robodyn_cli.model.model import Model
from robodyn_cli.record import record
from robodyn_cli.scene import types as sc
from robodyn_cli.spatial.algebra import Array, Vector, zeros

if TYPE_CHECKING:
    from robodyn_cli.kernels.program import Program
    from robodyn_cli.kernels.rolled.kernels import RolledPlan

# symbol groups of the arrays that functions take
GROUPS = {"q": "q", "qd": "v", "qdd": "a", "tau": "tau", LAMBDA: LAMBDA}
OUT = "out"  # the output of a kernel
LINE = 8  # numbers in a line of the cache, or in the widest vector


def open_problem(source: sc.Scene | Model | Problem, task: str) -> Problem:
    """Return the equations of an open chain.

    Raises
    ------
    CapabilityError : it has loops or prescribed joints.
    """
    if isinstance(source, Model):
        # every joint counts as actuated here, so torques and ``actuated`` do not matter
        nothing = sc.Scene(schema=1, robot=sc.Robot(joints=(), links=()), gravity=(0.0, 0.0, 0.0))
        source = Problem(nothing, model=source)
    problem = source if isinstance(source, Problem) else Problem(source)
    if problem.model.closures:
        raise CapabilityError(
            f"{task} as a function of independent samples exists for open chains only: closed loops and couplers (here "
            f"{problem.model.closures[0]!r}) tie the joints to each other and share the load; for a mechanism use "
            "`inverse` or `simulate`"
        )
    if problem.scene.prescribed:
        name = next(iter(problem.scene.prescribed))
        raise CapabilityError(
            f"{task} takes all motion from its input, so 'prescribed' ({name!r}) is not allowed there"
        )
    return problem


@record
class Arguments:
    """The arrays that a function takes: for each the names of its columns."""

    columns: Mapping[str, tuple[str, ...]]

    @staticmethod
    def of(problem: Problem, names: Sequence[str]) -> Arguments:
        """Return the arguments ``names``, of ``q``, ``qd``, ``qdd``, ``tau`` and ``lam``, the multipliers."""
        others = {"q": problem.model.q_names}
        if LAMBDA in names:
            others[LAMBDA] = problem.constraints.names
        return Arguments({name: others.get(name, problem.model.v_names) for name in names})

    def rows(self, arrays: Sequence[Any]) -> tuple[dict[str, Array], bool]:
        """Return arrays (T, n) by name, and whether one state was given, as arrays (n,).

        Raises
        ------
        CapabilityError : what is no array of real numbers, an array without exactly one column per joint (further
        columns would be ignored silently), or arrays of different lengths.
        """
        by_name = {name: _real(name, array) for name, array in zip(self.columns, arrays)}
        for name, array in by_name.items():
            joints = self.columns[name]
            if array.ndim not in (1, 2) or array.shape[-1] != len(joints):
                raise CapabilityError(
                    f"{name} has shape {array.shape}; needed: (samples, {len(joints)}), a row for each sample and a "
                    f"column for each of {', '.join(joints)}, or ({len(joints)},) for one state"
                )
        shapes = {name: array.shape[:-1] for name, array in by_name.items()}
        if len(set(shapes.values())) > 1:
            listed = ", ".join(f"{name} {array.shape}" for name, array in by_name.items())
            raise CapabilityError(f"arrays of different lengths: {listed}; needed: as many rows of each")
        one = () in shapes.values()
        return {n: array[None] if one else np.asfortranarray(array) for n, array in by_name.items()}, one


def _real(name: str, array: Any) -> Array:
    """Return what is given for an argument as an array of doubles.

    Raises
    ------
    CapabilityError : it is none of real numbers.
    """
    try:
        values = np.asarray(array)
        if values.dtype.kind in "fiub":
            return values.astype(float, copy=False)
    except ValueError:  # rows of different lengths
        pass
    raise CapabilityError(f"{name} is {array!r:.60}; needed: an array of real numbers")


class StateFunction:
    """Named arrays of expressions as a compiled function of states.

    Parameters
    ----------
    names : what it takes, of ``q``, ``qd``, ``qdd`` and ``tau``. outputs : arrays of expressions, of any shape. eager :
    see ``SampleKernel``.

    Calling it takes arrays (T, n), or (n,) for one state, and returns {output: (T, *shape)}, or {output: shape}.
    Results are column-ordered: the samples of each entry lie next to each other. Arrays with ``order="F"`` do too,
    and are read in place.

    Raises
    ------
    CapabilityError : the outputs depend on time. SceneError : on data that the scene does not give.
    """

    def __init__(
        self, problem: Problem, names: Sequence[str], outputs: Mapping[str, Any], eager: bool = False
    ) -> None:
        from robodyn_cli.kernels.samples import SampleKernel

        entries = {name: np.asarray(array, dtype=object) for name, array in outputs.items()}
        if any(symbol is problem.t for a in entries.values() for symbol in free_symbols(a.flat)):
            raise CapabilityError(
                "a point that moves by a formula of t has no place at a state; allowed: points fixed to links"
            )
        self.arguments = Arguments.of(problem, names)
        self.shapes = {name: array.shape for name, array in entries.items()}
        known = [GROUPS[name] for name in names]
        # a program for each: compiling takes more than twice as long for one that is twice as long
        self.kernels = {
            name: SampleKernel({OUT: list(a.flat)}, known, eager=eager) for name, a in entries.items()
        }

    def __call__(self, *arrays: Any) -> dict[str, Array]:
        rows, one = self.arguments.rows(arrays)
        return {name: a[0] if one else a for name, a in self.evaluate(rows).items()}

    def evaluate(self, rows: Mapping[str, Array]) -> dict[str, Array]:
        """Return {output: (T, *shape)} of arrays (T, n) by name.

        All outputs lie in one block of memory. Several large arrays the allocator would give back to the system, to
        take them anew at the next call; a page touched for the first time costs more than what is written to it.
        """
        groups = {GROUPS[name]: array for name, array in rows.items()}
        samples = len(next(iter(rows.values())))
        sizes = [math.prod(shape) for shape in self.shapes.values()]
        padded = max(samples, *(kernel.lanes for kernel in self.kernels.values()))
        parts = np.split(_block(padded, sum(sizes)), np.cumsum(sizes)[:-1], axis=1)
        arrays: dict[str, Array] = {}
        for (name, kernel), part in zip(self.kernels.items(), parts):
            out = kernel.evaluate(samples, groups, {OUT: part})[OUT]
            arrays[name] = out.reshape(samples, *self.shapes[name])
        return arrays


def _block(rows: int, columns: int) -> Array:
    """Return an empty column-ordered array that begins with a line of the cache: vectors then fill whole lines."""
    memory = np.empty(rows * columns + LINE)
    first = -(memory.ctypes.data // memory.itemsize) % LINE
    return memory[first : first + rows * columns].reshape(columns, rows).T


def timeless(problem: Problem) -> list[Vector]:
    """Return the torques beside those of the actuators by term, friction with the exact sign.

    Raises
    ------
    CapabilityError : some depend on time, which functions of samples do not take.
    """
    terms = list(problem.passive_forces(smooth=False).values())
    if any(symbol is problem.t for symbol in free_symbols([x for term in terms for x in term])):
        effects = zip(problem.model.forces, problem.elements.effects)
        acting = {
            force.name: [x for a in effect.actions for x in a.wrench.components] for force, effect in effects
        }
        names = ", ".join(n for n, xs in acting.items() if any(s is problem.t for s in free_symbols(xs)))
        raise CapabilityError(
            f"forces that depend on time ({names}) are not allowed in a function of q, qd and qdd; "
            "allowed: forces of constants, positions and rates"
        )
    return terms


def needed_torques(problem: Problem) -> Vector:
    """Return the torques that a motion needs, tau = M a + C v + G - tau_passive - tau_friction - tau_external (nv,).

    Raises
    ------
    CapabilityError : as ``timeless``.
    """
    tau = problem.inverse_dynamics
    for term in timeless(problem):
        tau = tau - term
    return tau


def forward_problem(source: sc.Scene | Model | Problem) -> Problem:
    """Return the equations of an open chain whose accelerations follow from its torques.

    Raises
    ------
    CapabilityError : it has loops, prescribed joints or gears with losses.
    """
    problem = open_problem(source, "forward dynamics")
    if geared(problem.model):
        raise CapabilityError("gear losses depend on the drive, so they have no forward dynamics of samples")
    return problem


Samples = Callable[[Array, Array, Array], Array]


class _Unrolled:
    """One expression graph as straight-line code; the third array of samples is symbol group ``group``."""

    def __init__(self, entries: Any, group: str, eager: bool) -> None:
        from robodyn_cli.kernels.samples import SampleKernel

        self.group = group
        self.kernel = SampleKernel({"out": list(entries)}, ("q", "v", group), eager=eager)
        self.operations = self.kernel.program.operations
        if eager:
            self.kernel.load()

    def __call__(self, q: Array, qd: Array, x: Array) -> Array:
        return self.kernel.evaluate(len(q), {"q": q, "v": qd, self.group: x})["out"]


class _JointForces:
    """The torques of springs, dampers and friction at many samples, if there are any."""

    def __init__(self, problem: Problem) -> None:
        from robodyn_cli.kernels.samples import SampleKernel

        terms = timeless(problem)
        self.kernel = SampleKernel({"f": list(sum(terms[1:], terms[0]))}, ("q", "v")) if terms else None
        self.operations = self.kernel.program.operations if self.kernel else 0

    def add_to(self, tau: Array, q: Array, qd: Array) -> Array:
        return tau + self.kernel(q=q, v=qd)["f"] if self.kernel else tau

    def take_from(self, tau: Array, q: Array, qd: Array) -> Array:
        return tau - self.kernel(q=q, v=qd)["f"] if self.kernel else tau


class _Samples:
    """A function of samples: q (T, nq) and two arrays (T, nv), whose columns are the joints of one model."""

    names: tuple[str, str, str]
    _call: Samples

    def _open(self, problem: Problem) -> None:
        self.joints = problem.model.v_names
        self._arguments = Arguments.of(problem, self.names)

    def _evaluate(self, *arrays: Any) -> Array:
        """Return the function's result (T, nv), or (nv,) of one state.

        Raises
        ------
        CapabilityError : arrays of shapes that do not fit.
        """
        rows, one = self._arguments.rows(arrays)
        values = self._call(*rows.values())
        return values[0] if one else values


class InverseDynamics(_Samples):
    """Joint torques that a motion needs, tau = M qdd + C qd + G - tau_passive - tau_friction - tau_external.

    Calling it takes q (T, nq), qd and qdd (T, nv) and returns tau (T, nv) [N m or N], columns in the order of
    the joints; of one state it takes (nq,) and (nv,) and returns (nv,). Column-ordered arrays (``order="F"``) of
    float64 are read in place, others are copied first; the result is column-ordered.

    Short chains become straight-line code, long ones a loop over their bodies (attribute ``shape``:
    ``unrolled`` or ``rolled``; attribute ``code``: the program, or the tables of the loop).

    eager : see ``SampleKernel``.
    """

    names = ("q", "qd", "qdd")

    def __init__(self, source: sc.Scene | Model | Problem, eager: bool = True) -> None:
        problem = open_problem(source, "inverse dynamics")
        self._open(problem)
        self.shape, self._call, self.operations, self.code = self._compile(problem, eager)

    @staticmethod
    def _compile(problem: Problem, eager: bool) -> tuple[str, Samples, int, Program | RolledPlan]:
        if prefer_rolled(problem.model):
            from robodyn_cli.kernels.rolled.kernels import RolledInverseDynamics

            if geared(problem.model):
                raise CapabilityError(
                    "loops over bodies do not support gear losses; allowed: the command inverse"
                )

            rigid, forces = RolledInverseDynamics(problem.model), _JointForces(problem)
            operations = rigid.plan.operations + forces.operations
            call = lambda q, qd, qdd: forces.take_from(rigid(q, qd, qdd), q, qd)  # noqa: E731
            return "rolled", call, operations, rigid.plan
        unrolled = _Unrolled(needed_torques(problem), "a", eager)
        return "unrolled", unrolled, unrolled.operations, unrolled.kernel.program

    def __call__(self, q: Array, qd: Array, qdd: Array) -> Array:
        """Return tau (T, nv), or (nv,) of one state."""
        return self._evaluate(q, qd, qdd)


class ForwardDynamics(_Samples):
    """Joint accelerations that torques cause, qdd = M^-1 (tau + tau_passive + tau_friction + tau_external - C qd - G).

    Calling it takes q (T, nq), qd and tau (T, nv) and returns qdd (T, nv); arrays and attributes as for
    ``InverseDynamics``, whose inverse it is: friction has the exact sign of the rate, and is 0 at rest.
    """

    names = ("q", "qd", "tau")

    def __init__(self, source: sc.Scene | Model | Problem) -> None:
        problem = forward_problem(source)
        self._open(problem)
        self.shape, self._call, self.operations = self._compile(problem)

    @staticmethod
    def _compile(problem: Problem) -> tuple[str, Samples, int]:
        if prefer_rolled(problem.model):
            from robodyn_cli.kernels.rolled.kernels import RolledForwardDynamics

            rigid, forces = RolledForwardDynamics(problem.model), _JointForces(problem)
            operations = rigid.plan.operations + forces.operations
            return "rolled", lambda q, qd, tau: rigid(q, qd, forces.add_to(tau, q, qd)), operations
        model = problem.model
        f: Any = zeros(model.nv)
        for k, symbol in enumerate(problem.graph.symbols(model.v_names, "tau")):
            f[k] = symbol
        for term in timeless(problem):
            f = f + term
        unrolled = _Unrolled(problem.free_accelerations(f - problem.bias), "tau", eager=True)
        return "unrolled", unrolled, unrolled.operations

    def __call__(self, q: Array, qd: Array, tau: Array) -> Array:
        """Return qdd (T, nv), or (nv,) of one state."""
        return self._evaluate(q, qd, tau)
