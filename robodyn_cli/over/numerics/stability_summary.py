"""The summary of ``stability``: its keys."""

from __future__ import annotations

from typing import Any

from robodyn_cli.motion.motion import Gains
from robodyn_cli.over.numerics.energy_growth import Growth, GrowthKeys, Period
from robodyn_cli.over.numerics.spectrum import Spectrum
from robodyn_cli.over.numerics.trial import Reference, Trial
from robodyn_cli.record import record
from robodyn_cli.results.summary import ABSENT, Absent
from robodyn_cli.spatial.algebra import Array


@record
class ReferenceKeys:
    """Which methods agree, to how many digits, until when [s], and why the motion itself ends before."""

    methods: list[str]
    digits: float
    until: float
    ends_early: str | Absent

    @staticmethod
    def of(ref: Reference | None) -> ReferenceKeys | None:
        if ref is None:
            return None
        return ReferenceKeys(list(ref.methods), round(ref.digits, 2), ref.until, ref.ends_early)


@record
class SpectrumKeys:
    """Rates along the run [1/s]; see ``Spectrum``. instants : how many were looked at."""

    stiffness_ratio: float
    fastest_decay: float
    fastest_oscillation: float
    fastest_growth: float
    slowest_rate: float
    instants: int
    complete: bool

    @staticmethod
    def of(found: Spectrum | None) -> SpectrumKeys | None:
        if found is None:
            return None
        return SpectrumKeys(
            found.stiffness_ratio, found.fastest_decay, found.fastest_oscillation, found.fastest_growth,
            found.slowest, len(found.times), found.complete,
        )  # fmt: skip


@record
class StepLimit:
    """What limits the step of a method: extents of its region of stability, and the largest step [s]."""

    method: str
    kind: str
    real_axis: float
    imaginary_axis: float
    largest_step: float | None


@record
class EnergyGrowth:
    """The energy over many periods, by method."""

    period: Period
    periods: int
    growths: list[Growth]


@record
class EnergyKeys:
    """Keys of ``summary.energy_growth``."""

    period: Period
    periods: int
    methods: list[GrowthKeys]


@record
class GainKeys:
    """Keys of ``summary.baumgarte.own`` and ``.fixed``: the gains chosen, or why none were."""

    method: str
    chosen: Gains | Absent = ABSENT
    reference_step: float | Absent = ABSENT
    over: float | Absent = ABSENT
    runs: int | Absent = ABSENT
    message: str | Absent = ABSENT


@record
class GainPlane:
    """What a method made of the plane of gains [1/s]: drift, error and steps (n, n), rows by alpha."""

    keys: GainKeys
    gain: Array | None = None
    drift: Array | None = None
    error: Array | None = None
    steps: Array | None = None


@record
class StabilitySummary:
    """Keys of the summary of ``stability``."""

    termination: dict[str, Any]
    reference: ReferenceKeys | None
    spectrum: SpectrumKeys | None
    step_limits: list[StepLimit]
    methods: list[Trial]
    energy_growth: EnergyKeys
    baumgarte: dict[str, GainKeys] | Absent
