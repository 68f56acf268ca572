"""Linearly implicit methods for stiff motion (no iteration, one factored matrix per step, exact Jacobian), and their
tables in transformed form, each of which checks its order on import."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property, partial
from typing import Any

import numpy as np

from robodyn_cli.formulations.system import System
from robodyn_cli.integration_methods import IntegrationMethod
from robodyn_cli.integrators.runtime.memory import IntegerSlot
from robodyn_cli.integrators.stepping.control import StepAttempt, StepController, mean_squares
from robodyn_cli.integrators.stepping.factors import derivatives_of, real_factors
from robodyn_cli.integrators.stepping.stepper import Method, Stepper, StepProgram
from robodyn_cli.integrators.stepping.writer import Writer
from robodyn_cli.kernels.arrays import Array
from robodyn_cli.kernels.ir import Block, Int, Value
from robodyn_cli.record import mutable_record, record
from robodyn_cli.spatial.algebra import Array as Floats

# fmt: off




Row = tuple[float, ...]
Tree = Any  # a tree is the sorted tuple of its branches


@record
class RosenbrockTable:
    """(E / (gamma h) - J) u_i = f(t + alpha_i h, y + sum a_ij u_j) + sum C_ij u_j / h + gamma_i h df/dt,
    y1 = y + sum m_i u_i, error = sum e_i u_i (Hairer and Wanner 1996, equations IV.7.25 and 7.26).

    order : of the solution. error_order : power of h with which the error estimate of a step falls. dense_order :
    of the continuous extension y(x) = y + x (y1 - y) + x (1 - x) (d_1 + x d_2 + ...), d_k = sum dense_kj u_j.
    """

    order: int
    error_order: int
    gamma: float
    a: tuple[Row, ...]
    C: tuple[Row, ...]
    m: Row
    e: Row
    dense_order: int
    dense: tuple[Row, ...]

    def __post_init__(self) -> None:
        self._check()

    def _lower(self, rows: tuple[Row, ...]) -> Floats:
        s = len(self.m)
        out = np.zeros((s, s))
        for i, row in enumerate(rows):
            out[i, : len(row)] = row
        return out

    @cached_property
    def Gamma(self) -> Floats:
        """Matrix of the untransformed method, gamma on the diagonal."""
        s = len(self.m)
        return np.linalg.inv(np.eye(s) / self.gamma - self._lower(self.C))

    @cached_property
    def alpha(self) -> Floats:
        """Nodes of the stages."""
        return np.asarray((self._lower(self.a) @ self.Gamma).sum(axis=1))

    @cached_property
    def gamma_sums(self) -> Floats:
        """Weights of df/dt."""
        return np.asarray(self.Gamma.sum(axis=1))

    def _check(self) -> None:
        """Check the order conditions of all rooted trees up to the order (Hairer and Wanner 1996, IV.7)."""
        A = self._lower(self.a) @ self.Gamma
        B = A + self.Gamma
        b = np.array(self.m) @ self.Gamma

        def phi(tree: Tree) -> Floats:
            if not tree:
                return np.ones(len(b))
            if len(tree) == 1:
                return np.asarray(B @ phi(tree[0]))
            product = np.ones(len(b))
            for child in tree:
                product = product * (A @ phi(child))
            return product

        for n in range(1, self.order + 1):
            for tree in rooted_trees(n):
                if abs(float(b @ phi(tree)) - 1.0 / density(tree)) > 1e-11:
                    raise ArithmeticError(f"a condition of order {n} fails")
        for x in (0.25, 0.5, 0.75):
            bend = sum(np.array(row) * x**k for k, row in enumerate(self.dense))
            inside = x * b + x * (1.0 - x) * (bend @ self.Gamma)
            for n in range(1, self.dense_order + 1):
                for tree in rooted_trees(n):
                    if abs(float(inside @ phi(tree)) - x**n / density(tree)) > 1e-11:
                        raise ArithmeticError(f"a condition of order {n} fails inside the step")


@record
class UsualForm:
    """Coefficients of a Rosenbrock method in its usual form (see ``transformed``); e : of the error."""

    order: int
    error_order: int
    alpha: tuple[Row, ...]
    gamma: tuple[Row, ...]
    b: Row
    e: Row
    dense_order: int
    dense: tuple[Row, ...]


def transformed(m: UsualForm) -> RosenbrockTable:
    """Return the transformed table of a method in its usual form.

    k_i = h f(t + alpha_i h, y + sum alpha_ij k_j) + h J sum gamma_ij k_j + gamma_i h^2 df/dt, y1 = y + sum b_i k_i;
    gamma : rows with the diagonal, which is the same in all. e : weights of the error estimate. dense : of the
    continuous extension.
    """
    s = len(m.b)
    A, G = np.zeros((s, s)), np.zeros((s, s))
    for i in range(s):
        A[i, : len(m.alpha[i])], G[i, : i + 1] = m.alpha[i], m.gamma[i]
    inverse = np.linalg.inv(G)
    a, C = A @ inverse, np.diag(1.0 / np.diag(G)) - inverse

    def rows(x: Floats) -> tuple[Row, ...]:
        return tuple(tuple(float(c) for c in x[i, :i]) for i in range(s))

    def row(x: Row) -> Row:
        return tuple(float(c) for c in np.array(x) @ inverse)

    weights = tuple(row(d) for d in m.dense)
    return RosenbrockTable(
        m.order, m.error_order, float(G[0, 0]), rows(a), rows(C), row(m.b), row(m.e), m.dense_order, weights
    )


def rooted_trees(n: int) -> list[Tree]:
    """Return the rooted trees with n nodes, a tree being the sorted tuple of its branches."""
    if n == 1:
        return [()]
    trees: set[Tree] = set()

    def fill(left: int, largest: int, chosen: Tree) -> None:
        if left == 0:
            trees.add(tuple(sorted(chosen, key=repr)))
        for k in range(min(left, largest), 0, -1):
            for tree in rooted_trees(k):
                fill(left - k, k, (*chosen, tree))

    fill(n - 1, n - 1, ())
    return sorted(trees, key=repr)


def nodes(tree: Tree) -> int:
    """Return the number of nodes."""
    return 1 + sum(nodes(t) for t in tree)


def density(tree: Tree) -> int:
    """Return the tree's density: the product of the sizes of all its subtrees."""
    total = nodes(tree)
    for branch in tree:
        total *= density(branch)
    return total


