"""Close the loops: from rough initial values to exact positions and consistent velocities."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.errors import GeometryError, SingularConfigurationError
from robodyn_cli.expr.graph import Expr
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.loops.base import Row
from robodyn_cli.model.model import Model

Array = NDArray[Any]
ATTEMPTS = 24  # random starts for coordinates without an initial value
RANK_TOLERANCE = 1e-9


class Equations(Protocol):
    """What assembly needs of the equations (satisfied by ``equations.problem.Problem``)."""

    model: Model

    @property
    def constraint_rows(self) -> tuple[Row, ...]: ...


@dataclasses.dataclass(frozen=True)
class Assembled:
    """A closed configuration: q, v, the largest residuals, and rows that depend on the others."""

    q: Array
    v: Array
    position_residual: float
    velocity_residual: float
    independent: tuple[int, ...]
    redundant: tuple[str, ...]


class _Numbers:
    """eta, Psi and eta_t on numbers."""

    def __init__(self, equations: Equations, parameters: Sequence[float]) -> None:
        self.rows = equations.constraint_rows
        self.nv = equations.model.nv
        self.entries = [x for row in self.rows for x in row.psi]
        self.parameters = list(parameters)

    def _evaluate(self, outputs: list[Expr | float], q: Array, t: float) -> Array:
        return np.array(evaluate(outputs, {"q": q.tolist(), "t": [t], "p": self.parameters}), dtype=float)

    def eta(self, q: Array, t: float = 0.0) -> Array:
        return self._evaluate([r.eta for r in self.rows], q, t)

    def psi(self, q: Array, t: float = 0.0) -> Array:
        return self._evaluate(self.entries, q, t).reshape(len(self.rows), self.nv)

    def eta_t(self, q: Array, t: float = 0.0) -> Array:
        return self._evaluate([r.eta_t for r in self.rows], q, t)


def _newton(numbers: _Numbers, q: Array, free: Sequence[int], iterations: int = 60) -> tuple[Array, float]:
    """Solve eta = 0 in the free coordinates by damped Gauss-Newton steps; returns q and the largest residual."""
    q = q.copy()
    residual = numbers.eta(q)
    size = float(np.abs(residual).max(initial=0.0))
    stalled = 0
    for _ in range(iterations):
        if size < 1e-300 or stalled > 3:
            break
        J = numbers.psi(q)[:, free]
        step, *_ = np.linalg.lstsq(J, -residual, rcond=1e-12)
        largest = float(np.abs(step).max(initial=0.0))
        if largest > 0.7:
            step *= 0.7 / largest
        scale = 1.0
        for _ in range(12):
            trial = q.copy()
            trial[free] += scale * step
            new = numbers.eta(trial)
            if np.abs(new).max() < size:
                break
            scale *= 0.5
        else:
            break
        stalled = stalled + 1 if np.abs(new).max() > 0.5 * size else 0
        q, residual, size = trial, new, float(np.abs(new).max())
    return q, size


def mechanism_size(model: Model) -> float:
    """Return a length that stands for the size of the mechanism [m]."""
    total = 0.0
    for body in model.bodies:
        total += float(np.linalg.norm([x if not isinstance(x, Expr) else 0.0 for x in body.X_tree.r]))
    for frame in (*model.points.values(), *(f for loop in model.loops for f in (loop.first, loop.second))):
        total = max(total, float(np.linalg.norm([x if not isinstance(x, Expr) else 0.0 for x in frame.p])))
    return max(total, 1e-12)


def assemble(
    equations: Equations,
    given: dict[str, float],
    rates: dict[str, float],
    hold: Sequence[str] = (),
    parameters: Sequence[float] = (),
) -> Assembled:
    """Close the loops at t = 0.

    Parameters
    ----------
    given : initial values by joint; coordinates that are not given are found from many starts.
    rates : initial rates by joint; the others follow from the velocity constraints, with least norm.
    hold : joints whose position stays exactly as given.

    Raises
    ------
    GeometryError : a loop cannot close (which, and by how much), or the rates contradict the constraints.
    SingularConfigurationError : the start is a singular configuration.
    """
    model = equations.model
    numbers = _Numbers(equations, parameters)
    place = {b.joint_name: b.q for b in model.bodies}
    rate_place = {b.joint_name: b.v for b in model.bodies}
    q = np.zeros(model.nq)
    for name, value in given.items():
        q[place[name]] = value
    v = np.zeros(model.nv)
    for name, value in rates.items():
        v[rate_place[name]] = value
    if not numbers.rows:
        return Assembled(q, v, 0.0, 0.0, (), ())
    size = mechanism_size(model)
    free = [k for name, k in place.items() if name not in hold]
    missing = [k for name, k in place.items() if name not in given and name not in hold]
    q = _close(numbers, q, free, missing, [place[n] for n in given], size, equations)
    independent, redundant = _independent_rows(numbers, q, free)
    v, remaining = _close_rates(numbers, q, v, [rate_place[n] for n in rates], [rate_place[n] for n in hold])
    return Assembled(
        q, v, float(np.abs(numbers.eta(q)).max()), remaining, independent,
        tuple(numbers.rows[i].name for i in redundant),
    )  # fmt: skip


def _close(
    numbers: _Numbers, q: Array, free: list[int], missing: list[int], given: list[int], size: float,
    equations: Equations,
) -> Array:
    rng = np.random.default_rng(20240229)
    starts = [q]
    if missing:
        for _ in range(ATTEMPTS):
            start = q.copy()
            start[missing] = rng.uniform(-np.pi, np.pi, len(missing))
            starts.append(start)
    best: tuple[float, Array] | None = None
    worst: tuple[float, Array] | None = None
    for start in starts:
        if missing:  # first the unknown coordinates alone, so that the given ones pick the branch
            start, _ = _newton(numbers, start, missing)
        closed, residual = _newton(numbers, start, free)
        if worst is None or residual < worst[0]:
            worst = (residual, closed)
        if residual <= 1e-11 * size:
            angle = closed[given] - q[given]
            wrapped = closed.copy()
            wrapped[missing] = (closed[missing] + np.pi) % (2 * np.pi) - np.pi
            distance = float(np.abs(angle).sum()) + 1e-6 * float(np.abs(wrapped[missing]).sum())
            if np.abs(numbers.eta(wrapped)).max() <= 1e-11 * size:
                closed = wrapped
            if best is None or distance < best[0] - 1e-12:
                best = (distance, closed)
    if best is None:
        assert worst is not None
        eta = np.abs(numbers.eta(worst[1]))
        row = numbers.rows[int(eta.argmax())]
        loop = row.name.rsplit(".", 1)[0]
        gap = float(np.linalg.norm([e for e, r in zip(eta, numbers.rows) if r.name.rsplit(".", 1)[0] == loop]))
        raise GeometryError(
            f"the loop {loop!r} cannot close: at best a gap of {gap:.6g} m (row {row.name}) remains with the "
            "held joints as given",
            loop=loop, gap=gap, q=worst[1].tolist(),
        )  # fmt: skip
    return best[1]


def _close_rates(
    numbers: _Numbers, q: Array, v: Array, given: list[int], hold: list[int]
) -> tuple[Array, float]:
    """Return rates that satisfy Psi v + eta_t = 0, changing as few of the given ones as possible."""
    psi, eta_t = numbers.psi(q), numbers.eta_t(q)
    scale = max(float(np.abs(psi).max()), 1e-300) * max(float(np.abs(v).max()), 1.0)
    nv = len(v)
    for fixed in (set(given) | set(hold), set(hold) if not given else set(given), set()):
        free = [k for k in range(nv) if k not in fixed]
        new = v.copy()
        residual = psi @ new + eta_t
        for _ in range(3):
            if not free:
                break
            step, *_ = np.linalg.lstsq(psi[:, free], -residual, rcond=1e-12)
            new[free] += step
            residual = psi @ new + eta_t
        remaining = float(np.abs(residual).max())
        if remaining <= 1e-10 * scale:
            return new, remaining
        if fixed and given and fixed == set(given):
            row = numbers.rows[int(np.abs(residual).argmax())]
            raise GeometryError(
                f"the initial rates contradict the constraints: {row.name} moves at {remaining:.6g} m/s; "
                "give fewer of initial.qd",
                row=row.name, residual=remaining,
            )  # fmt: skip
    return new, remaining


def _rank(psi: Array) -> tuple[int, Array]:
    sigma = np.linalg.svd(psi, compute_uv=False)
    return int((sigma > RANK_TOLERANCE * max(float(sigma[0]), 1e-300)).sum()), sigma


def _independent_rows(numbers: _Numbers, q: Array, free: list[int]) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Tell rows that always depend on the others (redundant) from a loss of rank at this configuration alone."""
    psi = numbers.psi(q)
    here, _ = _rank(psi)
    m = len(numbers.rows)
    if here == m:
        return tuple(range(m)), ()
    # the rank at nearby closed configurations is that of the mechanism itself
    rng = np.random.default_rng(7)
    generic, example = here, psi
    for _ in range(6):
        moved, residual = _newton(numbers, q + 0.05 * rng.normal(size=len(q)), list(range(len(q))))
        if residual < 1e-9:
            rank, _ = _rank(numbers.psi(moved))
            if rank > generic:
                generic, example = rank, numbers.psi(moved)
    if here < generic:
        raise SingularConfigurationError(
            "the start is a singular configuration: the constraints lose rank there "
            f"({here} of {generic} independent rows), so multipliers are not unique; start away from it",
            rank=here, generic_rank=generic, kind="bifurcation",
        )  # fmt: skip
    keep: list[int] = []
    for i in range(m):
        if _rank(example[[*keep, i]])[0] > len(keep):
            keep.append(i)
    return tuple(keep), tuple(i for i in range(m) if i not in keep)
