"""The kinds of motor and of gear: one line here for each, ``module:member``."""

from __future__ import annotations

from robodyn_cli.registry import Registry

motor_types: Registry[type] = Registry(
    "robodyn_cli.motors",
    {
        "dc": "kinds:DcMotor",
        "brushless": "kinds:BrushlessMotor",
        "stepper": "kinds:StepperMotor",
        "envelope": "kinds:TorqueTable",
    },
)

gear_types: Registry[type] = Registry(
    "robodyn_cli.motors",
    {
        "gear": "gear:RotaryGear",
        "belt": "gear:Belt",
        "ball_screw": "gear:BallScrew",
    },
)
