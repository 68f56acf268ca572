"""What ``plan``, ``compare``, ``run``, ``check``, ``validate``, ``cache``, ``animate`` and ``report``
print for programs (``--json``)."""

from __future__ import annotations

from robodyn_cli.record import record
from robodyn_cli.summaries.facts import ABSENT, ANY, Absent, fact

OF_DATASET = "unit of the dataset"
OF_FIGURE = "`unit`"


@record
class Kept:
    """A term of the equations."""

    term: str = fact("the term")
    reason: str = fact("why it is kept")
    operations: int | None = fact("that leaving it out would save; `null` where not counted")
    share: float | None = fact("of all operations; `null` where not counted")


@record
class LeftOut:
    """A term that the equations do not have."""

    term: str = fact("the term")
    reason: str = fact("why it is left out")
    operations_saved: int | None = fact("that it would add; `null` where not counted")


@record
class Kernel:
    """A program of a run."""

    name: str = fact("what it computes")
    operations: int = fact("of one evaluation")
    inputs: dict[str, int] = fact("how many numbers it takes, by group", names=ANY)
    numbers: list[str] = fact("places in the scene of the numbers that it reads from a table")
    outputs: dict[str, int] = fact("how many numbers it gives, by group", names=ANY)
    engine: str = fact("`compiled` or `interpreted`")
    shape: str = fact("loops over bodies or straight code")
    lanes: int = fact("evaluations at once")
    lanes_hold: str = fact("what these are evaluations of")
    digest: str = fact("of its code")
    placed: str | Absent = fact("where in the stepping loop", default=ABSENT)


@record
class Chosen:
    """A decision of a builder."""

    choice: str = fact("what was to be decided")
    taken: str = fact("what was taken")
    reason: str = fact("why")
    operations: dict[str, int] | Absent = fact("of the ways that were compared", names=ANY, default=ABSENT)


@record
class LoopCosts:
    """Operations of equation (36)."""

    operations: int = fact("together")
    rows: list[str] = fact("names of the loops' rows")
    open_tree: int | None = fact("without the loops")
    loop_terms: int | None = fact("of the loops")
    open_chain_of_as_many_joints: int | None = fact("of an open chain of as many joints")
    ratio: float | None = fact("of all operations over those of that chain")
    projection_of_positions: int = fact("of a projection of positions in a step")
    projection_of_velocities: int = fact("of a projection of velocities in a step")
    events: int = fact("of the functions of events in a step")


@record
class PlanReport:
    """What ``plan`` says of a command on a scene."""

    status: str = fact("`ok`, or `failed` where data are missing")
    command: str = fact("that is planned")
    title: str = fact("title of the scene")
    mechanism: str = fact("what the scene is, in words")
    operations: int = fact("of the program in the inner loop")
    operations_general: int = fact("of the same program with every constant a symbol")
    operations_of: str = fact("what that program computes: torques or accelerations")
    ratio: float | None = fact("`operations_general` over `operations`")
    kept: list[Kept] = fact("terms of the equations")
    left_out: list[LeftOut] = fact("terms that they do not have")
    kernels: list[Kernel] = fact("programs that are compiled")
    choices: list[Chosen] = fact("decisions of the builders")
    missing: list[str] = fact("data without which the command stops")
    not_given_and_not_needed: list[str] = fact("data that are neither given nor needed")
    given_without_effect: list[str] = fact("data that do not occur in the equations")
    terms_counted: bool = fact("whether operations were counted by term; not in large models")
    equation_36: LoopCosts | Absent = fact("of mechanisms with loops", default=ABSENT)


@record
class DatasetReport:
    """How one dataset compares: the worst sample where values were compared, else the detail."""

    path: str = fact("of the dataset")
    verdict: str = fact("`equal`, `differs`, `missing`, `extra`, `shape`, `units`, `names` or `entries`")
    error: float | Absent = fact("difference at the worst sample", OF_DATASET, default=ABSENT)
    ratio: float | Absent = fact("that difference over what is allowed there", default=ABSENT)
    value: float | Absent = fact("of the result there", OF_DATASET, default=ABSENT)
    expected: float | Absent = fact("of the baseline there", OF_DATASET, default=ABSENT)
    time: float | Absent | None = fact("of the worst sample", "s", default=ABSENT)
    column: str | Absent | None = fact("of the worst sample", default=ABSENT)
    stated: float | Absent | None = fact(
        "sum of the errors that both results state there; `null` where one states none",
        OF_DATASET, default=ABSENT,
    )  # fmt: skip
    within_stated: bool | Absent | None = fact(
        "whether no sample is farther off than the errors that are stated", default=ABSENT
    )
    detail: str | Absent = fact("why values could not be compared", default=ABSENT)


@record
class ComparisonReport:
    """What ``compare`` says of two results."""

    status: str = fact("`ok` or `failed`")
    rtol: float = fact("relative tolerance")
    atol: float = fact("absolute tolerance", OF_DATASET)
    datasets: list[DatasetReport] = fact("how each compares, worst first")


@record
class ResultReport:
    """How one result compares with its baseline."""

    result: str = fact("name of the result")
    verdict: str = fact("`equal`, `differs`, `missing`, `extra` or `unreadable`")
    message: str | None = fact("why the two could not be compared")
    datasets: list[DatasetReport] = fact("that differ, worst first")


@record
class TreeReport:
    """What ``compare`` says of two directories with results."""

    status: str = fact("`ok` or `failed`")
    exit_code: int = fact("the worst of all results")
    rtol: float = fact("relative tolerance")
    atol: float = fact("absolute tolerance", OF_DATASET)
    results: list[ResultReport] = fact("how each compares")


