"""Coefficients of explicit Runge-Kutta pairs, exact where they are rational; each table checks its own sums on import.

Explicit Runge-Kutta methods: one loop over a tableau, written out by the compiler.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from functools import partial

from robodyn_cli.formulations.system import System
from robodyn_cli.integration_methods import IntegrationMethod
from robodyn_cli.integrators.runtime.memory import IntegerSlot
from robodyn_cli.integrators.stepping.control import StepAttempt, StepController, mean_squares
from robodyn_cli.integrators.stepping.stepper import Method, Stepper
from robodyn_cli.integrators.stepping.writer import Writer
from robodyn_cli.kernels.arrays import Array
from robodyn_cli.kernels.ir import Block, Int, Value
from robodyn_cli.record import record

# fmt: off



Row = tuple[float, ...]


@record
class ExplicitTable:
    """An explicit Runge-Kutta pair.

    A : strictly lower rows, extra stages for dense output included. b : weights. c : nodes.
    errors : weights of the error estimates. order : of the solution; error_order : of the estimate.
    dense : weights of the stages in dense output, whose meaning is its own; dense_order : of that output.
    """

    order: int
    error_order: int
    dense_order: int
    c: Row
    A: tuple[Row, ...]
    b: Row
    errors: tuple[Row, ...] = ()
    dense: tuple[Row, ...] = ()

    @property
    def stages(self) -> int:
        """Stages of a step, those for dense output only excluded."""
        return len(self.b)

    @property
    def first_same_as_last(self) -> bool:
        """Whether the last stage is the rate at the end of the step, and so the first stage of the next."""
        return self.c[self.stages - 1] == 1.0 and (*self.A[self.stages - 1], 0.0) == self.b

    def __post_init__(self) -> None:
        for i, row in enumerate(self.A):
            if abs(sum(row) - self.c[i]) > 1e-13 * max(1.0, sum(abs(x) for x in row)):
                raise ArithmeticError(f"row {i} does not sum to its node")
        for k in range(self.order):
            if abs(sum(w * c**k for w, c in zip(self.b, self.c)) - 1 / (k + 1)) > 1e-13:
                raise ArithmeticError(f"the weights fail at power {k}")
        for row in self.errors:
            if abs(sum(row)) > 1e-13:
                raise ArithmeticError("error weights do not sum to zero")


def fractions(text: str) -> Row:
    """Return fractions, written as ``1/6 -2 0.5``, as the doubles next to them."""
    return tuple(float(Fraction(x)) for x in text.split())


def triangle(*rows: str) -> tuple[Row, ...]:
    """Return the rows of A, of which the first is empty."""
    return ((), *(fractions(row) for row in rows))


# Hairer, Norsett and Wanner (1993), section II.10: DOP853; stages 13 to 15 serve dense output
DOP853 = ExplicitTable(
    order=8,
    error_order=8,
    dense_order=7,
    c=(0.0, 0.05260015195876773, 0.0789002279381516, 0.1183503419072274, 0.2816496580927726, 0.3333333333333333, 0.25, 0.3076923076923077, 0.6512820512820513, 0.6, 0.8571428571428571, 1.0, 1.0, 0.1, 0.2, 0.7777777777777778),
    A=(
        (),
        (0.05260015195876773,),
        (0.0197250569845379, 0.0591751709536137),
        (0.02958758547680685, 0.0, 0.08876275643042054),
        (0.2413651341592667, 0.0, -0.8845494793282861, 0.924834003261792),
        (0.037037037037037035, 0.0, 0.0, 0.17082860872947386, 0.12546768756682242),
        (0.037109375, 0.0, 0.0, 0.17025221101954405, 0.06021653898045596, -0.017578125),
        (0.03709200011850479, 0.0, 0.0, 0.17038392571223998, 0.10726203044637328, -0.015319437748624402, 0.008273789163814023),
        (0.6241109587160757, 0.0, 0.0, -3.3608926294469414, -0.868219346841726, 27.59209969944671, 20.154067550477894, -43.48988418106996),
        (0.47766253643826434, 0.0, 0.0, -2.4881146199716677, -0.590290826836843, 21.230051448181193, 15.279233632882423, -33.28821096898486, -0.020331201708508627),
        (-0.9371424300859873, 0.0, 0.0, 5.186372428844064, 1.0914373489967295, -8.149787010746927, -18.52006565999696, 22.739487099350505, 2.4936055526796523, -3.0467644718982196),
        (2.273310147516538, 0.0, 0.0, -10.53449546673725, -2.0008720582248625, -17.9589318631188, 27.94888452941996, -2.8589982771350235, -8.87285693353063, 12.360567175794303, 0.6433927460157636),
        (0.054293734116568765, 0.0, 0.0, 0.0, 0.0, 4.450312892752409, 1.8915178993145003, -5.801203960010585, 0.3111643669578199, -0.1521609496625161, 0.20136540080403034, 0.04471061572777259),
        (0.056167502283047954, 0.0, 0.0, 0.0, 0.0, 0.0, 0.25350021021662483, -0.2462390374708025, -0.12419142326381637, 0.15329179827876568, 0.00820105229563469, 0.007567897660545699, -0.008298),
        (0.03183464816350214, 0.0, 0.0, 0.0, 0.0, 0.028300909672366776, 0.053541988307438566, -0.05492374857139099, 0.0, 0.0, -0.00010834732869724932, 0.0003825710908356584, -0.00034046500868740456, 0.1413124436746325),
        (-0.42889630158379194, 0.0, 0.0, 0.0, 0.0, -4.697621415361164, 7.683421196062599, 4.06898981839711, 0.3567271874552811, 0.0, 0.0, 0.0, -0.0013990241651590145, 2.9475147891527724, -9.15095847217987),
    ),
    b=(0.054293734116568765, 0.0, 0.0, 0.0, 0.0, 4.450312892752409, 1.8915178993145003, -5.801203960010585, 0.3111643669578199, -0.1521609496625161, 0.20136540080403034, 0.04471061572777259),
    errors=(
        (0.01312004499419488, 0.0, 0.0, 0.0, 0.0, -1.2251564463762044, -0.4957589496572502, 1.6643771824549864, -0.35032884874997366, 0.3341791187130175, 0.08192320648511571, -0.022355307863886294, 0.0),
        (-0.18980075407240762, 0.0, 0.0, 0.0, 0.0, 4.450312892752409, 1.8915178993145003, -5.801203960010585, -0.4226823213237919, -0.1521609496625161, 0.20136540080403034, 0.02265179219836082, 0.0),
    ),
    dense=(
        (-8.428938276109013, 0.0, 0.0, 0.0, 0.0, 0.5667149535193777, -3.0689499459498917, 2.38466765651207, 2.117034582445028, -0.871391583777973, 2.2404374302607883, 0.6315787787694688, -0.08899033645133331, 18.148505520854727, -9.194632392478356, -4.436036387594894),
        (10.427508642579134, 0.0, 0.0, 0.0, 0.0, 242.28349177525817, 165.20045171727028, -374.5467547226902, -22.113666853125306, 7.733432668472264, -30.674084731089398, -9.332130526430229, 15.697238121770845, -31.139403219565178, -9.35292435884448, 35.81684148639408),
        (19.985053242002433, 0.0, 0.0, 0.0, 0.0, -387.0373087493518, -189.17813819516758, 527.8081592054236, -11.57390253995963, 6.8812326946963, -1.0006050966910838, 0.7777137798053443, -2.778205752353508, -60.19669523126412, 84.32040550667716, 11.99229113618279),
        (-25.69393346270375, 0.0, 0.0, 0.0, 0.0, -154.18974869023643, -231.5293791760455, 357.6391179106141, 93.40532418362432, -37.45832313645163, 104.0996495089623, 29.8402934266605, -43.53345659001114, 96.32455395918828, -39.17726167561544, -149.72683625798564),
    ),
)

# Dormand and Prince (1980); the seventh stage is the first of the next step. Dense output of Shampine (1986): row i are
# the coefficients of theta, theta^2, theta^3, theta^4 for stage i
DOPRI5 = ExplicitTable(
    order=5,
    error_order=5,
    dense_order=4,
    c=fractions("0 1/5 3/10 4/5 8/9 1 1"),
    A=triangle(
        "1/5",
        "3/40 9/40",
        "44/45 -56/15 32/9",
        "19372/6561 -25360/2187 64448/6561 -212/729",
        "9017/3168 -355/33 46732/5247 49/176 -5103/18656",
        "35/384 0 500/1113 125/192 -2187/6784 11/84",
    ),
    b=fractions("35/384 0 500/1113 125/192 -2187/6784 11/84 0"),
    errors=(fractions("-71/57600 0 71/16695 -71/1920 17253/339200 -22/525 1/40"),),
    dense=(
        fractions("1 -8048581381/2820520608 8663915743/2820520608 -12715105075/11282082432"),
        fractions("0 0 0 0"),
        fractions("0 131558114200/32700410799 -68118460800/10900136933 87487479700/32700410799"),
        fractions("0 -1754552775/470086768 14199869525/1410260304 -10690763975/1880347072"),
        fractions("0 127303824393/49829197408 -318862633887/49829197408 701980252875/199316789632"),
        fractions("0 -282668133/205662961 2019193451/616988883 -1453857185/822651844"),
        fractions("0 40617522/29380423 -110615467/29380423 69997945/29380423"),
    ),
)

RK4 = ExplicitTable(
    order=4,
    error_order=4,
    dense_order=3,
    c=fractions("0 1/2 1/2 1"),
    A=triangle("1/2", "0 1/2", "0 0 1"),
    b=fractions("1/6 1/3 1/3 1/6"),
)


# of the step controller that also looks at the last error (Hairer and Wanner 1996, IV.2)
SAFETY, GAIN = 0.9, 0.32


class ExplicitRungeKutta(Method):
    """Explicit Runge-Kutta method given by its tableau and its kind of dense output."""

    def __init__(self, table: ExplicitTable, output: type[ExplicitStepper], facts: IntegrationMethod) -> None:
        super().__init__(facts)
        self.table, self.output = table, output
        self.dense_order = table.dense_order
        self.vectors = self.adaptive

    def dense_size(self, system: System) -> int:
        return (self.output.rows + 1) * system.size

    def stepper(self, w: Writer) -> ExplicitStepper:
        return self.output(self, w)


class ExplicitStepper(Stepper[Sequence[Array]]):
    """Writes steps from a tableau; K are the rates at the stages, which dense output takes over.

    The first stage is evaluated only where it is not known (``RATE_KNOWN``): it is after a rejection, and where the
    rate at the end of the last step was evaluated and the state has stayed what it was there. It lies behind dense
    output.

    rows : of numbers, one a component, that dense output keeps.
    """

    rows: int

    def __init__(self, method: ExplicitRungeKutta, w: Writer) -> None:
        super().__init__(method, w)
        self.table = method.table
        self.K = [w.behind_dense(w.size * self.rows), *(w.array(2, 1) for _ in self.table.A[1:])]
        self.x = w.array(2, 1)
        self.known = w.integer_at(IntegerSlot.RATE_KNOWN)
        self.control = StepController(
            self.table.error_order, safety=SAFETY, floor=1e-10, least=0.2, most=10.0, gain=GAIN
        )

    def attempt(self, t: Value, h: Value, failed: Block) -> StepAttempt[Sequence[Array]]:
        f, w = self.f, self.w
        with f.when(f.compare_int("eq", f.load_int(self.known), 0)):
            w.rate(t, w.state, self.K[0])
            w.count(IntegerSlot.EVALUATIONS)
        f.store_int(1, self.known)
        for i in range(1, self.table.stages):
            self._stage(t, h, i)
        w.count(IntegerSlot.EVALUATIONS, self.table.stages - 1)
        for c in w.each(w.size):
            w.new[c] = f.muladd(h, self._sum(self.table.b, c), w.state[c])
        return StepAttempt(self._error(h), self.K)

    def _stage(self, t: Value, h: Value, i: int) -> None:
        f, w = self.f, self.w
        for c in w.each(w.size):
            self.x[c] = f.muladd(h, self._sum(self.table.A[i], c), w.state[c])
        w.rate(f.muladd(h, self.table.c[i], t), self.x, self.K[i])

    def _sum(self, weights: Sequence[float], component: Int | int) -> Value:
        """Return the weighted sum of the stages' rates of one component."""
        f = self.f
        total: Value | None = None
        for weight, rates in zip(weights, self.K):
            if weight != 0.0:
                k = rates[component]
                total = k * weight if total is None else f.muladd(k, weight, total)
        return f.constant(0.0) if total is None else total

    def _error(self, h: Value) -> Value | None:
        """Return the mean square of the error; a pair with two estimates takes them together (Hairer's DOP853)."""
        f, estimates = self.f, self.table.errors
        if not estimates:
            return None
        # errors are those of rates, which are rounded at each stage on its own
        rounded = None if self.w.rounded is None else [math.hypot(*weights) / h for weights in estimates]
        squares = mean_squares(
            self.w, len(estimates), lambda c: [self._sum(e, c) for e in estimates], rounded
        )
        with f.strict():
            if len(squares) == 1:
                return h * h * squares[0]
            return h * h * squares[0] * squares[0] / (f.muladd(squares[1], 0.01, squares[0]) + 1e-300)

    # -- dense output ---------------------------------------------------------------------------------
    def save_dense(self, t: Value, h: Value, kept: Sequence[Array]) -> None:
        self.f.store_int(0, self.known)
        with self.used(t, h):
            self._carry_over(self._store_dense(t, h, kept))
        if self.table.first_same_as_last:
            self._carry_over(kept[self.table.stages - 1])

    def _carry_over(self, last: Array | None) -> None:
        """Make the rate at the end of the step the first stage of the next, unless the state is projected."""
        w = self.w
        if last is not None and not self.method.moves_state(w.system):
            for c in w.each(w.size):
                self.K[0][c] = last[c]
            self.f.store_int(1, self.known)

    def _end_rate(self, t: Value, h: Value, room: Array) -> Array:
        """Return the rate at the end of the step, evaluated in ``room`` where no stage has it."""
        w, table = self.w, self.table
        if table.first_same_as_last:
            return self.K[table.stages - 1]
        w.rate(t + h, w.new, room)
        w.count(IntegerSlot.EVALUATIONS)
        return room

    def _store_dense(self, t: Value, h: Value, K: Sequence[Array]) -> Array | None:
        """Store the numbers of dense output; return the rate at the end of the step where it was evaluated."""
        raise NotImplementedError

    def _put(self, component: Int | int, values: Sequence[Value]) -> None:
        f, w = self.f, self.w
        for row, value in enumerate(values):
            f.store(value, f.offset("%dense", w.size * row + component))

    def _get(self, component: Int | int, width: int) -> list[Value]:
        f, w = self.f, self.w
        places = [f.offset("%dense", w.size * row + component) for row in range(self.rows)]
        return [f.splat(f.load(place), width) for place in places]


