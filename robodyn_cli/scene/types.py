"""The scene as typed, immutable data: the checked content of the YAML, with names resolved but nothing computed.

Every field is one YAML key. Angles are in radians here, whatever the file used. ``formula`` values are
``robodyn_cli.expr.formula.Formula`` trees with canonical names (a constant is a formula too). The loader
fills in the ``parent`` and ``link`` of every joint.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NewType

from robodyn_cli.commands import SAMPLERS, SCENE_COMMANDS
from robodyn_cli.expr.statements import Expectation
from robodyn_cli.forces.registry import force_types
from robodyn_cli.loops.registry import loop_types
from robodyn_cli.record import record
from robodyn_cli.scene.robot_types import Frame as Frame
from robodyn_cli.scene.robot_types import Inertia as Inertia
from robodyn_cli.scene.robot_types import Joint as Joint
from robodyn_cli.scene.robot_types import Link as Link
from robodyn_cli.scene.robot_types import Orientation as Orientation
from robodyn_cli.scene.robot_types import Place as Place
from robodyn_cli.scene.robot_types import Placement as Placement
from robodyn_cli.scene.robot_types import Point as Point
from robodyn_cli.scene.robot_types import Robot as Robot
from robodyn_cli.scene.robot_types import Torque as Torque
from robodyn_cli.scene.run_options import AssembleOptions as AssembleOptions
from robodyn_cli.scene.run_options import Baumgarte as Baumgarte
from robodyn_cli.scene.run_options import DeployOptions as DeployOptions
from robodyn_cli.scene.run_options import InverseOptions as InverseOptions
from robodyn_cli.scene.run_options import KinematicsOptions as KinematicsOptions
from robodyn_cli.scene.run_options import SimulateOptions as SimulateOptions
from robodyn_cli.scene.run_options import StaticsOptions as StaticsOptions
from robodyn_cli.schema.fields import (
    Boolean,
    Choice,
    Criteria,
    Either,
    Formula,
    Integer,
    JointMap,
    LaterSection,
    ListOf,
    MapOf,
    Name,
    Number,
    OrFile,
    Section,
    Tagged,
    Text,
    Variations,
    Vector,
    key,
)
from robodyn_cli.trajectories.registry import trajectory_types

if TYPE_CHECKING:
    from robodyn_cli.expr.statements import Variation
    from robodyn_cli.scene import nested_options as nested
    from robodyn_cli.scene.robot_parts import Coupler


def _controllers() -> Mapping[str, type]:
    from robodyn_cli.control.registry import control_types  # few scenes have a controller

    return control_types


@record
class Initial:
    """The state at t = 0."""

    q: dict[str, float] = key(
        JointMap(Number()),
        default=None,
        unit="rad or m",
        doc="Positions; a list or a map by coordinate for joints with several.",
    )
    qd: dict[str, float] = key(
        JointMap(Number(), coordinates="v"),
        default=None,
        unit="rad/s or m/s",
        doc="Rates; 0 where not given.",
    )
    hold: tuple[str, ...] = key(
        ListOf(Name(of="joint"), minimum=0),
        default=(),
        doc="Joints kept at their value when the loops are closed.",
    )
    source: str | None = key(
        Text(),
        default=None,
        name="from",
        doc="Result of `simulate`, or of `deploy` with `latches`, to go on from: its directory or file, from here.",
    )
    at: float | None = key(
        Number(), default=None, unit="s", doc="Time of the sample to go on from; by default the last one."
    )


SEEN = Formula(("t", "q", "qd", "ref", "refd", "refdd", "s", "tau"))


@record
class Signal:
    """A quantity to record, by a formula."""

    value: Any = key(SEEN, doc="The formula.")
    unit: str = key(Text(), default="1", doc="Its unit, as the file states it.")


@record
class Outputs:
    """Further quantities to record."""

    reactions: bool = key(
        Boolean(),
        default=False,
        doc="Record force and moment in every joint and loop closure, and of the base.",
    )
    reaction_axes: str = key(
        Choice(("joint", "world")),
        default="joint",
        doc="Axes of the components: the joint's own frame, turning with the link, or the world's.",
    )
    signals: dict[str, Any] = key(
        MapOf(Either((SEEN, Section(Signal))), of="signal"),
        default=None,
        doc="Quantities to record by formulas, in t, q, qd, tau and what a controller knows (ref, refd, refdd, s).",
    )
    extremes: tuple[str, ...] = key(ListOf(Text()), default=(), doc="Columns whose extremes to tell.")
    response: bool = key(
        Boolean(), default=False, doc="Tell how what the controller leads goes to where it is to be."
    )
    abscissa: str | None = key(
        Text(),
        default=None,
        doc="Joint (or coordinate) over whose position plots are drawn in place of time.",
    )


@record
class StudyOptions:
    """What ``sweep`` varies, and how."""

    vary: dict[str, Variation] = key(
        Variations(),
        default=None,
        doc="Keys of the scene, as `--set` writes them, with values or distribution: `[a, b]`, `linspace(a, b, n)`, "
        "`logspace(a, b, n)`, `uniform(low, high)`, `triangular(low, mode, high)`, `normal(mean, sd)`.",
    )
    n: int | None = key(Integer(minimum=1), default=None, doc="Samples of the distributions.")
    sampler: str = key(Choice(SAMPLERS), default="random", doc="How samples are drawn.")
    seed: int = key(Integer(minimum=0), default=0, doc="Seed of the samples.")
    of: tuple[str, ...] = key(
        ListOf(Text()), default=(), doc="Outputs: keys of the summary, as `expect` writes them."
    )
    least_yield: float | None = key(
        Number(minimum=0.0, maximum=1.0),
        default=None,
        unit="1",
        name="yield",
        doc="Share of runs that must hold what `expect` says.",
    )
    correlation: tuple[nested.Correlation, ...] = key(
        ListOf(LaterSection("scene.nested_options:Correlation")),
        default=(),
        doc="Pairs of keys that vary together.",
    )


@record
class Scene:
    """A whole scene.

    From the loader come ``path``, ``text`` (resolved YAML), ``sources`` (files read), and what it has to say of robots
    in other formats: ``notes``, and ``warnings``, which ``--strict`` takes as errors.
    """

    schema: int = key(Integer(minimum=1, maximum=1), doc="Version of the scene format: 1.")
    robot: Robot = key(
        OrFile(Section(Robot), robot=True),
        doc="The mechanism, in place or as the path of a YAML, URDF, SDF or MJCF file.",
    )
    gravity: tuple[float, ...] = key(Vector(3), unit="m/s^2", doc="Gravity in the world frame.")
    title: str = key(Text(), default="", doc="Title of plots and reports.")
    command: str | None = key(
        Choice(SCENE_COMMANDS), default=None, doc="What `robodyn run` does with this file."
    )
    parameters: dict[str, float] = key(
        MapOf(Number(), of="parameter", minimum=0), default=None, doc="Named constants for formulas."
    )
    loops: tuple[Any, ...] = key(
        ListOf(Tagged(lambda: loop_types), minimum=0), default=(), doc="Loop closures."
    )
    forces: tuple[Any, ...] = key(
        ListOf(Tagged(lambda: force_types), minimum=0), default=(), doc="Forces on points and between bodies."
    )
    payloads: tuple[nested.Payload, ...] = key(
        ListOf(LaterSection("scene.nested_options:Payload"), minimum=0),
        default=(),
        doc="Masses that links pick up and release.",
    )
    couplers: tuple[Coupler, ...] = key(
        ListOf(LaterSection("scene.robot_parts:Coupler"), minimum=0),
        default=(),
        doc="Gears, racks, belts: relations between joint coordinates.",
    )
    actuated: tuple[str, ...] | None = key(
        ListOf(Name(of="joint"), minimum=0),
        default=None,
        doc="Actuated joints; default: all in open chains, those in `torques` in loops.",
    )
    torques: dict[str, Any] = key(
        JointMap(Either((Formula(), Section(Torque))), coordinates="v"),
        default=None,
        unit="N m or N",
        doc="Actuator torques: a number, a formula in t, q and qd, or a table; with a role by their section.",
    )
    drives: dict[str, Any] = key(
        MapOf(LaterSection("motors.drive:Drive"), of="joint", minimum=0),
        default=None,
        doc="Motors, gears and brakes of joints, whose torques, heat and limits `inverse` and `simulate` report.",
    )
    catalogue: Any = key(
        OrFile(LaterSection("motors.drive:Catalogue"), catalogue=True),
        default=None,
        doc="Motors, gears and brakes that `drives` and `size` choose from; default: the example catalogue.",
    )
    control: Any = key(
        OrFile(Tagged(_controllers)),
        default=None,
        doc="Controller whose torques `simulate` adds to `torques`.",
    )
    prescribed: dict[str, Any] = key(
        Either((Choice(("trajectory",)), JointMap(Formula(("t",)), word="trajectory"))),
        default=None,
        unit="rad or m",
        doc="Joints whose motion is prescribed, by formulas or as the `trajectory` leads them; `trajectory` alone: "
        "all that it leads.",
    )
    initial: Initial = key(Section(Initial), default=Initial(), doc="State at t = 0.")
    trajectory: Any = key(
        OrFile(Tagged(lambda: trajectory_types)),
        default=None,
        doc="Motion that `inverse` and `kinematics` follow.",
    )
    inverse: InverseOptions = key(
        Section(InverseOptions), default=InverseOptions(), doc="Options of `inverse`."
    )
    simulate: SimulateOptions = key(
        Section(SimulateOptions), default=SimulateOptions(), doc="Options of `simulate` and `deploy`."
    )
    deploy: DeployOptions = key(Section(DeployOptions), default=DeployOptions(), doc="Options of `deploy`.")
    assemble: AssembleOptions = key(
        Section(AssembleOptions), default=AssembleOptions(), doc="Options of `assemble`."
    )
    kinematics: KinematicsOptions = key(
        Section(KinematicsOptions), default=KinematicsOptions(), doc="Options of `kinematics`."
    )
    reach: nested.ReachOptions | None = key(
        LaterSection("scene.nested_options:ReachOptions"), default=None, doc="The pose of `reach`."
    )
    statics: StaticsOptions = key(
        Section(StaticsOptions), default=StaticsOptions(), doc="Options of `statics`."
    )
    motorisation: Any = key(
        LaterSection("scene.nested_options:Motorisation"),
        default=None,
        doc="Margins of motorisation: torque available over factored resistance, in `inverse`, `simulate`, `deploy` "
        "and `kinematics`.",
    )
    outputs: Outputs = key(Section(Outputs), default=Outputs(), doc="Further quantities to record.")
    expect: dict[str, Expectation] = key(
        Criteria(minimum=0), default=None, doc="What `robodyn run` and `check` expect of the summary."
    )
    study: StudyOptions = key(
        Section(StudyOptions), default=StudyOptions(), doc="What `sweep` varies, and how."
    )
    search: Any = key(LaterSection("scene.nested_options:SearchOptions"), default=None, doc="For `optimise`.")
    notes: tuple[str, ...] = dataclasses.field(default=(), compare=False)
    warnings: tuple[str, ...] = dataclasses.field(default=(), compare=False)
    path: str = dataclasses.field(default="", compare=False)
    text: str = dataclasses.field(default="", compare=False, repr=False)
    latched: bool = False  # whether the command follows the latches of `deploy`
    sources: tuple[str, ...] = dataclasses.field(default=(), compare=False)


Ready = NewType("Ready", Scene)  # as the doors of `ready` return it
