"""The scene as typed, immutable data: what the YAML says, checked, with names resolved but nothing computed.

Every field is one YAML key. Angles are in radians here, whatever the file used. ``formula`` values are
``robodyn_cli.expr.formula.Formula`` trees with canonical names (a constant is a formula too). The loader
fills in the ``parent`` and ``link`` of every joint.
"""

from __future__ import annotations

import dataclasses
from typing import Any

from robodyn_cli.expr.expectation import Expectation
from robodyn_cli.expr.formula import Formula as FormulaTree
from robodyn_cli.forces.registry import force_types, joint_forces
from robodyn_cli.joints.registry import joint_types
from robodyn_cli.loops.registry import loop_types
from robodyn_cli.scene.commands import SCENE_COMMANDS
from robodyn_cli.scene.methods import METHODS
from robodyn_cli.schema.fields import (
    Boolean,
    Choice,
    Criteria,
    Either,
    Formula,
    Inline,
    Integer,
    JointMap,
    ListOf,
    MapOf,
    Name,
    Number,
    OrFile,
    Section,
    Tagged,
    Text,
    Vector,
    key,
)
from robodyn_cli.trajectories.registry import trajectory_types


@dataclasses.dataclass(frozen=True)
class Placement:
    """Position and orientation of a frame: ``p = xyz``, ``R = Rz(yaw) Ry(pitch) Rx(roll)``."""

    xyz: tuple[float, ...] = key(Vector(3), default=(0.0, 0.0, 0.0), unit="m", doc="Origin.")
    rpy: tuple[float, ...] = key(
        Vector(3, angle=True), default=(0.0, 0.0, 0.0), unit="rad", doc="Roll, pitch, yaw about fixed axes."
    )


@dataclasses.dataclass(frozen=True)
class Inertia:
    """Rotational inertia about the centre of mass; a component that is not given is *unknown*, not zero."""

    xx: float | None = key(Number(), default=None, unit="kg m^2", doc="Moment about x.")
    yy: float | None = key(Number(), default=None, unit="kg m^2", doc="Moment about y.")
    zz: float | None = key(Number(), default=None, unit="kg m^2", doc="Moment about z.")
    xy: float | None = key(
        Number(), default=None, unit="kg m^2", doc="Element xy of the tensor (-integral xy dm)."
    )
    xz: float | None = key(Number(), default=None, unit="kg m^2", doc="Element xz of the tensor.")
    yz: float | None = key(Number(), default=None, unit="kg m^2", doc="Element yz of the tensor.")


@dataclasses.dataclass(frozen=True)
class Joint:
    """A joint and where it sits: by D-H parameters, or by ``origin`` and ``axis``."""

    name: str = key(Name(of="joint"), doc="Name; also the name of its coordinate in formulas.")
    type: str = key(Choice(tuple(joint_types)), doc="Kind of joint.")
    parent: str | None = key(
        Name(of="link"), default=None, doc="Link it hangs on, or `base`; default: the previous joint's link."
    )
    link: str | None = key(
        Name(of="link"),
        default=None,
        doc="Link that it moves; default: the link at the same place in `links`.",
    )
    a: float | None = key(Number(), default=None, unit="m", doc="D-H length.")
    alpha: float | None = key(Number(angle=True), default=None, unit="rad", doc="D-H twist.")
    d: float | None = key(Number(), default=None, unit="m", doc="D-H offset (revolute, fixed).")
    theta: float | None = key(
        Number(angle=True), default=None, unit="rad", doc="D-H angle (prismatic, fixed)."
    )
    offset: float = key(
        Number(angle=True), default=0.0, unit="rad or m", doc="Added to q to give the D-H variable."
    )
    origin: Placement | None = key(
        Section(Placement),
        default=None,
        doc="Placement in the parent link's frame (before any D-H parameters).",
    )
    axis: tuple[float, ...] | None = key(
        Vector(3),
        default=None,
        unit="1",
        doc="Joint axis in the joint's own frame (without D-H parameters); of a universal joint the first one, of "
        "a planar one the normal of its plane. Not for spherical and floating joints.",
    )
    axis2: tuple[float, ...] | None = key(
        Vector(3),
        default=None,
        unit="1",
        doc="Second axis of a universal joint, or x of a planar one, at right angles to `axis`; default: the frame's "
        "x for an `axis` along z, y for x, z for y.",
    )
    pitch: float | None = key(
        Number(),
        default=None,
        unit="m/rad",
        doc="Advance of a helical joint along its axis, lead / (2 pi); positive for a right-handed thread.",
    )
    gear_ratio: float = key(
        Number(), default=1.0, unit="1", doc="N: motor turns per joint turn (may be negative)."
    )
    rotor_inertia: float = key(
        Number(minimum=0.0),
        default=0.0,
        unit="kg m^2",
        doc="J of the rotor, reflected as N^2 J on the joint.",
    )
    forces: tuple[tuple[str, Any], ...] = key(
        Inline(lambda: joint_forces),
        default=(),
        doc="Joint forces: each registered kind (`friction`, `spring`, `damper`) is a key of the joint.",
    )


