"""The grammar of formulas: a Pratt parser over a fixed set of operators and functions.

Nothing of Python can be reached from a formula.

    + - * / ^ (or **), unary signs, parentheses, numbers, pi, e, a unit after a number or parenthesis,
    sin(x) ... step(x), min(a, b, ...), max(a, b, ...), if(a < b, x, y), t, NAME, q.NAME, qd.NAME, p.NAME,
    length(POINT, POINT), length_rate(POINT, POINT), angle(POINT, POINT, POINT), speed(POINT), POINT.x ... POINT.vz
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from typing import NoReturn

from robodyn_cli.errors import SceneError, unknown_name
from robodyn_cli.expr import formula_tree as tree
from robodyn_cli.expr import units
from robodyn_cli.expr.quantities import FormulaQuantity, quantity_of
from robodyn_cli.record import record

MAX_DEPTH = 60
# each adds an event function, and compile time grows faster than their number
MAX_SWITCHES = 100

_BINDING = {"+": 10, "-": 10, "*": 20, "/": 20, "^": 40, "**": 40}
_UNARY_BINDING = 30
_COMPARISONS = ("<", "<=", ">", ">=")
_TOKEN = re.compile(
    r"(?P<number>(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?)"
    r"|(?P<name>[A-Za-z_][A-Za-z0-9_]*(?:\.[A-Za-z_][A-Za-z0-9_]*)*)"
    r"|(?P<sign>\*\*|<=|>=|[-+*/^()<>,])"
)


@record
class Token:
    """A word of a formula, and its column from 1."""

    kind: str  # number, name, sign or end
    text: str
    column: int


def tokens(text: str) -> list[Token]:
    """Return the words of a formula, the end last.

    Raises
    ------
    SceneError : at a character that no formula has.
    """
    found = []
    position = 0
    while position < len(text):
        if text[position] in " \t\r\n":
            position += 1
            continue
        match = _TOKEN.match(text, position)
        if match is None:
            tree.fail(text, position + 1, f"unexpected {text[position]!r}")
        found.append(Token(str(match.lastgroup), match.group(), position + 1))
        position = match.end()
    return [*found, Token("end", "end of the formula", len(text) + 1)]


class Parser:
    """Pratt parser: ``expression(binding)`` reads operators that bind at least that tightly."""

    def __init__(self, text: str) -> None:
        self.text = text
        self.tokens = tokens(text)
        self.position = 0
        self.names: dict[str, int] = {}
        self.units: dict[str, int] = {}  # words of units, with the columns of their first use
        self.behind_unit = -1  # the position behind the last unit
        self.switches = 0

    def whole(self) -> tree.FormulaNode:
        root = self.expression(0, 0)
        if self.token.kind != "end":
            self.unexpected(self.token)
        return root

    @property
    def token(self) -> Token:
        return self.tokens[self.position]

    def next(self) -> Token:
        token = self.token
        self.position += 1
        return token

    def expect(self, sign: str) -> None:
        if self.token.text != sign or self.token.kind != "sign":
            self.unexpected(self.token, f"{sign!r} is needed here")
        self.next()

    def fail(self, token: Token, message: str) -> NoReturn:
        tree.fail(self.text, token.column, message)

    def unexpected(self, token: Token, wanted: str = "") -> NoReturn:
        shown = token.text if token.kind == "end" else repr(token.text)
        if not wanted and token.text in _COMPARISONS:
            wanted = "a comparison is allowed only as the first argument of if(a < b, x, y)"
        elif not wanted and token.kind in ("number", "name"):
            wanted = "an operator such as '*' is missing before it"
            before = self.tokens[self.tokens.index(token) - 1]
            if token.kind == "name" and before.kind == "number" and token.text not in units.table():
                wanted = f"{units.unknown(token.text)}, and {wanted}"
        self.fail(token, f"unexpected {shown}" + (f"; {wanted}" if wanted else ""))

    def fold(self, node: tree.FormulaNode, token: Token, *arguments: tree.FormulaNode) -> tree.FormulaNode:
        """Return the node's number if its arguments are numbers, else the node."""
        if not all(isinstance(x, tree.Num) for x in arguments):
            return node
        try:
            number = float(node.value({}))
        except (ArithmeticError, ValueError) as error:
            self.fail(token, f"{token.text!r} has no value here: {error}")
        if not math.isfinite(number):
            self.fail(token, f"{token.text!r} gives {number}; allowed: finite numbers")
        kind = self.checked(token, lambda: quantity_of(node, {}))
        return tree.Num(number, kind.kinds[0] if kind.stated and kind.kinds else None)

    def checked(self, token: Token, kind: Callable[[], FormulaQuantity]) -> FormulaQuantity:
        """Return what a number is of; what has no unit is refused at a place of the formula."""
        try:
            return kind()
        except SceneError as error:
            self.fail(token, error.message)

    def expression(self, binding: int, depth: int) -> tree.FormulaNode:
        if depth > MAX_DEPTH:
            self.fail(self.token, f"nested more than {MAX_DEPTH} levels deep")
        left = self.operand(depth)
        while self.token.kind == "sign" and _BINDING.get(self.token.text, -1) >= binding:
            left = self.operation(left, self.next(), depth)
        return left

    def operation(self, left: tree.FormulaNode, token: Token, depth: int) -> tree.FormulaNode:
        level = _BINDING[token.text]
        if level == _BINDING["^"]:
            right = self.expression(level, depth + 1)  # the same level again: a^b^c is a^(b^c)
            node: tree.FormulaNode = tree.Power(left, right)
        else:
            right = self.expression(level + 1, depth + 1)
            node = self.chain(left, token.text, right)
        if token.text in ("/", "^", "**") and self.position == self.behind_unit:
            # 360/7 deg reads as (360/7) deg to people, and as 360/(7 deg) to grammars: refuse to guess
            last = self.tokens[self.position - 1]
            self.fail(last, f"{last.text!r} after {token.text!r} is ambiguous; use parentheses")
        if token.text == "/" and right == tree.Num(0.0):
            self.fail(token, "division by zero")
        return self.fold(node, token, left, right)

    @staticmethod
    def chain(left: tree.FormulaNode, op: str, right: tree.FormulaNode) -> tree.Chain:
        if isinstance(left, tree.Chain) and _BINDING[left.rest[0][0]] == _BINDING[op]:
            return tree.Chain(left.first, (*left.rest, (op, right)))
        return tree.Chain(left, ((op, right),))

    def operand(self, depth: int) -> tree.FormulaNode:
        token = self.next()
        if token.kind == "sign" and token.text in ("+", "-"):
            operand = self.expression(_UNARY_BINDING, depth + 1)
            return operand if token.text == "+" else self.fold(tree.Negative(operand), token, operand)
        return self.postfix(self.primary(token, depth), token)

    def postfix(self, node: tree.FormulaNode, token: Token) -> tree.FormulaNode:
        """Return a number with the unit behind it in SI units; behind a name only ``deg`` is one."""
        last = self.tokens[self.position - 1]
        read = units.match(self.text, last.column - 1 + len(last.text))
        if self.token.kind != "name" or read is None:
            return node
        unit, end = read
        if token.kind == "name" and self.token.text != "deg":
            return node
        while self.token.column - 1 < end and self.token.kind != "end":
            if self.token.kind == "name":
                self.units.setdefault(self.token.text, self.token.column)
            self.next()
        if self.token.text in unit.words:
            self.unexpected(self.token, f"{self.token.text!r} is allowed once")
        self.behind_unit = self.position
        if last is token and token.kind == "number":
            number = unit.value(token.text)
            if not math.isfinite(number):
                self.fail(token, f"number {token.text[:40]} is too large")
            return tree.Num(number, unit.dims)
        return self.fold(
            self.chain(node, "*", tree.Num(unit.factor, unit.dims)), token, node, tree.Num(unit.factor)
        )

    def primary(self, token: Token, depth: int) -> tree.FormulaNode:
        if token.kind == "number":
            number = float(token.text)
            if not math.isfinite(number):
                self.fail(token, f"number {token.text[:40]} is too large")
            return tree.Num(number)
        if token.text == "(":
            inner = self.expression(0, depth + 1)
            self.expect(")")
            return inner
        if token.kind == "name":
            if self.token.text == "(":
                return self.call(token, depth)
            if token.text in tree.CONSTANTS:
                return tree.Num(tree.CONSTANTS[token.text])
            if token.text == "deg":
                self.unexpected(token, "'deg' goes after a number, as in 45 deg")
            group, dot, name = token.text.partition(".")
            point, _, axis = token.text.rpartition(".")
            if axis in tree.AXES and point and group not in tree.QUALIFIERS:
                return self.named(f"{axis}({point})", token)
            if dot and (group not in tree.QUALIFIERS or name.count(".") > (group != "p")):
                self.fail(
                    token,
                    f"unknown name {token.text!r}; a dot is allowed only in q.JOINT, qd.JOINT, q.JOINT.COORDINATE and "
                    f"p.PARAMETER, behind points in POINT.{', POINT.'.join(tree.AXES)}, and beside a controller in "
                    "ref.JOINT, refd.JOINT, refdd.JOINT, tau.JOINT and s.STATE",
                )
            return self.named(token.text, token)
        self.unexpected(token, "a number, a name or '(' is needed here")

    def call(self, name: Token, depth: int) -> tree.FormulaNode:
        if name.text in tree.OF_POINTS:
            return self.of_points(name)
        if name.text != "if" and name.text not in tree.FUNCTIONS:
            known = [*tree.FUNCTIONS, "if", *tree.OF_POINTS]
            self.fail(name, unknown_name("function", name.text, known))
        self.expect("(")
        node = self.conditional(name, depth + 1) if name.text == "if" else self.function(name, depth + 1)
        self.expect(")")
        return node

    def of_points(self, function: Token) -> tree.FormulaNode:
        """Return the name of a function of points, such as their distance."""
        points: list[str] = []
        for _ in range(tree.OF_POINTS[function.text][0]):
            self.expect("," if points else "(")
            if self.token.kind != "name":
                self.unexpected(
                    self.token, "a point is needed here: a name, or LINK.origin, LINK.end, LINK.com"
                )
            points.append(self.next().text)
        self.expect(")")
        return self.named(f"{function.text}({', '.join(points)})", function)

    def named(self, name: str, token: Token) -> tree.FormulaNode:
        """Return a free name, which stands first where a token does."""
        self.names.setdefault(name, token.column)
        return tree.Identifier(name)

    def function(self, name: Token, depth: int) -> tree.FormulaNode:
        _, least, most = tree.FUNCTIONS[name.text]
        arguments = []
        if self.token.text != ")":
            arguments.append(self.expression(0, depth))
            while self.token.text == ",":
                self.next()
                arguments.append(self.expression(0, depth))
        if not least <= len(arguments) <= most:
            needed = (
                f"{least} or more arguments" if most == tree.MANY else f"{least} argument" + "s" * (least > 1)
            )
            self.fail(name, f"{name.text!r} is given {len(arguments)}; it takes {needed}")
        if name.text in tree.SWITCHING:
            self.count_switches(name, max(1, len(arguments) - 1), arguments)
        return self.fold(tree.Call(name.text, tuple(arguments)), name, *arguments)

    def count_switches(self, token: Token, count: int, arguments: Sequence[tree.FormulaNode]) -> None:
        """Count the places where the formula jumps or bends; numbers alone have none."""
        if all(isinstance(x, tree.Num) for x in arguments):
            return
        self.switches += count
        if self.switches > MAX_SWITCHES:
            fault = (
                f"the formula switches at more than {MAX_SWITCHES} places ({', '.join(tree.SWITCHING)}, if)"
            )
            self.fail(token, f"{fault}; give a course of many pieces as a table")

    def conditional(self, name: Token, depth: int) -> tree.FormulaNode:
        left = self.expression(0, depth)
        comparison = self.token
        if comparison.text not in _COMPARISONS:
            self.unexpected(comparison, "if(a < b, x, y) needs a comparison: <, <=, > or >=")
        self.next()
        right = self.expression(0, depth)
        self.expect(",")
        yes = self.expression(0, depth)
        self.expect(",")
        no = self.expression(0, depth)
        self.count_switches(name, 1, (left, right))
        node = tree.If(comparison.text, left, right, yes, no)
        return self.fold(node, name, left, right, yes, no)
