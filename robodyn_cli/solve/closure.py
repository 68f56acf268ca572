"""The closure equations on numbers: the rank of their Jacobian, and the damped Gauss-Newton steps that solve them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import reduce
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.algorithms import bands
from robodyn_cli.expr.fixed import derived
from robodyn_cli.expr.functions import maximum, sqrt
from robodyn_cli.expr.graph import Expr, Scalar
from robodyn_cli.expr.rebuild import Evaluator
from robodyn_cli.loops.base import Row
from robodyn_cli.model.manifold import Manifold
from robodyn_cli.model.model import Model
from robodyn_cli.spatial.algebra import Array, vector

MOST_STEP = 0.7  # rad, or part of the size of the mechanism
ITERATIONS = 60
HALVINGS = 12  # of a step that does not lessen the residual
PATIENT = 3  # steps in a row that may fail to halve the residual
TINY = 1e-300
CLOSED = 1e-11  # rad, or part of the size of the mechanism, up to which loops count as closed
SAME = 1e-6  # rad, or part of the size of the mechanism, for configurations that count as one
SLOW = 6  # steps in a row that may fail to halve the residual
CUT = 1e-12  # ratio of singular values below which steps leave a direction alone
WORTH = 200_000  # operations in Python from which on reading code that works them off takes less time
ROUNDED = 1e-6  # the same, and the residual, for redundant rows that contradict by rounding in the data
RANK = 1e-8  # ratio of singular values below which rank is lost, in comparable units
LEAST_ROUNDED = 1e-10  # rad, or part of the size, that loops lack only where such rows contradict


def rank(A: Array, tolerance: float = RANK) -> int:
    """Return the rank of a matrix A (m, n), or the largest of several (T, m, n).

    A singular value counts if it exceeds ``tolerance`` times the largest one of its matrix.
    """
    return counted_rank(bands.singular_values(A), tolerance)


def least_step(J: Array, F: Array, cut: float | None = None) -> Array:
    """Return the least step x (n,) with J x = F for one J (m, n), in the sense of least squares.

    cut : ratio of singular values below which a direction is left alone; by default where rounding hides it.
    """
    banded = J.shape[0] == J.shape[1] and bands.Band.of(J[None]) is not None and np.isfinite(J).all()
    if banded and bands.full_rank(J[None], RANK)[0]:
        return np.asarray(bands.solved(J[None], F[None])[0])
    x, *_ = np.linalg.lstsq(J, F, rcond=cut)
    return np.asarray(x)


def counted_rank(sigma: Array, tolerance: float = RANK) -> int:
    """Return the same from singular values (k,) or (T, k), largest first."""
    counted = sigma > tolerance * np.maximum(sigma[..., :1], 1e-300)
    return int(counted.sum(axis=-1).max(initial=0))


def has_full_rank(A: Array, tolerance: float) -> NDArray[np.bool_]:
    """Tell of which matrices (T, m, n) all singular values count; of none that is not finite. See ``rank``."""
    full: NDArray[np.bool_] = regularity(A) > tolerance
    return full


def regularity(A: Array) -> Array:
    """Return the ratios of least to largest singular value of matrices A (T, m, n), 0 of those that are not finite."""
    finite: Any = np.isfinite(A).all(axis=(1, 2))
    known: Array = np.where(finite[:, None, None], A, 0.0)
    sigma = bands.singular_values(known)
    ratio: Array = sigma[:, -1] / np.maximum(sigma[:, 0], 1e-300)
    return ratio


class Conditions(Protocol):
    """Conditions F(q, t) = 0 with their derivatives.

    lengths : (nv,) size of a large motion of each coordinate. sizes : (m,) size of a large residual of each row.
    """

    lengths: Array
    sizes: Array

    def at(self, q: Array, t: float) -> tuple[Array, Array]:
        """Return F (m,) and J (m, nv)."""
        ...

    def step(self, q: Array, dq: Array) -> Array:
        """Return the position (nq,) reached from q by a small motion dq (nv,)."""
        ...


ODD = 100.0  # times the usual length, from which on a length seems to be in another unit


def mechanism_size(model: Model) -> float:
    """Return a characteristic length of the mechanism [m]: the sum of the distances from joint to joint, or more."""
    return _size(len(model.bodies), [float(x) for x in _lengths(model)])


def out_of_scale(model: Model) -> str:
    """Return words about a length that is so much larger than the others, that its unit may be another one."""
    places = {f"joint {body.joint_name!r}": [body.X_tree.r] for body in model.bodies}
    places |= {f"loop {loop.name!r}": [loop.first.p, loop.second.p] for loop in model.loops}
    lengths = {
        name: max(math.hypot(*(0.0 if isinstance(x, Expr) else float(x) for x in r)) for r in own)
        for name, own in places.items()
    }
    known = sorted(x for x in lengths.values() if x > 0.0)
    name = max(lengths, key=lambda name: lengths[name], default="")
    usual = known[(len(known) - 1) // 2] if known else math.inf
    if not name or lengths[name] < ODD * usual:
        return ""
    far = f"{name} is {lengths[name]:.6g} m from its link's origin"
    return f"; {far}, where others are {usual:.3g} m: are these metres?"


def size_number(model: Model) -> float:
    """Return the same as a number of the scene, for equations: it is computed from the lengths there."""
    bodies = len(model.bodies)
    (size,) = derived(lambda lengths: [_size(bodies, lengths)], _lengths(model))
    return size


def _lengths(model: Model) -> list[float]:
    """Return the coordinates of places, of joints first, and lengths of bars, each as a place along one axis."""
    ends = (frame.p for loop in model.loops for frame in (loop.first, loop.second))
    places = [*(body.X_tree.r for body in model.bodies), *(frame.p for frame in model.points.values()), *ends]
    bars = [vector([loop.element.length, 0.0, 0.0]) for loop in model.loops]
    return [0.0 if isinstance(x, Expr) else x for place in (*places, *bars) for x in place]


def staged_size(model: Model) -> float:
    """Return the same by arithmetic of numbers of the scene alone, which leaves the program without Python."""
    return _size(len(model.bodies), _lengths(model), lambda *r: sqrt(sum(x * x for x in r)), maximum)


def _size(
    bodies: int,
    lengths: Sequence[float],
    length: Callable[..., float] = math.hypot,
    larger: Callable[[float, float], float] = max,
) -> float:
    distances = [length(*lengths[k : k + 3]) for k in range(0, len(lengths), 3)]
    total = reduce(larger, [sum(distances[:bodies]), *distances[bodies:]])
    return total if total > 0.0 else 1.0


def rank_tolerances(model: Model, gap: Array | float, exact: float = RANK) -> Array:
    """Return the ratios of singular values (T,) below which rows depend on each other where loops are open by ``gap``
    (T,), rad or m: larger where what they lack is rounding in the data. exact : where they lack nothing."""
    residual = gap / max(mechanism_size(model), 1e-300)
    return np.where((residual > LEAST_ROUNDED) & (residual <= ROUNDED), ROUNDED, exact)


class ClosureEquations(Protocol):
    """The equations that assembly uses (satisfied by ``equations.problem.Problem``)."""

    model: Model

    @property
    def constraint_rows(self) -> tuple[Row, ...]: ...


class PointValues:
    """Expressions of q, t and parameters at one point after another: worked off in Python at first, in compiled code
    where that has taken a while.

    The number of operations decides and not their time, so that the same closing gives the same bits again.
    """

    def __init__(self, outputs: Sequence[Scalar], parameters: Sequence[float]) -> None:
        self._values = np.array([0.0 if isinstance(e, Expr) else float(e) for e in outputs])
        self._places = [k for k, e in enumerate(outputs) if isinstance(e, Expr)]
        self._moving, self._parameters = [outputs[k] for k in self._places], list(parameters)
        self._evaluate, self._done = Evaluator(self._moving), 0
        self._compiled: Callable[..., dict[str, Array]] | None = None

    def __call__(self, q: Array, t: float) -> Array:
        """Return the values at q (nq,) and t."""
        values = self._values.copy()
        values[self._places] = self._at(q, t)
        return values

    def _at(self, q: Array, t: float) -> list[float] | Array:
        if self._done <= WORTH:
            self._done += self._evaluate.operations
            return self._evaluate({"q": q.tolist(), "t": [t], "p": self._parameters})
        if self._compiled is None:
            from robodyn_cli.kernels.samples import SampleKernel, of_one_sample

            # stepwise, so that the order of nodes in the graph decides no bits
            kernel = SampleKernel({"x": self._moving}, ("q", "t", "p"), stepwise=True)
            self._compiled = of_one_sample(kernel, q=len(q), t=1, p=len(self._parameters))
        return self._compiled(q=q, t=t, p=self._parameters)["x"]


class Numbers:
    """eta (m,), Psi (m, nv) and eta_t (m,) as functions of numbers q (nq,) and t; the ``Conditions`` of assembly."""

    def __init__(self, equations: ClosureEquations, parameters: Sequence[float]) -> None:
        self.rows = equations.constraint_rows
        self.q_names, self.couplers = equations.model.q_names, equations.model.couplers
        self.model, self.manifold = equations.model, Manifold(equations.model)
        self.nv = equations.model.nv
        self.parameters = list(parameters)
        self._eta = self.values_of([row.eta for row in self.rows])
        self._eta_t = self.values_of([row.eta_t for row in self.rows])
        self._psi = self.values_of([x for row in self.rows for x in row.psi])
        self._both = self.values_of([x for row in self.rows for x in (row.eta, *row.psi)])
        self._cosines = self.values_of([row.cosine for row in self.rows])
        self.size = mechanism_size(equations.model)
        self.sizes = np.array([self.size if row.kind in ("force", "m") else 1.0 for row in self.rows])
        self.lengths = np.array([self.size if unit == "m" else 1.0 for unit in equations.model.v_units])

    def values_of(self, outputs: Sequence[Scalar]) -> PointValues:
        return PointValues(outputs, self.parameters)

    def eta(self, q: Array, t: float = 0.0) -> Array:
        return self._eta(q, t)

    def relative(self, q: Array) -> Array:
        return self.eta(q) / self.sizes

    def psi(self, q: Array, t: float = 0.0) -> Array:
        return self._psi(q, t).reshape(len(self.rows), self.nv)

    def at(self, q: Array, t: float) -> tuple[Array, Array]:
        both = self._both(q, t).reshape(len(self.rows), 1 + self.nv)
        return both[:, 0], both[:, 1:]

    def step(self, q: Array, dq: Array) -> Array:
        return self.manifold.integrate(q, dq)

    def turned(self, q: Array) -> list[str]:
        """Return the loops whose links are half a turn away from the attitude that is asked for."""
        cosines = self._cosines(q, 0.0)
        return sorted({row.closure for row, cosine in zip(self.rows, cosines) if cosine < 0.5})

    def eta_t(self, q: Array, t: float = 0.0) -> Array:
        return self._eta_t(q, t)


def newton(
    conditions: Conditions,
    q: Array,
    free: Sequence[int],
    patience: int = PATIENT,
    cut: float = CUT,
    enough: float = TINY,
) -> tuple[Array, float]:
    """Return q moved onto F = 0 at t = 0 by damped Gauss-Newton steps, and the largest relative residual.

    Steps are of least norm in coordinates divided by ``lengths``, which makes rad and m comparable.

    Parameters
    ----------
    free : velocity coordinates that may move. patience : steps in a row that may fail to halve the residual.
    cut : ratio of singular values below which a direction is left alone. enough : residual that needs no further
    step; by default steps go on as long as rounding lets them.
    """
    columns, lengths, sizes = list(free), conditions.lengths, conditions.sizes

    def at(q: Array) -> tuple[Array, Array, float]:
        """Return F and J, scaled, and the size of what steps can lessen of F."""
        F, J = conditions.at(q, 0.0)
        F, J = F / sizes, J[:, columns] * lengths[columns] / sizes[:, None]
        reached = _within_reach(F, J, cut) if cut > CUT else F
        return F, J, float(np.abs(reached).max(initial=0.0))

    F, J, size = at(q)
    slow = 0
    for _ in range(ITERATIONS):
        if not np.isfinite(size) or not np.all(np.isfinite(J)) or size < enough or slow > patience:
            break
        step = least_step(J, -F, cut)
        step *= min(1.0, MOST_STEP / max(float(np.abs(step).max(initial=0.0)), TINY))
        dq = np.zeros(len(lengths))
        for _ in range(HALVINGS):
            dq[columns] = step * lengths[columns]
            trial = conditions.step(q, dq)
            F_new, J_new, new = at(trial)
            if new < size:
                break
            step = 0.5 * step
        else:
            break
        slow = slow + 1 if new > 0.5 * size else 0
        q, F, J, size = trial, F_new, J_new, new
    return q, float(np.abs(F).max(initial=0.0))


def _within_reach(F: Array, J: Array, cut: float) -> Array:
    """Return the part of F (m,) along J (m, n), but where it is weaker than a ratio: the rest is contradiction."""
    if not np.isfinite(J).all():
        return F
    U, s, _ = np.linalg.svd(J, full_matrices=False)
    U = U[:, s > cut * s.max(initial=0.0)]
    return np.asarray(U @ (U.T @ F))


class ManyConditions(Protocol):
    """``Conditions`` of many runs side by side, on positions (N, nq) that are sums of steps; lengths and sizes may
    be those of each run (N, ...)."""

    @property
    def lengths(self) -> Array: ...
    @property
    def sizes(self) -> Array: ...

    def at_runs(self, q: Array) -> tuple[Array, Array]:
        """Return F (N, m) and J (N, m, nv)."""
        ...

    def part(self, rows: NDArray[np.intp]) -> ManyConditions:
        """Return the conditions of some of the runs (n,)."""
        ...


def newton_of_many(conditions: ManyConditions, q: Array, free: Sequence[int]) -> tuple[Array, Array]:
    """Return positions q (N, nq) moved by the steps of ``newton`` in many runs, and the relative residuals (N,)."""
    columns, q = list(free), q.copy()
    F, J, size = _scaled(conditions, q, columns)
    slow = np.zeros(len(q))
    moving: Any = np.isfinite(size)
    for _ in range(ITERATIONS):
        moving &= np.isfinite(J).all(axis=(1, 2)) & (size > TINY) & (slow <= PATIENT)
        waiting = np.flatnonzero(moving)
        if not len(waiting):
            break
        own, before = conditions.part(waiting), size.copy()
        step = capped(least_steps(J[waiting], -F[waiting]))
        for _ in range(HALVINGS):
            trial = q[waiting]
            trial[:, columns] += step * own.lengths[..., columns]
            there = _scaled(own, trial, columns)
            closer = there[2] < size[waiting]
            for known, new in zip((q, F, J, size), (trial, *there)):
                known[waiting[closer]] = new[closer]
            # what rounding is left of is as close as it gets
            again = ~closer & (size[waiting] > CLOSED)
            moving[waiting[~closer & ~again]] = False
            if not again.any():
                break
            waiting, own, step = waiting[again], own.part(np.flatnonzero(again)), 0.5 * step[again]
        else:
            moving[waiting] = False
        slow = np.where(size > 0.5 * before, slow + 1, 0)
    return q, size


def _scaled(conditions: ManyConditions, q: Array, columns: list[int]) -> tuple[Array, Array, Array]:
    """Return F (N, m) and J (N, m, n) in parts of sizes and lengths, and the largest part of F (N,)."""
    F, J = conditions.at_runs(q)
    lengths, sizes = conditions.lengths[..., columns], conditions.sizes
    F = F / sizes
    J = J[:, :, columns] * lengths[..., None, :] / sizes[..., :, None]
    return F, J, np.abs(F).max(axis=1, initial=0.0)


def capped(steps: Any) -> Any:
    """Return steps (N, n) with none longer than ``MOST_STEP``."""
    longest = np.abs(steps).max(axis=1, initial=0.0)
    return steps * np.minimum(1.0, MOST_STEP / np.maximum(longest, TINY))[:, None]


def least_steps(J: Array, F: Array) -> Array:
    """Return the least steps x (N, n) with J x = F for J (N, m, n); in the sense of least squares where there is none.

    Singular values, which only steps without rank or with more rows than columns need, take five times as long.
    """
    right, m, n = F[..., None], *J.shape[1:]
    steps: Array
    try:
        if m == n:
            return bands.solved(J, F)
        if m < n:
            transposed = np.swapaxes(J, 1, 2)
            steps = transposed @ np.linalg.solve(J @ transposed, right)
        else:
            steps = np.linalg.pinv(J, rcond=CUT) @ right
    except np.linalg.LinAlgError:
        steps = np.linalg.pinv(J, rcond=CUT) @ right
    return steps[..., 0]
