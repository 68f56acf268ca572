"""The closed chains of four links of a mechanism, by Grashof's rule, whatever its joints and closures are called."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from robodyn_cli.algorithms.kinematics import world_pose
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError
from robodyn_cli.given.motion import Planned
from robodyn_cli.model.model import BASE, FixedFrame, Loop
from robodyn_cli.observe.evaluation import SampleFunction
from robodyn_cli.record import record
from robodyn_cli.results.result import Result
from robodyn_cli.solve.four_bar import FourBar
from robodyn_cli.solve.guided import CLOSED
from robodyn_cli.spatial.algebra import Array, identity, zeros
from robodyn_cli.summaries.design import FourBarClass, JointDeadPoints
from robodyn_cli.summaries.facts import ABSENT
from robodyn_cli.summaries.mechanism import JointRange

FLAT = 1e-9  # sine of an angle out of the plane, and part of the size across it
PIN, SLIDE, OTHER = "pin", "slide", "other"
KEY = "kinematics.design.grashof"
KINDS = {"revolute": PIN, "cylindrical": PIN, "spherical": PIN, "prismatic": SLIDE}
Node = int | str  # a body, or what a closure puts between two: a bar, a block on a line


@record
class PlanarPair:
    """A joint or a closure between two links: its kind, where it is (3,) and its axis (3,) in the world, None where it
    has none. joint : of the tree, with its coordinate."""

    kind: str
    first: Node
    second: Node
    at: Array
    axis: Array | None
    closure: str = ""
    joint: str = ""

    def other(self, node: Node) -> Node:
        """Return the link at its other end."""
        return self.second if node == self.first else self.first


def add_four_bars(
    result: Result, problem: Problem, planned: Planned, joints: Mapping[str, JointRange]
) -> dict[str, FourBarClass]:
    """Add the pins of the chains of four links to a result, and return these as ``four_bars`` does.

    Raises
    ------
    CapabilityError : there is none.
    """
    poses = poses_at_start(problem, planned)
    for name, chain in chains_of(problem, poses).items():
        result.add(f"four_bars/{name}", chain.poses())
    return four_bars(problem, poses, planned.motion.q[0], joints)


def four_bars(
    problem: Problem, poses: Mapping[str, Array], q: Array, joints: Mapping[str, JointRange]
) -> dict[str, FourBarClass]:
    """Return the chains of four links by a closure of each; joints : where these go. poses : see ``pose_outputs``, at
    q (nq,).

    Raises
    ------
    CapabilityError : there is none.
    """
    start = dict(zip(problem.model.q_names, q.tolist()))
    chains = chains_of(problem, poses)
    return {name: chain.described(problem, start, joints) for name, chain in chains.items()}


def chains_of(problem: Problem, poses: Mapping[str, Array]) -> dict[str, ClosedChain]:
    """Return the chains of four links by a closure of each.

    Raises
    ------
    CapabilityError : there is none.
    """
    pairs = list(_pairs(problem, {name: (x[:3], x[3:].reshape(3, 3)) for name, x in poses.items()}))
    found: dict[str, ClosedChain] = {}
    known: set[frozenset[int]] = set()
    for pair in pairs:
        ring = _ring(pairs, pair) if pair.closure and pair.closure not in found else []
        if len(ring) != 4 or frozenset(map(id, ring)) in known:
            continue
        known.add(frozenset(map(id, ring)))
        chain = ClosedChain.of(ring, problem)
        if chain is not None:
            found[pair.closure] = chain
    if not found:
        raise CapabilityError(
            f"no closed chain has four links in a plane with four pins, or with three "
            f"pins and a slide; the closures are {', '.join(repr(x.name) for x in problem.model.loops)}",
            (problem.scene.path, KEY),
            key=KEY,
        )
    return found


def pose_outputs(problem: Problem) -> dict[str, list[Any]]:
    """Return the expressions of the poses of all bodies and ends of closures: places (3,) and attitudes (9,)."""
    model = problem.model
    ends = {f"{loop.name}.{k}": x for loop in model.loops for k, x in enumerate((loop.first, loop.second))}
    bodies = {str(k): FixedFrame(k, zeros(3), identity()) for k in range(len(model.bodies))}
    outputs = {}
    for name, frame in {**bodies, **ends}.items():
        pose = world_pose(model, problem.pose, frame)
        outputs[name] = [*pose.p, *pose.R.flat]
    return outputs


def poses_at_start(problem: Problem, planned: Planned) -> dict[str, Array]:
    """Return the poses at the first sample, see ``pose_outputs``."""
    function = SampleFunction(pose_outputs(problem), ("t", "q"), 1)
    values = function(t=planned.times[:1, None], q=planned.motion.q[:1])
    return {name: x[0] for name, x in values.items()}


def _pairs(problem: Problem, poses: Mapping[str, tuple[Array, Array]]) -> Iterator[PlanarPair]:
    """Yield the joints and closures."""
    model = problem.model
    types = {joint.name: joint.type for joint in problem.scene.robot.joints}
    for k, body in enumerate(model.bodies):
        p, R = poses[str(k)]
        kind = {"revolute": PIN, "prismatic": SLIDE}.get(types[body.joint_name], OTHER)
        yield PlanarPair(kind, body.parent, k, p, R[:, 2], joint=body.joint_name)
    for loop in model.loops:
        yield from _of_closure(loop, poses)


def _of_closure(loop: Loop, poses: Mapping[str, tuple[Array, Array]]) -> Iterator[PlanarPair]:
    """Yield the pairs of a closure: of a bar two pins, of a point on a line a slide and a pin."""
    (p, R), (other, _) = (poses[f"{loop.name}.{k}"] for k in (0, 1))
    first, second, kind = loop.first.body, loop.second.body, loop.element.type
    axis = None if loop.element.axis is None else R @ np.array(loop.element.axis, dtype=float)
    if kind == "distance":
        yield PlanarPair(PIN, first, loop.name, p, None, loop.name)
        yield PlanarPair(PIN, loop.name, second, other, None, loop.name)
    elif kind == "point_on_line":
        yield PlanarPair(SLIDE, first, loop.name, p, axis, loop.name)
        yield PlanarPair(PIN, loop.name, second, other, None, loop.name)
    else:
        yield PlanarPair(KINDS.get(kind, OTHER), first, second, p, axis, loop.name)


def _ring(pairs: Sequence[PlanarPair], closing: PlanarPair) -> list[PlanarPair]:
    """Return the shortest closed chain through a closure: it, and the pairs from its second link back to its first."""
    ways: dict[Node, list[PlanarPair]] = {closing.second: []}
    fringe: list[Node] = [closing.second]
    while fringe and closing.first not in ways:
        beyond: list[Node] = []
        for node in fringe:
            for pair in pairs:
                if pair is not closing and node in (pair.first, pair.second) and pair.other(node) not in ways:
                    ways[pair.other(node)] = [*ways[node], pair]
                    beyond.append(pair.other(node))
        fringe = beyond
    return [closing, *ways[closing.first]] if closing.first in ways else []


@record
class ClosedChain:
    """Four links in a plane: the pairs in the order of ``FourBar``'s pins, the slide last; links behind each."""

    ring: list[PlanarPair]
    links: list[Node]
    bar: FourBar
    frame: tuple[Array, Array]  # origin (3,), and directions of the plane and its normal (3, 3) as columns
    ground: int

    @staticmethod
    def of(ring: list[PlanarPair], problem: Problem) -> ClosedChain | None:
        """Return the chain of four pairs, None where it has no meaning in a plane."""
        kinds = [pair.kind for pair in ring]
        if OTHER in kinds or kinds.count(SLIDE) > 1:
            return None
        if SLIDE in kinds:  # the slide last
            k = kinds.index(SLIDE)
            ring = [*ring[k + 1 :], *ring[: k + 1]]
        node = ring[-1].first if ring[-1].first in (ring[0].first, ring[0].second) else ring[-1].second
        links = []
        for pair in ring:
            node = pair.other(node)
            links.append(node)
        frame = _plane(ring, problem)
        if frame is None:
            return None
        pins = np.array([(pair.at - frame[0]) @ frame[1][:, :2] for pair in ring])
        slide = ring[-1].axis @ frame[1][:, :2] if SLIDE in kinds else None
        bar = FourBar(pins, None) if slide is None else FourBar(pins[:3], slide / np.linalg.norm(slide))
        if not bar.lengths.min() > FLAT * float(np.abs(pins).max()):
            return None
        depth = [
            len(problem.model.path_to(x)) if isinstance(x, int) else len(problem.model.bodies) + 1
            for x in links
        ]
        return ClosedChain(ring, links, bar, frame, int(np.argmin(depth)))

    def poses(self) -> Array:
        """Return the pins in the world (n, 4, 3), and of a slide the foot of its line: now, and in dead points.

        With a slide they are counted so that the fixed link has its guide, or the first two of them.
        """
        bar, fixed = self.bar, self.ground
        if bar.slide is not None and fixed in (1, 2):
            bar, fixed = bar.backwards, (0, 3)[fixed - 1]
        flat = [bar.drawn]
        for pin in (fixed, (fixed + 1) % len(bar.pins)) if fixed != 3 or bar.slide is None else (0,):
            theta, between = bar.at_pin(pin)
            for end in (between.low, between.high):
                if end is not None:
                    pose = bar.dead_pose(pin, end.value - theta, fixed, end.outer)
                    flat += [] if pose is None else [pose]
        if bar.slide is not None and fixed == 3:
            _, between = bar.at_slide()
            ends = (between.low, between.high)
            flat += [x for end in ends if end is not None and (x := bar.dead_slide(end)) is not None]
        origin, axes = self.frame
        return np.array([origin + x @ axes[:, :2].T for x in flat])

    def described(
        self, problem: Problem, start: Mapping[str, float], joints: Mapping[str, JointRange]
    ) -> FourBarClass:
        """Return what the summary says."""
        bar, names = self.bar, [self._name(problem, x) for x in self.links]
        margin, error = bar.margin
        reached = {}
        for k, pair in enumerate(self.ring):
            if pair.joint and pair.joint in joints:
                reached[pair.joint] = self._joint(k, pair, start[pair.joint], joints[pair.joint])
        return FourBarClass(
            kind="four pins" if bar.slide is None else "three pins and a slide",
            lengths=dict(zip(names, bar.lengths.tolist())),
            offset=ABSENT if bar.slide is None else abs(bar.offset),
            margin=margin,
            margin_error=error,
            grashof=bool(bar.turning),
            shortest=names[int(np.argmin(bar.lengths))],
            ground=names[self.ground],
            type=bar.name(self.ground),
            inversions={name: bar.name(k) for k, name in enumerate(names)},
            joints=reached,
        )

    def _joint(self, k: int, pair: PlanarPair, q: float, gone: JointRange) -> JointDeadPoints:
        """Return the dead points of a joint in its coordinate, and how near the motion comes to them."""
        slides = pair.kind == SLIDE
        value, between = self.bar.at_slide() if slides else self.bar.at_pin(k)
        sign = self._sense(k, pair)
        if between.low is None or between.high is None:
            return JointDeadPoints(not slides, None, None, None, None, None)
        ends = [(q + sign * (end.value - value), end.error) for end in (between.low, between.high)]
        (low, low_off), (high, high_off) = sorted(ends)
        error = max(low_off, high_off) + CLOSED
        if gone.smallest is None or gone.largest is None:
            return JointDeadPoints(False, low, high, error, None, None)
        near = min(gone.smallest - low, high - gone.largest)
        off = error + max(gone.errors.smallest or 0.0, gone.errors.largest or 0.0)
        return JointDeadPoints(False, low, high, error, near, off)

    def _sense(self, k: int, pair: PlanarPair) -> float:
        """Return how the joint's coordinate grows with the angle, or with the way, of ``FourBar`` there."""
        assert pair.axis is not None
        if pair.kind == SLIDE:  # of link 2 along the slide of link 3
            return (1.0 if pair.second == self.links[2] else -1.0) * math.copysign(
                1.0, float(pair.axis @ (self.frame[1][:, :2] @ self.bar.slide))
            )
        # the angle grows with the turning of the link before the pin; with a slide of link 0 at pin 0, of link 1 at 2
        turning = self.links[k - 1] if self.bar.slide is None or k == 1 else self.links[0 if k == 0 else 1]
        return (1.0 if pair.second == turning else -1.0) * math.copysign(
            1.0, float(pair.axis @ self.frame[1][:, 2])
        )

    @staticmethod
    def _name(problem: Problem, node: Node) -> str:
        return "base" if node == BASE else node if isinstance(node, str) else problem.model.bodies[node].name


def _plane(ring: Sequence[PlanarPair], problem: Problem) -> tuple[Array, Array] | None:
    """Return origin and axes of the plane across the pins' axes; None where there is no such plane."""
    axes = [pair.axis for pair in ring if pair.kind == PIN and pair.axis is not None]
    if not axes:
        return None
    n = axes[0] / np.linalg.norm(axes[0])
    lead = next(x for x in n[::-1] if abs(x) > 0.5)
    n = n if lead > 0.0 else -n
    slides = [pair.axis for pair in ring if pair.kind == SLIDE and pair.axis is not None]
    if any(float(np.linalg.norm(np.cross(n, axis))) > FLAT for axis in axes) or any(
        abs(float(n @ axis)) > FLAT for axis in slides
    ):
        return None
    u = np.eye(3)[int(np.argmin(np.abs(n)))]
    u = u - (u @ n) * n
    u /= np.linalg.norm(u)
    return ring[0].at, np.column_stack([u, np.cross(n, u), n])
