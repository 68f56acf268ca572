"""Closed loops: constraint rows, and the equations of motion with Lagrange multipliers.

Driven joints of a mechanism with loops: their accelerations by their torques, and the torques for accelerations.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.algorithms.kinematics import (
    BodyMotion,
    Pose,
    motions,
    point_jacobian,
    poses,
    prescribed_motion,
    slice_q,
    slice_v,
    step_motion,
)
from robodyn_cli.algorithms.linear import LdlFactor, minimum_degree
from robodyn_cli.expr.calculus import directional
from robodyn_cli.expr.graph import Expr, Scalar, is_nonzero, nonzero_entries
from robodyn_cli.loops.base import LoopFrame, Row
from robodyn_cli.model.model import BASE, FixedFrame, Loop, Model
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import (
    Array,
    Matrix,
    Transform,
    Values,
    Vector,
    dot,
    identity,
    vector,
    zeros,
)

EXPANDED = 10  # rows up to which a determinant is expanded as it stands


class LoopRows:
    """Constraint rows of loop closures at q, qd, each relative to the last common ancestor of its two bodies.

    Parameters
    ----------
    X : transforms from parent to body. q, qd : (nq,), (nv,).
    gravity : (3,) base coordinates. It cancels in the difference of the two ends; giving it makes their accelerations
    the same expressions as in the Newton-Euler pass.
    """

    def __init__(
        self, model: Model, X: Sequence[Transform], q: Values, qd: Values, gravity: Vector | None = None
    ) -> None:
        self.model, self.X, self.q, self.qd, self.gravity = model, X, q, qd, gravity
        self._known: dict[int, tuple[dict[int, Pose], dict[int, BodyMotion]]] = {}

    def of(self, loop: Loop) -> list[Row]:
        """Return the rows of one closure."""
        rows: list[Row] = loop.element.rows(*self.ends(loop))
        return rows

    def ends(self, loop: Loop) -> tuple[LoopFrame, LoopFrame]:
        """Return the two ends of a closure."""
        root = self.model.common_ancestor(loop.first.body, loop.second.body)
        return self._end(loop.first, root), self._end(loop.second, root)

    def _kinematics(self, root: int) -> tuple[dict[int, Pose], dict[int, BodyMotion]]:
        """Return poses and motions (for qdd = 0) relative to a body, in its coordinates."""
        if root not in self._known:
            self._known[root] = poses(self.model, self.X, root), self._motions(root)
        return self._known[root]

    def _motions(self, root: int) -> dict[int, BodyMotion]:
        model, rest = self.model, zeros(self.model.nv)
        if root == BASE:
            return motions(model, self.X, self.q, self.qd, rest, self.gravity)
        by_body = {root: BodyMotion.at_rest()}
        for k, body in enumerate(model.bodies):
            if k != root and body.parent in by_body:
                rates = slice_v(body, self.qd), slice_v(body, rest)
                by_body[k] = step_motion(body, self.X[k], slice_q(body, self.q), *rates, by_body[body.parent])
        return by_body

    def _end(self, frame: FixedFrame, root: int) -> LoopFrame:
        pose, motion = self._kinematics(root)
        here, moving = pose[frame.body], motion[frame.body]
        p = here.point(frame.p)
        Jv, Jw = point_jacobian(self.model, self.q, pose, frame.body, p, root)
        drift, second = prescribed_motion(self.model, frame)
        return LoopFrame(
            p,
            here.R @ frame.R,
            Jv,
            Jw,
            here.R @ moving.w,
            here.R @ (moving.acceleration_of(frame.p) + second),
            here.R @ moving.wd,
            self.qd,
            here.R @ drift,
        )


def vanishes(row: Row) -> bool:
    """Tell whether a row is identically zero and may be dropped, such as the rows of a planar loop out of its
    plane."""
    if row.entries or any(is_nonzero(x) for x in (row.eta, row.gamma, row.eta_t)):
        return False
    # where the links are half a turn off and no joint can turn them, assembly is to refuse that
    return isinstance(row.cosine, Expr) or row.cosine >= 0.5


@record
class Multipliers:
    """Accelerations qdd (nv,) and multipliers lam (m,), the solution of equation (36) of the lecture."""

    qdd: Vector
    lam: Vector


def solve_with_multipliers(
    factor: LdlFactor, f: Values, psi: Matrix, gamma: Values, switches: Sequence[Any] = ()
) -> Multipliers:
    """Solve M qdd = f + Psi^T lambda with Psi qdd + gamma = 0 (equation 36 of the lecture).

    With M = L D L^T, b = L^-1 f and Y = L^-1 Psi^T:
    (Y^T D^-1 Y) lambda = -(gamma + Y^T D^-1 b);  qdd = L^-T D^-1 (b + Y lambda).

    Parameters
    ----------
    switches : one for each of the last rows: 1 where the row holds, 0 where its multiplier is zero instead.
    """
    m = psi.shape[0]
    b = factor.forward(f)
    Y = [factor.forward_entries(nonzero_entries(row)) for row in psi]
    scaled = [{k: y * factor.inverse[k] for k, y in row.items()} for row in Y]
    A = zeros(m, m)
    rhs = zeros(m)
    for i, j in _overlapping(Y):
        A[i, j] = A[j, i] = _product(scaled[i], Y[j])
    for i in range(m):
        total = gamma[i]
        for k, x in scaled[i].items():
            total = total + x * b[k]
        rhs[i] = -total
    first = m - len(switches)
    for k, switch in enumerate(switches):
        i = first + k
        rhs[i] = rhs[i] * switch
        for j in range(m):
            if j != i:
                A[i, j] = A[j, i] = A[i, j] * switch
        A[i, i] = A[i, i] * switch + (1.0 - switch)
    lam = LdlFactor.of(A, minimum_degree(A)).solve(rhs)
    loaded = list(b)
    for i, row in enumerate(Y):
        for k, y in row.items():
            loaded[k] = loaded[k] + y * lam[i]
    return Multipliers(factor.backward([x * d for x, d in zip(loaded, factor.inverse)]), lam)


def _product(x: dict[int, Any], y: dict[int, Any]) -> Any:
    """Return the scalar product of two rows."""
    total: Any = 0.0
    for k, value in x.items():
        if k in y:
            total = total + value * y[k]
    return total


def _overlapping(rows: Sequence[dict[int, Any]]) -> list[tuple[int, int]]:
    """Return the pairs i >= j of rows with a column in common: the other entries of the Gram matrix are zero."""
    of_column: dict[int, list[int]] = {}
    for i, row in enumerate(rows):
        for k in row:
            of_column.setdefault(k, []).append(i)
    return sorted({(i, j) for users in of_column.values() for i in users for j in users if j <= i})


def correction(psi: Matrix) -> Callable[[Values], Vector]:
    """Return the function of a residual that gives the smallest x with Psi x = residual.

    It is x = Psi^T (Psi Psi^T + mu E)^-1 residual. mu is 1e-12 of the mean diagonal, far below any regular pose, and
    bounds the correction where Psi loses rank.
    """
    m, nv = psi.shape
    rows = [nonzero_entries(row) for row in psi]
    A = _gram(rows)
    trace: Any = 0.0
    for i in range(m):
        trace = trace + A[i, i]
    for i in range(m):
        A[i, i] = A[i, i] + trace * (1e-12 / m)
    factor = LdlFactor.of(A, minimum_degree(A))

    def smallest(residual: Values) -> Vector:
        out = zeros(nv)
        for row, x in zip(rows, factor.solve(residual)):
            for k, value in row.items():
                out[k] = out[k] + value * x
        return out

    return smallest


def gram(psi: Matrix) -> Matrix:
    """Return Psi Psi^T (m, m); rows without a common column cost nothing."""
    return _gram([nonzero_entries(row) for row in psi])


def _gram(rows: Sequence[dict[int, Any]]) -> Matrix:
    A = zeros(len(rows), len(rows))
    for i, j in _overlapping(rows):
        A[i, j] = A[j, i] = _product(rows[i], rows[j])
    return A


def determinant(A: Matrix) -> Any:
    """Return the determinant: the product of those of the blocks on the diagonal, where rows and columns of a large
    matrix have an order in which all other entries lie on one side of these (Duff, Erisman and Reid, Direct Methods for
    Sparse Matrices, chapter 6)."""
    if A.shape[0] <= EXPANDED:
        return _expanded(A)
    from scipy.sparse import csr_matrix
    from scipy.sparse.csgraph import connected_components, maximum_bipartite_matching

    entries = csr_matrix([[is_nonzero(x) for x in row] for row in A])
    column_of = maximum_bipartite_matching(entries, perm_type="column")
    if (column_of < 0).any():
        return 0.0
    _, block_of = connected_components(entries[:, column_of], connection="strong")
    value: Any = parity(column_of)
    for block in range(block_of.max() + 1):
        rows = np.flatnonzero(block_of == block)
        value = value * _expanded(A[np.ix_(rows, column_of[rows])])
    return value


def parity(order: Sequence[int] | NDArray[np.integer[Any]]) -> float:
    """Return 1 where an order is made by an even number of swaps, else -1."""
    seen, swaps = [False] * len(order), 0
    for k in range(len(order)):
        while not seen[k]:
            seen[k] = True
            k = int(order[k])
            swaps += not seen[k]
    return -1.0 if swaps % 2 else 1.0


def _expanded(A: Matrix) -> Any:
    """Return the determinant by expansion along rows, minors shared; structural zeros cost nothing.

    The work grows as n 2^n: meant for n up to about 10.
    """
    n = A.shape[0]
    minors: dict[frozenset[int], Any] = {frozenset(): 1.0}
    for row in reversed(range(n)):
        size = n - row
        level: dict[frozenset[int], Any] = {}
        for smaller, value in minors.items():
            if len(smaller) != size - 1:
                continue
            for column in range(n):
                if column in smaller or not is_nonzero(A[row, column]):
                    continue
                sign = -1.0 if sum(c < column for c in smaller) % 2 else 1.0
                key = smaller | {column}
                term = sign * (A[row, column] * value)
                level[key] = level[key] + term if key in level else term
        minors = level
    return minors.get(frozenset(range(n)), 0.0)


class DrivenJoints:
    """The driven coordinates d of M qdd = f + B tau + Psi^T lambda, Psi qdd + gamma = 0, without qdd and lambda:

        qdd_d = a_0 + A tau,   A = B^T P B,   P = M^-1 - M^-1 Psi^T (Psi M^-1 Psi^T)^-1 Psi M^-1

    A (n, n) is symmetric. Where n driven joints move n degrees of freedom it is positive definite but at dead points.
    With more joints than freedoms it has their rank, and A^+ gives torques of least norm for the accelerations nearest
    to those asked for: the torques that ``solve.load_sharing.share`` finds for a motion that the loops allow.

    Parameters
    ----------
    factor : of M. psi : (m, nv), independent rows. driven : their velocity coordinates. directions : (n, f) columns
    that span the range of A at some pose, where there are more joints than freedoms f; None otherwise.
    """

    def __init__(
        self, factor: LdlFactor, psi: Matrix, driven: Sequence[int], directions: Array | None = None
    ) -> None:
        self.factor, self.psi, self.directions = factor, psi, directions
        units = identity(psi.shape[1])
        self._unit = [factor.forward(units[k]) for k in driven]
        self._rows = [factor.forward(row) for row in psi]
        gram = self._products(self._rows, self._rows)
        self._loops = LdlFactor.of(gram, minimum_degree(gram))
        # what torques and loads give in the rows of the loops, whitened by the factor of Psi M^-1 Psi^T
        self._hold = [self._loops.forward(column) for column in self._products(self._unit, self._rows)]
        self.A = self._products(self._unit, self._unit)
        for i, x in enumerate(self._hold):
            for j, y in enumerate(self._hold):
                self.A[i, j] = self.A[i, j] - self._weighted(self._loops, x, y)

    def free(self, f: Values, gamma: Values) -> Vector:
        """Return a_0 (n,), the accelerations of the driven joints without their torques; f (nv,), gamma (m,)."""
        load = self.factor.forward(f)
        rows = [g + self._weighted(self.factor, y, load) for g, y in zip(gamma, self._rows)]
        held = self._loops.forward(rows)
        return vector(
            [
                self._weighted(self.factor, x, load) - self._weighted(self._loops, y, held)
                for x, y in zip(self._unit, self._hold)
            ]
        )

    def torques(self, accelerations: Values) -> Vector:
        """Return A^+ r (n,) of accelerations r that the torques give beside a_0.

        Of more joints than freedoms: A^+ = C^+T K C^+ with C = A S, K = S^T A S and the directions S.
        """
        if self.directions is None:
            return LdlFactor.of(self.A).solve(accelerations)
        C = self.A @ self.directions
        K = self.directions.T @ C
        normal = LdlFactor.of(C.T @ C)
        return C @ normal.solve(K @ normal.solve(C.T @ vector(accelerations)))

    def _products(self, some: Sequence[Vector], others: Sequence[Vector]) -> Matrix:
        products = zeros(len(some), len(others))
        for i, x in enumerate(some):
            for k, y in enumerate(others):
                products[i, k] = self._weighted(self.factor, x, y)
        return products

    @staticmethod
    def _weighted(factor: LdlFactor, x: Values, y: Values) -> Any:
        """Return x^T D^-1 y."""
        return dot([a * d for a, d in zip(x, factor.inverse)], y)


def coordinate_row(
    name: str, model: Model, q: Sequence[Scalar], terms: Mapping[str, float], value: Scalar, kind: str
) -> Row:
    """Return the row of a linear relation between joint coordinates, eta = sum c_i q_i - s(t), with its derivatives.

    ``terms`` are by column of q, of joints whose velocities are the rates of positions.
    """
    t = model.graph.symbol("t", "t")
    psi = zeros(model.nv)
    eta: Scalar = 0.0
    for joint, coefficient in terms.items():
        psi[model.v_names.index(joint)] = coefficient
        eta = eta + coefficient * q[model.q_names.index(joint)]
    rate = directional([value], [t], [1.0])[0]
    second = directional([rate], [t], [1.0])[0]
    return Row(name, eta - value, psi, -second, -rate, kind)
