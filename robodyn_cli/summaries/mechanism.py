"""The summaries of ``assemble``, ``kinematics``, ``reach`` and ``statics``."""

from __future__ import annotations

from typing import Any

from robodyn_cli.record import record
from robodyn_cli.summaries.facts import (
    ACCELERATION,
    ANY,
    LOAD,
    LOOP,
    OWN,
    POINT,
    RATE,
    ROW,
    Absent,
    LoopResidual,
    PeakLoads,
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


@record
class ClosedBranch:
    """One way in which the loops close."""

    configuration: dict[str, float] = fact("joint positions", OWN)
    determinant: float | None = fact(
        "of the block of Psi of the coordinates that were solved; its unit follows the rows and these coordinates"
    )
    orientation: int | None = fact("sign of the determinant")
    singular_ratio: float = fact("smallest over largest singular value of that block")
    residual: float = fact("largest residual of the loops", "m or rad")
    chosen: bool = fact("whether it is the configuration of the result")


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
class AssembleSummary:
    """The summary of an assembly."""

    termination: Termination = fact("how the run ended")
    samples: int = fact("number of samples: 1")
    configuration: dict[str, float] = fact("joint positions with the loops closed", OWN, column="position")
    rates: dict[str, float] = fact("their rates; those that are not given are of least norm", RATE)
    accelerations: dict[str, float] = fact("of least norm", ACCELERATION)
    held: list[str] = fact("joints that stayed")
    solved: list[str] = fact("joints that closed the loops")
    residual: LoopResidual = fact("what the loops lack")
    residual_by_loop: dict[str, float] = fact("largest residual of positions", "m or rad", names=LOOP)
    redundant_rows: list[str] = fact("rows that follow from others")
    mobility: Mobility = fact("degrees of freedom")
    branches: list[ClosedBranch] | Absent = fact("the ways in which the loops close, where asked for")
    branch_search: BranchSearch | Absent = fact("how they were sought")


@record
class JointRange:
    """Where a joint goes, and how fast."""

    smallest: float | None = fact(
        "smallest position; `null` of a joint whose velocities are no rates of its positions",
        OWN,
        column="smallest",
    )
    largest: float | None = fact("largest position", OWN, column="largest")
    peak_speed: float = fact("largest magnitude of the rate", RATE, column="peak speed")
    peak_acceleration: float = fact(
        "largest magnitude of the acceleration", ACCELERATION, column="peak acceleration"
    )


@record
class PointPath:
    """The path of a named point, and how fast it goes."""

    path_length: float = fact("length of the path through the samples", "m", column="path length")
    peak_speed: float = fact("largest speed", "m/s", column="peak speed")
    peak_acceleration: float = fact("largest acceleration", "m/s^2", column="peak acceleration")


@record
class SingularRatio:
    """How near a dead point is."""

    smallest: float = fact(
        "smallest ratio of singular values: of the passive block of Psi, over the largest of Psi"
    )
    time: float = fact("when it is smallest", "s")


@record
class TransmissionAngle:
    """Extremes of the transmission angle."""

    smallest_deg: float = fact("smallest angle", "deg")
    smallest_time: float = fact("when it is smallest", "s")
    largest_deg: float = fact("largest angle", "deg")
    largest_time: float = fact("when it is largest", "s")


@record
class ClosureErrors:
    """The error estimate of a kinematic analysis."""

    closure: LoopResidual = fact("largest residuals of the loops by level")


@record
class KinematicsSummary:
    """The summary of a kinematic analysis."""

    termination: Termination | dict[str, Any] = fact(
        "how the run ended; of one that stopped, what is known of the cause", names=ANY
    )
    mobility: Mobility | Absent = fact("degrees of freedom, with loops")
    samples: int = fact("number of samples")
    warnings: list[str] | Absent = fact("joints beyond their limits, with the time; printed too")
    joints: dict[str, JointRange] = fact("of each joint")
    points: dict[str, PointPath] = fact("of each named point", names=POINT)
    singular_ratio: SingularRatio | Absent = fact("with loops")
    transmission_angle: TransmissionAngle | Absent = fact("where three points are named")
    error_estimate: ClosureErrors | Absent = fact("with loops")
    counters: dict[str, int] = fact(
        "`iterations` and `steps` of Newton's method along the motion; `ik_iterations` and `ik_steps` for a led point",
        names=("iterations", "steps", "ik_iterations", "ik_steps"),
    )


@record
class ReachedBranch:
    """One way to reach the pose."""

    name: str = fact("of the branch")
    configuration: dict[str, float] = fact("joint positions", OWN)
    reached: bool = fact("whether it reaches the pose")
    within_limits: bool = fact("whether all joints are within their limits")
    error: float = fact("the larger of distance and angle to the pose", "m or rad")
    chosen: bool = fact("whether it is the configuration of the result")


@record
class ReachSummary:
    """The summary of ``reach``."""

    termination: Termination = fact("how the run ended")
    samples: int = fact("number of samples: 1")
    frame: str = fact("the frame that was brought there")
    method: str = fact("`analytic` or `damped`")
    configuration: dict[str, float] = fact("the joint positions chosen", OWN)
    branch: str | Absent = fact("name of their branch, with a closed form")
    error: float = fact(
        "the larger of distance and angle to the pose, and of what the loops lack", "m or rad"
    )
    freedom: int = fact("how many freedoms the pose leaves in general")
    singular_ratio: float = fact(
        "smallest over largest singular value of what moves the frame, in rad and sizes of the mechanism: 0 in "
        "singular poses"
    )
    branches: list[ReachedBranch] | Absent = fact("all ways to reach the pose, where no freedom is left")


@record
class Balanced:
    """A balance."""

    stability: str = fact("`stable`, `unstable`, `indifferent` or `rigid`")
    stiffness: list[float] | list[list[float]] = fact(
        "eigenvalues of the reduced stiffness; real and imaginary parts where some are complex",
        "N m/rad or N/m",
    )
    residual: float = fact("force that is left", LOAD)
    iterations: int = fact("of the search")
    holding: dict[str, float] | Absent = fact(
        "torques that keep joints in `initial.hold` and prescribed ones where they are, beside those of the scene: the "
        "pose is a balance with these alone",
        LOAD,
    )


@record
class Held:
    """A configuration that actuators hold."""

    actuated: list[str] = fact("joints that hold it")
    torques: str = fact("`unique`, or of least norm and why")
    multipliers: str = fact("`unique`, or of least norm and why")
    residual: float = fact("force that is left", LOAD)


@record
class ForceResidual:
    """The error estimate of a static analysis."""

    force_residual: float = fact("force that is left", LOAD)


@record
class StaticsSummary:
    """The summary of a static analysis."""

    termination: Termination = fact("how the run ended")
    mobility: Mobility | Absent = fact("degrees of freedom, with loops")
    warnings: list[str] | Absent = fact("joints beyond their limits; printed too")
    multipliers: dict[str, float] | Absent = fact("of the loops' rows", "N or N m", names=ROW)
    constraint_residual: LoopResidual | Absent = fact("with loops")
    samples: int = fact("number of samples: 1")
    find: str = fact("what was asked for: `balance` or `hold`")
    configuration: dict[str, float] = fact("joint positions", OWN, column="position")
    torques_of_joints: dict[str, float] = fact(
        "torques of actuators, and what holds joints in place", LOAD, column="torque"
    )
    equilibrium: Balanced | Held = fact("of a balance, or of a configuration that is held")
    error_estimate: ForceResidual = fact("what is out of balance")
    reactions: PeakLoads | Absent = fact("loads of joints and closures, where asked for")
