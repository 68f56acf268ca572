"""Recursions over the bodies of a tree: the steps of each kind of body as programs, reduced to the needed.

Values that no torque or acceleration depends on (the moments out of the plane of a planar chain), or that are zero in
every body, are neither computed nor carried.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache

from robodyn_cli.expr.graph import Expr, Scalar, is_nonzero
from robodyn_cli.joints.base import Joint
from robodyn_cli.kernels.program import Program, make_program
from robodyn_cli.kernels.rolled.steps import QUANTITIES, RECIPES, ROTATION, BodyStage, Place, Structure
from robodyn_cli.record import record

BODY_GROUPS = ("p", "q", "v", "x", "kept", *QUANTITIES)


@record
class Step:
    """One kind of body in one sweep. ``places`` are the entries that the program's outputs are, by group."""

    program: Program
    places: Mapping[str, tuple[int, ...]]


@record
class Sweep:
    """One pass over the bodies. ``steps`` has one entry for each kind of body."""

    outward: bool
    steps: tuple[Step, ...]


@record
class Recursion:
    """A recursion over the bodies of a tree, whatever their number.

    carried : of each quantity, the entries that pass from body to body.
    kept : how many values a body keeps between sweeps.
    """

    sweeps: tuple[Sweep, ...]
    carried: dict[str, tuple[int, ...]]
    kept: int

    @property
    def digest(self) -> str:
        """Key of the compiled code."""
        steps = [f"{s.outward} {p.program.digest} {p.places}" for s in self.sweeps for p in s.steps]
        return " ".join([*steps, str(self.carried), str(self.kept)])

    @property
    def operations(self) -> int:
        """Operations per body, of the largest kind."""
        return sum(max(p.program.operations for p in s.steps) for s in self.sweeps)

    def constants_used(self, kind: int) -> set[int]:
        """Return which constants of a body the arithmetic needs."""
        code = [i for s in self.sweeps for i in s.steps[kind].program.instructions]
        return {i.value[1] for i in code if i.op == "sym" and i.value[0] == "p"}


def structure_of(rows: Sequence[Sequence[Scalar]]) -> Structure:
    """Return which constants all bodies of a kind share as structure, so that they need no arithmetic.

    Zeros (a planar chain, joints without rotors), and ones in rotations. Any other number stays in the table,
    equal or not: the code is to serve all models of one structure.
    """
    found: list[float | None] = []
    for k, column in enumerate(zip(*rows)):
        values = {None if isinstance(x, Expr) else float(x) for x in column}
        value = values.pop() if len(values) == 1 else None
        found.append(value if value == 0.0 or (value == 1.0 and k < ROTATION) else None)
    return tuple(found)


@lru_cache(maxsize=32)
def make_recursion(
    recipe: str, joints: tuple[Joint, ...], structures: tuple[Structure, ...], gravity: tuple[bool, ...]
) -> Recursion:
    """Stage a recursion for the kinds of joint that a model has.

    Parameters
    ----------
    recipe : ``inverse`` or ``forward``.
    joints, structures : one for each kind.
    gravity : which components of gravity are not zero.
    """
    run, names = RECIPES[recipe]
    # with bodies in general places no entry stays zero, so there is nothing to search for
    anyhow = all(c is None for structure in structures for c in structure[: ROTATION + 3])
    present = {name: (anyhow,) * QUANTITIES[name] for name in names}
    if not anyhow:
        present["motion"] = (False,) * 6 + gravity
    while True:
        stages = [BodyStage(joint, structure, present) for joint, structure in zip(joints, structures)]
        for stage in stages:
            run(stage)
        grown = {
            name: tuple(old or any(_can_differ(s, (name, k)) for s in stages) for k, old in enumerate(mask))
            for name, mask in present.items()
        }
        if grown == present:
            break
        present = grown  # zeros of the base that do not survive a body; another body may undo more
    needed = _needed(stages)
    sweeps = []
    for number, draft in enumerate(stages[0].drafts):
        steps = []
        for j, stage in enumerate(stages):
            steps.append(_step(stage.drafts[number].outputs, needed[j], present))
        sweeps.append(Sweep(draft.outward, tuple(steps)))
    carried = {
        name: tuple(k for k, x in enumerate(mask) if x and (name, k) in needed[0])
        for name, mask in present.items()
    }
    return Recursion(tuple(sweeps), carried, max(len(stage.kept.stored) for stage in stages))


def _can_differ(stage: BodyStage, place: Place) -> bool:
    """Tell whether some step of a body gives an entry of a quantity another value than zero."""
    given = (draft.outputs.get(place, 0.0) for draft in stage.drafts)
    return any(is_nonzero(x) for x in given)


def _needed(stages: Sequence[BodyStage]) -> list[set[Place]]:
    """Return, for each kind, the entries of quantities and kept values that some ``out`` depends on.

    Quantities pass between bodies of all kinds; what is kept stays with its body.
    """
    needed: list[set[Place]] = [set() for _ in stages]
    seen: list[set[int]] = [set() for _ in stages]
    pending: list[tuple[int, Scalar]] = []

    def want(place: Place, kinds: Sequence[int]) -> None:
        for j in kinds:
            if place not in needed[j]:
                needed[j].add(place)
                outputs = (draft.outputs for draft in stages[j].drafts)
                pending.extend((j, found[place]) for found in outputs if place in found)

    everywhere = range(len(stages))
    for j, stage in enumerate(stages):
        for k in range(stage.joint.nv):
            want(("out", k), [j])
    while pending:
        j, node = pending.pop()
        if not isinstance(node, Expr) or node.index in seen[j]:
            continue
        seen[j].add(node.index)
        pending.extend((j, a) for a in node.args)
        if node.op == "sym":
            _, group, k = node.value
            if group == "kept" or group in QUANTITIES:
                want((group, k), [j] if group == "kept" else everywhere)
    return needed


def _step(outputs: Mapping[Place, Scalar], needed: set[Place], present: Mapping[str, Sequence[bool]]) -> Step:
    """Return a step with the outputs that are needed and can be other than zero."""
    values: dict[str, list[Scalar]] = {}
    places: dict[str, list[int]] = {}
    for (group, k), value in outputs.items():
        if (group, k) in needed and (group not in present or present[group][k]):
            values.setdefault(group, []).append(value)
            places.setdefault(group, []).append(k)
    return Step(make_program(dict(values), BODY_GROUPS), {group: tuple(ks) for group, ks in places.items()})