@record
class VariantValue:
    """A figure of one of several results."""

    value: float | int | str | None = fact("of the result; `null` where it has no such figure", OF_FIGURE)
    unit: str = fact("of the value")
    error: float | None = fact("that the result states of it", OF_FIGURE)
    difference: float | None = fact(
        "to the value of the first result; `null` of that itself, and of what is no number",
        OF_FIGURE, errors=(".difference_error",),
    )  # fmt: skip
    difference_error: float | None = fact("sum of both errors; `null` where one is not stated", OF_FIGURE)


@record
class VariantFigure:
    """A figure of several results."""

    key: str = fact("of the summary, or of the scene; `outcome`: how the run ended")
    given: bool = fact("whether it is a key of the scene")
    verdict: str = fact(
        "`differs` by more than the errors, `within` them, `open` where one is not stated, or `equal` in all results"
    )
    values: list[VariantValue] = fact("of each result")


@record
class VariantsReport:
    """What ``compare --figures`` says of several results."""

    status: str = fact("`ok`")
    results: list[str] = fact("what they are called: ends of their paths")
    figures: list[VariantFigure] = fact("what tells the scenes apart, then what differs, then the rest")


@record
class BaselineReport:
    """How the result of a scene compares with the stored one."""

    directory: str = fact("of the stored result")
    verdict: str = fact("`equal`, `differs`, `missing`, `extra` or `unreadable`")
    message: str | None = fact("why the two could not be compared")
    rtol: float = fact("relative tolerance")
    atol: float = fact("absolute tolerance", OF_DATASET)
    datasets: list[DatasetReport] = fact("that differ, worst first")
    updated: bool = fact("whether the stored result was replaced by this one", default=False)


@record
class Judged:
    """What ``run --baseline`` adds to the summary of each scene."""

    baseline: BaselineReport = fact("with `run --baseline`: how the result compares with the stored one")


@record
class JudgedCriterion:
    """One criterion of a scene and what the run gave."""

    key: str = fact("of the summary")
    expected: str = fact("as the scene says it")
    found: float | int | bool | str | None = fact("value of the run", "unit of the key")
    holds: bool = fact("whether it is as expected")
    shown: str = fact("the value for reading, in the unit of what is expected")

    def __str__(self) -> str:
        return f"{self.key}: {self.shown} (expected {self.expected})"


@record
class SceneReport:
    """How a scene of a batch ended."""

    scene: str = fact("file of the scene")
    name: str = fact("of the scene in the batch")
    command: str | None = fact("that was run")
    verdict: str = fact("`ok`, `failed`, `error` or `stopped`")
    exit_code: int = fact("of this scene")
    unchanged: bool = fact("whether an earlier result was kept")
    seconds: float = fact("that it took", "s")
    message: str | None = fact("what went wrong, in words")
    criteria: list[JudgedCriterion] = fact("that the scene expects")
    directory: str | None = fact("of the result")
    baseline: BaselineReport | Absent = fact("with `--baseline`: how the result compares")


@record
class BatchReport:
    """How a batch ended."""

    status: str = fact("`ok` or `failed`")
    exit_code: int = fact("the worst of all scenes")
    scenes: list[SceneReport] = fact("how each ended")


@record
class CheckReport:
    """How a result meets its criteria."""

    status: str = fact("`ok` or `failed`")
    failed: int = fact("how many criteria it does not meet")
    criteria: list[JudgedCriterion] = fact("of the scene")


@record
class Finding:
    """One thing that is wrong with a scene; its place as far as it is known."""

    severity: str = fact("`error` or `warning`")
    message: str = fact("what is wrong; it begins with the place")
    exit_code: int = fact("with which a run would end")
    file: str | Absent = fact("in which it stands", default=ABSENT)
    line: int | Absent = fact("in which it stands, from 1 on", default=ABSENT)
    column: int | Absent = fact("in which it stands, from 1 on", default=ABSENT)
    key: str | Absent = fact("of the scene", default=ABSENT)


@record
class SceneFindings:
    """What is wrong with a scene."""

    scene: str = fact("file of the scene")
    exit_code: int = fact("of the worst finding")
    findings: list[Finding] = fact("errors first")


@record
class ValidationReport:
    """What is wrong with scenes."""

    status: str = fact("`ok` or `failed`")
    exit_code: int = fact("the worst of all scenes")
    scenes: list[SceneFindings] = fact("what is wrong with each")


@record
class CacheReport:
    """What ``cache`` says of the compiled code that is kept."""

    status: str = fact("`ok`")
    directory: str | None = fact("where it is kept; `null` where it is not")
    entries: int = fact("number of objects")
    bytes: int = fact("their size", "B")
    most_bytes: int = fact("size beyond which the oldest go first", "B")
    removed: int = fact("objects that were removed, with `--clear`")


@record
class MovieReport:
    """What ``animate`` has written."""

    status: str = fact("`ok`")
    file: str = fact("the picture")
    size: int = fact("of the file", "B")
    stills: int | Absent = fact("of a strip: number of pictures", default=ABSENT)
    frames: int | Absent = fact("of a movie: number of frames", default=ABSENT)
    held: int | Absent = fact("of a movie: times that the last frame is shown", default=ABSENT)
    fps: float | Absent = fact("of a movie: frames in a second", "1/s", default=ABSENT)
    speed: float | Absent = fact("of a movie: seconds of the run in a second", default=ABSENT)
    duration: float | Absent = fact("of a movie", "s", default=ABSENT)


@record
class PageReport:
    """What ``report`` has written."""

    status: str = fact("`ok`")
    file: str = fact("the page")
    results: int = fact("on the page")
    size: int = fact("of the file", "B")
