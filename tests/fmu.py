"""Units of FMI, exported and driven: by the importer in C, and what they say of themselves."""

from __future__ import annotations

import subprocess
import zipfile
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from robodyn_cli.over.c99.asked_keys import asked_key
from robodyn_cli.over.fmu.export import export_fmu
from robodyn_cli.scene.load import Family
from tests.exported_c import COMPILER

IMPORTER = Path(__file__).parent / "fmu_importer.c"
PLAIN = (
    "-std=c99",
    "-Wall",
    "-Wextra",
    "-pedantic",
    "-Werror",
    "-O0",
    "-shared",
    "-fPIC",
    "-fvisibility=hidden",
)
SANITIZED = ("-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")


class ExportedUnit:
    """A unit, unpacked, with the importer that drives it."""

    def __init__(
        self,
        family: Family,
        folder: Path,
        keys: Sequence[str] = (),
        inputs: Sequence[str] = (),
        flags: Sequence[str] = (),
    ) -> None:
        self.path = folder / "own.fmu"
        given = {"--key": keys, "--input": inputs}
        asked = [[asked_key(text, option) for text in texts] for option, texts in given.items()]
        self.notes = export_fmu(family, self.path, *asked, flags=[*PLAIN, *flags])
        assert all(note.startswith("not a key of the loop") for note in self.notes), self.notes
        with zipfile.ZipFile(self.path) as unit:
            unit.extractall(folder / "unit")
        self.root = ElementTree.parse(folder / "unit" / "modelDescription.xml").getroot()
        (self.library,) = (folder / "unit" / "binaries").glob("*/own.*")
        variables = list(self.root.find("ModelVariables") or ())
        self.references = {v.attrib["name"]: int(v.attrib["valueReference"]) for v in variables}
        self.kinds = {v.attrib["name"]: v.attrib.get("causality", "") for v in variables}
        self.importer = folder / "importer"
        command = [
            str(COMPILER),
            "-std=c99",
            "-Wall",
            "-Wextra",
            *flags,
            str(IMPORTER),
            "-o",
            str(self.importer),
        ]
        done = subprocess.run([*command, "-ldl"], capture_output=True, text=True)
        assert done.returncode == 0, done.stderr

    @property
    def outputs(self) -> list[str]:
        """Names of the real outputs; between the first and the last all references are outputs."""
        floats = [v for v in self.root.find("ModelVariables") or () if v.tag == "Float64"]
        return [v.attrib["name"] for v in floats if v.attrib["causality"] == "output"]

    def run(self, step: float, count: int, keys: Sequence[str] = ()) -> tuple[float, dict[str, float], float]:
        """Return the time reached, the outputs there, and the seconds that the steps took."""
        names = self.outputs
        first, last = self.references[names[0]], self.references[names[-1]]
        token = self.root.attrib["instantiationToken"]
        words = [
            str(self.importer),
            str(self.library),
            token,
            repr(step),
            str(count),
            str(first),
            str(last - first + 1),
        ]
        done = subprocess.run([*words, *map(self._key, keys)], capture_output=True, text=True)
        if done.returncode:
            raise RuntimeError(f"{done.returncode}: {done.stderr}")
        seconds, reached, *values = map(float, done.stdout.split())
        found = {name: values[self.references[name] - first] for name in names}
        return reached, found, seconds

    def _key(self, text: str) -> str:
        name, _, value = text.partition("=")
        later = "@" * name.startswith("@")
        return f"{later}{self.references[name.removeprefix('@')]}={value}"


def column(values: dict[str, float], names: Sequence[str], prefix: str) -> np.ndarray:
    return np.array([values[f"{prefix}.{name}"] for name in names])
