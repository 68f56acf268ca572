"""Figures of kinematic design, of the forces on a foundation, and of a flywheel."""

from __future__ import annotations

from robodyn_cli.record import record
from robodyn_cli.summaries.facts import ABSENT, ANY, JOINT, LINK, LOOP, OWN, PAIR, Absent, fact


@record
class JointDeadPoints:
    """Between which dead points a joint of a chain of four links may go; `null` where it has none."""

    turns: bool = fact("whether it turns fully against its neighbour")
    lower: float | None = fact("dead point below its first position", OWN, errors=(".error",))
    upper: float | None = fact("dead point above", OWN, errors=(".error",))
    error: float | None = fact("error of both", OWN)
    distance: float | None = fact(
        "how near the motion comes to one of them; negative where it goes beyond",
        OWN,
        errors=(".distance_error",),
    )
    distance_error: float | None = fact("of the distance", OWN)


@record
class FourBarClass:
    """A closed chain of four links by Grashof's rule."""

    kind: str = fact("`four pins`, or `three pins and a slide`")
    lengths: dict[str, float] = fact(
        "of links between their pins", "m", names=(LINK, LOOP), errors=("design.four_bars.LOOP.margin_error",)
    )
    offset: float | Absent = fact(
        "distance of the slide's line from the pin that is not on it",
        "m", errors=("design.four_bars.LOOP.margin_error",), default=ABSENT,
    )  # fmt: skip
    margin: float = fact(
        "p + q - s - l of the shortest, longest and other lengths; with a slide the longer of two lengths less the "
        "shorter and the offset: positive where the shortest link turns fully (Grashof), 0 in a change point",
        "m",
        errors=(".margin_error",),
    )
    margin_error: float = fact("what rounding leaves of it", "m")
    grashof: bool = fact("whether a link turns fully against all others")
    shortest: str = fact("the shortest link")
    ground: str = fact("the link that is nearest to the base in the chain")
    type: str = fact("what it is called with that link fixed")
    inversions: dict[str, str] = fact("what it is called with each link fixed", names=(LINK, LOOP))
    joints: dict[str, JointDeadPoints] = fact(
        "of the joints of the chain that have a coordinate", names=JOINT
    )


@record
class DeadPointPassed:
    """Where the first joint of a ratio is at rest while the second moves: it cannot drive there."""

    time: float = fact("when", "s", errors=(".time_error",))
    time_error: float = fact("of the time", "s")
    first: float = fact("position of the first joint there", OWN, errors=(".error",))
    second: float = fact("position of the second joint there", OWN, errors=(".error",))
    error: float = fact("of the positions", "rad or m")


@record
class Unbounded:
    """Where a column has no finite value: a pole at infinity, a point at rest, a ratio to a joint at rest."""

    times: list[float] = fact("when", "s", errors=("design.unbounded.KEY.error",))
    error: float = fact("of these times", "s")
    throughout: bool = fact("whether it has none at any time")


@record
class DesignFigures:
    """Figures of kinematic design, beside the extremes of its columns."""

    four_bars: dict[str, FourBarClass] | Absent = fact(
        "chains of four links, by a closure of each", names=LOOP
    )
    dead_points: dict[str, list[DeadPointPassed]] | Absent = fact(
        "of ratios of joints: where the first joint is at rest", names=PAIR
    )
    unbounded: dict[str, Unbounded] | Absent = fact(
        "datasets without extremes, and when they are unbounded", names=ANY
    )


@record
class DesignKeys:
    """What `kinematics.design` adds to the summary."""

    design: DesignFigures = fact("kinematic design")


@record
class ShakingErrors:
    """Errors of the figures of the shaking force and moment."""

    peak_force: float = fact("of the largest force", "N")
    peak_force_time: float = fact("of its time", "s")
    rms_force: float = fact("of the RMS force", "N")
    peak_moment: float = fact("of the largest moment", "N m")
    peak_moment_time: float = fact("of its time", "s")
    rms_moment: float = fact("of the RMS moment", "N m")


@record
class ShakingFigures:
    """What the inertia of the links exerts on the base, weights left out; without the spin of rotors."""

    about: str = fact("point about which moments are")
    peak_force: float = fact("largest magnitude of the force", "N", errors=(".errors.peak_force",))
    peak_force_time: float = fact("when it is largest", "s", errors=(".errors.peak_force_time",))
    rms_force: float = fact("root of its mean square", "N", errors=(".errors.rms_force",))
    peak_moment: float | Absent = fact(
        "largest magnitude of the moment", "N m", errors=(".errors.peak_moment",)
    )
    peak_moment_time: float | Absent = fact("when it is largest", "s", errors=(".errors.peak_moment_time",))
    rms_moment: float | Absent = fact("root of its mean square", "N m", errors=(".errors.rms_moment",))
    not_determined: list[str] | Absent = fact("components that the scene's data do not determine")
    errors: ShakingErrors = fact("errors of these figures")


@record
class FlywheelErrors:
    """Errors of the figures of a flywheel."""

    inertia: float = fact("of the inertia", "kg m^2")
    whole_inertia: float = fact("of this inertia", "kg m^2")
    own_inertia: float | Absent = fact("of this inertia", "kg m^2", default=ABSENT)
    energy: float = fact("of the energy", "J")
    mean_torque: float = fact("of the mean torque", "N m")
    fullest_time: float = fact("of the time", "s")
    emptiest_time: float = fact("of the time", "s")


@record
class FlywheelFigures:
    """The flywheel that keeps the rate of a joint within a coefficient of fluctuation."""

    joint: str = fact("the joint")
    rate: float = fact("its mean rate", "rad/s", errors=None)
    inertia: float = fact(
        "moment of inertia on its shaft: `whole_inertia` less `own_inertia`, 0 where the mechanism needs none",
        "kg m^2",
        errors=(".errors.inertia",),
    )
    whole_inertia: float = fact(
        "that the shaft has to have: energy over the coefficient and the rate squared",
        "kg m^2",
        errors=(".errors.whole_inertia",),
    )
    own_inertia: float | Absent = fact(
        "mean inertia of the mechanism reduced to the shaft, 2 T over the rate squared; left out, and not counted, "
        "where the scene does not give it",
        "kg m^2",
        errors=(".errors.own_inertia",),
        default=ABSENT,
    )
    energy: float = fact("energy that it takes up and gives in a cycle", "J", errors=(".errors.energy",))
    mean_torque: float = fact("mean torque of the cycle", "N m", errors=(".errors.mean_torque",))
    fullest_time: float = fact("when it is quickest", "s", errors=(".errors.fullest_time",))
    emptiest_time: float = fact("when it is slowest", "s", errors=(".errors.emptiest_time",))
    errors: FlywheelErrors = fact("errors of these figures")


@record
class BalanceKeys:
    """What `inverse.shaking` and `inverse.flywheel` add to the summary."""

    shaking: ShakingFigures | Absent = fact("force and moment on the base", default=ABSENT)
    flywheel: FlywheelFigures | Absent = fact("of a flywheel", default=ABSENT)
