"""Expression graph: scalars that remember how they were computed.

Algorithms written for numbers also run on ``Expr`` and build the graph of their computation.
Constants stay Python floats and are folded while the graph is built: terms multiplied by zero never appear, and equal
subexpressions exist once (hash-consing). Numbers of the scene (``Fixed``) are constants too, and products of them are
numbers again, but they are never taken for structure: not for a one, and not for another number that is equal.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from typing import Any, Union

from robodyn_cli.expr.fixed import Fixed, collected, is_plain

Scalar = Union[float, "Expr"]
Row = tuple[float, ...]

COMMUTATIVE = frozenset({"add", "mul", "min", "max"})


class Expr:
    """One node: an operation on earlier nodes, a constant or a symbol. Create nodes by arithmetic only."""

    # large scenes have a million: a fifth entry would take 16 bytes of each
    __slots__ = ("args", "graph", "index", "op")

    def __init__(self, graph: Graph, op: str, args: tuple[Expr, ...], index: int) -> None:
        self.graph = graph
        self.op = op
        self.args = args
        self.index = index

    @property
    def value(self) -> Any:
        """What a constant, a symbol or a table is beside its arguments; None of others."""
        return self.graph.values.get(self.index)

    # two of three terms and factors are zeros of vectors and matrices: these are told without a further call
    def __add__(self, other: Scalar) -> Scalar:
        return self if type(other) is float and other == 0.0 else self.graph.add(self, other)

    def __sub__(self, other: Scalar) -> Scalar:
        return self.graph.sub(self, other)

    def __rsub__(self, other: Scalar) -> Scalar:
        return self.graph.sub(other, self) if isinstance(other, (float, int)) else NotImplemented

    def __mul__(self, other: Scalar) -> Scalar:
        return 0.0 if type(other) is float and other == 0.0 else self.graph.mul(self, other)

    __radd__, __rmul__ = __add__, __mul__

    def __truediv__(self, other: Scalar) -> Scalar:
        return self.graph.div(self, other) if isinstance(other, (Expr, float, int)) else NotImplemented

    def __rtruediv__(self, other: Scalar) -> Scalar:
        return self.graph.div(other, self) if isinstance(other, (Expr, float, int)) else NotImplemented

    def __neg__(self) -> Scalar:
        return self.graph.neg(self)

    def __pos__(self) -> Expr:
        return self

    def __pow__(self, other: Scalar) -> Scalar:
        return self.graph.power(self, other) if isinstance(other, (Expr, float, int)) else NotImplemented

    def __rpow__(self, other: Scalar) -> Scalar:
        return self.graph.power(other, self) if isinstance(other, (Expr, float, int)) else NotImplemented

    def __bool__(self) -> bool:
        raise TypeError("the truth of an expression is not known while the graph is built; use where()")

    def __repr__(self) -> str:
        if self.op == "sym":
            return f"<{self.value[0]}>"
        if self.op == "const":
            return repr(self.value)
        return f"<{self.op} #{self.index}>"


def is_number(x: Any) -> bool:
    """Tell whether ``x`` is a plain number (folded), not an expression."""
    return not isinstance(x, Expr)


def is_nonzero(x: Any) -> bool:
    """Tell whether ``x`` is structurally nonzero: an expression, or a number other than zero.

    Only numbers are known while the graph is built, so an expression counts as nonzero whatever value it takes later.
    """
    return isinstance(x, (Expr, Fixed)) or x != 0.0


def nonzero_entries(row: Iterable[Any]) -> dict[int, Any]:
    """Return the structurally nonzero entries of a row by their places."""
    # rows of large mechanisms are plain zeros nearly everywhere: these are told without a call
    return {k: x for k, x in enumerate(row) if (x != 0.0 if type(x) is float else is_nonzero(x))}


class Graph:
    """Owner of nodes; equal nodes are the same object, and ``index`` is a topological order."""

    def __init__(self) -> None:
        self.nodes: list[Expr] = []
        # by operation and ``args``, the node's own
        self._operations: defaultdict[str, dict[tuple[Expr, ...], Expr]] = defaultdict(dict)
        self._valued: dict[Any, Expr] = {}
        self.values: dict[int, Any] = {}  # by index

    def clear(self) -> None:
        """Let go of all nodes, which nobody needs any more: they hold the graph, and would wait for the collector."""
        for nodes in (self.nodes, self._operations, self._valued, self.values):
            nodes.clear()

    # -- leaves ---------------------------------------------------------------------------------------
    def constant(self, value: float) -> Expr:
        """Return the node of a constant (needed only as an argument of other nodes)."""
        if isinstance(value, Fixed):
            return self._with_value("const", (), value, id(value))
        # -0.0 == 0.0 hash alike, and 0.0 never needs its sign here
        return self._with_value("const", (), float(value), ("const", value))

    def symbol(self, name: str, group: str, position: int = 0) -> Expr:
        """Return the symbol ``name``, entry ``position`` of the input array ``group``."""
        value = (name, group, position)
        return self._with_value("sym", (), value, value)

    def symbols(self, names: Sequence[str], group: str) -> list[Expr]:
        """Return a symbol for each name, numbered in order."""
        return [self.symbol(name, group, k) for k, name in enumerate(names)]

    def _with_value(self, op: str, args: tuple[Expr, ...], value: Any, identity: Any) -> Expr:
        """Return the node with a value; identity : what tells it from others."""
        node = self._valued.get(identity)
        if node is None:
            node = self._valued[identity] = Expr(self, op, args, len(self.nodes))
            self.nodes.append(node)
            self.values[node.index] = value
        return node

    def _node(self, op: str, args: tuple[Expr, ...]) -> Expr:
        """Return the node of an operation."""
        table = self._operations[op]
        node = table.get(args)
        if node is None:
            node = table[args] = Expr(self, op, args, len(self.nodes))
            self.nodes.append(node)
        return node

    def like(self, node: Expr, args: Sequence[Scalar]) -> Expr:
        """Return the node of this graph that does to its arguments what a node of another one does to its own."""
        if len(args) == 2:
            return self._binary(node.op, *args)
        own = tuple([self._as_node(x) for x in args])
        return self._table_of(own[0], *node.value) if node.op == "table" else self._node(node.op, own)

    def _as_node(self, x: Scalar) -> Expr:
        return x if isinstance(x, Expr) else self.constant(x)

    def _binary(self, op: str, a: Scalar, b: Scalar) -> Expr:
        x = a if isinstance(a, Expr) else self.constant(a)
        y = b if isinstance(b, Expr) else self.constant(b)
        if x.graph is not self or y.graph is not self:
            raise ValueError("expressions of different graphs cannot be combined")
        if op in COMMUTATIVE and y.index < x.index:
            x, y = y, x
        return self._node(op, (x, y))

    # -- arithmetic with folding ----------------------------------------------------------------------
    def add(self, a: Scalar, b: Scalar) -> Scalar:
        """Return a + b."""
        if not isinstance(a, Expr):
            if not isinstance(b, Expr):
                return a + b
            a, b = b, a
        # a is an expression now
        if not isinstance(b, Expr):
            if not isinstance(b, Fixed):
                if not isinstance(b, (float, int)):
                    return NotImplemented
                if b == 0.0:
                    return a
            if a.op == "neg":
                return self.sub(b, a.args[0])
            if a.op == "sub" and a.args[0].op == "const":
                return self.sub(a.args[0].value + b, a.args[1])
            constant, rest = _split(a, "add", 0.0)
            if not is_plain(constant, 0.0):
                return self.add(rest, constant + b)
            return self._binary("add", a, b)
        if b.op == "neg":
            return self.sub(a, b.args[0])
        if a.op == "neg":
            return self.sub(b, a.args[0])
        like = _like_terms("add", a, b)
        return self._binary("add", a, b) if like is None else self.mul(*like)

    def sub(self, a: Scalar, b: Scalar) -> Scalar:
        """Return a - b."""
        if not isinstance(b, Expr):
            if not isinstance(b, (float, int)):
                return NotImplemented
            return self.add(a, -b) if isinstance(a, Expr) else a - b
        if a is b:
            return 0.0
        if not isinstance(a, Expr):
            if is_plain(a, 0.0):
                return self.neg(b)
            if b.op == "neg":
                return self.add(a, b.args[0])
            if b.op == "sub" and b.args[0].op == "const":
                return self.add(a - b.args[0].value, b.args[1])
            constant, rest = _split(b, "add", 0.0)
            if not is_plain(constant, 0.0):
                return self.sub(a - constant, rest)
            return self._binary("sub", a, b)
        if b.op == "neg":
            return self.add(a, b.args[0])
        if a.op == "neg":
            return self.neg(self.add(a.args[0], b))
        like = _like_terms("sub", a, b)
        return self._binary("sub", a, b) if like is None else self.mul(*like)

    def neg(self, a: Scalar) -> Scalar:
        """Return -a."""
        if not isinstance(a, Expr):
            return -a
        if a.op == "neg":
            return a.args[0]
        if a.op == "sub":
            x, y = a.args
            return self.add(y, -x.value) if x.op == "const" else self._binary("sub", y, x)
        if a.op == "mul":
            factor, rest = _split(a, "mul", 1.0)
            if not isinstance(factor, Fixed) and not is_plain(factor, 1.0):
                return self.mul(-factor, rest)
        return self._node("neg", (a,))

    def mul(self, a: Scalar, b: Scalar) -> Scalar:
        """Return a * b; a factor zero removes the other (expressions are taken as finite)."""
        if not isinstance(a, Expr):
            if not isinstance(b, Expr):
                return a * b
            a, b = b, a
        if not isinstance(b, Expr):
            if isinstance(b, Fixed):
                if b.op == "neg":
                    return self.neg(self.mul(b.args[0], a))
            elif not isinstance(b, (float, int)):
                return NotImplemented
            elif b == 0.0:
                return 0.0
            elif b == 1.0:
                return a
            elif b == -1.0:
                return self.neg(a)
            if a.op == "neg":
                return self.mul(-b, a.args[0])
            if a.op == "mul":
                x, y = a.args
                if x.op == "const":
                    return self.mul(x.value * b, y)
                if y.op == "const":
                    return self.mul(y.value * b, x)
            return self._binary("mul", a, b)
        if a.op == "neg":
            return self.neg(self.mul(a.args[0], b))
        if b.op == "neg":
            return self.neg(self.mul(a, b.args[0]))
        # constants float outward, so that products of shared factors are found again
        factor, a = _split(a, "mul", 1.0)
        other, b = _split(b, "mul", 1.0)
        if not (is_plain(factor, 1.0) and is_plain(other, 1.0)):
            return self.mul(factor * other, self.mul(a, b))
        return self._binary("mul", a, b)

    def div(self, a: Scalar, b: Scalar) -> Scalar:
        """Return a / b."""
        if not isinstance(b, Expr):
            return self.mul(a, 1.0 / b) if isinstance(a, Expr) else a / b
        if not isinstance(a, Expr) and is_plain(a, 0.0):
            return 0.0
        if a is b:
            return 1.0
        return self._binary("div", a, b)

    def power(self, a: Scalar, b: Scalar) -> Scalar:
        """Return a ** b; small whole exponents become products. An exponent is structure, whatever gave it."""
        if not isinstance(b, Expr):
            b = float(b)
            if not isinstance(a, Expr):
                return a**b
            n = int(b) if float(b).is_integer() else None
            if n is not None and 0 <= n <= 8:
                result: Scalar = 1.0
                square: Scalar = a
                while n:
                    if n & 1:
                        result = self.mul(result, square)
                    square = self.mul(square, square) if n > 1 else square
                    n >>= 1
                return result
            if n is not None and -8 <= n < 0:
                return self.div(1.0, self.power(a, -b))
            if b == 0.5:
                return self.unary("sqrt", a)
        return self._binary("pow", a, b)

    def unary(self, op: str, a: Expr) -> Scalar:
        """Return a function of one argument; sin and cos take out the sign."""
        if a.op == "neg" and op in ("sin", "tan", "asin", "atan", "sinh", "tanh", "sign"):
            return self.neg(self.unary(op, a.args[0]))
        if a.op == "neg" and op in ("cos", "cosh", "abs"):
            return self.unary(op, a.args[0])
        return self._node(op, (a,))

    def binary(self, op: str, a: Scalar, b: Scalar) -> Scalar:
        """Return a function of two arguments (``atan2``, ``min``, ``max``, ``pow``)."""
        return self.power(a, b) if op == "pow" else self._binary(op, a, b)

    def where(self, x: Expr, a: Scalar, b: Scalar) -> Scalar:
        """Return a if x > 0, else b."""
        if a is b or (not any(isinstance(e, (Expr, Fixed)) for e in (a, b)) and a == b):
            return a
        return self._node("where", (x, self._as_node(a), self._as_node(b)))

    def piecewise(self, x: Expr, knots: Row, rows: tuple[Row, ...], held: Row | None = None) -> Scalar:
        """Return the polynomial sum_i rows[i][k] (x - knots[k])^i of the segment k that x lies in, right-continuous.

        Parameters
        ----------
        rows : for each power the coefficients of the segments, one fewer than knots.
        held : values before the first knot and from the last one on; without them the polynomials at the ends go on.
        """
        if len(rows) == 1 and held is None and all(is_plain(x, rows[0][0]) for x in rows[0]):
            return rows[0][0]
        return self._table_of(x, knots, rows, held)

    def _table_of(self, x: Expr, knots: Row, rows: Any, held: Any) -> Expr:
        numbers = tuple(
            id(e) if isinstance(e, Fixed) else ("plain", e) for e in (*knots, *sum(rows, ()), *(held or ()))
        )
        identity = ("table", x, numbers, len(knots), held is None)
        return self._with_value("table", (x,), (knots, rows, held), identity)

    def interpolate(self, x: Expr, knots: tuple[float, ...], values: tuple[float, ...]) -> Scalar:
        """Return the piecewise linear function through (knots, values) at x, held beyond the ends."""
        slopes = tuple((values[k + 1] - values[k]) / (knots[k + 1] - knots[k]) for k in range(len(knots) - 1))
        return self.piecewise(x, knots, (values[:-1], slopes), (values[0], values[-1]))


def _split(a: Expr, op: str, neutral: float) -> tuple[float, Expr]:
    """Split a constant off a sum or a product, ``neutral`` where it has none: a = constant + rest or constant rest."""
    if a.op == op:
        x, y = a.args
        if x.op == "const":
            return x.value, y
        if y.op == "const":
            return y.value, x
    return neutral, a


def _like_terms(op: str, a: Expr, b: Expr) -> tuple[float, Expr] | None:
    """Return c and x with a + b = c x (``add``) or a - b = c x (``sub``), None where the terms are not alike."""
    (factor, x), (other, y) = _split(a, "mul", 1.0), _split(b, "mul", 1.0)
    return (collected(op, factor, other), x) if x is y else None


def reachable(outputs: Iterable[Scalar]) -> list[Expr]:
    """Return the nodes that the outputs, of one graph, need: arguments before results."""
    asked = [e for e in outputs if isinstance(e, Expr)]
    if not asked:
        return []
    every, k = asked[0].graph.nodes, max([e.index for e in asked])
    needed = bytearray(k + 1)
    for e in asked:
        needed[e.index] = 1
    nodes: list[Expr] = []
    # arguments have lower indices than what is computed from them: from the last one down all is found in one pass
    while k >= 0:
        nodes.append(every[k])
        for argument in every[k].args:
            needed[argument.index] = 1
        k = needed.rfind(1, 0, k)
    return nodes[::-1]


def free_symbols(outputs: Iterable[Scalar]) -> list[Expr]:
    """Return the symbols that the outputs depend on."""
    return [e for e in reachable(outputs) if e.op == "sym"]


def count_operations(outputs: Iterable[Scalar]) -> int:
    """Count the operations that evaluating the outputs takes (leaves are free)."""
    return sum(e.op not in ("sym", "const") for e in reachable(outputs))
