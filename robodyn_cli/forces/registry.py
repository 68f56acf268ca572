"""The kinds of force: one line here for each, ``module:member``.

``joint_forces`` act in a joint, and their name is a key of the joint; ``force_types`` act on points or between bodies,
and their name is the ``type`` of an entry of ``forces``.
"""

from __future__ import annotations

from robodyn_cli.registry import Registry

joint_forces: Registry[type] = Registry(
    "robodyn_cli.forces",
    {
        "friction": "friction:Friction",
        "spring": "springs:Spring",
        "damper": "springs:Damper",
        "limits": "limits:Limits",
        "gear": "friction:Gear",
    },
)

force_types: Registry[type] = Registry(
    "robodyn_cli.forces",
    {
        "spring": "springs:LinearSpring",
        "nonlinear_spring": "springs:NonlinearSpring",
        "torsional_spring": "springs:TorsionalSpring",
        "constant_force": "springs:ConstantForce",
        "bushing": "bushing:Bushing",
        "force": "wrench:PointForce",
        "wrench": "wrench:PointWrench",
    },
)
