"""The summaries of ``kinematics``, ``reach`` and ``statics``, and of a scene at one state (``info``)."""

from __future__ import annotations

from typing import Any

from robodyn_cli.record import record
from robodyn_cli.summaries.assemble import Mobility
from robodyn_cli.summaries.extremes import OF_COLUMNS, Extremes
from robodyn_cli.summaries.facts import (
    ABSENT,
    ACCELERATION,
    ANY,
    COLUMN,
    LINK,
    LOAD,
    OWN,
    POINT,
    RATE,
    ROW,
    TURNS,
    Absent,
    LoopResidual,
    PeakLoads,
    Termination,
    fact,
)

Matrix = list[list[float]]  # by rows


@record
class RangeErrors:
    """Errors of where a joint goes that are due to the samples: of what lies between them."""

    smallest: float | None = fact("of the smallest position", OWN)
    largest: float | None = fact("of the largest position", OWN)
    peak_speed: float = fact("of the largest rate", RATE)
    peak_acceleration: float = fact("of the largest acceleration", ACCELERATION)


@record
class JointRange:
    """Where a joint goes, and how fast."""

    smallest: float | None = fact(
        "smallest position; `null` of a joint whose velocities are no rates of its positions",
        OWN, errors=(".errors.smallest",), column="smallest",
    )  # fmt: skip
    largest: float | None = fact("largest position", OWN, errors=(".errors.largest",), column="largest")
    peak_speed: float = fact(
        "largest magnitude of the rate", RATE, errors=(".errors.peak_speed",), column="peak speed"
    )
    peak_acceleration: float = fact(
        "largest magnitude of the acceleration",
        ACCELERATION, errors=(".errors.peak_acceleration",), column="peak acceleration",
    )  # fmt: skip
    errors: RangeErrors = fact("errors of these figures")
    units: dict[str, str] = fact("units of this joint", names=("position", "speed", "acceleration"))


@record
class PathErrors:
    """Errors of the figures of a path that are due to the samples."""

    path_length: float = fact("of the length", "m")
    peak_speed: float = fact("of the largest speed", "m/s")
    peak_acceleration: float = fact("of the largest acceleration", "m/s^2")


@record
class PointPath:
    """The path of a named point, and how fast it goes."""

    path_length: float = fact(
        "length of the path", "m", errors=(".errors.path_length",), column="path length"
    )
    peak_speed: float = fact("largest speed", "m/s", errors=(".errors.peak_speed",), column="peak speed")
    peak_acceleration: float = fact(
        "largest acceleration", "m/s^2", errors=(".errors.peak_acceleration",), column="peak acceleration"
    )
    errors: PathErrors = fact("errors of these figures")


@record
class PointPlace:
    """Where a named point is at one time."""

    x: float = fact("its place along x of the world", "m", errors=(".error",))
    y: float = fact("along y", "m", errors=(".error",))
    z: float = fact("along z", "m", errors=(".error",))
    error: float = fact("error of these", "m")


@record
class PlacesAt:
    """Where named points are at one time."""

    time: float = fact("as it was asked for", "s")
    points: dict[str, PointPlace] = fact("of each named point", names=POINT)


@record
class SingularRatio:
    """How near a dead point is."""

    smallest: float = fact(
        "smallest ratio of singular values: of the passive block of Psi, over the largest of Psi",
        errors=(".smallest_error",),
        column="singular ratio",
    )
    smallest_error: float = fact("error of the smallest ratio")
    time: float = fact("when it is smallest", "s", errors=(".time_error",))
    time_error: float = fact("error of this time", "s")


@record
class TransmissionErrors:
    """Errors of the extremes of the transmission angle that are due to the samples."""

    smallest_deg: float = fact("of the smallest angle", "deg")
    smallest_time: float = fact("of its time", "s")
    largest_deg: float = fact("of the largest angle", "deg")
    largest_time: float = fact("of its time", "s")


@record
class TransmissionAngle:
    """Extremes of the transmission angle."""

    smallest_deg: float = fact(
        "smallest angle", "deg", errors=(".errors.smallest_deg",), column="transmission from"
    )
    smallest_time: float = fact("when it is smallest", "s", errors=(".errors.smallest_time",))
    largest_deg: float = fact(
        "largest angle", "deg", errors=(".errors.largest_deg",), column="transmission to"
    )
    largest_time: float = fact("when it is largest", "s", errors=(".errors.largest_time",))
    errors: TransmissionErrors = fact("errors of these figures")


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
    at: list[PlacesAt] | Absent = fact(
        "with `kinematics.at`: where points are at these times, one after another"
    )
    singular_ratio: SingularRatio | Absent = fact("with loops")
    transmission_angle: TransmissionAngle | Absent = fact("where three points are named")
    error_estimate: ClosureErrors | Absent = fact("with loops", errors=None)
    counters: dict[str, int] = fact(
        "`iterations` and `steps` of Newton's method along the motion; `ik_iterations` and `ik_steps` for a led point",
        names=("iterations", "steps", "ik_iterations", "ik_steps"),
    )
    extremes: dict[str, Extremes] | Absent = fact(OF_COLUMNS, names=COLUMN, default=ABSENT)


