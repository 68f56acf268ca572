"""The links, frames and models of an SDF file as typed data, under their whole names."""

from __future__ import annotations

from collections import Counter

from robodyn_cli.errors import SceneError, shown
from robodyn_cli.record import record
from robodyn_cli.scene.sdf.frames import MODEL, WORLD, Scope, SdfFrame, SdfFrames
from robodyn_cli.scene.sdf.given import SdfReading, flag, is_true, text_of
from robodyn_cli.scene.sdf.joints import SdfJoint, SdfJoints
from robodyn_cli.scene.text.nodes import Faults
from robodyn_cli.scene.unread import OF_DRAKE_ELEMENTS, SHAPES, Children, left_out
from robodyn_cli.scene.urdf.closures import OF_DRAKE
from robodyn_cli.scene.urdf.elements import Inertial, UrdfPose, UrdfShape
from robodyn_cli.scene.urdf.xml import XmlElement

VERSIONS = tuple(f"1.{k}" for k in range(5, 13))
_WHOLE = "the models themselves, in one file (gz sdf -p FILE prints them so)"
_LINK_LEFT = (
    "enable_wind", "self_collide", "must_be_base_link", "sensor", "projector", "audio_sink", "audio_source", "battery",
    "light", "particle_emitter", "plugin",
)  # fmt: skip
_WORLD_LEFT = (
    "audio", "wind", "gravity", "magnetic_field", "atmosphere", "gui", "physics", "scene", "light", "actor", "plugin",
    "road", "spherical_coordinates",
)  # fmt: skip
_AXIS = Children(
    ("xyz", "limit", "dynamics", "mimic", "use_parent_model_frame"), ("initial_position",), attributes=()
)
_TEXTS = (
    "mass", "static", "gravity", "kinematic", "linear", "angular", "parent", "child", "gearbox_ratio",
    "gearbox_reference_body", "thread_pitch", "screw_thread_pitch", "must_be_loop_joint", "use_parent_model_frame",
    "lower", "upper", "effort", "velocity", "damping", "friction", "spring_stiffness", "spring_reference",
    "multiplier", "offset", "reference",
)  # fmt: skip
_INERTIA = {"xx": 1.0, "xy": 0.0, "xz": 0.0, "yy": 1.0, "yz": 0.0, "zz": 1.0}  # the format's defaults
_MOMENTS = tuple(f"i{k}" for k in _INERTIA)
_ELEMENTS = {
    **OF_DRAKE_ELEMENTS,
    **dict.fromkeys((*_TEXTS, *_MOMENTS), Children((), attributes=())),
    "sdf": Children(("model", "world"), ("light", "actor"), (("include", _WHOLE),), attributes=("version",)),
    "world": Children(
        ("model", "joint", "frame"),
        _WORLD_LEFT,
        (("include", _WHOLE), ("population", "each model by itself"), ("state", "'initial' in the scene")),
        attributes=("name",),
    ),
    "model": Children(
        ("model", "link", "joint", "frame", "pose", "static"),
        ("self_collide", "allow_auto_disable", "enable_wind", "plugin", "gripper"),
        (("include", _WHOLE), ("model_state", "'initial' in the scene")),
        attributes=("name", "canonical_link", "placement_frame"),
    ),
    "link": Children(
        ("pose", "inertial", *SHAPES, "gravity", "kinematic", "velocity_decay"), _LINK_LEFT, attributes=("name",)
    ),
    "velocity_decay": Children(("linear", "angular"), attributes=()),
    "inertial": Children(
        ("pose", "mass", "inertia"),
        ("density", "auto_inertia_params"),
        (("fluid_added_mass", "the mass and the inertia of the body alone"),),
        attributes=("auto",),
    ),
    "inertia": Children(_MOMENTS, attributes=()),
    "joint": Children(
        (
            "parent", "child", "pose", "axis", "axis2", "gearbox_ratio", "gearbox_reference_body", "thread_pitch",
            "screw_thread_pitch", "physics",
        ),
        ("sensor", "plugin"),
        attributes=("name", "type"),
    ),
    "physics": Children(("simbody",), ("ode", "provide_feedback"), attributes=()),
    "simbody": Children(("must_be_loop_joint",), attributes=()),
    "axis": _AXIS,
    "axis2": _AXIS,
    "xyz": Children((), attributes=("expressed_in",)),
    "limit": Children(("lower", "upper", "effort", "velocity"), ("stiffness", "dissipation"), attributes=()),
    "dynamics": Children(("damping", "friction", "spring_stiffness", "spring_reference"), attributes=()),
    "mimic": Children(("multiplier", "offset", "reference"), attributes=("joint", "axis")),
    "frame": Children(("pose",), attributes=("name", "attached_to")),
    "pose": Children(
        (), acting=(("frame", "relative_to"),), attributes=("relative_to", "rotation_format", "degrees")
    ),
}  # fmt: skip


