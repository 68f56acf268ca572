"""The summary of ``assemble``: what closed the loops, how well, and the freedoms that are left."""

from __future__ import annotations

from robodyn_cli.record import record
from robodyn_cli.summaries.facts import (
    ACCELERATION,
    LOOP,
    OWN,
    RATE,
    Absent,
    LoopResidual,
    Termination,
    fact,
)


@record
class Mobility:
    """Degrees of freedom by counting and by rank."""

    coordinates: int = fact("velocity coordinates of the tree")
    rows: int = fact("of the closures, those that vanish identically included")
    vanishing_rows: int = fact("rows that vanish identically")
    rank: int = fact("of the loops' Jacobian Psi")
    redundant_rows: int = fact("rows that follow from others")
    count: int = fact("degrees of freedom by Gruebler and Kutzbach in space: coordinates less all rows")
    planar_count: int = fact("coordinates less the rows that do not vanish identically")
    actual: int = fact("degrees of freedom by the rank of the loops' rows")
    rank_tolerance: float = fact("part of the largest singular value of Psi below which one counts as zero")
    smallest_kept: float | Absent = fact(
        "smallest singular value that counts, over the largest", errors=(".smallest_kept_error",)
    )
    largest_dropped: float | Absent = fact(
        "largest singular value that does not count, over the largest", errors=(".largest_dropped_error",)
    )
    smallest_kept_error: float | Absent | None = fact(
        "of the former, by errors of the configuration and rounding; `null` where these are not known"
    )
    largest_dropped_error: float | Absent | None = fact("of the latter, likewise")


@record
class ClosedBranch:
    """One way in which the loops close."""

    configuration: dict[str, float] = fact("joint positions", OWN, errors=(".errors.JOINT",))
    determinant: float | None = fact(
        "of the block of Psi of the coordinates that were solved; its unit follows the rows and these coordinates",
        errors=(".determinant_error",),
    )
    determinant_error: float | None = fact("of the determinant, in its unit")
    orientation: int | None = fact("sign of the determinant")
    singular_ratio: float = fact(
        "smallest over largest singular value of that block", errors=(".singular_ratio_error",)
    )
    singular_ratio_error: float = fact("of this ratio")
    residual: float = fact("largest residual of the loops", "m or rad", errors=None)
    chosen: bool = fact("whether it is the configuration of the result")
    errors: dict[str, float] = fact("of the joint positions", OWN)


@record
class BranchSearch:
    """The effort of the search for branches, and what it proves."""

    starts: int = fact("of Newton's method")
    closed: int = fact("starts that closed the loops")
    found: int = fact("ways in which they close")
    complete: str = fact(
        "whether these are all", default="not proved: what many quasi-random starts of Newton's method found"
    )


@record
class NearestClosure:
    """How the configuration was found where the scene gives no start: others may close the loops too."""

    starts: int = fact("starts, q = 0 the first of them")
    closed: int = fact("how many of them closed the loops")
    distance: float = fact(
        "from q = 0: root of the sum of squares", "rad or sizes of the mechanism", errors=None
    )


@record
class UndrivenFreedoms:
    """Degrees of freedom that are left with all driven joints held, such as the spin of a rod between two balls."""

    count: int = fact("how many, to first order")
    joints: list[str] = fact("joints that they move; no others of these share one")


@record
class AssembleErrors:
    """How far the closed state may be off: what residuals and rounding make of it."""

    configuration: dict[str, float] = fact("of the joint positions", OWN)
    rates: dict[str, float] = fact("of the rates", RATE)
    accelerations: dict[str, float] = fact("of the accelerations", ACCELERATION)


@record
class AssembleSummary:
    """The summary of an assembly."""

    termination: Termination = fact("how the run ended")
    samples: int = fact("number of samples: 1")
    configuration: dict[str, float] = fact(
        "joint positions with the loops closed",
        OWN,
        errors=("error_estimate.configuration.JOINT",),
        column="position",
    )
    units: dict[str, str] = fact("unit of each coordinate: `rad`, `m` or `1`")
    rates: dict[str, float] = fact(
        "their rates; those that are not given are of least norm",
        RATE,
        errors=("error_estimate.rates.JOINT",),
    )
    accelerations: dict[str, float] = fact(
        "of least norm", ACCELERATION, errors=("error_estimate.accelerations.JOINT",)
    )
    held: list[str] = fact("joints that stayed")
    solved: list[str] = fact("joints that closed the loops")
    residual: LoopResidual = fact("what the loops lack", errors=None)
    residual_by_loop: dict[str, float] = fact(
        "largest residual of positions", "m or rad", names=LOOP, errors=None
    )
    error_estimate: AssembleErrors = fact("estimated errors")
    tolerance: float = fact(
        "residual up to which the loops count as closed: larger where redundant rows contradict each other by rounding",
        "rad or sizes of the mechanism", errors=None,
    )  # fmt: skip
    nearest: NearestClosure | Absent = fact("where no joint has an initial value")
    redundant_rows: list[str] = fact("rows that follow from others")
    mobility: Mobility = fact("degrees of freedom")
    undriven: list[UndrivenFreedoms] | Absent = fact("freedoms that nothing drives, where joints are driven")
    mass_condition: float | Absent = fact(
        "condition number of the inertia of the freedoms: accelerations lose its logarithm in digits; absent without "
        "freedoms, with missing data, or where a freedom moves no mass",
        errors=("mass_condition_error",),
    )
    mass_condition_error: float | Absent = fact("of this number, by errors of the configuration and rounding")
    branches: list[ClosedBranch] | Absent = fact("the ways in which the loops close, where asked for")
    branch_search: BranchSearch | Absent = fact("how they were sought")
