"""Operations of programs as IR, sine and cosine of all lanes at once among them; rough powers for step control."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from robodyn_cli.errors import CapabilityError
from robodyn_cli.kernels.ir import Function, Int, Value, double_type, int_type
from robodyn_cli.kernels.program import TRIGONOMETRIC

# pi/2 in three parts of full precision: with fused multiply-add each product is exact, so the reduction holds
# for |x| up to about 2^49 (Cody and Waite 1980)
PI_2 = (1.5707963267948966, 6.123233995736766e-17, -1.4973849048591833e-33)
# without it, the first two with 33 bits: their products with whole numbers of 20 bits are exact, for |x| up to 1.6e6
PI_2_SHORT = (1.5707963267341256, 6.077100506303966e-11, 2.0222662487959506e-21)
TO_NEAREST = 6755399441055744.0  # 1.5 * 2^52: adding it rounds to a whole number, kept in the low bits
# Cephes' minimax coefficients on [-pi/4, pi/4]
SIN = (
    -1.66666666666666307295e-1,
    8.33333333332211858878e-3,
    -1.98412698295895385996e-4,
    2.75573136213857245213e-6,
    -2.50507477628578072866e-8,
    1.58962301576546568060e-10,
)
COS = (
    4.16666666666665929218e-2,
    -1.38888888888730564116e-3,
    2.48015872888517045348e-5,
    -2.75573141792967388112e-7,
    2.08757008419747316778e-9,
    -1.13585365213876817300e-11,
)

# functions that LLVM hands to the C library, lane by lane; its intrinsics have the same names
LIBRARY = frozenset(["exp", "log", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "pow", "atan2"])


def _whole(n: int, width: int) -> str:
    """Return an integer in every lane."""
    return str(n) if width == 1 else "<" + ", ".join([f"i64 {n}"] * width) + ">"


def polynomial(f: Function, coefficients: Sequence[float], z: Value) -> Value:
    """Return c0 + c1 z + c2 z^2 + ... by Estrin's scheme (short dependency chains)."""
    level: list[Value | float] = list(coefficients)
    power = z
    while len(level) > 1:
        level = [
            f.muladd(level[k + 1], power, level[k]) if k + 1 < len(level) else level[k]
            for k in range(0, len(level), 2)
        ]
        if len(level) > 1:
            power = power * power
    return f.lift(level[0], z.width)


def _reduced(f: Function, n: Value, x: Value) -> tuple[Value, Value]:
    """Return x - n pi/2 as a sum of two, by products that need not be fused: all but the last are exact."""
    high, low, least = PI_2_SHORT
    whole = x - n * high
    part = n * low
    first = whole - part
    behind = ((whole - first) - part) - n * least
    r = first + behind
    return r, behind - (r - first)


def sincos(f: Function, x: Value, fused: bool = True) -> tuple[Value, Value]:
    """Return sin x and cos x, all lanes at once, to about one unit in the last place.

    NaN and infinities give NaN. Without fused multiply-add (``fused`` false) they are within two units for |x| up to
    1e6; beyond that x itself counts as rounded by one unit more.
    """
    width = x.width
    t, i = double_type(width), int_type(width)

    def whole(n: int) -> str:
        return _whole(n, width)

    with f.strict():
        shifted = f.muladd(x, 2.0 / np.pi, TO_NEAREST)
        n = shifted - TO_NEAREST
        if fused:
            r = x
            for part in PI_2:
                r = f.fma(n, -part, r)
        else:
            r, rest = _reduced(f, n, x)
        z = r * r
        s, c = polynomial(f, SIN, z), polynomial(f, COS, z)
        s = f.muladd(r * z, s, r) if fused else r + f.muladd(r * z, s, rest)
        c = f.muladd(z * z, c, f.muladd(z, -0.5, 1.0))
        # the quadrant is in the low bits of ``shifted``: odd swaps sine and cosine, bit 1 is the sign
        bits = f.name(f"bitcast {t} {shifted.ref} to {i}")
        odd = f.name(f"and {i} {bits}, {whole(1)}")
        swap = f.name(f"icmp ne {i} {odd}, {whole(0)}")
        flag = int_type(width, 1)
        sine = f.emit(f"select {flag} {swap}, {t} {c.ref}, {t} {s.ref}", width)
        cosine = f.emit(f"select {flag} {swap}, {t} {s.ref}, {t} {c.ref}", width)

        def with_sign(value: Value, quadrant: str) -> Value:
            high = f.name(f"shl {i} {quadrant}, {whole(62)}")
            sign = f.name(f"and {i} {high}, {whole(-(2**63))}")
            raw = f.name(f"bitcast {t} {value.ref} to {i}")
            flipped = f.name(f"xor {i} {raw}, {sign}")
            return f.emit(f"bitcast {i} {flipped} to {t}", width)

        next_quadrant = f.name(f"add {i} {bits}, {whole(1)}")
        return with_sign(sine, bits), with_sign(cosine, next_quadrant)


