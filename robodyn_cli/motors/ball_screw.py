"""A screw that moves a slide."""

from __future__ import annotations

import math
from typing import Any

from robodyn_cli.motors.gear import Transmission
from robodyn_cli.record import record
from robodyn_cli.schema.fields import Choice, Number, key


@record
class BallScrew(Transmission):
    """A ball screw, roller screw or trapezoidal screw, which turns a motor's turns into a slide's way."""

    type: str = key(Choice(("ball_screw",)), doc="Kind of gear.")
    lead: float = key(Number(minimum=0.0, exclusive=True), unit="m", doc="Way of the slide a turn.")

    @property
    def drives(self) -> str:
        return "m"

    @property
    def turns(self) -> Any:
        return 2.0 * math.pi / self.lead
