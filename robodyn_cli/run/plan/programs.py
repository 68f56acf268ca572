"""Compiled programs as the plan lists them."""

from __future__ import annotations

import hashlib
from typing import Any

from robodyn_cli.formulations.rolled import Rolled
from robodyn_cli.kernels.compiler import machine
from robodyn_cli.kernels.lower import INLINE_LIMIT
from robodyn_cli.kernels.program import Program
from robodyn_cli.kernels.rolled_tables import RolledPlan

Entry = dict[str, Any]


def _unrolled(name: str, program: Program, lanes: int, lanes_hold: str) -> Entry:
    return {
        "name": name,
        "operations": program.operations,
        "inputs": dict(program.inputs),
        "outputs": {k: len(v) for k, v in program.outputs.items()},
        "engine": "compiled",
        "shape": "unrolled",
        "lanes": lanes,
        "lanes_hold": lanes_hold,
        "digest": program.digest[:12],
    }


def sampled(name: str, program: Program, compiled: bool = True) -> Entry:
    """Describe a program that runs over samples, as many at a time as this processor has lanes."""
    if compiled:
        return _unrolled(name, program, machine().lanes, "samples")
    return {**_unrolled(name, program, 1, "blocks of samples"), "engine": "interpreted"}


def stepped(name: str, program: Program, lanes_hold: str = "state", lanes: int = 1) -> Entry:
    """Describe a program of the integrator's loop; ``stages`` or ``times`` of a step may fill the lanes."""
    entry = _unrolled(name, program, lanes, lanes_hold)
    return {**entry, "placed": "inlined" if program.operations <= INLINE_LIMIT else "function"}


def rolled(name: str, table: RolledPlan, operations: int) -> Entry:
    """Describe a loop over bodies of so many operations, those beside it included."""
    return {
        "name": name,
        "operations": operations,
        "inputs": {"q": table.nq, "v": table.nv, "a": table.nv},
        "outputs": {"out": table.nv},
        "engine": "compiled",
        "shape": "rolled",
        "lanes": machine().lanes,
        "lanes_hold": "samples",
        "digest": hashlib.sha256(table.digest.encode()).hexdigest()[:12],
    }


def rolled_step(name: str, dynamics: Rolled, lanes: int) -> Entry:
    """Describe loops over the bodies in the integrator's loop, with the program of the forces on the joints."""
    entry = rolled(name, dynamics.plan, dynamics.operations)
    forces = {k: n for k, n in dynamics.program.inputs.items() if k not in entry["inputs"]}
    return {
        **entry,
        "inputs": {"q": dynamics.plan.nq, "v": dynamics.plan.nv, **forces},
        "outputs": {"a": dynamics.plan.nv, **({"z": len(dynamics.z_rate)} if dynamics.z_rate else {})},
        "lanes": lanes,
        "lanes_hold": "state" if lanes == 1 else "stages",
        "placed": "function",
        "digest": hashlib.sha256(dynamics.digest.encode()).hexdigest()[:12],
    }


def how(entry: Entry) -> str:
    """Say how a program runs."""
    if entry["engine"] == "interpreted":
        return "interpreted, on blocks of samples"
    text = f"{entry['shape']}, "
    lanes = entry["lanes"]
    text += "one state at a time" if lanes == 1 else f"{lanes} {entry['lanes_hold']} at once"
    if "placed" in entry:
        text += f", {'inlined' if entry['placed'] == 'inlined' else 'a function'} in the stepping loop"
    return text