_LAST = (-7.502846399306121, 2.561846144803919, -11.627539656261098, -0.18268767659942256, 0.030198172008377946)

# Rodas5P of Steinebach (2023): order 5, L-stable, stiffly accurate
RODAS5P = RosenbrockTable(
    order=5,
    error_order=5,
    gamma=0.21193756319429014,
    a=(
        (),
        (3.0,),
        (2.849394379747939, 0.45842242204463923),
        (-6.954028509809101, 2.489845061869568, -10.358996098473584),
        (2.8029986275628964, 0.5072464736228206, -0.3988312541770524, -0.04721187230404641),
        _LAST,
        (*_LAST, 1.0),
        (*_LAST, 1.0, 1.0),
    ),
    C=(
        (),
        (-14.155112264123755,),
        (-17.97296035885952, -2.859693295451294),
        (147.12150275711716, -1.41221402718213, 71.68940251302358),
        (165.43517024871676, -0.4592823456491126, 42.90938336958603, -5.961986721573306),
        (24.854864614690072, -3.0009227002832186, 47.4931110020768, 5.5814197821558125, -0.6610691825249471),
        (30.91273214028599, -3.1208243349937974, 77.79954646070892, 34.28646028294783, -19.097331116725623,
         -28.087943162872662),
        (37.80277123390563, -3.2571969029072276, 112.26918849496327, 66.9347231244047, -40.06618937091002,
         -54.66780262877968, -9.48861652309627),
    ),
    m=(*_LAST, 1.0, 1.0, 1.0),
    e=(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0),
    dense_order=4,
    dense=(
        (25.948786856663858, -2.5579724845846235, 10.433815404888879, -2.3679251022685204, 0.524948541321073,
         1.1241088310450404, 0.4272876194431874, -0.17202221070155493),
        (-9.91568850695171, -0.9689944594115154, 3.0438037242978453, -24.495224566215796, 20.176138334709044,
         15.98066361424651, -6.789040303419874, -6.710236069923372),
        (11.419903575922262, 2.8879645146136994, 72.92137995996029, 80.12511834622643, -52.072871366152654,
         -59.78993625266729, -0.15582684282751913, 4.883087185713722),
    ),
)

# ode23s of Shampine and Reichelt (1997): order 2, L-stable, error from a formula of order 3; d = 1 / (2 + sqrt 2)
_D = 1.0 / (2.0 + 2.0**0.5)
_E32 = 6.0 + 2.0**0.5
ROSENBROCK23 = transformed(UsualForm(
    order=2,
    error_order=3,
    alpha=((), (0.5,), (0.0, 1.0)),
    gamma=((_D,), (-_D, _D), (_D * (_E32 - 2.0), -_D * _E32, _D)),
    b=(0.0, 1.0, 0.0),
    e=(1.0 / 6.0, -2.0 / 6.0, 1.0 / 6.0),
    dense_order=2,
    dense=((1.0 / (1.0 - 2.0 * _D), -1.0 / (1.0 - 2.0 * _D), 0.0),),
))


