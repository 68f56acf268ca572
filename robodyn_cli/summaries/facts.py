"""How a number of a summary is declared, once: its unit, its meaning and where its error stands; what many have.

Keys of every summary, beside those of its command.
"""

from __future__ import annotations

import dataclasses
import enum
import math
from collections.abc import Sequence
from decimal import ROUND_UP, Decimal
from typing import Any, Final

from robodyn_cli.record import record

REQUIRED: Any = dataclasses.MISSING


class Absent(enum.Enum):
    """The value of a field whose key a run does not have; ``None`` is a value, written as null."""

    ABSENT = "absent"


ABSENT: Final = Absent.ABSENT


def rounded_up(error: float, digits: int = 2) -> float:
    """Return an error as it is printed with some digits, away from zero: the printed one is a bound too."""
    if not math.isfinite(error) or error == 0.0:
        return error
    exact = Decimal(format(error, ".7g"))  # what rounding left of 0.3 is no more than 0.3
    return float(exact.quantize(Decimal(1).scaleb(exact.adjusted() - digits + 1), ROUND_UP))


@record
class UnitOf:
    """A unit that follows that of a coordinate, which the map around a field names: of one in rad, in m, and in 1."""

    turning: str
    sliding: str
    plain: str = ""

    def __call__(self, coordinate: str = "") -> str:
        """Return the unit for a coordinate in ``rad``, ``m`` or ``1``; that of either where it is not known."""
        known = {"rad": self.turning, "m": self.sliding, "1": self.plain}.get(coordinate)
        return known or str(self)

    def __str__(self) -> str:
        return f"{self.turning} or {self.sliding}"


def for_coordinate(unit: str, coordinate: str) -> str:
    """Return the one of ``N m/rad or N/m`` that is for a coordinate in ``rad`` or ``m``; other units as they are."""
    forms = unit.split(" or ")
    if len(forms) != 2 or coordinate not in ("rad", "m"):
        return unit
    turning = [form for form in forms if "N m" in form or "rad" in form]
    sliding = [form for form in forms if form not in turning]
    return (turning if coordinate == "rad" else sliding or forms)[0]


def of_angle(unit: str) -> bool:
    """Tell whether a unit is that of an angle, or of one of its rates."""
    return any(form.startswith("rad") for form in unit.split(" or "))


OWN = UnitOf("rad", "m", "1")
RATE = UnitOf("rad/s", "m/s", "1/s")
ACCELERATION = UnitOf("rad/s^2", "m/s^2", "1/s^2")
LOAD = UnitOf("N m", "N")
STIFFNESS = UnitOf("N m/rad", "N/m")
IMPULSE = UnitOf("N m s", "N s")
TURNS = UnitOf("1", "rad/m")

# what the keys of a map may be, beside words of our own: names in the scene, by what they name
JOINT, LINK, POINT, LOOP, ROW, LIMIT, PAYLOAD = "JOINT", "LINK", "POINT", "LOOP", "ROW", "LIMIT", "PAYLOAD"
COLUMN = "COLUMN"  # over time, as exports call it: ``q.theta1``, ``points/tip.x``
LATCH = "LATCH"
PAIR = "PAIR"  # a ratio of `kinematics.design`
OUTPUT = "OUTPUT"  # a key of the summary of each run of a study
ANY = "KEY"  # any key at all


@record
class Fact:
    """What the field of a record in a summary says; see ``fact``."""

    doc: str
    unit: str | UnitOf
    names: tuple[str, ...]
    errors: tuple[str, ...]
    column: str
    about_run: bool = False
    infinite: bool = False
    same_as: str = ""


def fact(
    doc: str,
    unit: str | UnitOf = "1",
    *,
    names: str | tuple[str, ...] = JOINT,
    errors: tuple[str, ...] | None = (),
    column: str = "",
    default: Any = REQUIRED,
) -> Any:
    """Declare one key of a summary as a field of a record.

    Parameters
    ----------
    doc : what it is, for readers of the docs and of pages, without its unit.
    unit : of its numbers; ``OWN``, ``RATE``, ``ACCELERATION``, ``LOAD`` or ``TURNS``: what follows the coordinate that
        the map around it names.
    names : of a map, what its keys are: kinds of names in capitals (``JOINT``), and words as they are.
    errors : keys of the same summary that state its error, of which the largest counts; a word in capitals stands for a
        name that was passed on the way (``drives.JOINT.errors.margin``), a dot in front: a key beside it (``.error``).
        None of what says how well or how long a run went, and not what the mechanism does, as all below it: residuals,
        estimated errors, steps, times on the clock. They have no error, and move with samples and tolerances.
    column : heading in the table of main figures; without one it is not in it.
    default : value where the maker of the record gives none.
    """
    kinds = (names,) if isinstance(names, str) else names
    own = Fact(doc, unit, kinds, errors or (), column, errors is None)
    return dataclasses.field(default=default, metadata={"fact": own})


