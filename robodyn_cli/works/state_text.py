"""A state as the user writes it (``q=[0.1, 0.2], qd.theta1=1``), as settings of the scene."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

from robodyn_cli.errors import of_option, unknown_name
from robodyn_cli.scene.checks.robot import moving
from robodyn_cli.scene.text.overrides import AskedSetting
from robodyn_cli.scene.types import Scene

_KEY = re.compile(r"(?:^|,)\s*([A-Za-z_][\w.]*)\s*=")
FORMS = "allowed: q=[0.1, 0.2], qd=[0, 1], or joint by joint: q.theta1=30 deg, qd.theta1=1"


def state_overrides(scene: Scene, given: Sequence[str]) -> list[str]:
    """Return the ``--set`` texts of a state such as ``q=[0.1, 0.2], qd.theta1=1``.

    A list has the joints in their order; in a mechanism with loops the joints given are held where they are put.
    """
    joints = moving(scene.robot)
    entries: dict[str, str] = {}
    for text in given:
        parts = _KEY.split(text)
        if len(parts) < 3 or parts[0].strip():
            raise of_option(f"--at {text!r}", f"is no state; {FORMS}")
        for key, value in zip(parts[1::2], parts[2::2]):
            group, _, joint = key.partition(".")
            if group not in ("q", "qd"):
                group, joint = "q", key
            if joint:
                _known(joint, joints, text)
                entries[f"{group}.{joint}"] = value.strip()
            else:
                entries |= {f"{group}.{name}": item for name, item in _items(value.strip(), joints, text)}
    overrides = [f"initial.{key}={value}" for key, value in entries.items()]
    held = [key.partition(".")[2] for key in entries if key.startswith("q.")]
    if (scene.loops or scene.couplers) and held:
        # with all joints held, none could move to close the loops
        overrides.append(f"initial.hold=[{', '.join(held if len(held) < len(joints) else [])}]")
    asked = f"--at {', '.join(given)!r}"
    return [AskedSetting(text, asked, names_key=False, above="initial.") for text in overrides]


def _known(joint: str, joints: Sequence[str], text: str) -> None:
    if joint not in joints:
        raise of_option(f"--at {text!r}", unknown_name("joint", joint, joints))


def _items(value: str, joints: Sequence[str], text: str) -> Iterable[tuple[str, str]]:
    if not value.startswith("[") and len(joints) == 1:
        return [(joints[0], value)]
    if not (value.startswith("[") and value.endswith("]")):
        raise of_option(f"--at {text!r}", f"{value!r} is no list; {FORMS}")
    # commas within brackets belong to the value of one joint
    items = [item.strip() for item in re.split(r",(?![^\[]*\]|[^{]*\})", value[1:-1])]
    if len(items) != len(joints):
        raise of_option(
            f"--at {text!r}",
            f"{len(items)} values for {len(joints)} joints; needed: one each of {', '.join(joints)}",
        )
    return zip(joints, items)