def _fit(x: NDArray[np.float64], y: NDArray[np.float64], degree: int) -> list[float]:
    """Return coefficients, lowest power first. (numpy.polynomial would take longer to import than all this.)"""
    return [float(c) for c in np.polyfit(x, y, degree)[::-1]]


def _fit_log2(degree: int) -> list[float]:
    x = np.cos((np.arange(40) + 0.5) * np.pi / 40) * 0.5 + 1.5
    return _fit(x, np.log2(x) - 1023, degree)


def _fit_exp2(degree: int) -> list[float]:
    x = np.linspace(-0.5, 0.5, 41)
    return _fit(x, 2.0**x, degree)


def rough_log2(f: Function, x: Value) -> Value:
    """Return log2 x to about 1e-4, for positive normal x."""
    t, i = double_type(x.width), int_type(x.width)
    with f.strict():
        bits = f.name(f"bitcast {t} {x.ref} to {i}")
        e = f.name(f"lshr {i} {bits}, {_whole(52, x.width)}")
        fraction = f.name(f"and {i} {bits}, {_whole(2**52 - 1, x.width)}")
        mantissa = f.name(f"or {i} {fraction}, {_whole(1023 << 52, x.width)}")
        m = f.emit(f"bitcast {i} {mantissa} to {t}", x.width)
        return polynomial(f, _fit_log2(5), m) + f.emit(f"sitofp {i} {e} to {t}", x.width)


def rough_exp2(f: Function, x: Value) -> Value:
    """Return 2 ** x to about 1e-4, for x within 1000; beyond, what it is there."""
    t, i = double_type(x.width), int_type(x.width)
    with f.strict():
        x = f.max(f.min(x, 1000.0), -1000.0)
        shifted = x + TO_NEAREST
        rest = x - (shifted - TO_NEAREST)
        y = polynomial(f, _fit_exp2(4), rest)
        raw = f.name(f"bitcast {t} {y.ref} to {i}")
        n = f.name(f"bitcast {t} {shifted.ref} to {i}")
        scale = f.name(f"shl {i} {n}, {_whole(52, x.width)}")
        total = f.name(f"add {i} {raw}, {scale}")
        return f.emit(f"bitcast {i} {total} to {t}", x.width)


def _where(f: Function, x: Value, a: Value, b: Value) -> Value:
    return f.select(f.compare("ogt", x, 0.0), a, b)


def _sign(f: Function, x: Value) -> Value:
    one = f.intrinsic("copysign", [f.constant(1.0, x.width), x])
    # x itself where it is zero or NaN
    return f.select(f.compare("une", x, 0.0) & f.compare("ord", x, 0.0), one, x)


def operation(f: Function, op: str, args: Sequence[Value], fused: bool) -> Value:
    """Emit one operation of a program on values, look-ups in tables excepted."""
    if op == "add":
        return args[0] + args[1]
    if op == "sub":
        return args[0] - args[1]
    if op == "mul":
        return args[0] * args[1]
    if op == "div":
        return args[0] / args[1]
    if op == "neg":
        return -args[0]
    if op == "sqrt":
        return f.sqrt(args[0])
    if op == "abs":
        return f.abs(args[0])
    if op == "sign":
        return _sign(f, args[0])
    if op == "round":
        return f.intrinsic("rint", args)
    if op == "min":
        return f.min(args[0], args[1])
    if op == "max":
        return f.max(args[0], args[1])
    if op == "where":
        return _where(f, args[0], args[1], args[2])
    if op in TRIGONOMETRIC:
        return sincos(f, args[0], fused)[op == "cos"]
    if op in LIBRARY:
        return f.intrinsic(op, args)
    raise CapabilityError(f"the operation {op} cannot be compiled")


