"""Elementary functions on numbers, numpy arrays and expressions alike."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from robodyn_cli.expr.fixed import Fixed, applied
from robodyn_cli.expr.graph import Expr

# what numpy calls them, where its names differ
NUMPY = {
    "asin": "arcsin", "acos": "arccos", "atan": "arctan", "atan2": "arctan2", "round": "rint", "min": "minimum",
    "max": "maximum", "pow": "power",
}  # fmt: skip


def _sign(x: float) -> float:
    return math.nan if math.isnan(x) else float(int(x > 0) - int(x < 0))


def _lift(op: str, number: Callable[[float], float]) -> Callable[[Any], Any]:
    def function(x: Any) -> Any:
        if isinstance(x, Expr):
            return x.graph.unary(op, x)
        if isinstance(x, Fixed):
            return applied(op, number, x)
        if isinstance(x, (float, int)):
            return number(x)
        import numpy as np

        return getattr(np, NUMPY.get(op, op))(x)

    function.__name__ = op
    function.__doc__ = f"Return {op}(x)."
    return function


sin = _lift("sin", math.sin)
cos = _lift("cos", math.cos)
tan = _lift("tan", math.tan)
asin = _lift("asin", math.asin)
acos = _lift("acos", math.acos)
atan = _lift("atan", math.atan)
sinh = _lift("sinh", math.sinh)
cosh = _lift("cosh", math.cosh)
tanh = _lift("tanh", math.tanh)
exp = _lift("exp", math.exp)
log = _lift("log", math.log)
sqrt = _lift("sqrt", math.sqrt)
absolute = _lift("abs", abs)
sign = _lift("sign", _sign)
nearest = _lift("round", lambda x: float(round(x)))


def _graph_of(*xs: Any) -> Any:
    return next((x.graph for x in xs if isinstance(x, Expr)), None)


def _scalar(*xs: Any) -> bool:
    return all(isinstance(x, (float, int)) for x in xs)


def _number(op: str, function: Callable[..., float], *xs: float) -> float:
    """Return a function of numbers, of which some may be numbers of the scene."""
    return applied(op, function, *xs) if any(isinstance(x, Fixed) for x in xs) else function(*xs)


def _lift_two(op: str, number: Callable[[Any, Any], float], doc: str) -> Callable[[Any, Any], Any]:
    def function(a: Any, b: Any) -> Any:
        graph = _graph_of(a, b)
        if graph is not None:
            return graph.binary(op, a, b)
        if _scalar(a, b):
            return _number(op, number, a, b)
        import numpy as np

        return getattr(np, NUMPY.get(op, op))(a, b)

    function.__name__, function.__doc__ = op, doc
    return function


atan2 = _lift_two("atan2", math.atan2, "Return the angle of the vector (x, y) from (y, x), in (-pi, pi].")
minimum = _lift_two("min", min, "Return the smaller of a and b.")
maximum = _lift_two("max", max, "Return the larger of a and b.")
power = _lift_two("pow", math.pow, "Return a ** b.")


def where(x: Any, a: Any, b: Any) -> Any:
    """Return a if x > 0, else b."""
    if isinstance(x, Expr):
        return x.graph.where(x, a, b)
    if isinstance(x, (float, int)):
        return a if x > 0 else b
    import numpy as np

    return np.where(np.asarray(x) > 0, a, b)


def step(x: Any) -> Any:
    """Return 0 for x < 0 and 1 for x >= 0."""
    return where(-x, 0.0, 1.0)


def interpolate(x: Any, knots: tuple[float, ...], values: tuple[float, ...]) -> Any:
    """Return the piecewise linear function through (knots, values) at x, held beyond the ends."""
    if isinstance(x, Expr):
        return x.graph.interpolate(x, knots, values)
    import numpy as np

    return float(np.interp(x, knots, values)) if _scalar(x) else np.interp(x, knots, values)
