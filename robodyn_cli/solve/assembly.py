"""Close the loops: exact positions and consistent velocities from approximate initial values."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from robodyn_cli.errors import GeometryError
from robodyn_cli.model.manifold import Manifold
from robodyn_cli.record import record
from robodyn_cli.solve.closure import CLOSED, ClosureEquations, Numbers, newton, rank
from robodyn_cli.solve.independent_rows import RANK_TOLERANCE, independent_rows, is_truss
from robodyn_cli.spatial.algebra import Array

ATTEMPTS = 24  # random starts


@record
class Assembled:
    """A closed configuration: q (nq,), v (nv,), the largest residuals, independent rows, and the other rows."""

    q: Array
    v: Array
    position_residual: float
    velocity_residual: float
    independent: tuple[int, ...]
    redundant: tuple[str, ...]


def assemble(
    equations: ClosureEquations,
    given: dict[str, float],
    rates: dict[str, float],
    hold: Sequence[str] = (),
    parameters: Sequence[float] = (),
) -> Assembled:
    """Close the loops at t = 0.

    Parameters
    ----------
    given : initial values by column of q; coordinates that are not given are found from many starts.
    rates : initial rates by column of v; the others follow from the velocity constraints, with least norm.
    hold : columns of q whose position stays exactly as given.

    Raises
    ------
    GeometryError : a loop cannot close (which, and by how much), or the rates contradict the constraints.
    SingularConfigurationError : the start is a singular configuration.
    """
    model = equations.model
    manifold = Manifold(model)
    place = {name: k for k, name in enumerate(model.q_names)}
    rate_place = {name: k for k, name in enumerate(model.v_names)}
    q = manifold.neutral()
    for name, value in given.items():
        q[place[name]] = value
    v = np.zeros(model.nv)
    for name, value in rates.items():
        v[rate_place[name]] = value
    if not equations.constraint_rows:
        return Assembled(q, v, 0.0, 0.0, (), ())
    numbers = Numbers(equations, parameters)
    lengths = numbers.lengths
    # a value for a quaternion counts for all three of its velocities
    places = [manifold.columns(k) for k in range(model.nv)]
    missing = [
        k
        for k, cs in enumerate(places)
        if not any(model.q_names[c] in given or model.q_names[c] in hold for c in cs)
    ]
    held = [k for k, cs in enumerate(places) if any(model.q_names[c] in hold for c in cs)]
    task = _Closing(
        free=[k for k in range(model.nv) if k not in held],
        missing=missing,
        turning=[
            int(manifold.position[k]) for k in missing if manifold.position[k] >= 0 and lengths[k] == 1.0
        ],
        held={name: q[place[name]] for name in hold},
    )
    q = _close(numbers, q, task)
    independent, redundant = independent_rows(numbers, q)
    v, remaining = _close_rates(numbers, q, v, [rate_place[n] for n in rates], held)
    return Assembled(
        q, v, float(np.abs(numbers.eta(q)).max()), remaining, independent,
        tuple(numbers.rows[i].name for i in redundant),
    )  # fmt: skip


@record
class _Closing:
    """Which coordinates may move while the loops are closed.

    free : velocity coordinates that are not held. missing : those without an initial value. turning : places in q of
    the missing ones that are angles. held : columns of q that are held, with their values.
    """

    free: list[int]
    missing: list[int]
    turning: list[int]
    held: dict[str, float]


def _close(numbers: Numbers, q: Array, task: _Closing) -> Array:
    """Return the closed configuration nearest to q, from q itself or from starts around it.

    Missing coordinates start anywhere. The others start further and further from q, but only if nothing nearer closes.
    """
    poses, tried = _close_from(numbers, q, task, [q, *starts_around(numbers, q, task.missing, np.pi, 1)])
    for seed, spread in enumerate((0.3, 1.0, np.pi), start=2):
        if not poses:
            poses, more = _close_from(numbers, q, task, starts_around(numbers, q, task.free, spread, seed))
            tried += more
    if not poses:
        raise _open_loop(numbers, task, tried)
    # a regular configuration is preferred to any singular one
    ranks = [rank(numbers.psi(closed), RANK_TOLERANCE) for _, closed in poses]
    return min((f for f, own in zip(poses, ranks) if own == max(ranks)), key=lambda f: f[0])[1]


def starts_around(
    numbers: Numbers, q: Array, coordinates: list[int], spread: float, seed: int
) -> list[Array]:
    """Return starts that differ from q by up to ``spread`` in the given coordinates; none without coordinates."""
    rng = np.random.default_rng(seed)
    starts = []
    for _ in range(ATTEMPTS if coordinates else 0):
        step = np.zeros(numbers.nv)
        step[coordinates] = rng.uniform(-spread, spread, len(coordinates)) * numbers.lengths[coordinates]
        starts.append(numbers.manifold.integrate(q, step))
    return starts


def _close_from(
    numbers: Numbers, q: Array, task: _Closing, starts: list[Array]
) -> tuple[list[tuple[float, Array]], list[tuple[float, Array]]]:
    """Return (distance from q, configuration) of the starts that close, and (residual, configuration) of every
    start."""
    given = [k for k in range(numbers.nv) if k not in task.missing]
    poses, tried = [], []
    for start in starts:
        if task.missing:  # first the unknown coordinates alone, so that the given ones pick the branch
            start, _ = newton(numbers, start, task.missing)
        closed, residual = newton(numbers, start, task.free)
        tried.append((residual, closed))
        if residual > CLOSED or numbers.turned(closed):
            continue
        wrapped = closed.copy()
        wrapped[task.turning] = (closed[task.turning] + np.pi) % (2 * np.pi) - np.pi
        if np.abs(numbers.relative(wrapped)).max() <= CLOSED:
            closed = wrapped
        moved = np.abs(numbers.manifold.difference(q, closed)) / numbers.lengths
        # rounded, so that rounding errors do not choose between equal distances
        poses.append((float(f"{moved[given].sum() + 1e-6 * moved[task.missing].sum():.9g}"), closed))
    return poses, tried


def _open_loop(numbers: Numbers, task: _Closing, tried: list[tuple[float, Array]]) -> GeometryError:
    """Return the error of a loop that cannot close, with the smallest gap that was found."""
    from scipy.optimize import minimize  # takes 0.4 s to import: only where something is already wrong

    free = task.free
    best: tuple[float, Array] | None = None
    for _, start in sorted(tried, key=lambda pair: pair[0])[:3]:

        def moved(x: Array, start: Array = start) -> Array:
            step = np.zeros(numbers.nv)
            step[free] = x * numbers.lengths[free]
            return numbers.manifold.integrate(start, step)

        def squares(x: Array, moved: Callable[[Array], Array] = moved) -> tuple[float, Array]:
            r = numbers.relative(moved(x))
            J = numbers.psi(moved(x))[:, free] * numbers.lengths[free] / numbers.sizes[:, None]
            return 0.5 * float(r @ r), J.T @ r

        q = start
        if free:
            # with quasi-velocities the gradient away from the start needs the rate of the manifold's exponential
            exact = not numbers.manifold.quasi
            optimum = minimize(
                squares if exact else lambda x: squares(x)[0],
                np.zeros(len(free)), jac=exact, method="BFGS", options={"gtol": 1e-10},
            )  # fmt: skip
            q = moved(optimum.x)
        sum_of_squares = float(np.sum(numbers.relative(q) ** 2))
        if best is None or sum_of_squares < best[0]:
            best = (sum_of_squares, q)
    assert best is not None
    eta = numbers.eta(best[1])
    if np.abs(eta / numbers.sizes).max() <= CLOSED:
        return _closed_elsewhere(numbers, best[1])
    return _other_attitude(numbers, task, best[1]) or _smallest_gap(numbers, task, best[1], eta)


def _other_attitude(numbers: Numbers, task: _Closing, q: Array) -> GeometryError | None:
    """Return the error of loops that close but for attitudes, None where their points do not meet either."""
    rows = [k for k, row in enumerate(numbers.rows) if row.kind in ("force", "m")]
    turns = [k for k in range(len(numbers.rows)) if k not in rows]
    if not turns:
        return None
    meeting = _Some(numbers, rows)
    starts = [q, *starts_around(numbers, q, task.free, 1.0, 5)] if rows else [q]
    closed = [
        there for there, left in (newton(meeting, start, task.free) for start in starts) if left <= CLOSED
    ]
    if not closed:
        return None
    nearest = min(closed, key=lambda there: float(np.abs(numbers.eta(there)[turns]).max()))
    eta = numbers.eta(nearest)
    worst = max(turns, key=lambda k: abs(eta[k]))
    row, angle = numbers.rows[worst], float(np.arcsin(min(1.0, abs(eta[worst]))))
    return GeometryError(
        f"the loop {row.closure!r} cannot close: its points meet, but not in the attitude asked for: axes stay "
        f"at least {angle:.6g} rad apart (row {row.name}) {_condition(task)}; check the axis, "
        "the rpy and the kind of closure",
        loop=row.closure, angle=angle, row=row.name, q=nearest.tolist(),
    )  # fmt: skip


class _Some:
    """The conditions of some rows (see ``Conditions``)."""

    def __init__(self, numbers: Numbers, rows: list[int]) -> None:
        self._numbers, self._rows = numbers, rows
        self.lengths, self.sizes = numbers.lengths, numbers.sizes[rows]

    def at(self, q: Array, t: float) -> tuple[Array, Array]:
        F, J = self._numbers.at(q, t)
        return F[self._rows], J[self._rows]

    def step(self, q: Array, dq: Array) -> Array:
        return self._numbers.step(q, dq)


def _condition(task: _Closing) -> str:
    held = ", ".join(f"{name} = {value:.6g}" for name, value in task.held.items())
    return f"with {held} held" if held else "whatever the joints do"


def _closed_elsewhere(numbers: Numbers, q: Array) -> GeometryError:
    """Return the error of loops that close, but far from the start or in another attitude."""
    names = ", ".join(numbers.turned(q))
    if not names:
        there = ", ".join(f"{n} {x:.6g}" for n, x in zip(numbers.q_names, q))
        text = (
            f"the loops close only far from 'initial.q', at {there}; give a start near that, or another one"
        )
        return GeometryError(text, gap=0.0, q=q.tolist())
    text = f"the loops close only with {names} in another attitude than asked for; check its rpy"
    return GeometryError(text, loop=names, gap=0.0, q=q.tolist())


def _where_free(numbers: Numbers, task: _Closing, q: Array) -> str:
    """Return words about where the loops close with nothing held."""
    if not task.held:
        return ""
    free, residual = newton(numbers, q, range(numbers.nv))
    if residual > CLOSED or numbers.turned(free):
        return ""
    free = np.where(np.abs(free) > CLOSED, free, 0.0)  # what is left of a zero
    pose = ", ".join(f"{name} {x:.6g}" for name, x in zip(numbers.q_names, free))
    loops = ", ".join(dict.fromkeys(row.closure for row in numbers.rows))
    stuck = f", where nothing can move: {loops} make a truss" if is_truss(numbers.psi(free)) else ""
    return f"; with nothing held the loops close at {pose}{stuck}"


def _smallest_gap(numbers: Numbers, task: _Closing, q: Array, eta: Array) -> GeometryError:
    """Return the error of the loop with the largest gap at q, where the loops come nearest to closing."""
    gaps: dict[str, float] = {}
    for value, row in zip(eta, numbers.rows):
        if row.kind == "force":
            loop = row.closure
            gaps[loop] = float(np.hypot(gaps.get(loop, 0.0), value))
    condition = _condition(task) + _where_free(numbers, task, q)
    worst = int(np.abs(eta / numbers.sizes).argmax())
    row, apart = numbers.rows[worst], float(abs(eta[worst]))
    loop = max(gaps, key=lambda name: gaps[name]) if gaps else ""
    if row.closure in numbers.couplers:
        text = (
            f"the coupler {row.closure!r} cannot hold: at best its terms miss its offset by {apart:.6g} "
            f"{row.unit} {condition}"
        )
        return GeometryError(text, coupler=row.closure, gap=apart, row=row.name, q=q.tolist())
    if not gaps or gaps[loop] < apart:
        loop, gap = row.closure, apart
        text = (
            f"the loop {loop!r} cannot close: the axes stay apart by {gap:.6g} (row {row.name}) {condition}"
        )
    else:
        gap = gaps[loop]
        text = f"the loop {loop!r} cannot close: at best a gap of {gap:.6g} m remains {condition}"
    return GeometryError(text, loop=loop, gap=gap, row=row.name, q=q.tolist())


def _close_rates(
    numbers: Numbers, q: Array, v: Array, given: list[int], hold: list[int]
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
            unit = "m/s" if row.kind in ("force", "m") else "rad/s"
            raise GeometryError(
                f"the initial rates contradict the constraints: {row.name} moves at {remaining:.6g} {unit}; "
                "give fewer of initial.qd",
                key="initial.qd", row=row.name, residual=remaining,
            )  # fmt: skip
    return new, remaining