class CubicOutput(ExplicitStepper):
    """Dense output by the cubic Hermite polynomial from states and rates at the ends of a step: order 3."""

    rows = 4

    def _store_dense(self, t: Value, h: Value, K: Sequence[Array]) -> Array | None:
        w = self.w
        last = self._end_rate(t, h, w.array(2, 1))
        for c in w.each(w.size):
            self._put(c, (w.state[c], w.new[c], h * K[0][c], h * last[c]))
        return last

    def dense(self, u: Value, h: Value, out: Array) -> None:
        x = u + 1.0
        for c in self.w.each(self.w.size):
            a, b, da, db = self._get(c, u.width)
            # x^2 (3 - 2 x) goes from 0 to 1; the slopes enter with x (1 - x)
            out[c] = a + (b - a) * x * x * (3.0 - 2.0 * x) - x * u * (-u * da - x * db)


class QuarticOutput(ExplicitStepper):
    """Dense output by a polynomial of degree 4 from the stages, whose coefficients are ``table.dense``."""

    rows = 5

    def _store_dense(self, t: Value, h: Value, K: Sequence[Array]) -> Array | None:
        w, columns = self.w, list(zip(*self.table.dense))
        for c in w.each(w.size):
            self._put(c, [w.state[c], *(h * self._sum(column, c) for column in columns)])
        return None

    def dense(self, u: Value, h: Value, out: Array) -> None:
        x = u + 1.0
        for c in self.w.each(self.w.size):
            *lower, value = self._get(c, u.width)
            for coefficient in reversed(lower):
                value = self.f.muladd(value, x, coefficient)
            out[c] = value