@dataclasses.dataclass(frozen=True)
class Link:
    """A rigid body. What is not given is unknown; a run that needs it says so."""

    name: str = key(Name(of="link"), doc="Name.")
    mass: float | None = key(Number(minimum=0.0), default=None, unit="kg", doc="Mass.")
    com: tuple[float, ...] | None = key(Vector(3), default=None, unit="m", doc="Centre of mass.")
    com_frame: str | None = key(
        Choice(("joint", "link")),
        default=None,
        doc="Frame of `com` and `inertia`: `joint` (origin and axes at the link's own joint, turning with "
        "the link) or `link` (the D-H frame, or the frame placed by `origin`).",
    )
    inertia: Inertia = key(
        Section(Inertia), default=Inertia(), doc="About the centre of mass, in the axes of `com_frame`."
    )


@dataclasses.dataclass(frozen=True)
class Place:
    """A place fixed to a link."""

    link: str = key(Name(of="link"), doc="Link that carries it, or `base`.")
    at: Any = key(
        Either((Choice(("origin", "end", "com")), Vector(3))),
        default="origin",
        unit="m",
        doc="`origin` (the link's own joint), `end` (the link frame of D-H, far end), `com`, or coordinates.",
    )
    frame: str = key(
        Choice(("joint", "link")), default="link", doc="Frame of the coordinates of `at` and of `rpy`."
    )


@dataclasses.dataclass(frozen=True)
class Point(Place):
    """A named point."""

    motion: tuple[FormulaTree, ...] | None = key(
        ListOf(Formula(("t",)), minimum=3, maximum=3),
        default=None,
        unit="m",
        doc="Displacement from `at` along the axes of the base, formulas in t: for points on `base` that loops join.",
    )


@dataclasses.dataclass(frozen=True)
class Frame(Place):
    """A named frame fixed to a link."""

    rpy: tuple[float, ...] = key(
        Vector(3, angle=True), default=(0.0, 0.0, 0.0), unit="rad", doc="Orientation in `frame`."
    )


@dataclasses.dataclass(frozen=True)
class Robot:
    """The tree of joints and links."""

    joints: tuple[Joint, ...] = key(
        ListOf(Section(Joint), minimum=1), doc="Joints; their order is that of q."
    )
    links: tuple[Link, ...] = key(ListOf(Section(Link), minimum=1), doc="Links.")
    convention: str | None = key(
        Choice(("standard", "modified")),
        default=None,
        doc="D-H convention; required as soon as a joint has D-H parameters.",
    )
    base: Placement = key(
        Section(Placement),
        default=Placement(),
        doc="Placement of the base in the world (gravity is a world vector).",
    )
    points: dict[str, Point] = key(MapOf(Section(Point), of="point"), default=None, doc="Named points.")
    frames: dict[str, Frame] = key(MapOf(Section(Frame), of="frame"), default=None, doc="Named frames.")


