"""The joints of an SDF file as typed data, under their whole names."""

from __future__ import annotations

import dataclasses
import math

from robodyn_cli.errors import listed, unknown_name
from robodyn_cli.record import record
from robodyn_cli.scene.sdf.frames import WORLD, Scope, SdfFrame, SdfFrames
from robodyn_cli.scene.sdf.given import FRAMES_SINCE, SdfReading, flag, text_of
from robodyn_cli.scene.urdf.drake import DRAKE, Rotor, rotor_of
from robodyn_cli.scene.urdf.elements import UNLIMITED
from robodyn_cli.scene.urdf.xml import XmlElement

SINGLE = ("revolute", "continuous", "prismatic", "screw")
CROSS = ("universal", "revolute2")
JOINT_TYPES = (*SINGLE, *CROSS, "ball", "fixed", "gearbox")
_ONLY_OF = {
    "axis2": (*CROSS, "gearbox", "ball", "fixed"),  # of the last two both axes say nothing
    **dict.fromkeys(("gearbox_ratio", "gearbox_reference_body"), ("gearbox",)),
    **dict.fromkeys(("thread_pitch", "screw_thread_pitch", f"{DRAKE}screw_thread_pitch"), ("screw",)),
}
_AXES = {**dict.fromkeys(SINGLE, 1), **dict.fromkeys((*CROSS, "gearbox"), 2)}


_SAME = 1e-6  # of pitches that are written twice, relative


@record
class SdfMimic:
    """q = multiplier (q_joint - reference) + offset."""

    element: XmlElement
    joint: str
    multiplier: float
    offset: float
    reference: float


@record
class SdfAxis:
    """A unit axis in the frame ``expressed_in``, empty for the joint's own; ``limits`` as far as there are some."""

    element: XmlElement
    xyz: tuple[float, ...]
    expressed_in: str
    limits: dict[str, float]
    damping: float
    friction: float
    stiffness: float
    rest: float
    mimic: SdfMimic | None

    @property
    def bare(self) -> bool:
        """Whether it says nothing of a coordinate."""
        limited = any(x or key in ("lower", "upper") for key, x in self.limits.items())
        return not (limited or self.damping or self.friction or self.stiffness or self.mimic)

    @property
    def crossed(self) -> bool:
        """Whether its limits leave no room."""
        return "lower" in self.limits and self.limits["lower"] >= self.limits.get("upper", math.inf)


@record
class SdfJoint:
    """A joint between the frames ``parent`` and ``child``.

    pitch : of a screw [m/rad]. ratio, reference : of a gearbox. cut : whether the file wants a loop to close here.
    rotor : of its motor, for one coordinate.
    """

    element: XmlElement
    name: str
    type: str
    parent: str
    child: str
    frame: SdfFrame
    axes: tuple[SdfAxis, ...]
    pitch: float = 0.0
    ratio: float = 1.0
    reference: str = ""
    cut: bool = False
    rotor: Rotor = Rotor()


