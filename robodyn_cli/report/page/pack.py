"""What the script of a page draws: figures, and their arrays as text."""

from __future__ import annotations

import base64
import hashlib
from typing import Any

import numpy as np

from robodyn_cli.spatial.algebra import Array


class Arrays:
    """The arrays of a page, each stored once and known by its number."""

    def __init__(self) -> None:
        self.packed: list[dict[str, Any]] = []
        self._numbers: dict[tuple[bytes, tuple[int, ...], str], int] = {}

    def put(self, array: Array, double: bool = False) -> int:
        """Return the number of an array, kept with 7 digits, or with all of them if ``double``."""
        kind = "<f8" if double else "<f4"
        # what single precision cannot hold is drawn nowhere
        with np.errstate(over="ignore"):
            content = np.ascontiguousarray(array, dtype=kind)
        data = content.tobytes()
        key = hashlib.sha256(data).digest(), content.shape, kind
        if key not in self._numbers:
            self._numbers[key] = len(self.packed)
            text = base64.b64encode(data).decode()
            self.packed.append({"type": kind[1:], "shape": content.shape, "data": text})
        return self._numbers[key]


class Store:
    """What the script of a page draws: figures, and the arrays that they hold by number."""

    def __init__(self) -> None:
        self.arrays = Arrays()
        self.figures: list[dict[str, Any]] = []

    def add(self, figure: dict[str, Any]) -> int:
        """Return the number of a figure."""
        self.figures.append(figure)
        return len(self.figures) - 1