SAFETY = 0.9


class Rosenbrock(Method):
    """Rosenbrock method given by its table; dense output from its stages."""

    def __init__(self, table: RosenbrockTable, facts: IntegrationMethod) -> None:
        super().__init__(facts)
        self.table = table
        self.dense_order = table.dense_order
        self.proportion = min(1.0, table.order / table.error_order)

    def linearisation(self, system: System) -> StepProgram:
        return derivatives_of(system)

    def dense_size(self, system: System) -> int:
        return (2 + len(self.table.dense)) * system.size

    def stepper(self, w: Writer) -> RosenbrockStepper:
        return RosenbrockStepper(self, w)


@mutable_record
class Stages:
    """A step: what it adds to the state, and the stages u_i."""

    increments: Array
    u: list[Array]


class RosenbrockStepper(Stepper[Stages]):
    """Writes steps from a table."""

    def __init__(self, method: Rosenbrock, w: Writer) -> None:
        super().__init__(method, w)
        self.table = method.table
        self.u = [w.array(2, 1) for _ in self.table.m]
        self.x, self.rates, self.increments, self.errors = (w.array(2, 1) for _ in range(4))
        self.control = StepController(self.table.error_order, safety=SAFETY, floor=1e-10, least=0.2, most=6.0)

    def attempt(self, t: Value, h: Value, failed: Block) -> StepAttempt[Stages]:
        f, w, T = self.f, self.w, self.table
        factors = real_factors(w, t, w.state, (1.0 / T.gamma) / h)
        w.count(IntegerSlot.EVALUATIONS, len(T.m) + 1)
        per_h = 1.0 / h
        for i, stage in enumerate(self.u):
            before = self.u[:i]
            for c in w.each(w.size):
                self.x[c] = self._sum(T.a[i], before, c, w.state[c])
            w.rate(f.muladd(h, float(T.alpha[i]), t), self.x, self.rates)
            for c in w.each(w.size):
                right = f.muladd(per_h, self._sum(T.C[i], before, c), self.rates[c]) if i else self.rates[c]
                ft = factors.time_derivative(c) if T.gamma_sums[i] != 0.0 else None
                if ft is not None:
                    right = f.muladd(h * float(T.gamma_sums[i]), ft, right)
                stage[c] = right
            factors.solve(stage)
        # increments apart: in short steps dense output would lose their digits in the difference of two states
        for c in w.each(w.size):
            self.increments[c] = self._sum(T.m, self.u, c)
            w.new[c] = w.state[c] + self.increments[c]
            self.errors[c] = self._sum(T.e, self.u, c)
        square = mean_squares(w, 1, lambda c: [self.errors[c]])[0]
        return StepAttempt(square, Stages(self.increments, self.u))

    def _sum(
        self, weights: Sequence[float], u: Sequence[Array], c: Int | int, start: Value | None = None
    ) -> Value:
        f = self.f
        total = start
        for weight, stage in zip(weights, u):
            if weight != 0.0:
                total = stage[c] * weight if total is None else f.muladd(stage[c], weight, total)
        return f.constant(0.0) if total is None else total

    def save_dense(self, t: Value, h: Value, kept: Stages) -> None:
        w = self.w
        with self.used(t, h):
            for c in w.each(w.size):
                numbers = [w.state[c], kept.increments[c]]
                numbers += [self._sum(row, kept.u, c) for row in self.table.dense]
                for place, value in enumerate(numbers):
                    self._dense(place)[c] = value

    def _dense(self, place: int) -> Array:
        """Return the numbers of dense output at a place: start, increment, then what bends the way between."""
        return Array(self.f, self.f.offset("%dense", place * self.w.system.size))

    def dense(self, u: Value, h: Value, out: Array) -> None:
        """The method's own continuous extension, from its stages.

        Rates at the ends of the step have no place in it: in a stiff component they are the rounding error of the
        state times the fastest decay, which would show at every sample.
        """
        f, w = self.f, self.w
        x = u + 1.0
        kept = [self._dense(place) for place in range(2 + len(self.table.dense))]
        for c in w.each(w.size):
            x0, gained, *rest = (f.splat(numbers[c], u.width) for numbers in kept)
            bend = rest[-1]
            for d in reversed(rest[:-1]):
                bend = f.muladd(bend, x, d)
            out[c] = f.muladd(f.muladd(-u, bend, gained), x, x0)


rodas5p = partial(Rosenbrock, RODAS5P)  # of Steinebach: L-stable, for stiff springs and dampers
rosenbrock23 = partial(Rosenbrock, ROSENBROCK23)  # MATLAB's ode23s: L-stable, at loose tolerances
