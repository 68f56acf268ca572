"""Why a scene of features that are right each for themselves may be refused: the whole list, as the docs print it."""

from __future__ import annotations

import re

# words of the message -> the reason
REASONS: dict[str, str] = {
    r"a symplectic partitioned method needs": "`verlet` and `symplectic*`: accelerations of positions and time alone",
    r"a function in Python is called once a period": "`control: python` is sampled",
    r"this gear moves a slide|this gear turns": "a gear fits its joint: a screw moves a slide",
    r"only `simulate` leaves others to the forces": "`inverse` and `kinematics` need the motion of all joints",
    r"the motion is given in 'inverse'": "`inverse` grips and releases payloads at times, not where something happens",
    r"'reach' is missing": "`reach` needs a pose",
    r"closes loops; this scene has none|deploy needs a mechanism with closed loops": "what closes or locks needs loops or a latch",
    r"no balance found in": "`statics` finds no balance where nothing can balance",
    r"a dead point needs as many driven joints as degrees of freedom": "a dead point needs as many drives as freedoms",
    r"'deploy' follows a mechanism until it locks, without a controller": "`deploy` has no controller",
    r"criterion away_from_limits needs joints with": "criteria about limits need joints with limits",
    r"has friction that sticks, and is at rest": "`linearise` takes no joint at rest that sticks",
    r"nothing moves: kinematics needs": "`kinematics` needs a motion",
    r"losses of gears depend on the direction of power": "`linearise` takes no losses of gears",
    r"nothing can move: the loops and prescribed joints": "`linearise` needs something that can move",
    r"does not follow masses that are gripped or released": "payloads come and go in `inverse` and `simulate` alone",
    r"statics knows no controller": "`statics` has no controller",
    r"'trajectory' is missing": "`inverse` needs a motion",
}


def reason_of(message: str) -> str | None:
    """Return the stated reason of a message that refuses a scene."""
    return next((reason for words, reason in REASONS.items() if re.search(words, message)), None)
