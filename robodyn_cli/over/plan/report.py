"""The records of a plan; their fields are the keys of ``plan --json``."""

from __future__ import annotations

from collections.abc import Sequence

from robodyn_cli.record import record
from robodyn_cli.results.summary import ABSENT, Absent


@record
class Kept:
    """A term of the equations. operations : what leaving it out would save; share : of all. None : not counted."""

    term: str
    reason: str
    operations: int | None
    share: float | None


@record
class LeftOut:
    """A term that the equations do not have; operations_saved : what it would add, None where not counted."""

    term: str
    reason: str
    operations_saved: int | None


@record
class Kernel:
    """A program of a run.

    numbers : places in the scene of the numbers that it reads. lanes : evaluations at once; lanes_hold : of what.
    placed : where in the stepping loop.
    """

    name: str
    operations: int
    inputs: dict[str, int]
    numbers: list[str]
    outputs: dict[str, int]
    engine: str
    shape: str
    lanes: int
    lanes_hold: str
    digest: str
    placed: str | Absent = ABSENT


@record
class Chosen:
    """A decision of a builder; operations : of the ways that were compared."""

    choice: str
    taken: str
    reason: str
    operations: dict[str, int] | Absent = ABSENT


@record
class LoopCosts:
    """Operations of equation (36): together, without the loops, of the loops, of an open chain of as many joints, and
    of what else loops take in a step."""

    operations: int
    rows: Sequence[str]
    open_tree: int | None
    loop_terms: int | None
    open_chain_of_as_many_joints: int | None
    ratio: float | None
    projection_of_positions: int
    projection_of_velocities: int
    events: int


@record
class Plan:
    """The plan of a command; see ``plan``."""

    status: str
    command: str
    title: str
    mechanism: str
    operations: int
    operations_general: int
    operations_of: str
    ratio: float | None
    kept: Sequence[Kept]
    left_out: Sequence[LeftOut]
    kernels: Sequence[Kernel]
    choices: Sequence[Chosen]
    missing: Sequence[str]
    not_given_and_not_needed: Sequence[str]
    given_without_effect: Sequence[str]
    terms_counted: bool
    equation_36: LoopCosts | Absent = ABSENT
