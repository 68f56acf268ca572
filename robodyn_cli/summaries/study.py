"""The summaries of ``sweep`` and ``sensitivity``: what many runs say together, and derivatives."""

from __future__ import annotations

from robodyn_cli.record import record
from robodyn_cli.summaries.facts import ABSENT, ANY, OUTPUT, Absent, fact

LEVELS = (0.05, 0.25, 0.5, 0.75, 0.95)  # quantiles
QUANTILES = tuple(f"{100 * level:g} %" for level in LEVELS)  # their names
BESIDE, OF_OUTPUT, OF_KEY = "as `unit` says", "unit of the output", "unit of the key"
OF_RUNS = ("results.OUTPUT.largest_error",)


@record
class Spread:
    """How an output spreads over the runs that have it; what needs samples is left out of a grid, of which it would
    tell how its values were chosen."""

    runs: int = fact("number of runs that have it")
    minimum: float = fact("smallest value", BESIDE, errors=OF_RUNS)
    maximum: float = fact("largest value", BESIDE, errors=OF_RUNS)
    nominal: float | None = fact("value of the scene as it stands", BESIDE, errors=OF_RUNS)
    unit: str = fact("of all numbers of this output")
    independent: int | Absent = fact(
        "number of independent runs that have it, by which the errors go: with `--indices` those of blocks A and B, "
        "of which mean, deviation and quantiles are; with samples at points of a grid those at one point",
        default=ABSENT,
    )
    mean: float | Absent = fact("of samples", BESIDE, errors=("results.OUTPUT.mean_error",), default=ABSENT)
    sd: float | Absent = fact(
        "standard deviation of samples", BESIDE, errors=("results.OUTPUT.sd_error",), default=ABSENT
    )
    quantiles: dict[str, float] | Absent = fact(
        "of samples",
        BESIDE,
        names=QUANTILES,
        errors=("results.OUTPUT.quantile_errors.LEVEL",),
        default=ABSENT,
    )
    mean_error: float | Absent | None = fact(
        "half the width of the interval that holds the true mean (Student's), and the mean of the errors of the runs; "
        "`null` of a single run",
        BESIDE, default=ABSENT,
    )  # fmt: skip
    sd_error: float | Absent | None = fact(
        "the larger distance to an end of the interval that holds the true deviation, and the largest error of a run",
        BESIDE, default=ABSENT,
    )  # fmt: skip
    quantile_errors: dict[str, float | None] | Absent = fact(
        "the larger distance to an end of the interval between two runs that holds the true quantile, whatever the "
        "distribution, and the largest error of a run; `null` where there are too few runs for one",
        BESIDE, names=QUANTILES, default=ABSENT,
    )  # fmt: skip
    confidence: float | Absent = fact(
        "probability that an interval holds the true value; with samplers `sobol` and `latin` it is larger, for their "
        "samples are spread more evenly than independent ones",
        default=ABSENT,
    )
    largest_error: float | Absent = fact(
        "of the errors that the runs estimate, where they do", BESIDE, default=ABSENT
    )


@record
class Share:
    """A share of runs, of samples with its confidence interval (Clopper and Pearson)."""

    share: float = fact("of all runs")
    low: float | Absent = fact(
        "of samples: lower end of the interval that holds the true share", default=ABSENT
    )
    high: float | Absent = fact("of samples: its upper end", default=ABSENT)
    confidence: float | Absent = fact("probability that the interval holds it", default=ABSENT)


@record
class Influence:
    """What a key does to an output, by a linear fit over all keys."""

    swing: float = fact("change of the output as the key goes from its 5 % to its 95 % quantile", OF_OUTPUT)
    rank_correlation: float = fact("Spearman's, of the key and the output")


@record
class SobolIndex:
    """Shares of an output's variance, each with the interval that holds it with 95 %."""

    first: float = fact("by the key alone")
    first_low: float = fact("lower end of its interval")
    first_high: float = fact("upper end of its interval")
    total: float = fact("with all interactions of the key")
    total_low: float = fact("lower end of its interval")
    total_high: float = fact("upper end of its interval")


@record
class NamedRun:
    """One run of a study that is worth a look."""

    run: int = fact("its number")
    why: str = fact("why it is named: the extreme of an output, the first failure of its kind")
    values: dict[str, float] = fact("of the keys that vary", OF_KEY, names=ANY)
    command: str = fact("that repeats it")


@record
class InputKeys:
    """A key that varies."""

    spec: str = fact("values or distribution as they were asked for")
    unit: str = fact("of the key")


@record
class StudySummary:
    """The summary of ``sweep``."""

    runs: int = fact("number of runs")
    of: str = fact("the command of each")
    sampler: str | Absent = fact("that drew the samples, of samples")
    seed: int | Absent = fact("of the samples, of samples")
    inputs: dict[str, InputKeys] = fact("the keys that vary", names=ANY)
    results: dict[str, Spread | None] = fact(
        "how each output spreads; `null` where no run has it", names=OUTPUT
    )
    failures: dict[str, int] = fact("number of runs by exit code other than 0", names=ANY)
    failed: Share = fact("share of runs that failed")
    cases: list[NamedRun] = fact("extremes of each output, and the first failure of each kind")
    influence: dict[str, dict[str, Influence]] = fact(
        "what each key does to each output, by output and key", names=(OUTPUT, ANY)
    )
    sobol_indices: dict[str, dict[str, SobolIndex] | None] | Absent = fact(
        "with `--indices`, by output and key; `null` where a run failed", names=(OUTPUT, ANY)
    )
    seconds: float = fact("wall time of the runs", "s")
    series: dict[str, int] | Absent = fact(
        "number of runs that a Taylor series made side by side, by its name; all others were made by the method that "
        "the command takes by itself",
        names=ANY, default=ABSENT,
    )  # fmt: skip
    yield_: Share | Absent = fact("share of runs that hold all that the scene expects", default=ABSENT)
    least_yield: float | Absent = fact("share that `--yield` asks for", default=ABSENT)


@record
class NominalNumber:
    """A key or an output of the scene as it stands."""

    value: float = fact("the number", BESIDE, errors=(".error",))
    unit: str = fact("its unit; empty where it is not known, as in a formula")
    error: float | Absent | None = fact(
        "of an output: its estimated error; `null` where the run tells none", BESIDE, default=ABSENT
    )


@record
class SlopeKeys:
    """A derivative d output / d key."""

    derivative: float | None = fact(
        "of the output by the key; `null` where there is none", BESIDE, errors=(".error",)
    )
    error: float | None = fact("its estimated error", BESIDE)
    unit: str = fact("of the derivative and its error")
    normalised: float | None = fact(
        "key / output times the derivative: 0 where that is less than its error, `null` where key or output is zero"
    )
    method: str = fact("`exact` or `differences`")
    reason: str | Absent = fact("why it is not exact, or why there is none", default=ABSENT)


@record
class SensitivitySummary:
    """The summary of ``sensitivity``."""

    of: str = fact("the command whose summary the outputs are keys of")
    nominal: dict[str, NominalNumber] = fact("the outputs of the scene as it stands", names=OUTPUT)
    keys: dict[str, NominalNumber] = fact("of the scene as it stands", names=ANY)
    sensitivities: dict[str, dict[str, SlopeKeys]] = fact(
        "by output and key, those that move it most first", names=(OUTPUT, ANY)
    )
    seconds: float = fact("wall time of all of it", "s")
