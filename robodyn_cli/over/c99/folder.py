"""A folder of C that tests itself: the library, ``self_test.c``, CMake, pkg-config and a page about it."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from robodyn_cli.errors import CapabilityError, GeometryError
from robodyn_cli.kernels.c99 import comment, literal, wrapped
from robodyn_cli.over.c99.asked_keys import AskedKey, is_start
from robodyn_cli.over.c99.functions import CFunction
from robodyn_cli.over.c99.keys import parametrised
from robodyn_cli.over.c99.objects import LibraryObject, objects_of, objects_readme
from robodyn_cli.over.c99.samples import (
    ALLOWED,
    LEAST,
    STATES_COMPARED,
    ComparedOutput,
    ComparedStates,
    compared_states,
)
from robodyn_cli.over.c99.simulation import CSimulation, simulation_of
from robodyn_cli.over.c99.source import Library, library_name
from robodyn_cli.record import record
from robodyn_cli.results.atomic import written_folder
from robodyn_cli.scene.load import Family
from robodyn_cli.scene.units import refuse_doubles
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.version import __version__

CMAKE = """# written by robodyn {version}
cmake_minimum_required(VERSION 3.13)
project({name} LANGUAGES C)
include(GNUInstallDirs)
if(NOT CMAKE_BUILD_TYPE)
  set(CMAKE_BUILD_TYPE Release)
endif()
option({big}_SINGLE "numbers are float" OFF)

add_library({name} {sources})
set_target_properties({name} PROPERTIES C_STANDARD 99 C_STANDARD_REQUIRED ON C_EXTENSIONS OFF PUBLIC_HEADER "{headers}")
target_include_directories({name} PUBLIC
  $<BUILD_INTERFACE:${{CMAKE_CURRENT_SOURCE_DIR}}> $<INSTALL_INTERFACE:${{CMAKE_INSTALL_INCLUDEDIR}}>)
if(NOT WIN32)
  target_link_libraries({name} PUBLIC m)
endif()
if({big}_SINGLE)
  target_compile_definitions({name} PUBLIC {big}_SINGLE)
  set(DEFINED -D{big}_SINGLE)
endif()
{options}
add_executable({name}_self_test self_test.c)
target_link_libraries({name}_self_test {name})
enable_testing()
add_test(NAME self_test COMMAND {name}_self_test)

configure_file({name}.pc.in {name}.pc @ONLY)
install(TARGETS {name})
install(FILES ${{CMAKE_CURRENT_BINARY_DIR}}/{name}.pc DESTINATION ${{CMAKE_INSTALL_LIBDIR}}/pkgconfig)
"""
PKG_CONFIG = """prefix=@CMAKE_INSTALL_PREFIX@
libdir=${{prefix}}/@CMAKE_INSTALL_LIBDIR@
includedir=${{prefix}}/@CMAKE_INSTALL_INCLUDEDIR@

Name: {name}
Description: functions of the mechanism {name}, written by robodyn
Version: {version}
Cflags: -I${{includedir}} @DEFINED@
Libs: -L${{libdir}} -l{name}
Libs.private: -lm
"""
README = """# {name}

Functions of the scene `{scene}` as C99, written by robodyn {version}. No memory is allocated, nothing is kept between
calls; only `libm` is needed. `{name}.h` says what each function takes and gives, with shapes and units.

    cc -O2 *.c -lm && ./a.out

builds all and compares each function with values of robodyn at {states} states{twice};
it ends with 0 where they agree. With CMake: `cmake -B build && cmake --build build && ctest --test-dir build`;
`cmake --install build` puts library, header and pkg-config file in place.

    {name}_numbers numbers;
    {name}_nominal(&numbers);
{example}

Several tables of numbers may be in use at once, in any threads.

## Errors

Largest difference from values that are correct to all digits, in parts of the largest entry of the output, at the
states of the self test; of residuals in parts of the size of the mechanism. Single precision is what
`-D{big}_SINGLE` compiles. The self test prints the same figures as it finds them, and allows {allowed} times as much,
at least {units} units of rounding.

