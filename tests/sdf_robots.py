"""SDF models with every frame turned and off, and where their links are by their text alone, by 4 x 4 matrices."""

from __future__ import annotations

from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
from scipy.spatial.transform import Rotation

INERTIAL = (
    "<inertial><pose>0.1 0.02 -0.03 0.3 -0.2 0.5</pose><mass>1.5</mass><inertia><ixx>0.1</ixx><ixy>0.01</ixy>"
    "<ixz>0</ixz><iyy>0.12</iyy><iyz>-0.01</iyz><izz>0.14</izz></inertia></inertial>"
)


def words(numbers: object) -> str:
    return " ".join(repr(float(x)) for x in numbers)  # type: ignore[attr-defined]


def random_pose(rng: np.random.Generator) -> np.ndarray:
    return np.concatenate([rng.uniform(-0.4, 0.4, 3), rng.uniform(-1, 1, 3)])


def pose(rng: np.random.Generator, relative_to: str = "") -> str:
    """Return a random <pose>."""
    attribute = f' relative_to="{relative_to}"' if relative_to else ""
    return f"<pose{attribute}>{words(random_pose(rng))}</pose>"


def link(name: str, rng: np.random.Generator, relative_to: str = "") -> str:
    return f'<link name="{name}">{pose(rng, relative_to)}{INERTIAL}</link>'


def joint(name: str, kind: str, parent: str, child: str, inside: str) -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent>{parent}</parent><child>{child}</child>{inside}</joint>'
    )


def axis(rng: np.random.Generator, inside: str = "", tag: str = "axis", frame: str = "") -> str:
    attribute = f' expressed_in="{frame}"' if frame else ""
    return f"<{tag}><xyz{attribute}>{words(rng.uniform(-1, 1, 3))}</xyz>{inside}</{tag}>"


def matrix(numbers: object) -> np.ndarray:
    """Return the 4 x 4 matrix of a pose: roll, pitch and yaw about fixed axes."""
    x = np.asarray(numbers, dtype=float)
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("xyz", x[3:]).as_matrix()
    T[:3, 3] = x[:3]
    return T


class Text:
    """A model as its text says: names are those of its own scope, and of nested models with ``::``."""

    def __init__(self, text: str) -> None:
        root = ElementTree.fromstring(text)
        self.elements: dict[str, tuple[Element, str]] = {}
        model = root.find("model")
        assert model is not None
        self._collect(model, "")

    def _collect(self, model: Element, prefix: str) -> None:
        self.elements[f"{prefix}__model__"] = (model, prefix)
        for child in model:
            if child.tag in ("link", "joint", "frame", "model"):
                name = prefix + child.get("name", "")
                if child.tag == "model":
                    self._collect(child, f"{name}::")
                    self.elements[name] = (child, prefix)
                else:
                    self.elements[name] = (child, prefix)

    def assembled(self, name: str) -> np.ndarray:
        """Return the pose in the world of a frame at q = 0."""
        if name.endswith("world"):
            return np.eye(4)
        element, prefix = self.elements[name]
        given = element.find("pose")
        default = {
            "link": "__model__",
            "model": "__model__" if name != "__model__" else "world",
            "frame": element.get("attached_to") or "__model__",
            "joint": (element.findtext("child") or "").strip(),
        }[element.tag]
        if name.endswith("::__model__"):
            return self.assembled(name.removesuffix("::__model__"))
        relative = default if given is None else given.get("relative_to") or default
        numbers = [0.0] * 6 if given is None else [float(x) for x in (given.text or "").split()]
        if given is not None and given.get("degrees") == "true":
            numbers[3:] = np.radians(numbers[3:])
        return self.assembled(prefix + relative) @ matrix(numbers)

    def body(self, name: str) -> str:
        """Return the link that a frame is part of."""
        element, prefix = self.elements[name]
        if element.tag == "link":
            return name
        if element.tag == "model":
            first = element.find("link")
            assert first is not None
            return ("" if name == "__model__" else f"{name}::") + first.get("name", "")
        return self.body(prefix + (element.get("attached_to") or "__model__"))

    def axis(self, name: str, tag: str = "axis") -> np.ndarray:
        """Return the unit axis of a joint in the world at q = 0."""
        element, prefix = self.elements[name]
        xyz = element.find(f"{tag}/xyz")
        assert xyz is not None
        in_model = (element.findtext(f"{tag}/use_parent_model_frame") or "false").strip() in ("true", "1")
        frame = prefix + ("__model__" if in_model else xyz.get("expressed_in") or name.removeprefix(prefix))
        u = self.assembled(frame)[:3, :3] @ [float(x) for x in (xyz.text or "").split()]
        return u / np.linalg.norm(u)

    def moved(self, name: str, steps: list[tuple[str, float]]) -> np.ndarray:
        """Return what joints with one axis, from the world on, have made of the pose of a frame at q = 0.

        A joint turns all behind it about its axis as it stands at q = 0, before those nearer to the world do.
        """
        T = self.assembled(name)
        for joint_name, q in reversed(steps):
            T = self.step(joint_name, q) @ T
        return T

    def step(self, name: str, q: float) -> np.ndarray:
        """Return the motion in the world of a joint about or along its axis at q = 0."""
        kind = self.elements[name][0].get("type")
        u, at = self.axis(name), self.assembled(name)[:3, 3]
        S = np.eye(4)
        if kind != "prismatic":
            S[:3, :3] = Rotation.from_rotvec(q * u).as_matrix()
            S[:3, 3] = at - S[:3, :3] @ at
        S[:3, 3] += {"prismatic": q, "screw": q * self.lead(name)}.get(kind or "", 0.0) * u
        return S

    def lead(self, name: str) -> float:
        """Return the advance of a screw [m/rad]."""
        element = self.elements[name][0]
        new, old = element.findtext("screw_thread_pitch"), element.findtext("thread_pitch")
        return float(new) / (2 * np.pi) if new else -1.0 / float(old or "nan")