class SdfJoints:
    """Reads joints, and puts their frames among those of the file."""

    def __init__(self, given: SdfReading, frames: SdfFrames) -> None:
        self.given, self.frames = given, frames
        self.all: dict[str, SdfJoint] = {}

    def read(self, element: XmlElement, scope: Scope) -> None:
        """Read a joint in a scope."""
        name = self.given.name(element)
        owner, full = f"joint {name!r}", scope.prefix + name
        kind = element.text("type", owner)
        if kind not in JOINT_TYPES:
            raise element.error(f"{owner}: {unknown_name('type', kind, JOINT_TYPES)}")
        for tag, kinds in _ONLY_OF.items():
            if kind not in kinds and element.all(tag):
                raise element.all(tag)[0].error(
                    f"{owner} is {kind} and has no <{tag}>; allowed: in joints of type {listed(kinds)}"
                )
        parent, child = (scope.whole(text_of(element, tag, owner)) for tag in ("parent", "child"))
        if child == WORLD:
            raise element.error(f"{owner}: the world cannot be its child; allowed: a link or frame")
        if full in self.all:
            raise element.error(f"{full!r} names two joints; allowed: one")
        pose, relative = self.given.pose(element, owner, scope)
        in_scope = self.given.version >= FRAMES_SINCE
        frame = SdfFrame(element, full if in_scope else f"{full}::__joint__", pose, relative or child, child)
        if in_scope:
            self.frames.add(frame)
        gearbox = kind == "gearbox"
        self.all[full] = SdfJoint(
            element, full, kind, parent, child, frame,
            self.axes(element, kind, owner, scope),
            _pitch(element, owner) if kind == "screw" else 0.0,
            element.value("gearbox_ratio", owner, 1.0),
            scope.whole(text_of(element, "gearbox_reference_body", owner)) if gearbox else "",
            _must_close(element, owner),
            rotor_of(element, owner),
        )  # fmt: skip
        if self.all[full].rotor.inertia and kind not in SINGLE:
            raise element.error(f"{owner} is {kind} and has a rotor; allowed: {', '.join(SINGLE)}")

    def axes(self, element: XmlElement, kind: str, owner: str, scope: Scope) -> tuple[SdfAxis, ...]:
        """Return the axes that a joint of this kind has; what another says must not act on the motion."""
        axes = []
        for k, tag in enumerate(("axis", "axis2")):
            axis = element.one(tag, owner)
            follows = element.one(f"{DRAKE}mimic", owner) if k == 0 else None
            if k < _AXES.get(kind, 0):
                if axis is None:
                    raise element.error(f"{owner} is {kind} and needs <{tag}>")
                axes.append(self.axis(axis, f"{owner}: {tag}", scope))
                if follows is not None:
                    axes[0] = dataclasses.replace(axes[0], mimic=_drake_mimic(follows, owner, scope))
            elif axis is not None and kind != "fixed" and not self.axis(axis, f"{owner}: {tag}", scope).bare:
                raise axis.error(
                    f"{owner} is {kind}: its <{tag}> says something of a coordinate that it does not have; allowed: "
                    "no <dynamics>, <limit> and <mimic>"
                )
        return tuple(axes)

    def axis(self, element: XmlElement, owner: str, scope: Scope) -> SdfAxis:
        """Return an axis with what acts about it."""
        xyz, expressed_in = element.one("xyz", owner), ""
        direction = (0.0, 0.0, 1.0) if xyz is None else tuple(xyz.values(owner, 3))
        if xyz is not None:
            expressed_in = self.given.reference(xyz, "expressed_in", scope)
            length = math.hypot(*direction)
            if not 0.0 < length < math.inf:
                raise xyz.error(f"{owner}: the axis has the length {length:g}; allowed: a direction")
            direction = tuple(x / length for x in direction)
        in_model = element.one("use_parent_model_frame", owner)
        if in_model is not None:
            if self.given.version >= FRAMES_SINCE:
                raise in_model.error(
                    f"{owner}: <{in_model.tag}> is of SDF 1.5 and 1.6; allowed: expressed_in"
                )
            expressed_in = scope.frame if flag(element, in_model.tag, owner) else ""
        dynamics = element.one("dynamics", owner)
        damping, friction, stiffness, rest = (
            0.0 if dynamics is None else dynamics.value(tag, owner, 0.0)
            for tag in ("damping", "friction", "spring_stiffness", "spring_reference")
        )
        if dynamics is not None and min(damping, friction, stiffness) < 0.0:
            raise dynamics.error(
                f"{owner}: damping, friction or spring_stiffness is negative; allowed: numbers >= 0"
            )
        return SdfAxis(
            element,
            direction,
            expressed_in,
            _limits(element, owner),
            damping,
            friction,
            stiffness,
            rest,
            self.mimic(element, owner, scope),
        )

    def mimic(self, axis: XmlElement, owner: str, scope: Scope) -> SdfMimic | None:
        """Return what an axis follows, if it does."""
        mimic = axis.one("mimic", owner)
        if mimic is None:
            return None
        if mimic.attributes.get("axis", "axis").strip() != "axis":
            raise mimic.error(
                f"{owner}: the mimic of a second axis is not read; allowed: that of a joint with one axis"
            )
        numbers = {"multiplier": 1.0, "offset": 0.0, "reference": 0.0}
        joint = mimic.text("joint", owner)
        return SdfMimic(
            mimic, scope.prefix + joint, *(mimic.value(k, owner, default) for k, default in numbers.items())
        )


def _drake_mimic(element: XmlElement, owner: str, scope: Scope) -> SdfMimic:
    """Return what ``drake:mimic`` says: q = multiplier q_joint + offset."""
    multiplier, offset = (element.number(k, owner, x) for k, x in (("multiplier", 1.0), ("offset", 0.0)))
    return SdfMimic(element, scope.prefix + element.text("joint", owner), multiplier, offset, 0.0)


def _must_close(element: XmlElement, owner: str) -> bool:
    """Tell whether ``must_be_loop_joint`` is set."""
    physics = element.one("physics", owner)
    simbody = None if physics is None else physics.one("simbody", owner)
    return simbody is not None and flag(simbody, "must_be_loop_joint", owner)


def _pitch(element: XmlElement, owner: str) -> float:
    """Return the advance [m/rad] of a right-handed screw; the old ``thread_pitch`` is in rad/m, left-handed."""
    pitches: dict[str, float] = {}
    for tag in ("screw_thread_pitch", f"{DRAKE}screw_thread_pitch", "thread_pitch"):
        given = element.one(tag, owner)
        if given is None:
            continue
        value = given.values(owner, 1)[0]
        if value == 0.0:
            raise given.error(f"{owner}: <{tag}> is 0; allowed: another number")
        pitches[tag] = -1.0 / value if tag == "thread_pitch" else value / math.tau
        first = next(iter(pitches))
        if not math.isclose(pitches[tag], pitches[first], rel_tol=_SAME):
            raise given.error(
                f"{owner}: <{tag}> says {math.tau * pitches[tag]:.6g} m per turn, and <{first}> "
                f"{math.tau * pitches[first]:.6g}; allowed: one of them"
            )
    if not pitches:
        raise element.error(f"{owner} is a screw and needs <screw_thread_pitch> [m per turn]")
    return next(iter(pitches.values()))


def _limits(axis: XmlElement, owner: str) -> dict[str, float]:
    """Return the limits but those that are infinite, and negative efforts and speeds, which bound nothing."""
    limit = axis.one("limit", owner)
    limits: dict[str, float] = {}
    for tag in ("lower", "upper", "effort", "velocity") if limit is not None else ():
        assert limit is not None
        child = limit.one(tag, owner)
        word = "" if child is None else child.content.strip().lower()
        if child is None or word.lstrip("+-") in ("inf", "infinity"):
            continue
        value = child.values(owner, 1)[0]
        if abs(value) < UNLIMITED and (tag in ("lower", "upper") or value >= 0.0):
            limits[tag] = value
    return limits
