"""The instruction list of a kernel, independent of how it is compiled.

A Program is the part of a graph that some outputs need, renumbered from zero, so that equal scenes give equal
programs whatever else was built in the graph. Its digest is the key of the cache of compiled code.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from functools import cached_property
from typing import Any

from robodyn_cli.errors import SceneError
from robodyn_cli.expr.graph import Expr, Scalar, reachable
from robodyn_cli.record import record

TRIGONOMETRIC = frozenset({"sin", "cos"})


@record
class Instruction:
    """One operation on earlier instructions; ``value`` is a constant's value or a symbol's (group, position)."""

    op: str
    args: tuple[int, ...]
    value: Any = None


@record
class Program:
    """Straight-line code with named outputs.

    outputs : per output array, the instruction of each entry, or a float where it is constant.
    """

    instructions: tuple[Instruction, ...]
    outputs: dict[str, tuple[int | float, ...]]

    @cached_property
    def operations(self) -> int:
        """Number of arithmetic operations and function calls."""
        return sum(i.op not in ("sym", "const") for i in self.instructions)

    @cached_property
    def inputs(self) -> dict[str, int]:
        """Input arrays and one more than the highest position read of each."""
        found: dict[str, int] = {}
        for i in self.instructions:
            if i.op == "sym":
                group, position = i.value
                found[group] = max(found.get(group, 0), position + 1)
        return found

    @property
    def sizes(self) -> dict[str, int]:
        """Sizes of the outputs."""
        return {name: len(entries) for name, entries in self.outputs.items()}

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the canonical text of the program."""
        hasher = hashlib.sha256()
        lines = []
        for i in self.instructions:
            value = i.value.hex() if i.op == "const" else i.value
            lines.append(f"{i.op} {i.args} {value}\n")
        for name, entries in self.outputs.items():
            lines.append(f"{name}: {[e.hex() if isinstance(e, float) else e for e in entries]}\n")
        hasher.update("".join(lines).encode())
        return hasher.hexdigest()


def make_program(outputs: dict[str, Sequence[Scalar]], known: Sequence[str]) -> Program:
    """Collect what the outputs need into a Program.

    Parameters
    ----------
    outputs : named arrays of expressions or numbers.
    known : symbol groups that the kernel has inputs for.

    Raises
    ------
    SceneError : the outputs depend on something that the scene does not say (an unknown mass or inertia).
    """
    nodes = reachable([e for array in outputs.values() for e in array])
    number: dict[int, int] = {}
    instructions: list[Instruction] = []
    missing: list[str] = []
    for node in nodes:
        number[node.index] = len(instructions)
        value = node.value
        if node.op == "sym":
            name, group, position = node.value
            if group not in known:
                missing.append(name)
            value = (group, position)
        instructions.append(Instruction(node.op, tuple(number[a.index] for a in node.args), value))
    if missing:
        raise unknown_data(missing)
    return Program(
        tuple(instructions),
        {
            name: tuple(number[e.index] if isinstance(e, Expr) else float(e) for e in array)
            for name, array in outputs.items()
        },
    )


def unknown_data(names: Sequence[str]) -> SceneError:
    """Return the error that names data the equations need and the scene does not give."""
    listed = ", ".join(sorted(set(names)))
    hint = ""
    if any("inertia.x" in n or "inertia.y" in n or n.startswith("com[2]") for n in names):
        hint = " (the motion or the load leaves the plane)"
    return SceneError(
        f"the equations of motion need {listed}, which the scene does not give{hint}",
        missing=sorted(set(names)),
    )
