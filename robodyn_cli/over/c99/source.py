"""The library: its header, and the definitions of its functions."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Sequence
from functools import cached_property

import numpy as np

from robodyn_cli.kernels.c99 import (
    INDENT,
    REAL,
    TIED,
    Statements,
    comment,
    helpers_text,
    identifier,
    literal,
    wrapped,
)
from robodyn_cli.over.c99.functions import GROUPS, CFunction
from robodyn_cli.over.c99.keys import Parametrised
from robodyn_cli.over.c99.samples import LOST, ComparedStates
from robodyn_cli.over.c99.solve import SOLVE
from robodyn_cli.over.c99.table import PLACED, FunctionNames, NumberFunctions, NumberTable
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.version import __version__

MEANINGS = {
    "t": "time [s]",
    "q": "positions",
    "qd": "rates",
    "qdd": "accelerations",
    "tau": "torques of the joints",
    "z": "states of the controller",
    "noise": "standard normal random numbers of the sensors",
}
STATUS = "Returns 0; 1 where loops lose rank; 2 where nothing has inertia along a motion that they leave."


def unique(names: Iterable[str]) -> list[str]:
    """Return names as identifiers, each another one."""
    taken: list[str] = []
    for name in names:
        own, k = identifier(name), 2
        while own in taken:
            own, k = f"{identifier(name)}_{k}", k + 1
        taken.append(own)
    return taken


def library_name(path: str) -> str:
    """Return what the C of a scene's file is called."""
    stem = identifier(os.path.splitext(os.path.basename(path))[0]) or "scene"
    return stem if stem[0].isalpha() else f"robot_{stem.lstrip('_')}"


