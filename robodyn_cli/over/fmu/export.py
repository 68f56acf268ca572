"""A scene as a unit of FMI 3.0: sources, and a binary where a C compiler is at hand."""

from __future__ import annotations

import hashlib
import io
import os
import platform
import re
import shutil
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from robodyn_cli.errors import CapabilityError, RobodynError, of_option
from robodyn_cli.foreign import opened
from robodyn_cli.kernels.as_c.words import text_beside
from robodyn_cli.over.c99.asked_keys import AskedKey, is_start
from robodyn_cli.over.c99.keys import input_bounds, key_bounds, parametrised
from robodyn_cli.over.c99.source import library_name
from robodyn_cli.over.fmu.description import UnitDescription
from robodyn_cli.over.fmu.set_points import with_set_points
from robodyn_cli.over.fmu.structure import FmuStructure
from robodyn_cli.over.loop_c.library import LoopLibrary
from robodyn_cli.over.loop_c.structure import left_out, with_able_keys
from robodyn_cli.results.atomic import write_bytes
from robodyn_cli.scene.load import Family
from robodyn_cli.scene.units import refuse_doubles

SUFFIX = ".fmu"
SYSTEMS = {"linux": ("linux", ".so"), "darwin": ("darwin", ".dylib"), "win32": ("windows", ".dll")}
MACHINES = {"x86_64": "x86_64", "amd64": "x86_64", "arm64": "aarch64", "aarch64": "aarch64", "i686": "x86"}
COMPILERS = ("cc", "gcc", "clang")  # MinGW brings no cc
FLAGS = ("-std=c99", "-O2", "-shared", "-fPIC", "-fvisibility=hidden")
EPOCH = (1980, 1, 1, 0, 0, 0)  # of entries: the same scene gives the same file


def export_fmu(
    family: Family,
    target: Path,
    asked: Sequence[AskedKey],
    inputs: Sequence[AskedKey] = (),
    flags: Sequence[str] = FLAGS,
) -> list[str]:
    """Write a unit of FMI 3.0; return what there is to say.

    Raises
    ------
    CapabilityError : the scene, or a key, cannot leave: by name. OutputError : it cannot be written.
    """
    if target.suffix != SUFFIX:
        raise of_option(f"--fmu {target}", f"allowed: a file that ends with {SUFFIX}", CapabilityError)
    structure, left = fmu_structure(family, asked, inputs)
    library = LoopLibrary(structure, library_name(target.with_suffix("").name), os.path.basename(family.path))
    texts = unit_texts(structure, library)
    binary, notes = compiled(library, texts, flags)
    entries = {name: text.encode() for name, text in texts.items()} | binary
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as unit:
        for name, content in entries.items():
            unit.writestr(zipfile.ZipInfo(name, EPOCH), content, zipfile.ZIP_DEFLATED)
    write_bytes(target, buffer.getvalue())
    return [*left, *notes]


def fmu_structure(
    family: Family, asked: Sequence[AskedKey], inputs: Sequence[AskedKey]
) -> tuple[FmuStructure, list[str]]:
    """Return the motion with the keys that are asked for; without any, with those that cost nothing and can vary.

    The second is what to say of keys that are left out.
    """
    for option, given in {"--key": asked, "--input": inputs}.items():
        refuse_doubles(family.root, [one.name for one in given], option)
    points, inputs = with_set_points(family, inputs)
    if points is not None:
        family, inputs = points.family, [*inputs, *points.keys]
    names = [one.name for one in inputs]
    ranges = {one.name: one.ends for one in (*asked, *inputs)} | input_bounds(family, inputs)
    if asked:
        numbers = [one for one in asked if not is_start(family, one)]
        held = parametrised(family, numbers, simulated=True).keys if numbers else ()
        bounds = {key.name: (key.low, key.high) for key in held}
        bounds |= key_bounds(family, [one for one in numbers if one.name not in bounds])
        ranges |= {name: x for name, x in bounds.items() if name in ranges}
        return FmuStructure(family, ranges, names, points), []
    cheap, why = _cheap(family)
    more = {name: ends for name, ends in cheap.items() if name not in ranges}
    made, left = with_able_keys(
        family, more, lambda keys: FmuStructure(family, {**keys, **ranges}, names, points)
    )
    return made, [*why, *left_out(left)]


def _cheap(family: Family) -> tuple[Mapping[str, tuple[float, float]], list[str]]:
    """Return the keys that are parameters by default, with their bounds, and why there are none."""
    try:
        return {key.name: (key.low, key.high) for key in parametrised(family, []).keys}, []
    except RobodynError as error:  # functions of a state cannot hold a part of the scene
        return {}, [
            f"no numbers of the equations are keys of the loop unless --key asks for them: {error.message}"
        ]


def unit_texts(structure: FmuStructure, library: LoopLibrary) -> dict[str, str]:
    """Return the files of a unit, by their place in it."""
    token = hashlib.sha256((library.source + library.header).encode()).hexdigest()[:32]
    described = UnitDescription(structure, library, token)
    own = f"{library.name}_loop"
    sources = {
        f"{own}.h": library.header, f"{own}.c": library.source, "fmu.c": named(library, text_beside(__file__, "fmu.c")),
        "fmu_absent.c": text_beside(__file__, "fmu_absent.c"), "fmi3.h": text_beside(__file__, "fmi3.h"),
        "fmu_data.h": described.header,
    }  # fmt: skip
    motion = structure.motion
    return {
        "modelDescription.xml": described.model(motion.scene.simulate.duration, motion.options.rtol),
        "sources/buildDescription.xml": described.build(name for name in sources if name.endswith(".c")),
        **{f"sources/{name}": text for name, text in sources.items()},
    }


def named(library: LoopLibrary, text: str) -> str:
    """Return a text of C with names of the library."""
    text = text.replace("own_STATES", f"{library.big}_LOOP_NX")
    text = re.sub(r"\bown_(REACHED|ENDED|FAILED)\b", rf"{library.big}_LOOP_\1", text)
    return re.sub(r"\bown\b|\bown_", lambda m: library.name + m[0][3:], text)


def compiled(
    library: LoopLibrary, texts: Mapping[str, str], flags: Sequence[str]
) -> tuple[dict[str, bytes], list[str]]:
    """Return the binary by its place, and what there is to say of it."""
    compiler = next(filter(None, map(shutil.which, COMPILERS)), None)
    system = SYSTEMS.get(sys.platform)
    machine = MACHINES.get(platform.machine().lower())
    if compiler is None or system is None or machine is None:
        return {}, [f"no C compiler ({' or '.join(COMPILERS)}) is installed: the unit has sources alone"]
    folder, suffix = system
    with tempfile.TemporaryDirectory() as name:
        root = Path(name)
        for place, text in texts.items():
            (root / Path(place).name).write_text(text, encoding="utf-8")
        out = root / f"{library.name}{suffix}"
        sources = [str(path) for path in sorted(root.glob("*.c"))]
        command = [compiler, *flags, f"-D{library.big}_VECTORS", *sources, "-o", str(out), "-lm"]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode:
            first = done.stderr.strip().splitlines()[:1]
            return {}, [f"{compiler} has failed, the unit has sources alone: {' '.join(first)}"]
        with opened(out) as made:
            return {f"binaries/{machine}-{folder}/{out.name}": made.read()}, []
