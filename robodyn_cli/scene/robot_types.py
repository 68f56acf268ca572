"""The robot of a scene as typed, immutable data: joints, links, points (see ``scene.types``)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from robodyn_cli.expr.formula import FormulaTree
from robodyn_cli.expr.functions import interpolate
from robodyn_cli.forces.registry import joint_forces
from robodyn_cli.joints.registry import joint_types
from robodyn_cli.loops.registry import loop_types
from robodyn_cli.record import record
from robodyn_cli.schema.fields import (
    DRIVE,
    Choice,
    Direction,
    Either,
    Formula,
    Inline,
    LaterSection,
    ListOf,
    MapOf,
    Name,
    Number,
    Section,
    Tagged,
    Text,
    Vector,
    key,
    like,
    role_key,
)
from robodyn_cli.schema.fields import Orientation as Orientation
from robodyn_cli.schema.fields import Placement as Placement

if TYPE_CHECKING:
    from robodyn_cli.scene.robot_parts import Coupler, Shape


@record
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


DH = ("a", "alpha", "d", "theta")
# what forces may act on in joints with several coordinates, of all kinds of joint (``Joint.freedoms``)
FREEDOMS = ("theta1", "theta2", "theta", "d", "x", "y", "translation", "rotation")


@record
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
    alpha: float | None = key(Number(), default=None, unit="rad", doc="D-H twist.")
    d: float | None = key(Number(), default=None, unit="m", doc="D-H offset (revolute, fixed).")
    theta: float | None = key(Number(), default=None, unit="rad", doc="D-H angle (prismatic, fixed).")
    offset: float = key(Number(), default=0.0, unit="rad or m", doc="Added to q to give the D-H variable.")
    origin: Placement | None = key(
        Section(Placement),
        default=None,
        doc="Placement in the parent link's frame (before any D-H parameters).",
    )
    axis: tuple[float, ...] | None = key(
        Direction(),
        default=None,
        unit="1",
        doc="Joint axis in the joint's own frame (without D-H parameters); of a universal joint the first one, of "
        "a planar one the normal of its plane. Not for spherical and floating joints.",
    )
    axis2: tuple[float, ...] | None = key(
        Direction(),
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
    gear_ratio: Any = key(
        Either((Number(), MapOf(Number(), of="coordinate"))),
        default=1.0,
        unit="1",
        doc="N: motor turns per joint turn (may be negative); by coordinate for joints with several.",
    )
    rotor_inertia: Any = key(
        Either((Number(minimum=0.0), MapOf(Number(minimum=0.0), of="coordinate"))),
        default=0.0,
        unit="kg m^2",
        doc="J of the rotor, reflected as N^2 J on the joint; by coordinate for joints with several. Of a "
        "spherical joint one number, against the angular acceleration about any axis.",
    )
    forces: tuple[tuple[str, Any], ...] = key(
        Inline(lambda: joint_forces, FREEDOMS),
        default=(),
        doc="Joint forces: each registered kind (`friction`, `spring`, `damper`, `limits`, `gear`) is a key. Joints "
        "with several coordinates take a map by coordinate.",
    )

    @property
    def has_dh(self) -> bool:
        """Whether D-H parameters place it."""
        return any(getattr(self, name) is not None for name in DH)


@record
class Link:
    """A rigid body. Data that are not given are unknown; a run that needs them refuses the scene."""

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
    visual: tuple[Shape, ...] = key(
        ListOf(LaterSection("scene.robot_parts:Shape"), minimum=0),
        default=(),
        doc="Shapes that it is drawn with; the equations ignore them.",
    )


@record
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
        Choice(("joint", "link")),
        default="link",
        doc="Frame of the coordinates of `at` and of a frame's orientation.",
    )


@record
class Point(Place):
    """A named point."""

    motion: tuple[FormulaTree, ...] | None = key(
        ListOf(Formula(("t",)), minimum=3, maximum=3),
        default=None,
        unit="m",
        doc="Displacement from `at` along the axes of the base, formulas in t: for points on `base`, which loops join "
        "and forces act between.",
    )


@record
class Frame(Orientation, Place):
    """A named frame fixed to a link."""


@record
class Attachment:
    """A link or a whole robot that is added to a robot."""

    to: str = key(Name(of="link"), default="base", doc="Link that it is fixed to, or `base`.")
    origin: Placement | None = key(Section(Placement), default=None, doc="Placement in that link's frame.")
    link: str | None = key(Name(of="link"), default=None, doc="Name of a new link: a tool, a payload.")
    mass: float | None = like(Link, "mass")
    com: tuple[float, ...] | None = like(Link, "com")
    com_frame: str | None = like(Link, "com_frame")
    inertia: Inertia = like(Link, "inertia")
    visual: tuple[Shape, ...] = like(Link, "visual")
    joint: Joint | None = key(
        Section(Joint),
        default=None,
        doc="Joint of the new link, without `parent`, `link`, and `origin` where that is given; default: fixed.",
    )
    include: str | None = key(
        Text(), default=None, doc="Or: path of the file of a robot, in YAML, URDF, SDF or MJCF."
    )
    prefix: str = key(Text(), default="", doc="Prefix of all names of that robot.")


@record
class Robot:
    """The tree of joints and links."""

    joints: tuple[Joint, ...] = key(ListOf(Section(Joint)), doc="Joints; their order is that of q.")
    links: tuple[Link, ...] = key(ListOf(Section(Link)), doc="Links.")
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
    points: dict[str, Point] = key(
        MapOf(Section(Point), of="point", minimum=0), default=None, doc="Named points."
    )
    frames: dict[str, Frame] = key(
        MapOf(Section(Frame), of="frame", minimum=0), default=None, doc="Named frames."
    )
    couplers: tuple[Coupler, ...] = key(
        ListOf(LaterSection("scene.robot_parts:Coupler"), minimum=0),
        default=(),
        doc="Relations between joint coordinates that belong to the robot, as those of the scene.",
    )
    loops: tuple[Any, ...] = key(
        ListOf(Tagged(lambda: loop_types), minimum=0),
        default=(),
        doc="Loop closures that belong to the robot, as those of the scene.",
    )
    actuated: tuple[str, ...] | None = key(
        ListOf(Name(of="joint")),
        default=None,
        doc="Its joints with motors; they are the scene's where that has no `actuated`.",
    )
    attach: tuple[Attachment, ...] = key(
        ListOf(Section(Attachment), minimum=0),
        default=(),
        doc="Links and robots to add, behind the joints and links that are there; they become part of these lists.",
    )

    @property
    def limited(self) -> bool:
        """Whether any joint has limits."""
        return any(name.partition(".")[0] == "limits" for joint in self.joints for name, _ in joint.forces)

    def limits_of(self, coordinate: str) -> Any:
        """Return the ``Limits`` of a joint's coordinate, None where it has none."""
        joint, _, part = coordinate.partition(".")
        key = f"limits.{part}" if part else "limits"
        return next((dict(own.forces).get(key) for own in self.joints if own.name == joint), None)


@record
class Torque:
    """A joint torque as a table, linear between rows and held beyond the ends, or a formula with a role."""

    table: tuple[tuple[float, ...], ...] | None = key(
        ListOf(Vector(2), minimum=2),
        default=None,
        unit="s, N m or N",
        doc="Rows of time and torque, times increasing.",
    )
    formula: FormulaTree | None = key(
        Formula(), default=None, unit="N m or N", doc="Or: a formula in t, q and qd."
    )
    role: str = role_key(DRIVE)

    def evaluate(self, environment: Mapping[str, Any]) -> Any:
        """Return the torque [N m or N], see ``Formula.evaluate``."""
        if self.table is None:
            return self.formula.evaluate(environment)  # type: ignore[union-attr]
        return interpolate(environment["t"], *zip(*self.table))