class Dop853Output(ExplicitStepper):
    """Dense output of order 7 of DOP853, which takes four more stages (Hairer, Norsett and Wanner 1993, II.6)."""

    rows = 8

    def _store_dense(self, t: Value, h: Value, K: Sequence[Array]) -> Array | None:
        w, last = self.w, self.table.stages
        self._end_rate(t, h, K[last])
        for i in range(last + 1, len(K)):
            self._stage(t, h, i)
        w.count(IntegerSlot.EVALUATIONS, len(K) - last - 1)
        for c in w.each(w.size):
            delta = w.new[c] - w.state[c]
            start, end = h * K[0][c], h * K[last][c]
            rows = [w.state[c], delta, start - delta, 2.0 * delta - (start + end)]
            self._put(c, rows + [h * self._sum(weights, c) for weights in self.table.dense])
        return K[last]

    def dense(self, u: Value, h: Value, out: Array) -> None:
        x = u + 1.0
        for c in self.w.each(self.w.size):
            start, *rows = self._get(c, u.width)
            value = rows[-1] * x
            for k in range(6, 0, -1):
                value = (value + rows[k - 1]) * (x if k % 2 else -u)
            out[c] = value + start


dop853 = partial(ExplicitRungeKutta, DOP853, Dop853Output)  # of Dormand and Prince (Hairer et al. 1993)
dopri5 = partial(ExplicitRungeKutta, DOPRI5, QuarticOutput)  # of Dormand and Prince, MATLAB's ode45
rk4 = partial(ExplicitRungeKutta, RK4, CubicOutput)  # the classical method