# -- piecewise polynomials ------------------------------------------------------------------------------------
# Their numbers lie in a program's table: n knots, n - 1 coefficients of each power from the lowest on, and the values
# held beyond the ends.
def halvings(n: int) -> int:
    """Return how many halvings find one of n - 1 segments; so many need no test of their own."""
    return max(1, (n - 1).bit_length())


def piecewise(f: Function, x: Value, at: str, shape: Sequence[int]) -> Value:
    """Return the polynomial at x, lane by lane; the numbers begin at the address ``at``.

    shape : knots, degree, whether values are held beyond the ends, and which derivative is wanted, by default none.
    """
    n, degree, held, derivative = (*shape, 0)[:4]
    rows = [f.offset(at, n + power * (n - 1)) for power in range(degree + 2)]
    results = []
    for k in range(x.width):
        u = f.lane(x, k)
        low, high = _interval(f, n)
        for _ in range(halvings(n)):
            _halve(f, u, at, low, high)
        i = f.load_int(low)
        s = u - f.load(f.offset(at, i))

        def coefficient(power: int, i: Int = i) -> Value:
            x = f.load(f.offset(rows[power], i))
            return x if derivative == 0 else x * float(math.perm(power, derivative))

        value = coefficient(degree)
        for power in reversed(range(derivative, degree)):
            value = coefficient(power) + s * value
        if held and derivative:
            inside = f.compare("oge", u, f.load(at)) & f.compare("olt", u, f.load(f.offset(at, n - 1)))
            value = f.select(inside, value, f.select(f.compare("uno", u, 0.0), u, 0.0))
        elif held:
            value = _beyond_ends(f, u, value, at, f.offset(at, n - 1), rows[-1])
        results.append(value)
    return f.pack(results, x.width)


def piecewise_of_shape(f: Function, u: Value, at: str, shape: list[Int], target: str) -> None:
    """Store the polynomial at u, one number, of which the code reads the shape: n, degree, held, halvings."""
    n, degree, held, times = shape
    low, high = _interval(f, n)
    with f.count(times):
        _halve(f, u, at, low, high)
    i = f.load_int(low)
    s = u - f.load(f.offset(at, i))
    segments = n - 1
    row = f.offset(f.offset(at, n), i)
    f.store(f.load(f.offset(row, segments * degree)), target)
    with f.count(degree, down=True) as power:
        f.store(f.load(f.offset(row, segments * power)) + s * f.load(target), target)
    with f.when(f.compare_int("sgt", held, 0)):
        ends = f.offset(f.offset(at, n), segments * (degree + 1))
        f.store(_beyond_ends(f, u, f.load(target), at, f.offset(at, segments), ends), target)


def _interval(f: Function, n: Int | int) -> tuple[str, str]:
    """Return the places in memory of the ends of the interval that is halved: at first all n knots."""
    low, high = f.int_slot(), f.int_slot()
    f.store_int(0, low)
    f.store_int(n - 1, high)
    return low, high


def _halve(f: Function, u: Value, at: str, low: str, high: str) -> None:
    """Halve the interval of knots that u lies in, unless it is one segment."""
    a, b = f.load_int(low), f.load_int(high)
    middle = f.emit_int(f"lshr i64 {(a + b).ref}, 1")
    right = f.compare("oge", u, f.load(f.offset(at, middle)))
    wider = f.compare_int("sgt", b - a, 1)
    f.store_int(f.select_int(right & wider, middle, a), low)
    f.store_int(f.select_int((~right) & wider, middle, b), high)


def _beyond_ends(f: Function, u: Value, value: Value, first: str, last: str, ends: str) -> Value:
    """Return the value between the first and the last knot, and those held before and behind; u itself if NaN."""
    begin, end = f.load(first), f.load(last)
    inside = f.compare("oge", u, begin) & f.compare("olt", u, end)
    held = f.select(f.compare("olt", u, begin), f.load(ends), f.load(f.offset(ends, 1)))
    return f.select(inside, value, f.select(f.compare("uno", u, 0.0), u, held))
