"""Programs as readable C99: one statement for each value that is used twice, sines and cosines by their angles.

Nothing is allocated, nothing is kept between calls, and only ``libm`` is called. A macro F gives numbers and functions
their precision, so that the same text serves both: ``F(sin)(q[0])``. (C libraries of controllers have no ``tgmath.h``
that compiles: it takes complex functions that they lack.)
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterable, Sequence
from typing import Protocol

from robodyn_cli.kernels.program import TRIGONOMETRIC, Instruction, Program

WIDTH = 110  # of a line
NESTED = 64  # characters of an expression that may stand inside another one
INDENT = "    "
TIED = "\0"  # a space at which no line ends
REAL = "real"  # the type whose precision a switch tells
# how tightly an expression holds its parts together
SUM, PRODUCT, WHOLE = 1, 2, 3
HELD = {"add": SUM, "sub": SUM, "mul": PRODUCT, "div": PRODUCT, "neg": SUM}
SIGNS = {"add": "+", "sub": "-", "mul": "*", "div": "/"}
FUNCTIONS = {"abs": "fabs", "round": "rint", "min": "smaller", "max": "larger"}
# what C99 lacks, by name; a file holds those that it calls
HELPERS = {
    "sign": "static {real} {name}({real} x)\n{{\n    return x == 0 || x != x ? x : x > 0 ? 1 : -1;\n}}\n",
    "smaller": "static {real} {name}({real} a, {real} b)\n{{\n    return a < b || a != a ? a : b;\n}}\n",
    "larger": "static {real} {name}({real} a, {real} b)\n{{\n    return a > b || a != a ? a : b;\n}}\n",
    "sum": """/* a + b, zero where it cancels but for rounding */
static double sum(double a, double b)
{{
    const double total = a + b, most = fabs(a) > fabs(b) ? fabs(a) : fabs(b);
    return fabs(total) <= 1e-15 * most ? 0.0 : total;
}}
""",
    "piecewise": """/* Piecewise polynomial at x: knots, coefficients by power for all segments, values held outside. */
static {real} {name}({real} x, const {real} *table, int knots, int degree, int held)
{{
    const {real} *rows = table + knots, *outside = rows + (degree + 1) * (knots - 1);
    int k = 0, last = knots - 2, power;
    {real} s, y;

    if (held && !(x >= table[0] && x < table[knots - 1]))
        return x < table[0] ? outside[0] : x == x ? outside[1] : x;
    while (k < last) {{
        const int middle = (k + last + 1) / 2;
        if (x >= table[middle])
            k = middle;
        else
            last = middle - 1;
    }}
    s = x - table[k];
    y = rows[degree * (knots - 1) + k];
    for (power = degree - 1; power >= 0; --power)
        y = y * s + rows[power * (knots - 1) + k];
    return y;
}}
""",
}  # fmt: skip


class LeafNames(Protocol):
    """What a program's leaves are called in C."""

    @property
    def real(self) -> str:
        """The type of values."""
        ...

    def symbol(self, group: str, position: int) -> str:
        """Return an input: ``q[0]``."""
        ...

    def label(self, group: str, position: int) -> str:
        """Return what is written behind ``sin_`` and ``cos_`` of an input: ``theta1``."""
        ...

    def number(self, place: int) -> str:
        """Return an entry of the program's table of numbers."""
        ...

    def block(self, first: int, count: int) -> str:
        """Return the address of so many entries that follow one another."""
        ...

    def literal(self, value: float) -> str:
        """Return a number that is part of the code."""
        ...


def identifier(text: str) -> str:
    """Return letters, digits and underscores for a name of any letters."""
    return re.sub(r"[^A-Za-z0-9_]", "_", text)


def comment(text: str) -> str:
    """Return a text that may stand in a comment: no end of it, no letters that compilers may not read."""
    plain = "".join(x if x.isascii() and x.isprintable() else " " if x.isspace() else "?" for x in text)
    return plain.replace("\\", "/").replace("/*", "/ *").replace("*/", "* /").replace("??", "? ?")


def wrapped(text: str, indent: str = INDENT) -> str:
    """Return a statement on as many lines as it takes; what ``TIED`` joins stays on one."""
    if text and len(indent) + len(text) <= WIDTH and text.isprintable():  # as most are
        return f"{indent}{text.strip()}"
    lines = textwrap.wrap(
        text, WIDTH, initial_indent=indent, subsequent_indent=indent + INDENT,
        break_long_words=False, break_on_hyphens=False,
    )  # fmt: skip
    return "\n".join(lines).replace(TIED, " ")