@record
class ReachedBranch:
    """One way to reach the pose."""

    name: str = fact("of the branch")
    configuration: dict[str, float] = fact("joint positions", OWN, errors=(".errors.JOINT",))
    reached: bool = fact("whether it reaches the pose")
    within_limits: bool = fact("whether all joints are within their limits")
    error: float = fact("the larger of distance and angle to the pose", "m or rad", errors=None)
    chosen: bool = fact("whether it is the configuration of the result")
    errors: dict[str, float] | Absent = fact("of the joint positions, where it reaches the pose", OWN)


@record
class ReachErrors:
    """How far joint positions may be off: what residuals and rounding make of them; with freedoms left, those of the
    nearest that reach the pose."""

    configuration: dict[str, float] = fact("of the joint positions", OWN)


@record
class ReachSummary:
    """The summary of ``reach``."""

    termination: Termination = fact("how the run ended")
    samples: int = fact("number of samples: 1")
    frame: str = fact("the frame that was brought there")
    method: str = fact("`analytic` or `damped`")
    configuration: dict[str, float] = fact(
        "the joint positions chosen", OWN, errors=("error_estimate.configuration.JOINT",), column="position"
    )
    units: dict[str, str] = fact("unit of each coordinate: `rad`, `m` or `1`")
    branch: str | Absent = fact("name of their branch, with a closed form")
    error: float = fact(
        "the larger of distance and angle to the pose, and of what the loops lack", "m or rad", errors=None
    )
    freedom: int = fact("how many freedoms the pose leaves in general")
    singular_ratio: float = fact(
        "smallest over largest singular value of what moves the frame, in rad and sizes of the mechanism: 0 in "
        "singular poses",
        errors=("singular_ratio_error",),
    )
    singular_ratio_error: float = fact("of this ratio")
    error_estimate: ReachErrors = fact("estimated errors")
    branches: list[ReachedBranch] | Absent = fact("all ways to reach the pose, where no freedom is left")


@record
class Balanced:
    """A balance."""

    stability: str = fact("`stable`, `unstable`, `indifferent` or `rigid`")
    stiffness: list[float] | list[list[float]] = fact(
        "eigenvalues of the reduced stiffness; real and imaginary parts where some are complex",
        "N m/rad or N/m",
        errors=("equilibrium.stiffness_error",),
    )
    stiffness_error: float | None = fact(
        "of these eigenvalues: by the error of the configuration, and by rounding",
        "N m/rad or N/m",
    )
    residual: float = fact("force that is left", LOAD, errors=None)
    iterations: int = fact("of the search")
    holding: dict[str, float] | Absent = fact(
        "torques that keep joints in `initial.hold` and prescribed ones where they are, beside those of the scene: the "
        "pose is a balance with these alone",
        LOAD,
        errors=("error_estimate.holding.JOINT",),
    )


@record
class Held:
    """A configuration that actuators hold."""

    actuated: list[str] = fact("joints that hold it")
    torques: str = fact("`unique`, or of least norm and why")
    multipliers: str = fact("`unique`, or of least norm and why")
    residual: float = fact("force that is left", LOAD, errors=None)


@record
class StaticsErrors:
    """How far a configuration at rest may be off: what residuals and rounding make of it; `null` where rounding decides
    whether actuators hold it. Where nothing decides between configurations the errors are those of the nearest."""

    force_residual: float = fact("force that is left", LOAD, errors=None)
    configuration: dict[str, float | None] = fact("of the joint positions", OWN)
    torques_of_joints: dict[str, float | None] = fact("of the torques", LOAD)
    holding: dict[str, float | None] | Absent = fact("of the torques that keep joints in place", LOAD)
    multipliers: dict[str, float | None] | Absent = fact("of the multipliers", "N or N m", names=ROW)


