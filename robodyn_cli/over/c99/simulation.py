"""The simulation that goes with the functions of a scene."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence

from robodyn_cli.over.c99.asked_keys import AskedKey, is_start
from robodyn_cli.over.c99.keys import Parametrised, key_bounds
from robodyn_cli.record import record
from robodyn_cli.scene.load import Family

LOOP_README = """
## Simulation

`{name}_loop.h` makes the motion that `robodyn {command}` makes of the scene, in double precision: the same compiled
loop, statement for statement. With the values of the scene it ends at {time:.12g} s, after {steps} steps.

    double values[{big}_LOOP_KEYS + 1];
    static {name}_loop_room room;
    {name}_loop_result result;
    {name}_loop_values(values);
    if ({name}_loop_run(&room, values, &result, NULL) == 0)
        printf("%g s +- %g s\\n", result.time, result.time_error);

`{name}_loop_run` integrates twice, so that what it gives has its error, and closes loops for other values. Where its
rules do not vouch for a run it returns a reason, and robodyn itself has to be asked. `{name}_loop_begin` and
`{name}_loop_to` go step by step; an integration takes {kilobytes:.0f} kB. `-D{big}_VECTORS` takes vectors of GCC and
Clang: the loop compiles and runs faster.
"""


@record
class CSimulation:
    """The simulation of a scene as C: files by name, the definition of its test, and what is told of it."""

    files: Mapping[str, str]
    test: str
    readme: str


def simulation_of(
    family: Family, asked: Sequence[AskedKey], made: Parametrised, name: str
) -> tuple[CSimulation, list[str]]:
    """Return the simulation with the keys that are asked for, and what to say of those that are left out."""
    from robodyn_cli.over.loop_c.expected import loop_test
    from robodyn_cli.over.loop_c.library import LoopLibrary
    from robodyn_cli.over.loop_c.structure import left_out, structure_of

    bounds = {key.name: (key.low, key.high) for key in made.keys}
    others = [one for one in asked if one.name not in bounds and not is_start(family, one)]
    bounds |= key_bounds(family, others)
    ranges = {one.name: bounds.get(one.name, one.ends) for one in asked}
    structure, without = structure_of(family, ranges, bounds)
    library = LoopLibrary(structure, name, os.path.basename(made.own.problem.scene.path))
    first = structure.judging.first
    readme = LOOP_README.format(
        name=name, big=library.big, command=structure.command.name, time=float(first.time[0]),
        steps=int(first.steps[0]), kilobytes=8 * sum(library.tables.integration.values()) / 1000,
    )  # fmt: skip
    files = {f"{name}_loop.h": library.header, f"{name}_loop.c": library.source}
    return CSimulation(files, loop_test(library), readme), left_out(without)
