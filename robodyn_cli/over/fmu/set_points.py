"""What a controller is to follow as inputs: positions and rates that other tools set at communication points."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError, RobodynError, of_option
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.over.c99.asked_keys import AskedKey
from robodyn_cli.over.c99.functions import ready
from robodyn_cli.record import record
from robodyn_cli.scene.load import Family

REFERENCE = "control.reference"  # the key that asks for them
ENDLESS = "1e9"  # s: the duration of what is set
TIME = "set_time"
UNLIMITED = (-math.inf, math.inf)


@record
class SetPoints:
    """A scene whose controller follows what is set, as ``parameters`` of a formula of time.

    family : of that scene. names, units : of the inputs, by their keys. time : the key of the time from which on rates
    count.
    """

    family: Family
    names: Mapping[str, str]
    units: Mapping[str, str]
    time: str = f"parameters.{TIME}"

    @property
    def keys(self) -> list[AskedKey]:
        return [AskedKey(key, option="--input") for key in (*self.names, self.time)]


def with_set_points(family: Family, inputs: Sequence[AskedKey]) -> tuple[SetPoints | None, list[AskedKey]]:
    """Return the set points that are asked for, if they are, and the other inputs.

    Each joint of the reference is to be at ``q + qd (t - time)``, at first from its place and rate in the scene.

    Raises
    ------
    CapabilityError : the controller follows no joints, or what it is to follow has to be known ahead.
    """
    others = [one for one in inputs if one.name != REFERENCE]
    if len(others) == len(inputs):
        return None, others
    if any(one.low is not None for one in inputs if one.name == REFERENCE):
        raise _refusal("a range", "no range")
    values, formulas = [f"parameters.{TIME}=0.0"], []
    keys: dict[str, str] = {}
    units: dict[str, str] = {}
    for k, joint in enumerate(_reference(family)):
        place, rate = f"set_{k}", f"set_rate_{k}"
        values += [f"parameters.{place}={joint.q!r}", f"parameters.{rate}={joint.qd!r}"]
        formulas.append(f'"{joint.name}": "{place} + {rate}*(t - {TIME})"')
        keys |= {
            f"parameters.{place}": f"setpoint.{joint.name}",
            f"parameters.{rate}": f"setpoint_rate.{joint.name}",
        }
        units |= {f"parameters.{place}": joint.unit, f"parameters.{rate}": f"{joint.unit}/s"}
    follows = f"{REFERENCE}={{type: joint, duration: {ENDLESS}, q: {{{', '.join(formulas)}}}}}"
    return SetPoints(family.with_values([*values, follows]), keys, units), others


@record
class _Led:
    """A joint of a reference: its unit, its position and rate at t = 0."""

    name: str
    unit: str
    q: float
    qd: float


def _reference(family: Family) -> list[_Led]:
    """Return the joints of a controller's reference."""
    scene = family.own
    if scene.control is None or scene.control.type in ("python", "lqr"):
        kind = "no controller" if scene.control is None else f"control.type {scene.control.type}"
        raise _refusal(kind, "a controller that follows a motion of joints")
    problem = Problem(ready(scene))
    control = problem.control
    assert control is not None
    ahead = control.controller.type == "feed_forward" and bool(problem.constraints.rows)
    if control.controller.at_point or ahead:
        raise _refusal(
            f"control.type {control.controller.type}", "a controller that follows a motion of joints"
        )
    if not control.reference.known:
        raise _refusal("joints without a start", "a reference, or initial.q of the driven joints")
    q, qd, _ = control.reference.at(problem.t, problem.environment)
    numbers = [float(x) for x in evaluate([*q, *qd], {"t": [0.0]})]
    names, model = control.reference.joints, problem.model
    units = [model.q_units[model.q_names.index(name)] for name in names]
    return [_Led(*each) for each in zip(names, units, numbers[: len(q)], numbers[len(q) :])]


def _refusal(kind: str, allowed: str) -> RobodynError:
    return of_option(f"--input {REFERENCE}", f"{kind}; allowed: {allowed}", CapabilityError)