@dataclasses.dataclass(frozen=True)
class Coupler:
    """A linear relation between joint coordinates: gears, racks, belts. The sum of coefficient times q is a value."""

    name: str = key(Name(of="coupler"), doc="Name.")
    terms: dict[str, float] = key(
        MapOf(Number(), of="joint"), unit="1, m/rad or rad/m", doc="Coefficient of each joint's coordinate."
    )
    value: FormulaTree | None = key(
        Formula(("t",)),
        default=None,
        unit="rad or m",
        doc="What they sum to: a number or a formula in t; default 0.",
    )


@dataclasses.dataclass(frozen=True)
class Initial:
    """The state at t = 0."""

    q: dict[str, float] = key(
        JointMap(Number(angle=True)),
        default=None,
        unit="rad or m",
        doc="Positions; a list or a map by coordinate for joints with several.",
    )
    qd: dict[str, float] = key(
        JointMap(Number(angle=True), coordinates="v"),
        default=None,
        unit="rad/s or m/s",
        doc="Rates; 0 where not given.",
    )
    hold: tuple[str, ...] = key(
        ListOf(Name(of="joint")), default=(), doc="Joints kept at their value when the loops are closed."
    )


@dataclasses.dataclass(frozen=True)
class Torque:
    """A joint torque as a table; linear between rows, held beyond the ends."""

    table: tuple[tuple[float, ...], ...] = key(
        ListOf(Vector(2), minimum=2), unit="s, N m or N", doc="Rows of time and torque, times increasing."
    )


@dataclasses.dataclass(frozen=True)
class InverseOptions:
    samples: int = key(
        Integer(minimum=2, maximum=100_000_000), default=1001, doc="Number of uniform samples."
    )


@dataclasses.dataclass(frozen=True)
class Baumgarte:
    alpha: float = key(Number(minimum=0.0), unit="1/s", doc="Rate gain (the term 2 alpha eta-dot).")
    beta: float = key(Number(minimum=0.0), unit="1/s", doc="Position gain (the term beta^2 eta).")


@dataclasses.dataclass(frozen=True)
class SimulateOptions:
    duration: float = key(
        Number(minimum=0.0, exclusive=True), default=10.0, unit="s", doc="Length of the run."
    )
    samples: int = key(
        Integer(minimum=2, maximum=100_000_000), default=1001, doc="Number of uniform samples."
    )
    integrator: str = key(
        Choice(("auto", *METHODS)),
        default="auto",
        doc="Method of integration.",
    )
    rtol: float = key(Number(minimum=1e-15, maximum=0.1), default=1e-10, unit="1", doc="Relative tolerance.")
    atol: float = key(Number(minimum=0.0), default=1e-12, unit="rad, m", doc="Absolute tolerance.")
    step: float | None = key(
        Number(minimum=0.0, exclusive=True),
        default=None,
        unit="s",
        doc="Step of the methods with a fixed step.",
    )
    max_steps: int = key(Integer(minimum=1), default=10_000_000, doc="Steps after which the run is stopped.")
    stabilisation: Any = key(
        Either((Choice(("projection", "baumgarte", "none")), Section(Baumgarte))),
        default="projection",
        doc="How loops stay closed: `projection`, `none`, Baumgarte's {alpha, beta}, or `baumgarte` with "
        "gains that the run chooses.",
    )
    singular: str = key(
        Choice(("stop", "pass")),
        default="stop",
        doc="What `simulate` does where the loops' constraints lose rank: stop (exit code 4) or "
        "pass through.",
    )
    error_estimate: bool = key(
        Boolean(), default=True, doc="Estimate the global error by a second, tighter integration."
    )