@record
class SdfLink:
    """A link; ``weightless`` : gravity does not act on it. The poses of its shapes are with ``frames``."""

    element: XmlElement
    name: str
    frame: SdfFrame
    static: bool
    inertial: Inertial
    weightless: bool
    visual: tuple[tuple[UrdfShape, SdfFrame], ...]
    collision: tuple[tuple[UrdfShape, SdfFrame], ...]

    @property
    def assumed(self) -> bool:
        """Whether its mass or one of its moments of inertia is the format's default."""
        given = self.inertial.element
        tags = {child.tag for part in (given, *given.all("inertia")) for child in part.children}
        return given is self.element or not tags.issuperset(("mass", "ixx", "iyy", "izz"))


@record
class SdfRobot:
    """What a file holds; ``ignored`` : how many elements of each kind are left out.

    ties : constraints of Drake between points, each with the scope of the names in it.
    """

    element: XmlElement
    name: str
    frames: SdfFrames
    links: tuple[SdfLink, ...]
    joints: tuple[SdfJoint, ...]
    named: tuple[SdfFrame, ...]
    ties: tuple[tuple[XmlElement, Scope], ...]
    ignored: Counter[str]


def read_elements(root: XmlElement, faults: Faults) -> SdfRobot:
    """Return the links, joints and frames of a file; those with errors are reported and left out.

    Raises
    ------
    SceneError : another version, or neither one model nor one world.
    """
    version = root.text("version", "the file")
    if version not in VERSIONS:
        raise root.error(f"version {shown(version)} of SDF; allowed: {VERSIONS[0]} to {VERSIONS[-1]}")
    tops = [child for child in root.children if child.tag in ("model", "world")]
    if len(tops) != 1:
        place = tops[1] if tops else root
        raise place.error(f"the file has {len(tops)} <model> or <world>; allowed: one")
    ignored = left_out(root, _ELEMENTS, faults)
    reader = _SdfReader(root, int(version[2:]), faults)
    if tops[0].tag == "world":
        reader.scope(tops[0], Scope("", WORLD))
    else:
        reader.model(tops[0], Scope("", WORLD), top=True)
    name = tops[0].attributes.get("name", "").strip()
    return SdfRobot(
        root,
        name,
        reader.frames,
        tuple(reader.links),
        tuple(reader.joints.all.values()),
        tuple(reader.named),
        tuple(reader.ties),
        ignored,
    )