| function | output | double | single |
|---|---|---|---|
{errors}
{loop}{objects}{left_out}"""
LOOP_OPTIONS = """option({big}_VECTORS "the loop uses vectors of GCC and Clang" OFF)
if({big}_VECTORS)
  target_compile_definitions({name} PRIVATE {big}_VECTORS)
endif()
"""


@record
class CFolder:
    """What was written: files, notes for the user, and those files that are objects."""

    files: list[Path]
    notes: list[str]
    objects: list[LibraryObject]


def export_c(
    family: Family,
    asked: Sequence[AskedKey],
    directory: Path,
    loop: bool = False,
    processor: str | None = None,
) -> CFolder:
    """Write a scene's functions as C into a folder, whole or not at all.

    loop : whether the simulation goes with them. processor : for which of ``PROCESSORS`` there are objects, too.

    Raises
    ------
    CapabilityError : functions of a state cannot hold a part of the scene, its motion cannot leave, or a key is
    structure: it is named; llvmlite is too old for objects. OutputError : it cannot be written.
    """
    refuse_doubles(family.root, [one.name for one in asked], "--key")
    starts = [one for one in asked if is_start(family, one)] if loop else []
    made = parametrised(family, [one for one in asked if one not in starts], loop)
    if not made.own.functions:
        raise CapabilityError("it has no functions: " + "; ".join(made.own.left_out.values()), (family.path,))
    name, simulation = library_name(family.path), None
    without: list[str] = []
    if loop:  # first, since of most scenes it is what cannot leave
        simulation, without = simulation_of(family, asked, made, name)
    states = compared_states(made.own)
    library = Library(made, states, name)
    changed = None
    if made.changed is not None:
        with contextlib.suppress(GeometryError):  # other lengths may not close the loops
            changed = made.changed[0], compared_states(made.changed[1])
    notes = [f"left out: {one}: {why}" for one, why in made.own.left_out.items()] + without
    objects = [] if processor is None else objects_of(library, processor)
    about = "" if processor is None else objects_readme(library, processor, objects)
    contents: dict[str, str | bytes] = {
        f"{library.name}.h": library.header,
        f"{library.name}.c": library.source,
        **({} if simulation is None else simulation.files),
        "self_test.c": SelfTest(library, changed, "" if simulation is None else simulation.test).text,
        "CMakeLists.txt": _cmake(library, simulation is not None),
        f"{library.name}.pc.in": PKG_CONFIG.format(name=library.name, version=__version__),
        "README.md": _readme(library, changed is not None, simulation, about),
        **{one.name: one.code for one in objects},
    }
    written_folder(directory, contents)
    return CFolder([directory / name for name in contents], notes, objects)


def _cmake(library: Library, loop: bool) -> str:
    name, big = library.name, library.big
    stems = [name, *([f"{name}_loop"] if loop else [])]
    return CMAKE.format(
        name=name, big=big, version=__version__, sources=" ".join(f"{x}.c {x}.h" for x in stems),
        headers=";".join(f"{x}.h" for x in stems),
        options=LOOP_OPTIONS.format(name=name, big=big) if loop else "",
    )  # fmt: skip


def _readme(library: Library, twice: bool, simulation: CSimulation | None, objects: str) -> str:
    """Return the page about a folder; objects : the part about these."""
    scene = os.path.basename(library.made.own.problem.scene.path)
    rows = [
        f"| `{library.names[one.function]}` | {one.output} | {one.errors['double']:.1e} | {one.errors['single']:.1e} |"
        for one in library.states.outputs
    ]
    left = "".join(f"- `{name}`: {comment(why)}\n" for name, why in library.made.own.left_out.items())
    mass = library.names.get("mass_matrix")
    example = [] if mass is None else [f"    {library.name}_{mass}(&numbers, q, M);"]
    keys = library.made.keys
    if keys:
        key = library.key_names[keys[0].name]
        example.insert(
            0,
            f"    {library.name}_set(&numbers, {key}, {literal(keys[0].value)}); /* 0 where it is allowed */",
        )
    return README.format(
        name=library.name, big=library.big, scene=comment(scene), version=__version__, states=STATES_COMPARED,
        twice=", with the scene's numbers and with others" if twice else "", example="\n".join(example),
        allowed=int(ALLOWED), units=int(ALLOWED * LEAST),
        errors="\n".join(rows), loop="" if simulation is None else simulation.readme, objects=objects,
        left_out=f"\n## Left out\n\n{left}" if left else "",
    )  # fmt: skip


TEST_HEAD = """/* Compares {name} with values of robodyn. Ends with 0 where all agree. */

