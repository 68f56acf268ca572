"""The forces that act in a joint: one file a kind, one line here; the name is the key in the joint's YAML."""

from __future__ import annotations

from robodyn_cli.forces.damper import Damper
from robodyn_cli.forces.friction import Friction
from robodyn_cli.forces.spring import Spring

joint_forces: dict[str, type] = {
    "friction": Friction,
    "spring": Spring,
    "damper": Damper,
}
