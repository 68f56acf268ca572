"""The kinds of controller: one line here for each, ``module:member``."""

from __future__ import annotations

from robodyn_cli.registry import Registry

control_types: Registry[type] = Registry(
    "robodyn_cli.control",
    {
        "pd": "feedback:Pd",
        "pid": "feedback:Pid",
        "gravity": "feedback:Gravity",
        "computed_torque": "feedback:ComputedTorque",
        "feed_forward": "feedback:FeedForward",
        "task_pd": "feedback:TaskPd",
        "lqr": "lqr:Lqr",
        "formulas": "own:ByFormulas",
        "python": "own:InPython",
    },
)
