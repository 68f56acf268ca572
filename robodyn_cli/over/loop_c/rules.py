"""Rules that ``over/live/rules.py`` records, as C: a function each, whose values lie in memory of the caller."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from robodyn_cli.kernels.c99 import identifier, literal, wrapped
from robodyn_cli.record import record

# entry by entry
SIGNS = {
    "add": "{0} + {1}", "subtract": "{0} - {1}", "multiply": "{0} * {1}", "divide": "{0} / {1}",
    "power": "pow({0}, {1})", "minimum": "least({0}, {1})", "maximum": "most({0}, {1})", "negative": "-{0}",
    "absolute": "fabs({0})", "sqrt": "sqrt({0})", "exp": "exp({0})", "log": "log({0})", "rint": "rint({0})",
    "floor": "floor({0})",
    "sign": "sign({0})", "isfinite": "{0} - {0} == 0.0", "isnan": "{0} != {0}", "less": "{0} < {1}",
    "less_equal": "{0} <= {1}", "greater": "{0} > {1}", "greater_equal": "{0} >= {1}", "equal": "{0} == {1}",
    "not_equal": "{0} != {1}", "logical_and": "{0} != 0.0 && {1} != 0.0", "logical_or": "{0} != 0.0 || {1} != 0.0",
    "logical_not": "!({0} != 0.0)", "where": "{0} != 0.0 ? {1} : {2}",
}  # fmt: skip
# rows that become one entry: where they begin, and what each entry does
REDUCED = {
    "max": ("-HUGE_VAL", "most({0}, {1})"), "min": ("HUGE_VAL", "least({0}, {1})"), "sum": ("0.0", "{0} + {1}"),
    "all": ("1.0", "{0} != 0.0 && {1} != 0.0"), "any": ("0.0", "{0} != 0.0 || {1} != 0.0"),
}  # fmt: skip
FEW_RUNS = 8  # stretches of entries that are copied one after another in the text; more lie in a table


# what runs give to rules, and what these say of them, wherever a rule asks for it
GIVEN = (
    "steps", "time", "again.steps", "again.given_up", "jacobian", "mass", "psi", "eta", "cosines", "size", "q", "v",
    "part", "best.q", "best.distance", "best.full", "best.sure",
    "energies.start", "energies.end", "work", "start", "first.out", "first.end", "again.out", "again.end",
    "again.time", "third.out", "third.end",
)  # fmt: skip
JUDGED = (
    "w", "when", "most", "good", "step", "v", "end", "time_error", "q",
    "best.q", "best.distance", "best.full", "best.sure",
)  # fmt: skip


@record
class _Place:
    """Where a value lies: an expression of its first entry, and how many it has. first : in the scratch, or -1."""

    text: str
    size: int
    first: int = -1
    number: str = ""  # of one entry that is known

    def entry(self, k: str = "k") -> str:
        return self.number or f"{self.text}[{k if self.size > 1 else 0}]"


class CRules:
    """Rules as C.

    given, judged : names of all that rules take and say. scratch : doubles that each rule takes, by its name.
    """

    def __init__(
        self,
        rules: Mapping[str, Any],
        examples: Mapping[str, Any],
        given: Sequence[str] = GIVEN,
        judged: Sequence[str] = JUDGED,
    ) -> None:
        taken = [name for own, _ in examples.values() for name in own]
        said = [name for rule in rules.values() for name in rule["outputs"]]
        self.given, self.judged = (list(dict.fromkeys(x)) for x in ([*given, *taken], [*judged, *said]))
        self.scratch: dict[str, int] = {}
        self.functions = []
        for name, rule in rules.items():
            sizes = {key: int(np.size(x)) for key, x in examples[name][0].items()}
            function = _Rule(name, rule, sizes)
            self.scratch[name] = function.room.size
            self.functions.append(function.text)

    @property
    def text(self) -> str:
        """The structs and the functions."""
        given = "\n".join(f"    const double *{identifier(name)};" for name in self.given)
        made = "\n".join(f"    const double *{identifier(name)};" for name in self.judged)
        structs = f"typedef struct {{\n{given}\n}} Given;\n\ntypedef struct {{\n{made}\n}} Judged;\n"
        return "\n".join([structs, *self.functions])


def double(value: float) -> str:
    """Return a double with all its digits; that which is no number is a float in C."""
    return "(double)NAN" if math.isnan(value) else literal(value)


def rule_name(name: str) -> str:
    """Return what the function of a rule is called."""
    return f"rule_{identifier(name)}"


class _Room:
    """Scratch that is given out and taken back. size : doubles that were needed at most."""

    def __init__(self) -> None:
        self.taken: list[tuple[int, int]] = []
        self.size = 0

    def take(self, count: int) -> int:
        at = 0
        for first, size in sorted(self.taken):
            if first - at >= count:
                break
            at = max(at, first + size)
        self.taken.append((at, count))
        self.size = max(self.size, at + count)
        return at

    def give_back(self, first: int) -> None:
        self.taken = [x for x in self.taken if x[0] != first]


class _Rule:
    """The function of one rule."""

    def __init__(self, name: str, rule: Mapping[str, Any], sizes: Mapping[str, int]) -> None:
        self.name, self.room = name, _Room()
        self.lines: list[str] = []
        self.tables: dict[str, str] = {}
        self.places: list[_Place] = []
        code = rule["code"]
        last = {k: place for place, step in enumerate(code) for k in step[1]}
        kept = set(rule["outputs"].values())
        for place, (op, args, *data) in enumerate(code):
            own = [self.places[k] for k in args]
            self.places.append(self._value(op, own, data, sizes, place in last or place in kept))
            for k in {*args, place}:
                if k not in kept and last.get(k, place) <= place and self.places[k].first >= 0:
                    self.room.give_back(self.places[k].first)
        outputs = [
            f"    judged->{identifier(key)} = {self.places[k].text};" for key, k in rule["outputs"].items()
        ]
        body = "\n".join(self.lines)
        used = [f"    (void){x};" for x in ("given", "s") if f"{x}->" not in body and f"{x} +" not in body
                and not (x == "given" and "given->" in "\n".join(outputs))]  # fmt: skip
        declared = [f"    int {x};" for x in ("k", "n", "i0", "i1", "i2", "i3", "i4") if f" {x} <" in body]
        head = f"static void {rule_name(name)}(const Given *given, Judged *judged, double *s)\n{{"
        everything = body + "\n".join(outputs)
        tables = [text for name, text in self.tables.items() if re.search(rf"\b{name}\b", everything)]
        self.text = "\n".join([*tables, head, *declared, *used, body, *outputs, "}\n"])

    def _value(
        self, op: str, args: Sequence[_Place], data: Sequence[Any], sizes: Mapping[str, int], used: bool
    ) -> _Place:
        if op == "input":
            return _Place(f"given->{identifier(data[0])}", sizes[data[0]])
        if op == "constant":
            return self._constant([float(str(x).replace("Infinity", "inf")) for x in data[0]])
        if not used:
            return _Place("s", 0)
        if op in SIGNS:
            return self._entrywise(op, args)
        if op == "take":
            return self._taken(args, data[0])
        if op in REDUCED:
            return self._reduced(op, args[0], *data)
        return self._matrices(op, args, data)

    def _new(self, count: int) -> _Place:
        first = self.room.take(count)
        return _Place(f"(s + {first})", count, first)

    def _constant(self, values: Sequence[float]) -> _Place:
        table = f"{rule_name(self.name)}_{len(self.tables)}"
        listed = ", ".join(map(double, values)) or "0.0"
        self.tables[table] = wrapped(
            f"static const double {table}[{max(1, len(values))}] = {{{listed}}};", ""
        )
        number = f"({literal(values[0])})" if len(values) == 1 and math.isfinite(values[0]) else ""
        return _Place(table, len(values), number=number)

    def _entrywise(self, op: str, args: Sequence[_Place]) -> _Place:
        out = self._new(max(a.size for a in args))
        text = SIGNS[op].format(*(a.entry() for a in args))
        self.lines.append(f"    for (k = 0; k < {out.size}; ++k)\n        {out.text}[k] = {text};")
        return out

    def _reduced(self, op: str, rows: _Place, length: int, initial: float | None) -> _Place:
        start, step = REDUCED[op]
        out = self._new(rows.size // length if length else 1)
        first = start if initial is None else literal(initial)
        self.lines += [
            f"    for (n = 0; n < {out.size}; ++n) {{",
            f"        {out.text}[n] = {first};",
            f"        for (k = 0; k < {length}; ++k)",
            f"            {out.text}[n] = {step.format(f'{out.text}[n]', f'{rows.text}[n * {length} + k]')};",
            "    }",
        ]
        return out

    # -- entries elsewhere ----------------------------------------------------------------------------
    def _taken(self, args: Sequence[_Place], runs: Any) -> _Place:
        if len(args) == 1:
            return self._picked(args[0], runs)
        whole = self._new(sum(a.size for a in args))
        at = 0
        for a in args:
            self._copy(f"{whole.text} + {at}", a.text, a.size)
            at += a.size
        if not isinstance(runs, Mapping) and list(runs) == [0, whole.size]:
            return whole
        out = self._picked(whole, runs)
        self.room.give_back(whole.first)
        return out

    def _copy(self, to: str, source: str, count: int) -> None:
        if count:
            self.lines.append(f"    memcpy({to}, {source}, {count} * sizeof(double));")

    def _picked(self, x: _Place, runs: Any) -> _Place:
        if isinstance(runs, Mapping):
            return self._strided(x, runs["first"], runs["shape"], runs["strides"])
        pairs = list(zip(runs[::2], runs[1::2]))
        out = self._new(sum(count for _, count in pairs))
        if len(pairs) <= FEW_RUNS:
            at = 0
            for first, count in pairs:
                self._copy(f"{out.text} + {at}", f"{x.text} + {first}", count)
                at += count
            return out
        table = f"{rule_name(self.name)}_{len(self.tables)}"
        listed = ", ".join(map(str, runs))
        self.tables[table] = wrapped(f"static const int {table}[{len(runs)}] = {{{listed}}};", "")
        self.lines.append(f"    gather({out.text}, {x.text}, {table}, {len(runs)});")
        return out

    def _strided(self, x: _Place, first: int, shape: Sequence[int], strides: Sequence[int]) -> _Place:
        out = self._new(math.prod(shape))
        place, at = str(first), "0"
        lines = []
        for k, (count, stride) in enumerate(zip(shape, strides)):
            lines.append(f"{'    ' * (k + 1)}for (i{k} = 0; i{k} < {count}; ++i{k})")
            place += f" + {stride} * i{k}"
            at = f"({at}) * {count} + i{k}" if k else f"i{k}"
        lines.append(f"{'    ' * (len(shape) + 1)}{out.text}[{at}] = {x.text}[{place}];")
        self.lines += lines
        return out

    # -- matrices -------------------------------------------------------------------------------------
    def _matrices(self, op: str, args: Sequence[_Place], data: Sequence[Any]) -> _Place:
        """Write a call of ``operations.c``: out, arguments, sizes, how many matrices, memory to work in."""
        a = args[0].size
        sizes = [int(x) for x in data if isinstance(x, int)]
        m, n = (sizes + [0, 0])[:2]
        small = min(m, n)
        least = {"sigma": (m * n, small), "right_vectors": (m * n, small * n), "pinv": (m * n, m * n)}
        if op == "matmul":
            one, each = m * n, m * sizes[2]
        elif op == "solve":
            one, each = m * m, m * n
        elif op == "det":
            one, each = m * m, 1
        elif op == "sort":
            one, each = m, m
        elif op == "row":
            one, each = m * n, n
        else:
            one, each = least[op]
        count = a // one if one else 0
        out = self._new(count * each)
        work = self._new(2 * a + 2 * max(m, n, 1) ** 2 + 4 * max(m, n, 1))
        if op == "row":
            sizes.append(args[1].size)
        listed = [out.text, *(x.text for x in args), *map(str, sizes), str(count)]
        listed += [literal(x) for x in data if not isinstance(x, int)]
        self.lines.append(wrapped(f"{op}({', '.join(listed)}, {work.text});"))
        self.room.give_back(work.first)
        return out