#include "{name}.h"

#include <math.h>
#include <stdio.h>

typedef {name}_real real;

enum {{ STATES = {states}, SETS = {sets} }};

#ifdef {big}_SINGLE
#define ALLOWED(in_double, in_single) in_single
#else
#define ALLOWED(in_double, in_single) in_double
#endif

/* Prints and judges the largest difference in parts of the largest entry. Returns 1 where it is too large. */
static int judged(const char *label, double difference, double most, double allowed)
{{
    const double part = most > 0 ? difference / most : difference;
    const int wrong = !(part <= allowed);

    printf("%-40s %9.1e   allowed %8.1e%s\\n", label, part, allowed, wrong ? "   WRONG" : "");
    return wrong;
}}

static void take(real *to, const double *from, int count)
{{
    int k;

    for (k = 0; k < count; ++k)
        to[k] = (real)from[k];
}}

/* Adds to the largest difference, and to the largest entry. */
static void compare(const real *is, const double *should, int count, double *difference, double *most)
{{
    int k;

    for (k = 0; k < count; ++k) {{
        const double off = fabs((double)is[k] - should[k]);
        if (!(off <= *difference))
            *difference = off;
        if (fabs(should[k]) > *most)
            *most = fabs(should[k]);
    }}
}}
"""


class SelfTest:
    """The test of a library: states, values of Python there, and the comparison.

    Parameters
    ----------
    changed : other values of the keys (keys,), and the comparison with these; None where there are none.
    loop : the definition of ``test_loop``, if any.
    """

    def __init__(
        self, library: Library, changed: tuple[Array, ComparedStates] | None, loop: str = ""
    ) -> None:
        self.library, self.changed, self.loop = library, changed, loop
        self.sets = [library.states, *([] if changed is None else [changed[1]])]

    @property
    def text(self) -> str:
        """The text of ``self_test.c``."""
        own = self.library
        head = TEST_HEAD.format(name=own.name, big=own.big, states=STATES_COMPARED, sets=len(self.sets))
        used = {name for f in own.functions for name in (*f.takes, *(("tau",) if f.solved else ()))}
        data = [
            _array(f"in_{name}", [states.arguments[name] for states in self.sets])
            for name in self.sets[0].arguments
            if name in used
        ]
        tests = [self._test(function) for function in own.functions]
        return "\n".join([head, *data, *tests, self._keys(), self.loop, self._main()])

    def _test(self, function: CFunction) -> str:
        own, name = self.library, self.library.names[function.name]
        places = [k for k, one in enumerate(own.states.outputs) if one.function == function.name]
        sizes = own.sizes
        lines = [
            _array(
                f"{name}_{own.states.outputs[k].output}", [states.outputs[k].values for states in self.sets]
            )
            for k in places
        ]
        takes = [*function.takes, *(["tau"] if function.solved else [])]
        outputs = {own.states.outputs[k].output: own.states.outputs[k].values.shape[1] for k in places}
        given = {**outputs, **({"lambda": function.outputs["gamma"].size} if function.solved else {})}
        local = [f"{x}[{max(1, sizes[x])}]" for x in takes if x != "t"] + [
            f"{x}[{max(1, count)}]" for x, count in given.items()
        ]
        call = f"{own.name}_{name}({', '.join(['numbers', *takes, *given])})"
        loads = [f"        take({x}, in_{x}[set][k], {sizes[x]});" for x in takes if x != "t"]
        loads += ["        t = (real)in_t[set][k][0];"] * ("t" in takes)
        called = f"        if ({call})\n            wrong = 1;" if function.solved else f"        {call};"
        compared = [
            f"        compare({x}, {name}_{x}[set][k], {count}, &difference[{i}], &most[{i}]);"
            for i, (x, count) in enumerate(outputs.items())
        ]
        judged = [
            self._judged(name, i, [states.outputs[k] for states in self.sets]) for i, k in enumerate(places)
        ]
        least = ", ".join(literal(own.states.outputs[k].least) for k in places)
        real_t = ", t" if "t" in takes else ""
        lines += [
            f"\nstatic int test_{name}(const {own.name}_numbers *numbers, int set)\n{{",
            wrapped(f"real {', '.join(local)}{real_t};"),
            f"    double difference[{len(places)}] = {{0}}, most[{len(places)}] = {{{least}}};",
            "    int k, wrong = 0;\n",
            "    for (k = 0; k < STATES; ++k) {",
            *loads, called, *compared,
            "    }",
            *judged,
            "    return wrong;\n}\n",
        ]  # fmt: skip
        return "\n".join(lines)

    @staticmethod
    def _judged(name: str, i: int, compared: Sequence[ComparedOutput]) -> str:
        kinds = ("double", "single")
        allowed = ", ".join(f"{max(one.allowed(kind) for one in compared):.2e}" for kind in kinds)
        label = f"{name} {compared[0].output}"
        return f'    wrong |= judged("{label}", difference[{i}], most[{i}], ALLOWED({allowed}));'

    def _keys(self) -> str:
        """Return the test of the keys: values of others, and what is refused."""
        own = self.library
        lines = [f"static int test_keys({own.name}_numbers *numbers)\n{{"]
        body = []
        if self.changed is not None:
            for key, x in zip(own.made.keys, self.changed[0]):
                body.append(f"    wrong |= {own.name}_set(numbers, {own.key_names[key.name]}, {literal(x)});")
            first = own.made.keys[0]
            body.append(
                f"    wrong |= {own.name}_set(numbers, {own.key_names[first.name]}, (double)NAN) != 1;"
            )
            body.append(f'    wrong |= {own.name}_key("no such key") != -1;')
        body.append(f"    wrong |= {own.name}_set(numbers, {own.big}_KEYS, 1.0) != 1;")
        lines += [
            "    int wrong = 0;\n",
            *body,
            '    printf("%-40s %s\\n", "keys", wrong ? "WRONG" : "as they should be");',
        ]
        return "\n".join([*lines, "    return wrong;\n}\n"])

    def _main(self) -> str:
        own = self.library
        calls = [f"        wrong |= test_{own.names[f.name]}(&numbers, set);" for f in own.functions]
        return "\n".join([
            "int main(void)\n{",
            f"    {own.name}_numbers numbers;\n    int set, wrong = 0;\n",
            f"    {own.name}_nominal(&numbers);",
            "    for (set = 0; set < SETS; ++set) {",
            "        if (set)\n            wrong |= test_keys(&numbers);",
            *calls,
            "    }",
            *([] if len(self.sets) > 1 else ["    wrong |= test_keys(&numbers);"]),
            *(["    wrong |= test_loop();"] if self.loop else []),
            '    printf("%s\\n", wrong ? "some are wrong" : "all agree");',
            "    return wrong;\n}\n",
        ])  # fmt: skip


def _array(name: str, sets: Sequence[Array]) -> str:
    """Return numbers (T, n) of each set of states as a table of C."""
    count = max(1, sets[0].shape[1])

    def rows(states: Array) -> Iterator[str]:
        for row in states:
            yield "{" + ", ".join(literal(float(x)) for x in (row if len(row) else np.zeros(1))) + "}"

    inside = ", ".join("{" + ", ".join(rows(states)) + "}" for states in sets)
    return wrapped(f"static const double {name}[SETS][STATES][{count}] = {{{inside}}};", "")
