"""The kinds of controller: one file and one line here for each, ``module:member``."""

from __future__ import annotations

from robodyn_cli.registry import Registry

control_types: Registry[type] = Registry(
    "robodyn_cli.control",
    {
        "pd": "pd:Pd",
        "pid": "pid:Pid",
        "gravity": "gravity:Gravity",
        "computed_torque": "computed_torque:ComputedTorque",
        "feed_forward": "feed_forward:FeedForward",
        "task_pd": "task_pd:TaskPd",
        "lqr": "lqr:Lqr",
        "formulas": "by_formulas:ByFormulas",
        "python": "in_python:InPython",
    },
)
