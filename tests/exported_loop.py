"""Exported simulations, compiled and called by ``ctypes``, in the form of the runs of a page."""

from __future__ import annotations

import ctypes
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from robodyn_cli.over.loop_c.library import LoopLibrary
from robodyn_cli.over.loop_c.structure import CStructure
from robodyn_cli.scene.load import Family
from tests.exported_c import compiled
from tests.live import Ranges


class ExportedLoop:
    """The library of a scene's simulation."""

    def __init__(self, family: Family, ranges: Ranges, folder: Path, flags: Sequence[str] = ("-O0",)) -> None:
        self.structure = CStructure(family, ranges)
        library = LoopLibrary(self.structure, "own", "scene.yaml")
        folder.mkdir(exist_ok=True)
        (folder / "own_loop.h").write_text(library.header, encoding="utf-8")
        (folder / "own_loop.c").write_text(library.source, encoding="utf-8")
        path = compiled(folder, *flags, "-shared", "-fPIC", out=f"{'-'.join(flags)[:40]}.so")
        self.code = ctypes.CDLL(str(path))
        self.code.own_loop_time.restype = ctypes.c_double
        self.code.own_loop_reason.restype = self.code.own_loop_event.restype = ctypes.c_char_p
        self.reasons = ["", *library.tables.data["reasons"]]
        self.sizes = [int(x) for x in re.findall(r"double memory\[(\d+)\]", library.header)]
        self.states = self.structure.system.size
        self.samples = library.tables.shown + 1
        _, _, nq, nv = (1, 1, len(library.tables.data["q"]["names"]), len(library.tables.data["v"]["names"]))
        self.nq, self.nv = nq, nv

    def run(self, row: np.ndarray) -> dict[str, Any]:
        """Return a whole motion, as a page gives it."""
        room, samples = np.zeros(self.sizes[1]), np.zeros((self.samples, self.states))
        count = 2 + 2 * (max(1, self.nq) + max(1, self.nv))
        result = np.zeros(count + 2)
        values = np.append(row, 0.0)
        reason = self.code.own_loop_run(_at(room), _at(values), _at(result), _at(samples))
        if reason:
            refused = self.code.own_loop_reason(reason).decode()
            return {"refused": refused, "reason": self.reasons[reason], "numbers": result[:count]}
        places = np.cumsum([2, self.nq, self.nq, self.nv, self.nv])
        parts = [result[a:b] for a, b in zip(places, places[1:])]
        steps, second, event, rows = result[count:].view(np.int32)[:4]
        found = dict(zip(("q", "q_error", "v", "v_error"), (x.tolist() for x in parts)))
        return {
            **found, "time": result[0], "time_error": result[1], "steps": int(steps), "second_steps": int(second),
            "event": int(event), "samples": samples[: int(rows)],
        }  # fmt: skip

    def begin(self, row: np.ndarray, again: int = 0) -> tuple[np.ndarray, int]:
        memory = np.zeros(self.sizes[0])
        return memory, int(self.code.own_loop_begin(_at(memory), _at(np.append(row, 0.0)), again))

    def start(self, row: np.ndarray) -> np.ndarray | None:
        """Return the positions of a start, None where that is left to the program."""
        memory, reason = self.begin(row)
        state = np.zeros(self.states)
        self.code.own_loop_state(_at(memory), _at(state))
        return None if reason else state[list(self.structure.system.q_places)]

    def to(self, memory: np.ndarray, time: float) -> tuple[int, np.ndarray]:
        state = np.zeros(self.states)
        return int(self.code.own_loop_to(_at(memory), ctypes.c_double(time), _at(state))), state

    def stop(self, memory: np.ndarray, time: float, longest: float = 1e3) -> tuple[int, np.ndarray]:
        """Go to a time with a step that ends there."""
        state = np.zeros(self.states)
        times = ctypes.c_double(time), ctypes.c_double(longest)
        return int(self.code.own_loop_stop(_at(memory), *times, _at(state))), state

    def change(self, memory: np.ndarray, row: np.ndarray) -> int:
        return int(self.code.own_loop_change(_at(memory), _at(np.append(row, 0.0)), 0))

    def time(self, memory: np.ndarray) -> float:
        return float(self.code.own_loop_time(_at(memory)))


def _at(array: np.ndarray) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)