class Library:
    """The C of the functions of a scene: ``header`` and ``source`` are its texts.

    Parameters
    ----------
    made : functions and keys. states : of the start, and their comparison. name : of the library.
    """

    def __init__(self, made: Parametrised, states: ComparedStates, name: str) -> None:
        self.made, self.states, self.name = made, states, name
        self.big = name.upper()
        self.functions = made.own.functions
        self.model = made.own.problem.model
        self.control = made.own.problem.control
        self.names = dict(zip((f.name for f in self.functions), unique(f.name for f in self.functions)))
        keys = [key.name for key in made.keys]
        self.key_names = dict(zip(keys, (f"{self.big}_KEY_{x}" for x in unique(keys))))
        self.table = NumberTable(made)
        self._helpers: set[str] = set()
        # the table has its size when all functions are written
        self._bodies = [self._body(function) for function in self.functions]

    @property
    def sizes(self) -> dict[str, int]:
        """How many entries each argument has."""
        controls = 0 if self.control is None else len(self.control.z)
        noise = 0 if self.control is None else self.control.channels
        nv = self.model.nv
        return {"q": self.model.nq, "qd": nv, "qdd": nv, "tau": nv, "z": controls, "noise": noise}

    # -- declarations -------------------------------------------------------------------------------------
    def arguments(self, function: CFunction, real: str) -> list[str]:
        """Return the parameters of a function as C declares them."""
        listed = [f"const {self.name}_numbers *numbers"]
        for name in function.takes:
            listed.append(f"{real} t" if name == "t" else f"const {real} {name}[{max(1, self.sizes[name])}]")
        if function.solved:
            rows = function.outputs["gamma"].size
            listed += [
                f"const {real} tau[{self.model.nv}]",
                f"{real} qdd[{self.model.nv}]",
                f"{real} lambda[{rows}]",
            ]
        else:
            listed += [f"{real} {name}[{max(1, out.size)}]" for name, out in function.outputs.items()]
        return listed

    def _declared(self, function: CFunction, real: str) -> str:
        kind = "int" if function.solved else "void"
        listed = ", ".join(x.replace(" ", TIED) for x in self.arguments(function, real))
        return f"{kind} {self.name}_{self.names[function.name]}({listed})"

    def _described(self, function: CFunction) -> str:
        """Return the comment above a declaration: what it does, shapes and units."""
        lines = [function.meaning]
        if function.solved:
            lines += [
                STATUS,
                f"tau ({self.model.nv}): torques of the joints.",
                f"qdd ({self.model.nv}): accelerations.",
            ]
            lines.append(f"lambda ({function.outputs['gamma'].size}): multipliers of the rows, N or N m.")
        else:
            for name, out in function.outputs.items():
                lines.append(f"{name} {_shape(out.entries)}: {out.meaning} [{out.units}].")
        return _block_comment(lines)

    @cached_property
    def header(self) -> str:
        """The text of the header."""
        own, big = self.name, self.big
        parts = [
            _block_comment(self._about()),
            f"#ifndef {big}_H\n#define {big}_H\n",
            f"#ifdef {big}_SINGLE\ntypedef float {own}_real;\n#else\ntypedef double {own}_real;\n#endif\n",
            self._enumerations(),
            self._table_type(),
            '#ifdef __cplusplus\nextern "C" {\n#endif\n',
            *self._of_numbers(),
            *(
                f"{self._described(f)}{wrapped(self._declared(f, f'{own}_real'), '')};\n"
                for f in self.functions
            ),
            "#ifdef __cplusplus\n}\n#endif\n",
            "#endif\n",
        ]
        return "\n".join(parts)

    def _about(self) -> list[str]:
        scene, model = self.made.own.problem.scene, self.model
        lines = [
            f"{self.name}: functions of the scene {os.path.basename(scene.path)}, written by robodyn {__version__}.",
            "",
            "Arrays are row by row, units SI. Outputs must not overlap inputs. Nothing is allocated, nothing kept.",
            f"Where {self.big}_SINGLE is defined, numbers are float in place of double.",
            "",
            f"q ({model.nq}), positions: {_columns(model.q_names, model.q_units)}.",
            f"qd ({model.nv}), rates: {_columns(model.v_names, [f'{x}/s' for x in model.v_units])}.",
            f"qdd and tau ({model.nv}) have the order of qd.",
        ]
        if self.control is not None:
            lines.append(
                f"z ({len(self.control.z)}), states of the controller: {', '.join(self.control.names) or 'none'}."
            )
            lines.append(f"Driven joints, in this order: {', '.join(self.control.joints)}.")
        lines += [f"Left out: {name}: {why}." for name, why in self.made.own.left_out.items()]
        return lines

    def _enumerations(self) -> str:
        big, model = self.big, self.model
        constants = {"NQ": model.nq, "NV": model.nv}
        if self.control is not None:
            constants |= {"NZ": len(self.control.z), "NDRIVEN": len(self.control.joints)}
        lines = [f"enum {{ {', '.join(f'{big}_{k} = {x}' for k, x in constants.items())} }};"]
        for kind, names in (("Q", model.q_names), ("QD", model.v_names)):
            members = ", ".join(f"{big}_{kind}_{x} = {k}" for k, x in enumerate(unique(names)))
            lines.append(wrapped(f"enum {{ {members} }};", ""))
        if self.control is not None and self.control.period is not None:
            lines.append(f"#define {big}_CONTROL_PERIOD {literal(float(self.control.period))} /* s */")
            if self.control.rest:
                lines.append(f"#define {big}_CONTROL_REST {literal(float(self.control.rest))} /* s */")
        return "\n".join(lines) + "\n"

    def _table_type(self) -> str:
        """Return the keys, and the type of a table of numbers."""
        members = [
            f"    {self.key_names[key.name]}, /* {comment(key.name)}{f' [{comment(key.unit)}]' if key.unit else ''}"
            f"{_bounds(key.low, key.high)} */"
            for key in self.made.keys
        ]
        keys, own = "\n".join(members), self.name
        return (
            f"/* Keys of the scene that can be set. */\nenum {own}_key {{\n{keys}{chr(10) if members else ''}"
            f"    {self.big}_KEYS\n}};\n\n"
            "/* The numbers of the scene: keys, and what follows from them. Only the functions below change them. */\n"
            f"typedef struct {{\n    double key[{max(1, len(members))}];\n"
            f"    {own}_real {PLACED}[{max(1, len(self.table.entries))}];\n}} {own}_numbers;\n"
        )

    def _of_numbers(self) -> list[str]:
        own = self.name
        return [
            f"/* Sets all numbers to those of the scene. */\nvoid {own}_nominal({own}_numbers *numbers);\n",
            "/* Sets a key. Returns 0; 1 without such a key or beyond its bounds; 2 where the equations were others.\n"
            f"   The numbers stay as they were unless it returns 0. */\n"
            f"int {own}_set({own}_numbers *numbers, int key, double value);\n",
            f"/* Returns the key of a name such as those above, -1 for none. */\nint {own}_key(const char *name);\n",
            f"/* The state at which the scene starts: q ({self.model.nq}), qd ({self.model.nv}). */\n"
            f"void {own}_start({own}_real q[{self.model.nq}], {own}_real qd[{self.model.nv}]);\n",
        ]

    # -- definitions --------------------------------------------------------------------------------------
    @cached_property
    def source(self) -> str:
        """The text of the definitions."""
        own = self.name
        numbers = NumberFunctions(self.table, own, self.key_names, (self.states.q, self.states.qd))
        definitions = [*numbers.definitions, *self._bodies]
        solves = any(f.solved for f in self.functions)
        parts = [
            f"/* {own}.h says what these functions do. */\n",
            f'#include "{own}.h"\n\n#include <math.h>\n#include <string.h>\n',
            f"typedef {own}_real real;\n",
            f"#ifdef {self.big}_SINGLE\n#define F(x) x##f\n#else\n#define F(x) x\n#endif\n",
            helpers_text(self._helpers | numbers.helpers),
            self._solver() if solves else "",
            *definitions,
        ]
        return "\n".join(part for part in parts if part)

    def _solver(self) -> str:
        rows = next(f.outputs["gamma"].size for f in self.functions if f.solved)
        head = f"enum {{ NV = {self.model.nv}, ROWS = {rows}, RANK = {self.states.rank} }};\n"
        return (
            f"#ifdef {self.big}_SINGLE\n#define LOST F({LOST['single']}) /* of the largest pivot */\n"
            f"#else\n#define LOST F({LOST['double']})\n#endif\n\n{head}\n{SOLVE}"
        )

    def _body(self, function: CFunction) -> str:
        """Return the definition of a function."""
        program = self.made.programs[function.name]
        declared: list[str] = []
        q = [identifier(x) for x in unique(self.model.q_names)]
        arguments = {GROUPS[name]: name for name in function.takes}
        names = FunctionNames(self.table, program, arguments, {"q": q}, declared)
        written = Statements(program, names)
        self._helpers |= written.helpers
        stores = [
            wrapped(f"{output}[{k}] = {x};")
            for output, values in written.values.items()
            for k, x in enumerate(values)
        ]
        stores += [f"{INDENT}{name}[0] = 0;" for name, out in function.outputs.items() if not out.size]
        text = "\n".join([*declared, *written.lines, *stores])
        if function.solved:
            return self._solved_body(function, text)
        head = wrapped(_restrict(self._declared(function, REAL), function), "")
        return f"{head}\n{{\n{self._opening(function, text)}{text}\n}}\n"

    def _opening(self, function: CFunction, text: str) -> str:
        """Return what a body begins with: the table under its short name, and arguments that it does not use."""
        lines = []
        if re.search(rf"\b{PLACED}(\[| \+)", text):
            lines.append(f"{INDENT}const real *{PLACED} = numbers->{PLACED};")
            unused = []
        else:
            unused = ["numbers"]
        used = self.made.programs[function.name].inputs
        unused += [name for name in function.takes if GROUPS[name] not in used]
        return "\n".join([*lines, *(f"{INDENT}(void){name};" for name in unused), ""]) + "\n"

    def _solved_body(self, function: CFunction, text: str) -> str:
        """Return the linear equations of a function, and the function that solves them."""
        own, name = self.name, self.names[function.name]
        takes = ["numbers", *function.takes]
        listed = [f"const {own}_numbers *numbers"]
        listed += ["real t" if x == "t" else f"const real *{x}" for x in function.takes]
        listed += [f"real *restrict {x}" for x in function.outputs]
        head = wrapped(f"static void {name}_parts({', '.join(x.replace(' ', TIED) for x in listed)})", "")
        parts = f"{head}\n{{\n{self._opening(function, text)}{text}\n}}\n"
        arrays = ", ".join(f"{x}[{out.size}]" for x, out in function.outputs.items())
        body = [
            f"    real {arrays};\n    int k;\n",
            f"    {name}_parts({', '.join([*takes, *function.outputs])});",
            "    for (k = 0; k < NV; ++k)\n        load[k] = tau[k] - load[k];",
            "    return solve_constrained(M, load, Psi, gamma, qdd, lambda);",
        ]
        return parts + f"\n{wrapped(self._declared(function, REAL), '')}\n{{\n" + "\n".join(body) + "\n}\n"


def _restrict(declared: str, function: CFunction) -> str:
    """Return a declaration whose outputs overlap nothing; C leaves that out of the function's type."""
    for name in function.outputs:
        declared = declared.replace(f"{TIED}{name}[", f"{TIED}{name}[restrict{TIED}")
    return declared


def _shape(entries: Array) -> str:
    return f"({' x '.join(map(str, entries.shape))})"


def _columns(names: Sequence[str], units: Sequence[str]) -> str:
    return ", ".join(f"{name} [{unit}]" for name, unit in zip(names, units))


def _bounds(low: float, high: float) -> str:
    if np.isinf(low) and np.isinf(high):
        return ""
    return f", {'' if np.isinf(low) else f'{low:.6g} '}..{'' if np.isinf(high) else f' {high:.6g}'}"


def _block_comment(lines: Sequence[str]) -> str:
    inside = [wrapped(comment(line), " * ") if line else " *" for line in lines]
    text = "\n".join(inside).replace("\n * " + INDENT, "\n *   ")
    return f"/*\n{text}\n */\n"
