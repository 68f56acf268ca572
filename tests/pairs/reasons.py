"""Why a scene of features that are right each for themselves may be refused: the whole list, as the docs print it."""

from __future__ import annotations

import re

# words of the message -> the reason
REASONS: dict[str, str] = {
    # what a joint, a gear and a drive fit
    r"is fixed: it takes no|joint '\w+' is fixed; allowed": "a fixed joint has no forces, limits or drives",
    r"acts on one coordinate, and this joint turns or moves|holds single coordinates at rest|has no forwards|is floating: it takes no|is spherical: it takes no|at_limit\.\w+\.rpy":
        "limits, stops, gears, motors and sticking act on a coordinate, which balls and free bodies have none of",
    r"allowed: joints with one coordinate": "motors drive joints with one coordinate",
    r"this gear moves a slide|this gear turns|needs a gear that moves a slide": "a gear fits its joint: a screw moves a slide",
    r"say what its drive says too|says what its drive says too": "a drive stands for the gear and the rotor of its joint",
    r"gear losses together with|losses of gears depend on|takes gears without":
        "losses of gears: with rotors, prescribed motions and `fastest` paths in `inverse` alone, never in `linearise`",
    # motions
    r"'trajectory' is missing|trajectory.columns: has 1 entry": "`inverse` needs a motion",
    r"nothing moves: kinematics needs|nothing moves, and no time passes": "`kinematics` needs a motion, and a path a way",
    r"only `simulate` leaves others to the forces": "`inverse` and `kinematics` need the motion of all joints",
    r"and the trajectory leads \d+; lead \d+": "in a mechanism a motion leads as many joints as there are degrees of freedom",
    r"the motion asked for cannot be met|cannot reach its target|cannot reach the pose": "paths and poses are in reach",
    r"beyond the joint's (upper|lower) limit|beyond its stop|beyond its rigid stop|starts at .* beyond":
        "way points and starts are within limits and stops",
    r"no limits along a path": "`fastest` takes joints of one axis, or slides",
    r"forces that depend on time": "`fastest` and functions of a model take forces that do not depend on time",
    r"of 'a' is prescribed, so|is prescribed, so its torque is a result|is prescribed; sweep another":
        "a prescribed joint has no torque of its own, and is not swept",
    r"so 'prescribed' .* is not allowed there": "functions of torques take all motion from their input",
    r"is not in 'actuated'": "what is driven is in `actuated`",
    r"initial rates contradict the constraints|contradicts prescribed": "positions and rates of the start agree with loops and prescribed motions",
    r"singular configuration|singular pose": "a singular pose is no start, and no way",
    # loops and couplers
    r"the loops? .*does not close|gap of .* remains": "loops close",
    r"closes loops; this scene has none|deploy needs a mechanism with closed loops": "what closes or locks needs loops or a latch",
    r"its actuated joints \(.*\) command|the driven joints \(.*\) command|needs as many driven joints as degrees":
        "in a mechanism as many independent joints are driven as there are degrees of freedom",
    r"prescribed motion leave no freedom": "joints whose motion is given do not stick",
    r"deploy.latches: latch '\w+' (cannot hold|has a spring)|latch holds the links of a closure|latch of a closed mechanism has a spring":
        "a latch holds a joint of one axis, or links that a closure of type `revolute` joins, with a spring where joints turn about parallel axes",
    r"deploy.latches(\.\w+)*: does not go with": "rigid latches hold no prescribed joint, and dead points that close latches need loops that nothing prescribes",
    # kinematic design
    r"do not move in one plane|does not move in a plane|does not turn about one axis|kinematics.design.*does not move":
        "kinematic design is that of motions in a plane",
    r"a flywheel follows from|flywheel.joint: joint '\w+' (bears no|slides)":
        "a flywheel follows from a cycle in which its joint turns at a constant rate and is driven",
    # payloads
    r"which is gripped or released, does not go with": "payloads do not come and go beside rigid stops, sticking and `singular: pass`",
    r"does not follow masses that are gripped or released|'fastest' chooses the times|payload.*'singular: pass'|payloads that come":
        "payloads come and go in `inverse`, `simulate` and `deploy` with `latches`, not in `fastest` or beside `singular: pass`",
    r"the motion is given in 'inverse'": "`inverse` grips and releases payloads at times, not where something happens",
    # margins of motorisation
    r"motorisation: a margin knows no": "margins of motorisation know no losses of gears, and no payloads that come and go",
    r"motorisation: nothing drives": "a margin of motorisation needs what drives",
    # controllers
    r"'deploy' up to a dead point follows a mechanism without a controller|statics knows no controller|without a controller":
        "`deploy` without `latches`, `statics` and `singular: pass` have no controller",
    r"needs a function: simulate": "`control: python` is for Python",
    r"drives every joint; |control.joints: has no entry|drives no joint|has an attitude, which|and 'law' differ|"
    r"which the controller drives|unknown joint 'f":
        "a law drives the joints that it needs: all of them, one at least, joints of axes",
    r"control.reference: unknown key|leads joints; allowed: a path of a point":
        "`lqr` has no reference, and `task_pd` the path of a point",
    r"cannot be stabilised|the pose is no equilibrium|so the pose does not stay": "`lqr` needs a pose that it can hold",
    # methods
    r"a symplectic partitioned method needs": "`verlet` and `symplectic*`: accelerations of positions and time alone",
    r"it keeps a history of steps|a joint has friction with 'law: set_valued' or a rigid stop|velocities that are not rates":
        "`bdf` and `generalized_alpha` keep what sampled controllers, impacts and attitudes break",
    r"a Taylor series is written out for": "`taylor12` and `taylor16` take equations of 256 operations at most",
    r"whose steps are all as long as": "a fixed step has no `max_step`",
    r"the equations of a step of .* have no solution nearby": "a fixed step is as short as the motion asks for",
    r"rows of the loops depend on each other": "`generalized_alpha` needs independent rows of loops",
    r"do not follow joints that stick|independent coordinates do not go with joints that stick":
        "chosen gains, and independent coordinates, do not go with joints that stick or meet rigid stops",
    # poses and what else is asked
    r"'reach' is missing": "`reach` needs a pose",
    r"no balance found in": "`statics` finds no balance where nothing can balance",
    r"has friction that sticks, and is at rest": "`linearise` takes no joint at rest that sticks",
    r"nothing can move: the loops and prescribed joints": "`linearise` needs something that can move",
    r"criterion away_from_limits needs joints with": "criteria about limits need joints with limits",
    r"so it closes in infinitely many ways": "branches of a mechanism are listed where all its freedoms are held",
    r"has no branch|branch '\w+'": "branches have names where the arm has a closed form",
}  # fmt: skip


def reason_of(message: str) -> str | None:
    """Return the stated reason of a message that refuses a scene."""
    return next((reason for words, reason in REASONS.items() if re.search(words, message)), None)
