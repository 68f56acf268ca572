"""The robots of ``robodyn new --from``: a file NAME.yaml beside this one, and its name here."""

from __future__ import annotations

import re
from pathlib import Path

from robodyn_cli.errors import CapabilityError, unknown_name
from robodyn_cli.record import record

FOLDER = Path(__file__).parent
# in the order in which they are offered
ROBOTS = (
    "planar_2r", "planar_3r", "scara", "puma560", "seven_joint_arm", "cart_pole", "furuta_pendulum", "delta",
    "five_bar", "slider_crank", "watt_six_bar", "scissor_mast", "stewart_platform",
)  # fmt: skip


@record
class StarterRobot:
    """A robot's scene as it is written here, its title, and the command that runs it."""

    name: str
    title: str
    command: str
    scene: str

    def text(self, name: str) -> str:
        """Return the scene for a file of this name."""
        usage = f"#   robodyn {self.command} "
        return self.scene.replace(f"{usage}{self.name}.yaml\n", f"{usage}{name}\n", 1)


def find_robot(name: str) -> StarterRobot:
    """Return a robot of the collection.

    Raises
    ------
    CapabilityError : there is no robot of that name.
    """
    if name not in ROBOTS:
        raise CapabilityError(unknown_name("robot", name, ROBOTS))
    text = (FOLDER / f"{name}.yaml").read_text(encoding="utf-8")
    title, command = (re.findall(rf"^{key}: (.+)$", text, re.MULTILINE)[0] for key in ("title", "command"))
    return StarterRobot(name, title, command, text)