class _SdfReader:
    def __init__(self, root: XmlElement, version: int, faults: Faults) -> None:
        self.given, self.faults = SdfReading(version), faults
        self.frames = SdfFrames(root)
        self.joints = SdfJoints(self.given, self.frames)
        self.links: list[SdfLink] = []
        self.named: list[SdfFrame] = []
        self.ties: list[tuple[XmlElement, Scope]] = []

    # -- scopes -----------------------------------------------------------------------------------------
    def scope(self, element: XmlElement, scope: Scope) -> None:
        """Read what stands in a model or a world."""
        for child in element.children:
            with self.faults:
                if child.tag == "model":
                    self.model(child, scope)
                elif child.tag == "link":
                    self.link(child, scope)
                elif child.tag == "joint":
                    self.joints.read(child, scope)
                elif child.tag == "frame":
                    self.frame(child, scope)
                elif child.tag in OF_DRAKE:
                    self.ties.append((child, scope))

    def model(self, element: XmlElement, outer: Scope, top: bool = False) -> None:
        name = self.given.name(element)
        owner = f"model {name!r}"
        full = MODEL if top else outer.prefix + name
        static = outer.static or flag(element, "static", owner)
        inner = Scope("" if top else f"{full}::", full, static)
        canonical = self.given.reference(element, "canonical_link", inner) or _first(element, inner)
        placement = self.given.reference(element, "placement_frame", inner)
        pose, relative = self.given.pose(element, owner, outer)
        attached = WORLD if static or not canonical else canonical
        self.frames.add(SdfFrame(element, full, pose, relative or outer.frame, attached, placement))
        self.scope(element, inner)

    def frame(self, element: XmlElement, scope: Scope) -> None:
        name = self.given.name(element)
        attached = self.given.reference(element, "attached_to", scope) or scope.frame
        pose, relative = self.given.pose(element, f"frame {name!r}", scope)
        self.named.append(SdfFrame(element, scope.prefix + name, pose, relative or attached, attached))
        self.frames.add(self.named[-1])

    # -- links ------------------------------------------------------------------------------------------
    def link(self, element: XmlElement, scope: Scope) -> None:
        name = self.given.name(element)
        owner, full = f"link {name!r}", scope.prefix + name
        pose, relative = self.given.pose(element, owner, scope)
        frame = SdfFrame(element, full, pose, relative or scope.frame, full)
        self.frames.add(frame)
        for tag in ("kinematic", "velocity_decay"):
            acting = element.one(tag, owner)
            if acting is not None and (
                flag(element, tag, owner)
                if tag == "kinematic"
                else any(acting.value(k, owner, 0.0) for k in ("linear", "angular"))
            ):
                raise acting.error(f"{owner}: <{tag}> acts on the motion, and is not read; allowed: none")
        shapes = [
            tuple(
                self.shape(shape, owner, (full, f"{full}::__{tag}{k}__"), scope)
                for k, shape in enumerate(element.all(tag))
            )
            for tag in SHAPES
        ]
        weightless = not flag(element, "gravity", owner, True)
        inertial = self.inertial(element, owner)
        self.links.append(SdfLink(element, full, frame, scope.static, inertial, weightless, *shapes))

    def inertial(self, link: XmlElement, owner: str) -> Inertial:
        """Return the inertial of a link; what is not written has the format's values, 1 kg and 1 kg m^2."""
        inertial = link.one("inertial", owner)
        if inertial is None:
            return Inertial(link, 1.0, UrdfPose(), dict(_INERTIA))
        if is_true(inertial, inertial.attributes.get("auto", "false"), owner):
            raise inertial.error(
                f"{owner}: <inertial auto> takes the mass from shapes, which is not read; allowed: <mass> and <inertia>"
            )
        pose, relative = self.given.pose(inertial, owner, Scope("", MODEL))
        if relative:
            raise inertial.error(
                f"{owner}: the pose of <inertial> is in the link's frame; allowed: no relative_to"
            )
        mass, inertia = inertial.value("mass", owner, 1.0), inertial.one("inertia", owner)
        if mass < 0.0:
            raise inertial.error(f"{owner}: mass is negative (value {mass:g}); allowed: a number >= 0 [kg]")
        moments = {
            k: default if inertia is None else inertia.value(f"i{k}", owner, default)
            for k, default in _INERTIA.items()
        }
        return Inertial(inertial, mass, pose, moments)

    def shape(
        self, element: XmlElement, owner: str, names: tuple[str, str], scope: Scope
    ) -> tuple[UrdfShape, SdfFrame]:
        """Return a shape and its frame; one that is wrong is left out of pictures, and of nothing else.

        names : of the link, and of the frame.
        """
        link, own = names
        shape = next((kind for geometry in element.all("geometry") for kind in geometry.children), element)
        frame = SdfFrame(element, own, UrdfPose(), link, link)
        try:
            pose, relative = self.given.pose(element, owner, scope)
            frame = SdfFrame(element, own, pose, relative or link, link)
            sizes, file = _sizes(shape, owner)
        except SceneError:
            return UrdfShape(shape, ""), frame
        return UrdfShape(shape, shape.tag if sizes else "", sizes, file), frame


def _first(model: XmlElement, inner: Scope) -> str:
    """Return the first link of a model, or its first model; empty where it has neither."""
    for tag in ("link", "model"):
        for child in model.all(tag):
            return inner.prefix + child.attributes.get("name", "").strip()
    return ""


def _sizes(shape: XmlElement, owner: str) -> tuple[tuple[float, ...], str]:
    """Return the numbers of a geometry, none for one of another kind or without extent, and the file of a mesh."""
    if shape.tag == "mesh":
        scale = shape.one("scale", owner)
        sizes = (1.0, 1.0, 1.0) if scale is None else tuple(scale.values(owner, 3))
        return sizes, text_of(shape, "uri", owner).replace("model://", "package://", 1)
    names = {"sphere": ("radius",), "cylinder": ("radius", "length")}.get(shape.tag, ())
    size = shape.one("size", owner) if shape.tag == "box" else None
    sizes = (
        tuple(size.values(owner, 3)) if size is not None else tuple(shape.value(k, owner, 0.0) for k in names)
    )
    return (sizes if all(x > 0.0 for x in sizes) else ()), ""