@dataclasses.dataclass(frozen=True)
class Latch:
    between: tuple[str, ...] = key(
        ListOf(Name(of="link"), minimum=2, maximum=2), doc="The two links it fixes."
    )


@dataclasses.dataclass(frozen=True)
class DeployOptions:
    criterion: str = key(
        Choice(("dead_point", "multipliers", "either")), default="dead_point", doc="What counts as locked."
    )
    growth: float = key(
        Number(minimum=1.0, exclusive=True),
        default=1000.0,
        unit="1",
        doc="The norm of the multipliers passes this times its running median on a 1 ms grid.",
    )
    limit: float | None = key(
        Number(minimum=0.0, exclusive=True), default=None, unit="N", doc="Or: the norm passes this value."
    )
    latch: Latch | None = key(Section(Latch), default=None, doc="Links that lock to each other.")


@dataclasses.dataclass(frozen=True)
class Outputs:
    """What is recorded beyond the usual."""

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


@dataclasses.dataclass(frozen=True)
class Scene:
    """A whole scene. ``path``, ``text`` (resolved YAML) and ``sources`` (files read) come from the loader."""

    schema: int = key(Integer(minimum=1, maximum=1), doc="Version of the scene format: 1.")
    robot: Robot = key(OrFile(Section(Robot)), doc="The mechanism, in place or as a path.")
    gravity: tuple[float, ...] = key(Vector(3), unit="m/s^2", doc="Gravity in the world frame.")
    title: str = key(Text(), default="", doc="Title of plots and reports.")
    command: str | None = key(
        Choice(tuple(SCENE_COMMANDS)), default=None, doc="What `robodyn run` does with this file."
    )
    parameters: dict[str, float] = key(
        MapOf(Number(angle=True), of="parameter"), default=None, doc="Named constants for formulas."
    )
    loops: tuple[Any, ...] = key(ListOf(Tagged(lambda: loop_types)), default=(), doc="Loop closures.")
    forces: tuple[Any, ...] = key(
        ListOf(Tagged(lambda: force_types)), default=(), doc="Forces on points and between bodies."
    )
    couplers: tuple[Coupler, ...] = key(
        ListOf(Section(Coupler)), default=(), doc="Gears, racks, belts: relations between joint coordinates."
    )
    actuated: tuple[str, ...] | None = key(
        ListOf(Name(of="joint")),
        default=None,
        doc="Actuated joints; default: all in open chains, those in `torques` in loops.",
    )
    torques: dict[str, Any] = key(
        JointMap(Either((Formula(), Section(Torque))), coordinates="v"),
        default=None,
        unit="N m or N",
        doc="Actuator torques: a number, a formula in t, q and qd, or a table.",
    )
    prescribed: dict[str, FormulaTree] = key(
        JointMap(Formula(("t",))),
        default=None,
        unit="rad or m",
        doc="Joints whose motion is prescribed.",
    )
    initial: Initial = key(Section(Initial), default=Initial(), doc="State at t = 0.")
    trajectory: Any = key(
        OrFile(Tagged(lambda: trajectory_types)), default=None, doc="Motion that `inverse` follows."
    )
    inverse: InverseOptions = key(
        Section(InverseOptions), default=InverseOptions(), doc="Options of `inverse`."
    )
    simulate: SimulateOptions = key(
        Section(SimulateOptions), default=SimulateOptions(), doc="Options of `simulate` and `deploy`."
    )
    deploy: DeployOptions = key(Section(DeployOptions), default=DeployOptions(), doc="Options of `deploy`.")
    outputs: Outputs = key(Section(Outputs), default=Outputs(), doc="What is recorded beyond the usual.")
    expect: dict[str, Expectation] = key(
        Criteria(), default=None, doc="What `robodyn run` and `check` expect of the summary."
    )
    path: str = dataclasses.field(default="", compare=False)
    text: str = dataclasses.field(default="", compare=False, repr=False)
    sources: tuple[str, ...] = dataclasses.field(default=(), compare=False)
