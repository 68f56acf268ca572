"""The summaries of ``stability``, of its suite, and of ``work-precision``: what methods of integration do."""

from __future__ import annotations

from robodyn_cli.record import mutable_record, record
from robodyn_cli.summaries.facts import ABSENT, ANY, Absent, Termination, fact
from robodyn_cli.summaries.motion import STATE, Gains


@record
class ReferenceKeys:
    """The solution that methods are compared with."""

    methods: list[str] = fact("two that agree at tight tolerance")
    digits: float = fact("decimal digits to which they agree, relative to the range of each quantity")
    until: float = fact("time up to which they agree", "s")
    ends_early: str | Absent = fact(
        "why the motion itself ends before its duration (a singular configuration), else empty"
    )


@record
class SpectrumKeys:
    """Rates of the linearised equations of motion, over all instants."""

    stiffness_ratio: float = fact("largest ratio of the fastest decay over the slowest rate")
    fastest_decay: float = fact("largest -Re of any eigenvalue", "1/s")
    fastest_oscillation: float = fact("largest |Im| of any eigenvalue", "rad/s")
    fastest_growth: float = fact(
        "largest Re of any eigenvalue: how fast a small change may grow at its worst instant", "1/s"
    )
    slowest_rate: float = fact(
        "magnitude of the smallest eigenvalue above rounding, but no less than 1 / duration", "1/s"
    )
    instants: int = fact("how many were looked at")
    complete: bool = fact("whether these are all eigenvalues, or the largest only")


@record
class StepLimit:
    """What limits the step of a method."""

    method: str = fact("the method")
    kind: str = fact(
        "`region`: the largest step at which no mode grows; `iteration`: at which the iteration that solves a step is "
        "done within its rounds, so that steps need not be halved"
    )
    real_axis: float = fact(
        "extent of the region of stability along the negative real axis, of step times rate"
    )
    imaginary_axis: float = fact("extent along the imaginary axis, of step times rate")
    largest_step: float | None = fact("on this run; `null` without a limit", "s")


@mutable_record
class MethodTrial:
    """What a method did at the settings of the scene."""

    method: str = fact("the method")
    chosen: str = fact("the method that `auto` chose, and those that it changed to", default="")
    status: str = fact(
        "`stable`, `inaccurate` (error above 1e-3 of the range), `diverged`, `too_slow` or `unsupported`",
        default="stable",
    )
    error: float | None = fact("largest error of any q or qd", STATE, default=None)
    relative: float | None = fact("largest error over the range of its quantity", default=None)
    estimate: float | None = fact("the run's own estimate of its error", STATE, default=None)
    honest: bool | None = fact(
        "whether the estimate is at least a tenth of the error; `null`: nothing to compare", default=None
    )
    steps: int = fact("of the integration", default=0)
    evaluations: int = fact("of the right-hand side", default=0)
    seconds: float = fact("wall time of the run", "s", default=0.0)
    energy: float | None = fact("drift of the energy balance over the energy exchanged", default=None)
    until: float = fact("time reached", "s", default=0.0)
    failure: str | None = fact("class of the error that ended the run", default=None)
    joint: str | None = fact("the joint at which it broke down", default=None)
    quantity: str | None = fact("the quantity that broke down", default=None)
    message: str = fact("what ended the run or keeps it from being judged, in words", default="")


@record
class Period:
    """A period of the motion."""

    seconds: float = fact("its length", "s")
    source: str = fact("where it comes from")


@record
class GrowthKeys:
    """The error of the energy balance of one method over many periods."""

    method: str = fact("the method")
    status: str = fact("`ok`, `stopped` by an error, or `too_slow`")
    until: float = fact("time reached: a method that takes five times as long as the fastest is cut off", "s")
    largest_relative: float = fact("largest error of the energy balance over `scale`")
    scale: float = fact("the largest energy exchanged", "J")
    exponent: float | None = fact(
        "p of the fit error ~ t^p to its running maximum over the last nine tenths: 0 bounded, 0.5 rounding, 1 a "
        "steady drift"
    )
    steps: int = fact("of the integration")
    seconds: float = fact("wall time of the run", "s")
    message: str = fact("what ended the run, in words")


@record
class EnergyKeys:
    """The energy over many periods."""

    period: Period = fact("of the motion")
    periods: int = fact("how many were run")
    methods: list[GrowthKeys] = fact("of each method that was followed")


@record
class GainKeys:
    """The choice of Baumgarte's gains by one method, or why there is none."""

    method: str = fact("that ran over the plane of gains")
    chosen: Gains | Absent = fact("the gains that were chosen", default=ABSENT)
    reference_step: float | Absent = fact("mean step of the projected run", "s", default=ABSENT)
    over: float | Absent = fact("length of the trial runs", "s", default=ABSENT)
    runs: int | Absent = fact("number of runs over the plane of gains", default=ABSENT)
    message: str | Absent = fact("why no gains were chosen", default=ABSENT)


