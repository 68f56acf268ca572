"""The keys of the summaries of ``assemble``, ``kinematics`` and ``statics`` (see docs/cli.md)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from robodyn_cli.record import record
from robodyn_cli.results.summary import Absent, Residual, Termination

if TYPE_CHECKING:
    from robodyn_cli.ready.mobility import Mobility


@record
class Branch:
    """One way in which the loops close, and the block of Psi of the coordinates that were solved."""

    configuration: dict[str, float]
    determinant: float | None
    orientation: int | None
    singular_ratio: float
    residual: float
    chosen: bool


@record
class BranchSearch:
    """The effort of the search for branches, and what it proves."""

    starts: int
    closed: int
    found: int
    complete: str = "not proved: what many quasi-random starts of Newton's method found"


@record
class AssembleSummary:
    """The summary of an assembly."""

    termination: Termination
    samples: int
    configuration: dict[str, float]
    rates: dict[str, float]
    accelerations: dict[str, float]
    held: list[str]
    solved: list[str]
    residual: Residual
    residual_by_loop: dict[str, float]
    redundant_rows: list[str]
    mobility: Mobility
    branches: list[Branch] | Absent
    branch_search: BranchSearch | Absent


@record
class JointRange:
    """Where a joint goes, and how fast; None for positions of a joint whose velocities are no rates of them."""

    smallest: float | None
    largest: float | None
    peak_speed: float
    peak_acceleration: float


@record
class PointPath:
    """The path of a named point [m], and how fast it goes."""

    peak_speed: float
    peak_acceleration: float
    path_length: float


@record
class SingularRatio:
    """Smallest ratio of singular values of the passive block to the loops' largest, and its time."""

    smallest: float
    time: float


@record
class TransmissionAngle:
    """Extremes of the transmission angle [deg] and their times [s]."""

    smallest_deg: float
    smallest_time: float
    largest_deg: float
    largest_time: float


@record
class Closure:
    """The error estimate of a kinematic analysis: largest residuals of the loops by level."""

    closure: dict[str, float]


@record
class KinematicsSummary:
    """The summary of a kinematic analysis; ``termination`` of one that stopped has the error's details."""

    termination: Termination | dict[str, Any]
    mobility: Mobility | Absent
    samples: int
    warnings: list[str] | Absent
    joints: dict[str, JointRange]
    points: dict[str, PointPath]
    singular_ratio: SingularRatio | Absent
    transmission_angle: TransmissionAngle | Absent
    error_estimate: Closure | Absent
    counters: dict[str, int]


@record
class Balanced:
    """A balance: eigenvalues of the reduced stiffness, complex ones as pairs."""

    stability: str
    stiffness: list[Any]
    residual: float
    iterations: int


@record
class Held:
    """A configuration that actuators hold; ``unique``, or of least norm and why."""

    actuated: list[str]
    torques: str
    multipliers: str
    residual: float


@record
class ForceResidual:
    """The error estimate of a static analysis [N m or N]."""

    force_residual: float


@record
class StaticsSummary:
    """The summary of a static analysis."""

    termination: Termination
    mobility: Mobility | Absent
    warnings: list[str] | Absent
    multipliers: dict[str, float] | Absent
    constraint_residual: Residual | Absent
    samples: int
    find: str
    configuration: dict[str, float]
    torques_of_joints: dict[str, float]
    equilibrium: Balanced | Held
    error_estimate: ForceResidual
    reactions: dict[str, Any] | Absent
