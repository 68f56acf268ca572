"""The kinds of motor and of gear: one file a kind, one line here, ``module:member``."""

from __future__ import annotations

from robodyn_cli.registry import Registry

motor_types: Registry[type] = Registry(
    "robodyn_cli.motors",
    {
        "dc": "dc:DcMotor",
        "brushless": "brushless:BrushlessMotor",
        "stepper": "stepper:Stepper",
        "envelope": "torque_table:TorqueTable",
    },
)

gear_types: Registry[type] = Registry(
    "robodyn_cli.motors",
    {
        "gear": "gear:RotaryGear",
        "belt": "belt:Belt",
        "ball_screw": "ball_screw:BallScrew",
    },
)