@record
class StaticsSummary:
    """The summary of a static analysis."""

    termination: Termination = fact("how the run ended")
    mobility: Mobility | Absent = fact("degrees of freedom, with loops")
    warnings: list[str] | Absent = fact("joints beyond their limits; printed too")
    multipliers: dict[str, float] | Absent = fact(
        "of the loops' rows, of least norm where rows depend on each other", "N or N m", names=ROW,
        errors=("error_estimate.multipliers.ROW",), column="multiplier",
    )  # fmt: skip
    constraint_residual: LoopResidual | Absent = fact("with loops", errors=None)
    samples: int = fact("number of samples: 1")
    find: str = fact("what was asked for: `balance` or `hold`")
    configuration: dict[str, float] = fact(
        "joint positions", OWN, errors=("error_estimate.configuration.JOINT",), column="position"
    )
    units: dict[str, str] = fact("unit of each coordinate: `rad`, `m` or `1`")
    torques_of_joints: dict[str, float] = fact(
        "torques of actuators, and what holds joints in place",
        LOAD, errors=("error_estimate.torques_of_joints.JOINT",), column="torque",
    )  # fmt: skip
    equilibrium: Balanced | Held = fact("of a balance, or of a configuration that is held")
    error_estimate: StaticsErrors = fact("estimated errors")
    reactions: PeakLoads | Absent = fact("loads of joints and closures, where asked for")


@record
class InfoJoint:
    """A joint of the tree."""

    name: str = fact("name of the joint")
    type: str = fact("its kind")
    parent: str | None = fact("link that carries it")
    link: str | None = fact("link that it moves")
    gear_ratio: float | dict[str, float] = fact("motor turns per turn of the joint", TURNS, names=ANY)
    actuated: bool | None = fact("whether it has a motor; null where the scene does not say")


@record
class InfoLink:
    """The inertia of a link; `null` where the scene does not give it."""

    mass: float | None = fact("its mass", "kg")
    com: list[float] | None = fact("centre of mass", "m")
    com_frame: str | None = fact("frame in which it is given")
    inertia: dict[str, float | None] = fact(
        "about the centre of mass", "kg m^2", names=("xx", "yy", "zz", "xy", "xz", "yz")
    )


@record
class InfoState:
    """Positions by coordinate, and rates by velocity coordinate."""

    q: dict[str, float] = fact("positions", OWN)
    qd: dict[str, float] = fact("rates", RATE)


@record
class FrameAt:
    """A frame in world coordinates."""

    position: list[float] = fact("its origin", "m")
    rotation: Matrix = fact("its axes, as columns")
    quaternion: list[float] = fact("its attitude, a unit quaternion, scalar first")


@record
class PointAt:
    """A named point in world coordinates."""

    position: list[float] = fact("where it is", "m")
    velocity: list[float] = fact("its velocity", "m/s")
    jacobian: Matrix = fact("of its velocity by the rates (3, nv)", "m or 1")
    angular_jacobian: Matrix = fact("of the angular velocity of its link by the rates (3, nv)", "1 or rad/m")
    singular_values: list[float] | None = fact("of `jacobian`; `null` where data are missing", "m or 1")


@record
class ConstraintsAt:
    """Psi (m, nv) of all rows."""

    rows: list[str] = fact("the rows")
    psi: Matrix = fact("their Jacobian", "m, rad or 1")
    singular_values: list[float] | None = fact("of Psi; `null` where data are missing", "m, rad or 1")


@record
class InfoReport:
    """The report of ``info``; numbers that depend on data which the scene does not give are `null`."""

    joints: list[InfoJoint] = fact("of the tree")
    links: dict[str, InfoLink] = fact("with what the scene says of them", names=LINK)
    light_links: list[str] = fact(
        "off the ground, with a millionth of the mass of all links or less: markers"
    )
    state: InfoState = fact("at which all else is")
    mass_matrix: Matrix = fact("M (nv, nv) of the tree", "kg m^2, kg m or kg")
    mass_matrix_singular_values: list[float] | None = fact("of M", "kg m^2, kg m or kg")
    mass_matrix_condition: float | None = fact(
        "largest over smallest singular value of M; none where that is 0: by so much errors may grow", "1"
    )
    coriolis_matrix: Matrix = fact("C (nv, nv) of the tree: C qd are torques", "N m s, N s or kg m/s")
    gravity_torques: dict[str, float] = fact("G: what holds the weight", LOAD)
    frames: dict[str, FrameAt] = fact("of links, and named ones", names=(LINK, "FRAME"))
    points: dict[str, PointAt] = fact("named points", names=POINT)
    constraints: ConstraintsAt | Absent = fact("with loops, couplers or prescribed joints")
