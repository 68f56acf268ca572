"""What a scene with sticking friction, rigid stops and latches must meet, and samples that show a missed event."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from robodyn_cli.equations.contact_joints import ContactJoint
from robodyn_cli.errors import CapabilityError, NumericalError, listed
from robodyn_cli.motion.contact.sticking import DEPENDENT, independent_count, motions_left
from robodyn_cli.scene.types import Scene
from robodyn_cli.spatial.algebra import Array

LOADS = ("reactions/", "loop_reactions/", "latch_loads/")  # columns of loads
MISSED = 1e-6  # what has gone past an event by this part of its scale was missed


def check_freedom(joints: Sequence[ContactJoint], psi: Array, tolerance: float) -> bool:
    """Tell whether more joints could stick than the mechanism has freedoms for them.

    psi : (m, nv). tolerance : ratio of its singular values below which rows depend on each other.

    Raises
    ------
    CapabilityError : the motion of one is given, so that nothing says what its friction is at rest.
    """
    sticking = [joint for joint in joints if joint.friction is not None]
    if not sticking:
        return False
    motions = motions_left(psi, tolerance)[[joint.v for joint in sticking]]
    given = [joint.name for joint, own in zip(sticking, motions) if np.linalg.norm(own) < DEPENDENT]
    if given:
        raise CapabilityError(
            f"friction with 'law: set_valued' in {listed(given)}: loops and prescribed motion leave no freedom to "
            f"{'it' if len(given) == 1 else 'them'}, so that friction at rest would not be unique; allowed: "
            "'transition_speed' there",
            joint=given[-1],
        )
    return independent_count(motions.T) < len(sticking)


def refuse_loads(scene: Scene, joints: Sequence[ContactJoint]) -> None:
    """Refuse loads that are not unique where more joints stick than there are freedoms.

    Raises
    ------
    CapabilityError : the scene asks for them.
    """
    keys = {
        "outputs.reactions": scene.outputs.reactions,
        "outputs.extremes": any(name.startswith(LOADS) for name in scene.outputs.extremes),
        "prescribed": scene.prescribed,
    }
    for key in (key for key, asks in keys.items() if asks):
        names = listed([joint.name for joint in joints if joint.friction is not None])
        raise CapabilityError(
            f"friction with 'law: set_valued' in {names}, more joints than there are degrees of freedom: while "
            "they stick, loads in joints, loops and prescribed joints are not unique; allowed: without this key, or "
            "'transition_speed' in some of these joints",
            (key,),
            key=key,
        )


def refuse_blocked(joint: ContactJoint, t: float, psi: Array, before: Array, after: Array) -> None:
    """Refuse an impact of a joint that no impulse of its stop can bring about; psi : (m, nv).

    before, after : velocities (nv,), which Psi has to leave alike.

    Raises
    ------
    NumericalError : prescribed motion or loops drive the joint through its stop.
    """
    torn = np.abs(psi @ (after - before)).max(initial=0.0)
    if torn > MISSED * np.abs(psi).max(initial=0.0) * abs(before[joint.v]):
        raise NumericalError(
            f"joint {joint.name!r} runs into its rigid stop at t = {t:.6g} s, and prescribed motion or loops force "
            "it on",
            time=t, status="blocked",
        )  # fmt: skip


def refuse_missed(
    joints: Sequence[ContactJoint], states: Sequence[int], t: Array, q: Array, v: Array, fastest: float
) -> None:
    """Refuse samples that contradict the contact states: an event was missed.

    Parameters
    ----------
    states : of each joint, 0 where it is held, else its direction of motion.
    t, q, v : samples (T,), (T, nq), (T, nv). fastest : largest rate so far.

    Raises
    ------
    NumericalError : with the joint and the time.
    """
    for k, joint in enumerate(joints):
        wrong = np.zeros(len(t), dtype=bool)
        for push, at in joint.stops:
            wrong |= push * (q[:, joint.q] - at) < -MISSED * max(1.0, abs(at))
        if joint.friction is not None:
            wrong |= states[k] * v[:, joint.v] < -MISSED * fastest
        if wrong.any():
            when = float(t[int(np.argmax(wrong))])
            raise NumericalError(
                f"an event of joint {joint.name!r} before t = {when:.6g} s was missed; a tighter tolerance finds it",
                time=when, status="missed_event",
            )  # fmt: skip


def torn_open(latch: str, t: float) -> NumericalError:
    """Return the error of a latch that cannot hold what it was to hold beside loops and other latches."""
    return NumericalError(
        f"latch {latch!r} holds what the loops and other latches hold already, but only in the pose in which it "
        f"closed, and is torn open at t = {t:.6g} s: no finite impulse holds the mechanism there; let it hold another "
        "joint, or close in another pose",
        time=t, status="latch",
    )  # fmt: skip


def forced_on(latches: Sequence[str], t: float) -> NumericalError:
    """Return the error of latches that cannot stop what they hold."""
    return NumericalError(
        f"latch {', '.join(latches)} closes at t = {t:.6g} s, and prescribed motion or loops force on what it holds",
        time=t, status="latch",
    )  # fmt: skip
