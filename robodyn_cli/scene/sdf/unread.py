"""Which elements of an SDF are read, left out and counted, or refused because they act on the motion."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

from robodyn_cli.errors import did_you_mean, listed
from robodyn_cli.record import record
from robodyn_cli.scene.text.nodes import Faults
from robodyn_cli.scene.urdf.unread import SHAPES
from robodyn_cli.scene.urdf.xml import XmlElement


@record
class Children:
    """The children of an element: what is read, and what no equation reads; the rest is refused.

    acting : what to do instead, for those that act on the motion.
    """

    read: tuple[str, ...]
    left: tuple[str, ...] = ()
    acting: tuple[tuple[str, str], ...] = ()


_WHOLE = "the models themselves, in one file (gz sdf -p FILE prints them so)"
_LINK_LEFT = (
    "enable_wind", "self_collide", "must_be_base_link", "sensor", "projector", "audio_sink", "audio_source", "battery",
    "light", "particle_emitter", "plugin",
)  # fmt: skip
_WORLD_LEFT = (
    "audio", "wind", "gravity", "magnetic_field", "atmosphere", "gui", "physics", "scene", "light", "actor", "plugin",
    "road", "spherical_coordinates",
)  # fmt: skip
_AXIS = Children(("xyz", "limit", "dynamics", "mimic", "use_parent_model_frame"), ("initial_position",))
_ELEMENTS = {
    "sdf": Children(("model", "world"), ("light", "actor"), (("include", _WHOLE),)),
    "world": Children(
        ("model", "joint", "frame"),
        _WORLD_LEFT,
        (("include", _WHOLE), ("population", "each model by itself"), ("state", "'initial' in the scene")),
    ),
    "model": Children(
        ("model", "link", "joint", "frame", "pose", "static"),
        ("self_collide", "allow_auto_disable", "enable_wind", "plugin", "gripper"),
        (("include", _WHOLE), ("model_state", "'initial' in the scene")),
    ),
    "link": Children(("pose", "inertial", *SHAPES, "gravity", "kinematic", "velocity_decay"), _LINK_LEFT),
    "inertial": Children(
        ("pose", "mass", "inertia"),
        ("density", "auto_inertia_params"),
        (("fluid_added_mass", "the mass and the inertia of the body alone"),),
    ),
    "joint": Children(
        (
            "parent", "child", "pose", "axis", "axis2", "gearbox_ratio", "gearbox_reference_body", "thread_pitch",
            "screw_thread_pitch", "physics",
        ),
        ("sensor", "plugin"),
    ),
    "axis": _AXIS,
    "axis2": _AXIS,
    "limit": Children(("lower", "upper", "effort", "velocity"), ("stiffness", "dissipation")),
    "dynamics": Children(("damping", "friction", "spring_stiffness", "spring_reference")),
    "mimic": Children(("multiplier", "offset", "reference")),
    "frame": Children(("pose",)),
}  # fmt: skip


def left_out(root: XmlElement, faults: Faults, elements: Mapping[str, Children] = _ELEMENTS) -> Counter[str]:
    """Count what is left out by tag; what is not known or acts on the motion is reported.

    elements : the children of each element that is looked into. Elements of other programs (with a ``:``) are left out,
    but for those of Drake, see ``urdf/unread.py``.
    """
    left: Counter[str] = Counter()
    pending = [root]
    while pending:
        owner = pending.pop()
        known = elements[owner.tag]
        acting = dict(known.acting)
        for child in owner.children:
            if child.tag in known.read:
                pending += [child] if child.tag in elements else []
            elif child.tag in known.left or (":" in child.tag and not child.tag.startswith("drake:")):
                left[child.tag] += 1
            elif ":" not in child.tag:
                problem = f"is not known{did_you_mean(child.tag, known.read)}; read: {listed(known.read)}"
                if child.tag in acting:
                    problem = f"acts on the motion, and is not read; allowed: {acting[child.tag]}"
                with faults:
                    raise child.error(f"<{child.tag}> in <{owner.tag}> {problem}")
    return left
