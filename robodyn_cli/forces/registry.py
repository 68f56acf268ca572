"""The kinds of force: one file a kind, one line here.

``joint_forces`` act in a joint, and their name is a key of the joint; ``force_types`` act on points or between bodies,
and their name is the ``type`` of an entry of ``forces``.
"""

from __future__ import annotations

from robodyn_cli.forces.bushing import Bushing
from robodyn_cli.forces.constant_force import ConstantForce
from robodyn_cli.forces.damper import Damper
from robodyn_cli.forces.friction import Friction
from robodyn_cli.forces.gear import Gear
from robodyn_cli.forces.limits import Limits
from robodyn_cli.forces.linear_spring import LinearSpring
from robodyn_cli.forces.spring import Spring
from robodyn_cli.forces.torsional_spring import TorsionalSpring
from robodyn_cli.forces.wrench import PointForce, PointWrench

joint_forces: dict[str, type] = {
    "friction": Friction,
    "spring": Spring,
    "damper": Damper,
    "limits": Limits,
    "gear": Gear,
}

force_types: dict[str, type] = {
    "spring": LinearSpring,
    "torsional_spring": TorsionalSpring,
    "constant_force": ConstantForce,
    "bushing": Bushing,
    "force": PointForce,
    "wrench": PointWrench,
}
