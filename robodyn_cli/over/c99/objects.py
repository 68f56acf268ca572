"""A library as objects for controllers, compiled here from its C, with the sizes of its parts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from robodyn_cli.kernels.compiler import Target, compile_object
from robodyn_cli.kernels.elf import sections_of, undefined_symbols
from robodyn_cli.kernels.from_c.module import ir_of_c
from robodyn_cli.over.c99.source import Library
from robodyn_cli.record import record


@record
class Processor:
    """A processor for which objects are made: how it is called, what LLVM knows of it, and the options of GCC and Clang
    whose code calls the objects."""

    title: str
    target: Target
    options: str


PROCESSORS = {
    "cortex-m7": Processor(
        "Cortex-M7",
        Target("thumbv7em-unknown-none-eabihf", "cortex-m7", "", lanes=1, fused=True),
        "-mcpu=cortex-m7 -mthumb -mfpu=fpv5-d16 -mfloat-abi=hard",
    ),
}
KINDS = ("text", "rodata", "data", "bss")
README = """
## Objects for {title}

`{double}` and, with numbers in single precision, `{single}` are `{name}.c` as LLVM compiles it,
for little-endian {title} with its floating-point unit for doubles (FPv5-D16) and arguments in its registers:

    arm-none-eabi-gcc {options} \\
        -Wl,--gc-sections your.c {double} -lm

`{name}.h` declares their functions; with the second one define `{big}_SINGLE`. They call nothing but
{calls}.
Each function is a section of its own, so that `--gc-sections` leaves out those that are not called. Bytes of each
object, and of the code of each function; `rodata` holds an index of functions for unwinding, too:

| bytes | double | single |
|---|---|---|
{rows}
"""


@record
class LibraryObject:
    """An object file: its name, the precision of its numbers, its code, bytes by kind of section and by function."""

    name: str
    precision: str
    code: bytes
    sizes: Mapping[str, int]
    functions: Mapping[str, int]
    calls: tuple[str, ...]

    @property
    def told(self) -> dict[str, Any]:
        """What ``--json`` says of it."""
        return {"file": self.name, "precision": self.precision, **self.sizes, "calls": list(self.calls)}

    def __str__(self) -> str:
        sizes = ", ".join(f"{kind} {size}" for kind, size in self.sizes.items())
        return f"{self.name}  ({self.precision}: {sizes} bytes)"


def objects_of(library: Library, processor: str) -> list[LibraryObject]:
    """Return the objects of a library in double and in single precision.

    Raises
    ------
    CapabilityError : llvmlite is too old for other processors.
    """
    stem = f"{library.name}_{processor.replace('-', '_')}"
    made = []
    for precision, name in (("double", f"{stem}.o"), ("single", f"{stem}_single.o")):
        defined = [f"{library.big}_SINGLE"] if precision == "single" else []
        text = ir_of_c([library.header, library.source], defined)
        code = compile_object([text], PROCESSORS[processor].target)
        sections = sections_of(code)
        sizes = {kind: sum(x.size for x in sections if x.kind == kind) for kind in KINDS}
        functions = {x.name.removeprefix(".text."): x.size for x in sections if x.kind == "text" and x.size}
        made.append(LibraryObject(name, precision, code, sizes, functions, tuple(undefined_symbols(code))))
    return made


def objects_readme(library: Library, processor: str, objects: Sequence[LibraryObject]) -> str:
    """Return the part of a folder's page that is about its objects."""
    known, (double, single) = PROCESSORS[processor], objects
    rows = [f"| {kind} | {double.sizes[kind]} | {single.sizes[kind]} |" for kind in KINDS]
    rows += [
        f"| `{name}` | {size} | {single.functions.get(name, 0)} |" for name, size in double.functions.items()
    ]
    calls = sorted({*double.calls, *single.calls})
    return README.format(
        title=known.title, options=known.options, name=library.name, big=library.big, double=double.name,
        single=single.name, calls=", ".join(f"`{x}`" for x in calls), rows="\n".join(rows),
    )  # fmt: skip
