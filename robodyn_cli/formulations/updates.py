"""States that are set anew at known instants and constant in between: those of a sampled controller.

    phase 0 at n T, phase 1 (where there is one) at n T + rest,   n = 0, 1, ...

The stepping loop ends a step at each of these instants, evaluates a program and goes on; Python sees nothing of it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from robodyn_cli.equations.control.control import ASKED, NOISE, Control
from robodyn_cli.errors import CapabilityError
from robodyn_cli.formulations.layout import Layout
from robodyn_cli.kernels.program import Program, make_program
from robodyn_cli.model.model import STATE_GROUPS
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array

MOST_NUMBERS = 50_000_000  # random numbers of a run (400 MB)
SAME = 4e-16  # of an instant: rounding

# (t, measured q (nq,), measured v (nv,)) -> torques (n,)
Function = Callable[[float, Array, Array], Any]


@record
class Updates:
    """The updates of a system.

    period : T [s]. rest : of the second phase [s], 0 without one. places : of the states that they set, in x; None
    where these lie from 2 nv on. programs : output ``z`` for each phase. measurement : outputs ``q``, ``v`` that a
    function in Python is given. noise : random numbers (N, channels), a row for each sample. driven : how many torques
    it gives. joints : their names.
    """

    period: float
    rest: float
    count: int
    places: tuple[int, ...] | None
    programs: tuple[Program, ...]
    measurement: Program | None
    noise: Array
    joints: tuple[str, ...]
    function: Function | None = None

    @staticmethod
    def of(control: Control | None, layout: Layout | None, duration: float) -> Updates | None:
        """Return the updates of a sampled controller for a run of so long; None for others."""
        if control is None or control.period is None:
            return None
        known = (*STATE_GROUPS, NOISE, ASKED)

        def program(**outputs: Sequence[Any]) -> Program:
            own: dict[str, Sequence[Any]] = {
                k: v if layout is None else layout.renamed(v) for k, v in outputs.items()
            }
            return make_program(own, known)

        in_python = control.controller.type == "python"
        seen = control.measured
        return Updates(
            float(control.period),
            control.rest,
            len(control.z),
            None if layout is None else layout.z[: len(control.z)],
            tuple(program(z=phase) for phase in control.phases),
            program(q=seen.q, v=seen.v) if in_python else None,
            random_numbers(control, duration),
            control.joints,
            control.function,
        )

    @property
    def all_programs(self) -> list[Program]:
        return [*self.programs, *([] if self.measurement is None else [self.measurement])]

    @property
    def digest(self) -> str:
        """Key of everything that decides the compiled code."""
        return (
            f"{len(self.programs)} {self.count} {self.places} {self.noise.shape[1]} {len(self.joints)} "
            + " ".join(p.digest for p in self.all_programs)
        )

    def after(self, time: float) -> tuple[int, int, float]:
        """Return period, phase and instant [s] of the first update behind a time."""
        k = max(0, math.floor(time / self.period) - 1)
        while True:
            for phase, offset in enumerate((0.0, self.rest)[: len(self.programs)]):
                instant = k * self.period + offset
                if instant > time + SAME * abs(time):
                    return k, phase, instant
            k += 1


def random_numbers(control: Control, duration: float) -> Array:
    """Return standard normal numbers (N, channels), a row for each sample up to ``duration`` [s].

    Philox counts: a number follows from the seed, the sample and the channel alone (Salmon et al. 2011).

    Raises
    ------
    CapabilityError : they do not fit into memory.
    """
    if not control.channels or control.period is None:
        return np.zeros((1, 0))
    rows = math.floor(duration / float(control.period) * (1.0 + 1e-12)) + 2
    if rows * control.channels > MOST_NUMBERS:
        raise CapabilityError(
            f"noise of {rows} samples in {control.channels} channels does not fit into memory; allowed: a longer "
            "control.period or a shorter run"
        )
    seed = control.controller.sensors.seed
    normal: Array = np.random.Generator(np.random.Philox(seed)).standard_normal((rows, control.channels))
    return normal