def or_infinite(declared: Any) -> Any:
    """Declare that None stands for a number that is infinite, which ``expect`` takes for larger than any."""
    own = dataclasses.replace(declared.metadata["fact"], infinite=True)
    return dataclasses.field(default=declared.default, metadata={"fact": own})


def warned(summary: Any, more: Sequence[str]) -> Any:
    """Return a record of a summary with more ``warnings``."""
    own = [] if summary.warnings is ABSENT else summary.warnings
    return dataclasses.replace(summary, warnings=[*own, *more]) if more else summary


def same_as(key: str, declared: Any) -> Any:
    """Declare that another key of the same summary says the same, beside which figures of several results leave this
    one out."""
    own = dataclasses.replace(declared.metadata["fact"], same_as=key)
    return dataclasses.field(default=declared.default, metadata={"fact": own})


def key_of(field: str) -> str:
    """Return the key of a field: its name, without the last ``_`` of one that Python has a word for (``yield_``)."""
    return field.removesuffix("_")


def definitions(*places: tuple[type, tuple[str, ...]]) -> dict[str, str]:
    """Return the meanings of some fields of records by their names, each with its unit where it has one."""
    meanings = {}
    for kind, names in places:
        facts = {f.name: f.metadata["fact"] for f in dataclasses.fields(kind)}
        for name in names:
            unit = facts[name].unit
            meanings[name] = facts[name].doc + ("" if unit == "1" else f" [{unit}]")
    return meanings


@record
class Termination:
    """Why a run ended, and when."""

    reason: str = fact("why the run ended, in words")
    time: float = fact("when it ended", "s", errors=("lock.time_error",))


@record
class LoopResidual:
    """Largest residuals of the loops by level, where they are known."""

    position: float = fact("largest residual of the loops", "m or rad")
    velocity: float | Absent = fact("largest residual of their velocities", "m/s or rad/s", default=ABSENT)
    acceleration: float | Absent = fact(
        "largest residual of their accelerations", "m/s^2 or rad/s^2", default=ABSENT
    )
    redundant: float | Absent = fact(
        "largest residual of rows that were left out since others imply them", "m or rad", default=ABSENT
    )


@record
class PeakLoad:
    """The largest load of a joint or a closure."""

    peak_force: float = fact("largest magnitude of the force", "N", errors=(".force_error",))
    peak_moment: float = fact("largest magnitude of the moment", "N m", errors=(".moment_error",))
    force_error: float | None = fact("error of the largest force; `null` where no second run tells it", "N")
    moment_error: float | None = fact("error of the largest moment, likewise", "N m")

    def or_larger(self, other: PeakLoad) -> PeakLoad:
        """Return the larger force and the larger moment of two."""
        force, moment = (max(self.peak_force, other.peak_force), max(self.peak_moment, other.peak_moment))
        off = (
            max(load.peak_force + (load.force_error or 0.0) for load in (self, other)) - force,
            max(load.peak_moment + (load.moment_error or 0.0) for load in (self, other)) - moment,
        )
        return PeakLoad(force, moment, *off)


@record
class PeakLoads:
    """The largest loads of joints and closures, where the scene asks for reactions."""

    axes: str | Absent = fact("axes in which the loads are given: `joint` or `world`")
    not_determined: dict[str, list[str]] | Absent = fact(
        "components that the scene's data do not determine", names=(JOINT, LOOP, "base_wrench")
    )
    largest: dict[str, PeakLoad] = fact(
        "of joints, closures and the base", names=(JOINT, LOOP, "base_wrench")
    )


@record
class Failure:
    """What ended a run that failed."""

    kind: str = fact("class of the error")
    message: str = fact("what went wrong, in words")
    exit_code: int = fact("exit code of the command")


@record
class EveryRun:
    """Keys of every summary. ``exit_code`` may be expected, and is not written."""

    status: str = fact("`ok`, `locked`, `no_lock`, `overload`, `undersized`, `missed` or `failed`")
    command: str = fact("command that was run")
    title: str = fact("title of the scene")
    error: Failure = fact("of a run that failed: what ended it")
    exit_code: int = fact("exit code of the run, for `expect`; not written")
    notes: list[str] = fact("of a robot in another format: what its files hold and was left out")
    wall_time_s: dict[str, float] = fact(
        "time by stage (`load`, `equations`, `compile`, `integrate`, `write`, `plots`, ...), and `total`",
        "s",
        names=ANY,
        errors=None,
    )
    scene_file: str = fact("where the scene lies")
    run_id: str = fact("of this run, the same as the attribute of `result.h5`")
    outputs: list[str] = fact("names of the files that were written")
