"""The numbers of a scene in C: those that follow from keys in a table, the others in the code."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property

import numpy as np

from robodyn_cli.expr.many import CONSTANT
from robodyn_cli.kernels.c99 import INDENT, REAL, Statements, identifier, literal, wrapped
from robodyn_cli.kernels.program import Instruction, Program
from robodyn_cli.over.c99.keys import Parametrised
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array

SMALLEST, LARGEST = 1.2e-38, 3.4e38  # of normal numbers in single precision
RELATIONS = {"lt": "<", "le": "<=", "gt": ">", "ge": ">=", "eq": "==", "ne": "!="}
KEYS, PLACED = "key", "n"


class NumberTable:
    """The entries of the table ``n``: values of a recipe, each once, and blocks of tables over which code looks up."""

    def __init__(self, made: Parametrised) -> None:
        self.made, self.recipe = made, made.recipe
        self.entries: list[int] = []  # values of the recipe
        self._places: dict[int, int] = {}

    def is_constant(self, x: float) -> bool:
        return self.recipe.steps[self.recipe.value_of(x)][0] == CONSTANT

    def entry(self, x: float) -> str:
        """Return a number as C."""
        value = self.recipe.value_of(x)
        if self.is_constant(x):
            return code_literal(float(x))
        if value not in self._places:
            self._places[value] = len(self.entries)
            self.entries.append(value)
        return f"{PLACED}[{self._places[value]}]"

    def block(self, numbers: Sequence[float]) -> str:
        """Return the address of numbers that follow one another in the table."""
        first = len(self.entries)
        self.entries += [self.recipe.value_of(x) for x in numbers]
        return f"{PLACED} + {first}"

    def follow(self, places: Mapping[str, str]) -> tuple[list[str], set[str]]:
        """Return the statements that compute the table from keys, with the helpers that they call.

        They end with a return: 1 where the equations are those that were exported. places : of keys, as C.
        """
        code: list[Instruction] = []
        at: list[int] = []  # instruction of each value
        for op, data, args in self.recipe.steps:
            own = [at[a] for a in args]
            if op == "sub":
                code.append(Instruction("neg", (own[1],)))
                own[1] = len(code) - 1
            name = {CONSTANT: "const", "literal": "sym", "add": "sum", "sub": "sum"}.get(op, op)
            code.append(Instruction(name, tuple(own), (KEYS, data) if op == "literal" else data))
            at.append(len(code) - 1)
        sides = [side for decision in self.made.decisions for side in decision[1:3]]
        outputs: dict[str, tuple[int | float, ...]] = {
            PLACED: tuple(at[k] for k in self.entries),
            "sides": tuple(at[k] for k in sides),
        }
        written = Statements(Program(tuple(code), outputs), _KeyNames(places))
        lines = list(written.lines)
        lines += [
            wrapped(f"numbers->{PLACED}[{k}] = (real)({x});") for k, x in enumerate(written.values[PLACED])
        ]
        tests = []
        for k, (compare, _, _, outcome) in enumerate(self.made.decisions):
            a, b = written.values["sides"][2 * k : 2 * k + 2]
            test = f"{a} {RELATIONS[compare.__name__]} {b}"
            tests.append(f"({test})" if outcome else f"!({test})")
        tests = list(dict.fromkeys(tests))
        lines.append(wrapped(f"return {' && '.join(tests) or 1};"))
        return lines, written.helpers


def code_literal(value: float) -> str:
    """Return a number of the code, which a macro gives the precision of the others."""
    text = literal(abs(value))
    if value != value or abs(value) == float("inf"):
        return literal(value)
    fits = value == 0.0 or SMALLEST < abs(value) < LARGEST
    return f"{'-' * (value < 0)}{f'F({text})' if fits else f'(real){text}'}"


class _KeyNames:
    """What the leaves of numbers are called where they are computed, in double precision whatever that of the code."""

    real = "double"

    def __init__(self, places: Mapping[str, str]) -> None:
        self.places = places

    def symbol(self, group: str, position: int) -> str:
        return self.places[str(position)]

    def label(self, group: str, position: int) -> str:
        return identifier(str(position))

    def number(self, place: int) -> str:
        raise NotImplementedError

    def block(self, first: int, count: int) -> str:
        raise NotImplementedError

    def literal(self, value: float) -> str:
        return literal(value)


@record
class FunctionNames:
    """What the leaves of a function's program are called.

    arguments : by symbol group. labels : of its positions, by group. declared : tables of the code, to which it adds.
    """

    table: NumberTable
    program: Program
    arguments: Mapping[str, str]
    labels: Mapping[str, Sequence[str]]
    declared: list[str]
    real: str = REAL

    def symbol(self, group: str, position: int) -> str:
        name = self.arguments[group]
        return name if name == "t" else f"{name}[{position}]"

    def label(self, group: str, position: int) -> str:
        names = self.labels.get(group)
        return f"{self.arguments[group]}{position}" if names is None else names[position]

    def number(self, place: int) -> str:
        return self.table.entry(self.program.numbers[place])

    def block(self, first: int, count: int) -> str:
        numbers = self.program.numbers[first : first + count]
        if not all(self.table.is_constant(x) for x in numbers):
            return self.table.block(numbers)
        name = f"table{len(self.declared)}"
        entries = ", ".join(code_literal(float(x)) for x in numbers)
        self.declared.append(wrapped(f"static const real {name}[] = {{{entries}}};", INDENT))
        return name

    def literal(self, value: float) -> str:
        return code_literal(value)


class NumberFunctions:
    """The functions of a library that set its numbers, look keys up, and give the start.

    Parameters
    ----------
    name : of the library. key_names : of its keys in C. start : q (nq,) and qd (nv,).

    ``definitions`` are their texts, which call ``helpers``.
    """

    def __init__(
        self, table: NumberTable, name: str, key_names: Mapping[str, str], start: tuple[Array, Array]
    ) -> None:
        self.table, self.name, self.key_names, self.start = table, name, key_names, start
        self.keys, self.big = table.made.keys, name.upper()
        self.helpers: set[str] = set()

    @cached_property
    def definitions(self) -> list[str]:
        """The functions that set numbers, look keys up, and give the start."""
        own, keys = self.name, self.keys
        lines, self.helpers = self.table.follow(
            {key.name: f"key[{self.key_names[key.name]}]" for key in keys}
        )
        uses = any("key[" in line for line in lines)
        opening = f"{INDENT}const double *key = numbers->key;\n\n" if uses else ""
        unused = "" if uses or self.table.entries else f"{INDENT}(void)numbers;\n"
        follow = (
            "/* Computes what follows from the keys; 0 where the equations would be others. */\n"
            f"static int follow({own}_numbers *numbers)\n{{\n{opening}{unused}" + "\n".join(lines) + "\n}\n"
        )
        values = "\n".join(
            f"    numbers->key[{self.key_names[key.name]}] = {literal(key.value)};" for key in keys
        )
        nominal = (
            f"void {own}_nominal({own}_numbers *numbers)\n{{\n    memset(numbers, 0, sizeof *numbers);\n{values}\n"
            "    (void)follow(numbers);\n}\n"
        )
        q, qd = (
            "\n".join(f"    {x}[{k}] = {_value(e)};" for k, e in enumerate(array))
            for x, array in (("q", self.start[0]), ("qd", self.start[1]))
        )
        start = f"void {own}_start(real q[{len(self.start[0])}], real qd[{len(self.start[1])}])\n{{\n{q}\n{qd}\n}}\n"
        return [follow, nominal, self._set(), self._key(), start]

    def _set(self) -> str:
        own, keys = self.name, self.keys
        if not keys:
            return (
                f"int {own}_set({own}_numbers *numbers, int key, double value)\n{{\n    (void)numbers;\n"
                "    (void)key;\n    (void)value;\n    return 1;\n}\n"
            )
        bounds = "\n".join(
            wrapped(
                f"static const double {name}[] = {{{', '.join(literal(getattr(k, name)) for k in keys)}}};"
            )
            for name in ("low", "high")
        )
        return f"""int {own}_set({own}_numbers *numbers, int key, double value)
{{
{bounds}
    {own}_numbers changed = *numbers;
    int k;

    if (key < 0 || key >= {self.big}_KEYS || !isfinite(value) || value < low[key] || value > high[key])
        return 1;
    changed.key[key] = value;
    if (!follow(&changed))
        return 2;
    for (k = 0; k < (int)(sizeof changed.n / sizeof *changed.n); ++k)
        if (!isfinite(changed.n[k]))
            return 2;
    *numbers = changed;
    return 0;
}}
"""

    def _key(self) -> str:
        own, keys = self.name, self.keys
        if not keys:
            return f"int {own}_key(const char *name)\n{{\n    (void)name;\n    return -1;\n}}\n"
        names = "\n".join(f"        {_quoted(key.name)}," for key in keys)
        return f"""int {own}_key(const char *name)
{{
    static const char *const names[] = {{
{names}
    }};
    int k;

    for (k = 0; k < {self.big}_KEYS; ++k)
        if (strcmp(name, names[k]) == 0)
            return k;
    return -1;
}}
"""


def _value(x: float) -> str:
    return f"(real){literal(float(x))}" if x >= 0 or np.isnan(x) else f"-(real){literal(-float(x))}"


def _quoted(text: str) -> str:
    """Return a string literal of any text, in UTF-8."""
    plain = "".join(chr(x) if 32 <= x < 127 and chr(x) not in '"\\?' else f"\\{x:03o}" for x in text.encode())
    return f'"{plain}"'
