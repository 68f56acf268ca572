"""Compiled programs as the plan lists them."""

from __future__ import annotations

import hashlib
from typing import Any

from robodyn_cli.formulations.rolled import Rolled
from robodyn_cli.integrators.stepping.writer import INLINE_LIMIT, LANES
from robodyn_cli.kernels.compiler import machine
from robodyn_cli.kernels.program import Program
from robodyn_cli.kernels.rolled_tables import RolledPlan


def _entry(name: str, program: Program, lanes: int, lanes_hold: str) -> dict[str, Any]:
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


def sampled(name: str, program: Program, compiled: bool = True) -> dict[str, Any]:
    """Describe a program that runs over samples, as many at a time as this processor has lanes."""
    entry = _entry(name, program, machine().lanes, "samples")
    if not compiled:
        entry.update(engine="interpreted", lanes=1, lanes_hold="blocks of samples")
    return entry


def rolled(name: str, table: RolledPlan, extra: int) -> dict[str, Any]:
    """Describe a loop over bodies; ``extra`` : operations beside it."""
    a = {"q": table.nq, "v": table.nv, "a": table.nv}
    return {
        "name": name,
        "operations": table.bodies * table.recursion.operations + extra,
        "inputs": a,
        "outputs": {"out": table.nv},
        "engine": "compiled",
        "shape": "rolled",
        "lanes": machine().lanes,
        "lanes_hold": "samples",
        "digest": hashlib.sha256(table.digest.encode()).hexdigest()[:12],
    }


def rolled_step(name: str, dynamics: Rolled, lanes_hold: str) -> dict[str, Any]:
    """Describe loops over the bodies in the integrator's loop, with the program of the forces on the joints."""
    found = rolled(name, dynamics.plan, dynamics.program.operations)
    forces = {k: n for k, n in dynamics.program.inputs.items() if k not in found["inputs"]}
    found.update(
        inputs={"q": dynamics.plan.nq, "v": dynamics.plan.nv, **forces},
        outputs={"a": dynamics.plan.nv, **({"z": len(dynamics.z_rate)} if dynamics.z_rate else {})},
        lanes=1 if lanes_hold == "state" else LANES,
        lanes_hold=lanes_hold,
        placed="function",
        digest=hashlib.sha256(dynamics.digest.encode()).hexdigest()[:12],
    )
    return found


def stepped(name: str, program: Program, lanes_hold: str) -> dict[str, Any]:
    """Describe a program of the integrator's loop; ``stages`` or ``times`` of a step may fill the lanes."""
    entry = _entry(name, program, 1 if lanes_hold == "state" else LANES, lanes_hold)
    entry["placed"] = "inlined" if program.operations <= INLINE_LIMIT else "function"
    return entry


def how(entry: dict[str, Any]) -> str:
    """Say how a program runs."""
    if entry["engine"] == "interpreted":
        return "interpreted, on blocks of samples"
    text = f"{entry['shape']}, "
    lanes = entry["lanes"]
    text += "one state at a time" if lanes == 1 else f"{lanes} {entry['lanes_hold']} at once"
    if "placed" in entry:
        text += f", {'inlined' if entry['placed'] == 'inlined' else 'a function'} in the stepping loop"
    return text