def literal(value: float) -> str:
    """Return a double with all its digits."""
    if value != value or value in (float("inf"), float("-inf")):
        return "NAN" if value != value else "HUGE_VAL" if value > 0 else "-HUGE_VAL"
    return repr(float(value))


class Statements:
    """The statements that compute the values of a program.

    lines : of C, indented. values : of the outputs, as expressions. helpers : names of the ``HELPERS`` that they call.
    """

    def __init__(self, program: Program, names: LeafNames) -> None:
        self.code, self.names = program.instructions, names
        self.lines: list[str] = []
        self.helpers: set[str] = set()
        self._text: dict[int, tuple[str, int]] = {}
        self._uses = self._counted(program)
        entries = [e for output in program.outputs.values() for e in output]
        for e in entries:
            if not isinstance(e, float):
                self._need(e)
        self.values = {
            name: [names.literal(e) if isinstance(e, float) else self._text[e][0] for e in output]
            for name, output in program.outputs.items()
        }

    @staticmethod
    def _counted(program: Program) -> list[int]:
        uses = [0] * len(program.instructions)
        for i in program.instructions:
            for a in i.args:
                uses[a] += 1
        for output in program.outputs.values():
            for e in output:
                if not isinstance(e, float):
                    uses[e] += 1
        return uses

    def _need(self, k: int) -> None:
        """Write instruction k behind its arguments (an explicit stack: graphs may be deep)."""
        stack = [k]
        while stack:
            j = stack[-1]
            waiting = [a for a in self.code[j].args if a not in self._text]
            if j in self._text or not waiting:
                stack.pop()
                if j not in self._text:
                    self._add(j, self.code[j])
            else:
                stack += reversed(waiting)

    def _add(self, k: int, i: Instruction) -> None:
        text, tightness = self._expression(i)
        leaf = not i.args
        short = len(text) <= NESTED and self._uses[k] == 1 and i.op not in TRIGONOMETRIC
        if not (leaf or short):
            name = self._name(k, i)
            self.lines.append(wrapped(f"const {self.names.real} {name} = {text};"))
            text, tightness = name, WHOLE
        self._text[k] = text, tightness

    def _name(self, k: int, i: Instruction) -> str:
        """Return the name of a value: that of its angle for a sine or cosine of an input."""
        inner = self.code[i.args[0]]
        if i.op in TRIGONOMETRIC and inner.op == "sym":
            return f"{i.op}_{self.names.label(*inner.value)}"
        return f"{i.op[0] if i.op in TRIGONOMETRIC else 'x'}{k}"

    def _expression(self, i: Instruction) -> tuple[str, int]:
        """Return what an instruction computes, and how tightly it holds together."""
        names = self.names
        if i.op == "sym":
            return names.symbol(*i.value), WHOLE
        if i.op in ("const", "number"):
            text = names.literal(i.value) if i.op == "const" else names.number(i.value)
            return text, SUM if text.startswith("-") else WHOLE
        args = [self._text[a] for a in i.args]
        if i.op == "neg":
            return f"-{_inside(args[0], PRODUCT)}", SUM
        if i.op in SIGNS:
            # a - (b - c), a / (b * c), and the order of products: the right side holds together more tightly
            held = HELD[i.op]
            return f"{_inside(args[0], held)} {SIGNS[i.op]} {_inside(args[1], held + 1)}", held
        plain = [text for text, _ in args]
        if i.op == "where":
            x, a, b = (_inside(one, SUM + 1) for one in args)
            return f"({x} > 0 ? {a} : {b})", WHOLE
        if i.op == "table":
            first, knots, degree, held = i.value
            block = names.block(first, knots + (knots - 1) * (degree + 1) + 2 * held)
            plain += [block, str(knots), str(degree), str(int(held))]
            return self._called("piecewise", plain), WHOLE
        return self._called(FUNCTIONS.get(i.op, i.op), plain), WHOLE

    def _called(self, function: str, args: Sequence[str]) -> str:
        if function in HELPERS:
            function = function if self.names.real == REAL or function == "sum" else f"{function}_of_doubles"
            self.helpers.add(function)
        elif self.names.real == REAL:
            function = f"F({function})"
        return f"{function}({', '.join(args)})"


def _inside(part: tuple[str, int], held: int) -> str:
    """Return an expression as a part of one that holds so tightly."""
    text, own = part
    return text if own >= held else f"({text})"


def helpers_text(names: Iterable[str]) -> str:
    """Return the definitions of helper functions."""
    texts = []
    for name in sorted(names):
        function, doubles, _ = name.partition("_of_doubles")
        texts.append(HELPERS[function].format(name=name, real="double" if doubles else REAL))
    return "\n".join(texts)
