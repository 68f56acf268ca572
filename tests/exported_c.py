"""Exported C, compiled and called: libraries by ``ctypes``, self tests as programs."""

from __future__ import annotations

import ctypes
import re
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

COMPILER = shutil.which("cc")
STRICT = ["-std=c99", "-Wall", "-Wextra", "-pedantic", "-Werror"]
needs_compiler = pytest.mark.skipif(COMPILER is None, reason="no C compiler (cc) is installed")


def compiled(folder: Path, *flags: str, sources: Sequence[str] = (), out: str = "program") -> Path:
    """Return what ``cc *.c -lm`` makes of a folder, outside of it."""
    target = folder.parent / f"{folder.name}-{out}"
    paths = [str(folder / name) for name in sources] or [str(path) for path in sorted(folder.glob("*.c"))]
    command = [str(COMPILER), *STRICT, *flags, *paths, "-lm", "-o", str(target)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return target


def self_test(folder: Path, *flags: str) -> str:
    """Return what the self test of a folder prints; it has to end with 0."""
    program = compiled(folder, *flags, out="-".join(["test", *(flag.strip("-=") for flag in flags)])[:60])
    done = subprocess.run([str(program)], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


class ExportedC:
    """The library of a folder: ``call`` takes and gives numpy arrays."""

    def __init__(self, folder: Path) -> None:
        (header,) = folder.glob("*.h")
        self.name, self.header = header.stem, header.read_text(encoding="utf-8")
        path = compiled(folder, "-O1", "-shared", "-fPIC", sources=[f"{self.name}.c"], out="library.so")
        self.code = ctypes.CDLL(str(path))
        sizes = re.search(r"double key\[(\d+)\];\s+\w+ n\[(\d+)\];", self.header)
        assert sizes
        self.numbers = np.zeros(int(sizes[1]) + int(sizes[2]))
        getattr(self.code, f"{self.name}_nominal")(self._at(self.numbers))

    @staticmethod
    def _at(array: np.ndarray) -> Any:
        return array.ctypes.data_as(ctypes.POINTER(ctypes.c_double))

    def set(self, key: str, value: float) -> int:
        number = getattr(self.code, f"{self.name}_key")(key.encode())
        function = getattr(self.code, f"{self.name}_set")
        function.argtypes = [ctypes.c_void_p, ctypes.c_int, ctypes.c_double]
        return int(function(self.numbers.ctypes.data, number, value))

    def call(self, name: str, *given: Any) -> list[np.ndarray]:
        """Return the outputs of a function; arguments that it does not take last are outputs."""
        declared = re.search(rf"\b{self.name}_{name}\(([^;]*)\);", self.header)
        assert declared, name
        arguments = [re.sub(r"\s+", " ", x).strip() for x in declared[1].split(",")][1:]
        outputs = [
            np.full(int(size[1]), np.nan)
            for x in arguments
            if not x.startswith("const") and (size := re.search(r"\[(\d+)\]$", x))
        ]
        values = [
            ctypes.c_double(x) if np.ndim(x) == 0 else self._at(np.ascontiguousarray(x, dtype=float))
            for x in given
        ]
        assert len(values) + len(outputs) == len(arguments), arguments
        function = getattr(self.code, f"{self.name}_{name}")
        self.status = function(self._at(self.numbers), *values, *(self._at(x) for x in outputs))
        return outputs
