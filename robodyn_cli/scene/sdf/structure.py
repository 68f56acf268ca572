"""The tree in an SDF: which joints move links, which close loops, and where the links that nothing holds begin.

A joint that joins links that are joined already closes a loop. Joints are taken in this order, and in that of the file
among equals: fixed ones; those with limits, friction, springs, a mimic or a thread, whose coordinate says more than a
closure can; other joints with one axis; with two; balls; last those that the file wants to be cut.
"""

from __future__ import annotations

from collections import defaultdict

from robodyn_cli.errors import did_you_mean, shown
from robodyn_cli.record import record
from robodyn_cli.scene.sdf.elements import SdfRobot
from robodyn_cli.scene.sdf.frames import WORLD
from robodyn_cli.scene.sdf.joints import CROSS, SINGLE, SdfJoint
from robodyn_cli.scene.text.nodes import Faults


@record
class Move:
    """A joint as one of the tree, which moves ``link`` behind ``parent``.

    backward : whether ``link`` is the parent of the file. end : the name of a massless link in the place of ``link``,
    which a weld ties to it: a joint that closes a loop and needs its coordinate; empty for the others.
    """

    joint: SdfJoint
    parent: str
    link: str
    backward: bool = False
    end: str = ""


@record
class SdfStructure:
    """The tree: ``moves`` in the order of the file; ``floating`` and ``held`` : links at its roots.

    closing : the joints that became loops. static : joints inside what does not move, which are left out.
    """

    moves: tuple[Move, ...]
    closing: tuple[Move, ...]
    floating: tuple[str, ...]
    held: tuple[str, ...]
    gearboxes: tuple[SdfJoint, ...]
    static: tuple[SdfJoint, ...]

    @property
    def moving(self) -> set[str]:
        """The links that a joint with a coordinate moves, directly or by way of others."""
        above = {move.link: move for move in self.moves if not move.end}
        moves = dict.fromkeys(self.floating, True)
        for link in above:
            chain = []
            while link in above and link not in moves:
                chain.append(link)
                link = above[link].parent
            moved = moves.get(link, False)
            for link in reversed(chain):
                moved = moved or above[link].joint.type != "fixed"
                moves[link] = moved
        return {link for link, moved in moves.items() if moved}


def structure_of(robot: SdfRobot, faults: Faults) -> SdfStructure | None:
    """Return the structure of a robot; None where joints or frames are wrong, which is reported."""
    links = [link.name for link in robot.links]
    held = tuple(link.name for link in robot.links if link.static)
    groups = _Groups()
    for name in held:
        groups.unite(WORLD, name)
    moves: dict[str, Move] = {}
    for joint in robot.joints:
        with faults:
            first, second = (_body(robot, joint, name) for name in (joint.parent, joint.child))
            if first == second:
                raise joint.element.error(
                    f"joint {joint.name!r} joins {first!r} with itself; allowed: two links"
                )
            moves[joint.name] = Move(joint, first, second)
    if faults.found:
        return None
    static = {*held, WORLD}
    still = [m.joint for m in moves.values() if m.parent in static and m.link in static]
    left = {joint.name for joint in still}
    kept = [m for m in moves.values() if m.joint.type != "gearbox" and m.joint.name not in left]
    leaders = {axis.mimic.joint for m in kept for axis in m.joint.axes if axis.mimic}
    tree: list[Move] = []
    closing: list[Move] = []
    for move in sorted(kept, key=lambda m: _rank(m.joint, leaders)):
        (tree if groups.unite(move.parent, move.link) else closing).append(move)
    oriented, floating = _oriented(tree, links, held)
    for move in closing:
        if _needs_coordinate(move.joint, leaders):
            oriented[move.joint.name] = Move(
                move.joint, move.parent, move.link, end=f"{move.link}::{move.joint.name}"
            )
    return SdfStructure(
        tuple(oriented[joint.name] for joint in robot.joints if joint.name in oriented),
        tuple(move for move in closing if move.joint.name not in oriented),
        floating,
        held,
        tuple(m.joint for m in moves.values() if m.joint.type == "gearbox"),
        tuple(still),
    )


def _body(robot: SdfRobot, joint: SdfJoint, name: str) -> str:
    if name not in robot.frames.frames:
        hint = did_you_mean(name, robot.frames.frames)
        raise joint.element.error(
            f"joint {joint.name!r}: {shown(name)} is no link or frame of this file{hint}"
        )
    return robot.frames.body(robot.frames.frames[name])


def _needs_coordinate(joint: SdfJoint, leaders: set[str]) -> bool:
    return joint.type == "screw" or joint.name in leaders or not all(axis.bare for axis in joint.axes)


def _rank(joint: SdfJoint, leaders: set[str]) -> int:
    if joint.cut:
        return 5
    if joint.type == "fixed" or _needs_coordinate(joint, leaders):
        return 0 if joint.type == "fixed" else 1
    return 2 if joint.type in SINGLE else 3 if joint.type in CROSS else 4


def _oriented(
    tree: list[Move], links: list[str], held: tuple[str, ...]
) -> tuple[dict[str, Move], tuple[str, ...]]:
    """Return the joints of a tree, each away from its root, and the roots that nothing holds.

    Such a root is the first link of the file that is no joint's child, else the first one.
    """
    joints: defaultdict[str, list[Move]] = defaultdict(list)
    for move in tree:
        joints[move.parent].append(move)
        joints[move.link].append(move)
    children = {move.link for move in tree}
    reached = {WORLD, *held}
    oriented: dict[str, Move] = {}
    floating = []

    def grow(root: str) -> None:
        pending = [root]
        while pending:
            at = pending.pop()
            for move in joints[at]:
                beyond = move.link if move.parent == at else move.parent
                if beyond not in reached:
                    reached.add(beyond)
                    pending.append(beyond)
                    oriented[move.joint.name] = Move(move.joint, at, beyond, backward=move.parent != at)

    for root in sorted(reached):
        grow(root)
    for root in (*(link for link in links if link not in children), *links):
        if root not in reached:
            floating.append(root)
            reached.add(root)
            grow(root)
    return oriented, tuple(floating)


class _Groups:
    """Which links are joined."""

    def __init__(self) -> None:
        self.above: dict[str, str] = {}

    def top(self, name: str) -> str:
        while (above := self.above.setdefault(name, name)) != name:
            self.above[name] = self.above.setdefault(above, above)
            name = above
        return name

    def unite(self, first: str, second: str) -> bool:
        """Join two links; tell whether they were apart."""
        tops = self.top(first), self.top(second)
        self.above[tops[0]] = tops[1]
        return tops[0] != tops[1]
