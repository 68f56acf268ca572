"""What the summary of ``linearise`` says of the loop of a controller."""

from __future__ import annotations

from robodyn_cli.record import record
from robodyn_cli.summaries.control import LoopPole
from robodyn_cli.summaries.facts import Absent, fact, or_infinite

NEVER = "; `null`: never"


@record
class LoopErrors:
    """Errors of the margins of a loop: of rounding, through the place where they are taken; `null`: not known."""

    gain_margin: float | None = fact(
        "of the gain margin; `null`, as of the others: rounding decides about it"
    )
    gain_reduction: float | None = fact("of the gain reduction")
    phase_margin: float | None = fact("of the phase margin", "rad")
    delay_margin: float | None = fact("of the delay margin", "s")
    sensitivity_peak: float | None = fact("of the peak")
    gain_frequency: float | None = fact("of its frequency", "rad/s")
    reduction_frequency: float | None = fact("of its frequency", "rad/s")
    phase_frequency: float | None = fact("of its frequency", "rad/s")
    delay_frequency: float | None = fact("of its frequency", "rad/s")
    sensitivity_frequency: float | None = fact("of its frequency", "rad/s")


@record
class LoopMargins:
    """The loop opened at one input, all others closed; of a loop that is not stable no margin is left."""

    gain_margin: float | None = or_infinite(
        fact(
            "least factor above 1 by which its gain may grow until it is not stable; `null`: it may grow without bound "
            "(1e12 times at least); 1 where it is not stable",
            errors=(".errors.gain_margin",),
            column="gain up to",
        )
    )
    gain_frequency: float | None = fact("where that is" + NEVER, "rad/s", errors=(".errors.gain_frequency",))
    gain_reduction: float = fact(
        "largest factor below 1 to which its gain may fall; 0: it may be nothing; 1 where it is not stable",
        errors=(".errors.gain_reduction",),
        column="gain down to",
    )
    reduction_frequency: float | None = fact(
        "where that is" + NEVER, "rad/s", errors=(".errors.reduction_frequency",)
    )
    phase_margin: float | None = or_infinite(
        fact(
            "turn of least size that makes it not stable, later positive; `null`: none; 0 where it is not stable",
            "rad",
            errors=(".errors.phase_margin",),
            column="phase margin",
        )
    )
    phase_frequency: float | None = fact(
        "where that is, the gain being 1" + NEVER, "rad/s", errors=(".errors.phase_frequency",)
    )
    delay_margin: float | None = or_infinite(
        fact(
            "least further delay that makes it not stable: by phase over frequency, of a sampled loop by the exact "
            "model with that delay under the hold; `null`: any; 0 where it is not stable",
            "s",
            errors=(".errors.delay_margin",),
            column="delay margin",
        )
    )
    delay_frequency: float | None = fact(
        "where that is" + NEVER, "rad/s", errors=(".errors.delay_frequency",)
    )
    sensitivity_peak: float | None = or_infinite(
        fact(
            "largest 1 / |1 + L|, one over the least distance of L from -1; `null`, infinite, where it is not stable",
            errors=(".errors.sensitivity_peak",),
            column="largest sensitivity",
        )
    )
    sensitivity_frequency: float | None = fact(
        "where that is; `null`: at no finite one", "rad/s", errors=(".errors.sensitivity_frequency",)
    )
    errors: LoopErrors = fact("errors of these figures")


@record
class ClosedLoop:
    """The loop with all inputs closed."""

    about: str = fact("which pose that is, in words")
    stability: str = fact(
        "`stable`, `unstable`, `marginal`: a mode of the loop neither decays nor grows; or `saturated`: at this pose "
        "the limits cut what the law asks for"
    )
    poles: list[LoopPole] = fact(
        "of plant, law and delay, of a sampled loop per sample; where torques are at a limit, with these as they are"
    )
    period: float | Absent = fact("of its samples", "s")
    delay: float | Absent = fact("from a sample to its torques", "s")
    sensitivity_peak: float | None = or_infinite(
        fact(
            "largest singular value of (E + L)^-1 over all frequencies, all loops opened together; `null`, infinite, "
            "where it is not stable",
            errors=(".sensitivity_error",),
        )
    )
    sensitivity_frequency: float | None = fact(
        "where that is; `null`: at no finite one", "rad/s", errors=(".frequency_error",)
    )
    sensitivity_error: float | None = fact("error of the peak; `null`: not known")
    frequency_error: float | None = fact("error of its frequency; likewise", "rad/s")
    held_back: dict[str, float] | Absent = fact(
        "torque that the law gives there less what holds the pose, where that is more than rounding, wherever its "
        "states rest: the loop rests elsewhere", "N m or N",
    )  # fmt: skip
    saturated: list[str] | Absent = fact("joints whose limit cuts what the law asks for at the pose")
    restless: list[str] | Absent = fact("states of the law that do not rest at the pose")