@record
class StabilitySummary:
    """The summary of ``stability``."""

    termination: Termination = fact("how the report ended, and until when its reference goes")
    reference: ReferenceKeys | None = fact(
        "what methods are compared with; `null` where no two runs at tight tolerance agree"
    )
    spectrum: SpectrumKeys | None = fact(
        "rates along the run; `null` where the equations cannot be linearised"
    )
    step_limits: list[StepLimit] = fact("of each method whose step stability limits")
    methods: list[MethodTrial] = fact("what each method did; of the suite their names")
    energy_growth: EnergyKeys = fact("the energy over many periods")
    baumgarte: dict[str, GainKeys] | Absent = fact(
        "with loops: gains by method and tolerances of the scene (`own`) and by rk4 (`fixed`)",
        names=("own", "fixed"),
    )


@record
class CaseKeys:
    """A case of the suite."""

    name: str = fact("of the case")
    expects: str = fact("what is expected, in words")
    holds: bool = fact("whether it is as expected")
    found: str = fact("what misses the expectation")
    reference: ReferenceKeys | None = fact("what methods are compared with")
    stiffness_ratio: float | None = fact("largest ratio of the fastest decay over the slowest rate")
    fastest_decay: float | None = fact("largest -Re of any eigenvalue", "1/s")
    fastest_oscillation: float | None = fact("largest |Im| of any eigenvalue", "rad/s")
    methods: dict[str, MethodTrial] = fact("what each method did, by its name", names=ANY)
    seconds: float = fact("wall time of the case", "s")
    scene: str = fact("text of the scene")


@record
class SuiteSummary:
    """The summary of the suite of ``stability``."""

    termination: dict[str, str] = fact("how the suite ended", names=("reason",))
    quick: bool = fact("whether scenes were shorter and budgets smaller")
    missed: int = fact("how many cases miss their expectation")
    methods: list[str] = fact("names of the methods that were tried")
    cases: list[CaseKeys] = fact("what became of each case")


@mutable_record
class TimedRun:
    """One run of one method: what it was asked, what it reached, what it cost."""

    method: str = fact("the method")
    formulation: str = fact("`tree`, or how the loops were kept closed")
    tolerance: float | None = fact(
        "relative, and absolute in units of the state; of methods that control the step"
    )
    step: float | None = fact("of methods that do not", "s")
    error: float | None = fact("as `error_norm` defines it", f"{STATE}; s of a lock", default=None)
    run_time_s: float | None = fact("median over `repeats` runs without output", "s", default=None)
    compile_time_s: float = fact("time to compile, apart from the run", "s", default=0.0)
    evaluations: int = fact("of the right-hand side", default=0)
    steps: int = fact("of the integration", default=0)
    status: str = fact("`ok`, `inaccurate`, `too_slow`, `diverged`, `unsupported` or `no_lock`", default="ok")
    lock_time: float | Absent | None = fact(
        "when the mechanism locks, where that is what is compared", "s", errors=(".error",), default=ABSENT
    )


@mutable_record
class BestRun(TimedRun):
    """The run that reaches a level of error in the least time."""

    level: float = fact("of the error", f"{STATE}; s of a lock", default=0.0)


@record
class GivenGains:
    """Baumgarte's gains of the scene."""

    alpha: float = fact("gain of the velocities", "1/s")
    beta: float = fact("gain of the positions", "1/s")


@record
class WorkPrecisionSummary:
    """The summary of ``work-precision``."""

    termination: Termination = fact("how the runs ended, and until when they are compared")
    reference_digits: float = fact("decimal digits to which the two methods of the reference agree")
    reference_methods: list[str] = fact("the two methods of the reference")
    compared_until: float = fact("time up to which they agree well enough to compare anything", "s")
    compared_whole_duration: bool = fact("whether that is the whole duration")
    perturbation_growth: float = fact("by how much a small change of the start has grown by then")
    perturbation_grows: str = fact("`exponential` (as in chaotic motion), `polynomial` or `unknown`")
    e_folding_time: float | Absent = fact("time in which it grows e times, where exponentially", "s")
    repeats: int = fact("number of runs of which the median is taken")
    runs: list[TimedRun] = fact("of all methods and formulations")
    best: list[BestRun] = fact(
        "for each level of the error, down to what the references are apart, the run that reaches it in the least time"
    )
    baumgarte: Gains | GivenGains | Absent = fact(
        "with loops: the gains of the curves of that name, the scene's or chosen as `stabilisation: baumgarte` does"
    )
    lock_time: float | Absent = fact(
        "of a scene of `deploy` that comes to a dead point: the time of its lock by the reference", "s"
    )
    error_norm: str = fact("definition of the error")
