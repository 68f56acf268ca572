"""Kinematics in a page: a motion that loops and a lead determine, for other lengths, and where it takes points."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any

import numpy as np

from robodyn_cli.commands import places
from robodyn_cli.errors import CapabilityError
from robodyn_cli.over.live.code import StateEquations
from robodyn_cli.over.live.figures import Rule, rule_of, with_doubts
from robodyn_cli.over.live.follow import LoopMotion
from robodyn_cli.over.live.given import MOST_NUMBERS
from robodyn_cli.over.live.judging import REASONS
from robodyn_cli.over.live.keys import LiveMotion, cannot, columns
from robodyn_cli.over.live.picture import picture_of
from robodyn_cli.over.live.rules import Tape, plain
from robodyn_cli.over.many.command import VERDICT
from robodyn_cli.over.many.groups import first_of
from robodyn_cli.over.many.kinematics import KinematicsRuns, KinematicsStructure
from robodyn_cli.registry import Registry
from robodyn_cli.scene.load import Family
from robodyn_cli.solve.guided import CLOSED
from robodyn_cli.torques.checks import ROUNDED
from robodyn_cli.trajectories.led import velocity_columns
from robodyn_cli.works.kinematic_figures import (
    Figures,
    path_figures,
    range_figures,
    ratio_figures,
    transmission_angle,
    transmission_figures,
)
from robodyn_cli.works.kinematics import outputs

GROUPS = [["q", "positions", ""], ["v", "rates", "/s"]]
UNITS = {"path_length": "m", "smallest_deg": "deg", "largest_deg": "deg", "smallest_time": "s", "largest_time": "s",
         "time": "s"}  # fmt: skip


def kinematic_commands() -> dict[str, KinematicsRuns]:
    """Return the commands of motions without forces whose runs a page makes, by name."""
    batches: Registry[Any] = Registry("robodyn_cli", places("batch"), made=True)
    return {name: own for name, own in batches.items() if isinstance(own, KinematicsRuns)}


class LiveKinematics(LiveMotion):
    """The motion of a mechanism, with some keys that vary within ranges, see ``LiveScene``."""

    def __init__(self, family: Family, ranges: Mapping[str, tuple[float, float]]) -> None:
        super().__init__(family, ranges, kinematic_commands())
        if why := first_of({VERDICT: family.own.motorisation is not None}):
            raise CapabilityError(why, cannot(self.where))
        self.structure = self._built(self.mechanism, KinematicsStructure)
        self.problem, self.times = self.structure.problem, self.structure.times
        model, count = self.problem.model, len(self.times)
        self.sizes = {"t": 1, "q": model.nq, "v": model.nv, "a": model.nv}
        if count * sum(self.sizes.values()) > MOST_NUMBERS:
            raise CapabilityError(
                f"its motion has {count} samples of {sum(self.sizes.values())} "
                f"numbers; allowed: {MOST_NUMBERS} numbers in all, so fewer `kinematics.samples`",
                cannot(self.where),
            )
        motion = self.structure.motions(self.row[None])
        if not motion.good[0]:
            raise CapabilityError("its own motion is left to the command", cannot(self.where))
        self.motion = motion
        guided = self.structure.guided
        self.followed = (
            LoopMotion(guided, motion, self.where) if guided is not None and guided.varies else None
        )
        self._find_what_decides()

    # -- code -----------------------------------------------------------------------------------------
    @cached_property
    def paths(self) -> dict[str, list[Any]]:
        """What figures follow from, by path: motions of points, the angle's points, and Psi."""
        found = outputs(self.problem)
        wanted = [path for path in found if path.startswith(("point_velocities/", "point_accelerations/"))]
        if self.angle:
            wanted += [f"points/{name}" for name in self.angle]
        if self.passive:
            wanted.append("psi")
        return {path: list(found[path]) for path in wanted}

    @property
    def angle(self) -> tuple[str, ...]:
        """The points of the transmission angle."""
        return tuple(dict.fromkeys(self.problem.scene.kinematics.transmission or ()))

    @cached_property
    def passive(self) -> list[int]:
        """The velocity coordinates that nothing leads, where the ratio of singular values is a figure."""
        problem, lead = self.problem, self.structure.lead
        if lead is None or not problem.constraints.of_loops:
            return []
        led = (*lead.joints, *velocity_columns(problem.scene.prescribed))
        found = [k for k, name in enumerate(problem.model.v_names) if name not in led]
        return [] if len(found) == problem.model.nv else found

    @cached_property
    def equations(self) -> dict[str, StateEquations]:
        """Equations along the motion, by name."""
        found: dict[str, dict[str, Any]] = {"paths": self.paths} if self.paths else {}
        if self.followed is not None:
            found |= self.followed.equations()
        if picture := picture_of(self.problem.scene, self.problem):
            found["picture"] = picture
        return self._with_places(self.sizes, found)

    # -- figures --------------------------------------------------------------------------------------
    @cached_property
    def recorded(self) -> dict[str, tuple[Rule, dict[str, Any]]]:
        """The rules, each with the values of its example."""
        found = {} if self.followed is None else self.followed.rules()
        return {**found, "figures": self._figures()}

    def _figures(self) -> tuple[Rule, dict[str, Any]]:
        """Return the rule of all figures: ``SECTION.FIGURE`` and ``SECTION.FIGURE.error`` (n,)."""
        tape, motion = Tape(), self.motion
        known = self.structure.evaluated(self.row[None], motion)
        ways: dict[str, Any] = {path: tape.input(path, known[path][:, 0]) for path in self.paths}
        q, v, a = (tape.input(name, x[0]) for name, x in (("q", motion.q), ("v", motion.v), ("a", motion.a)))
        found = with_doubts(tape, _within("joints", self._ranges(q, v, a)))
        first = len(tape.doubts)
        times, breaks, closed = self.times, self.structure.breaks, self._closed
        if self.points:
            speeds, sizes = (
                np.stack([ways[f"{kind}/{name}"] for name in self.points], axis=1)
                for kind in ("point_velocities", "point_accelerations")
            )
            found |= with_doubts(tape, _within("points", path_figures(times, speeds, sizes, breaks)), first)
            first = len(tape.doubts)
        if self.passive:
            psi = ways["psi"].reshape(len(times), -1, self.problem.model.nv)
            block, every = (
                np.linalg.svd(x, compute_uv=False)[:, None] for x in (psi[:, :, self.passive], psi)
            )
            found |= with_doubts(
                tape, _within("ratio", ratio_figures(times, block, every, breaks, closed)), first
            )
            first = len(tape.doubts)
        if self.angle:
            angle = transmission_angle(ways, self.problem.scene.kinematics.transmission or ())
            own = transmission_figures(times, angle[:, None], breaks, closed)
            found |= with_doubts(tape, _within("angle", own), first)
        return rule_of(tape, found)

    def _ranges(self, q: Any, v: Any, a: Any) -> Figures:
        """Return the figures of joints; rates and accelerations that only rounding makes are none."""
        off = [ROUNDED * np.abs(x).max() for x in (v, a)]
        v, a = (np.where(np.abs(x) <= least, 0.0, x) for x, least in zip((v, a), off))
        figures = range_figures(self.times, (q, v, a), self.structure.breaks, self._closed)
        for name, least in zip(("peak_speed", "peak_acceleration"), off):
            value, error = figures[name]
            figures[name] = value, error + least
        return figures

    @property
    def _closed(self) -> float:
        """How far positions may be off at the samples [rad or m]."""
        return CLOSED if self.problem.model.closures else 0.0

    @property
    def points(self) -> list[str]:
        """Points whose paths have figures."""
        return [path.partition("/")[2] for path in self.paths if path.startswith("point_velocities/")]

    def named(self) -> list[dict[str, Any]]:
        """Return the figures in the order of the page, each with its place in the rule's outputs."""
        model = self.problem.model
        names = {"joints": list(model.v_names), "points": self.points, "ratio": [""], "angle": [""]}
        found = []
        for key in self.recorded["figures"][1]:
            section, _, figure = key.partition(".")
            if figure.endswith(".error") or key == "good":
                continue
            for k, name in enumerate(names[section]):
                unit = UNITS.get(figure) or self._unit(section, figure, k)
                found.append({"name": _title(section, figure, name), "unit": unit, "of": key, "entry": k})
        return sorted(found, key=lambda own: (list(names).index(own["of"].partition(".")[0]), own["entry"]))

    def _unit(self, section: str, figure: str, k: int) -> str:
        """Return the unit of a figure of a joint, a point or a ratio."""
        if section == "ratio":
            return ""
        own = "m" if section == "points" else self.problem.model.v_units[k]
        return own + {"peak_speed": "/s", "peak_acceleration": "/s^2"}.get(figure, "")

    # -- data -----------------------------------------------------------------------------------------
    def data(self) -> dict[str, Any]:
        """Return what a page needs beside the code."""
        model, motion = self.problem.model, self.motion
        rows = np.column_stack([self.times, motion.q[0], motion.v[0], motion.a[0]])
        q, v = 1, 1 + model.nq
        return {
            "title": self.family.own.title, "duration": float(self.times[-1]), "locks": False, "groups": GROUPS,
            "keys": [self._key_data(key, model) for key in self.keys],
            "q": columns(model.q_names, model.q_units, range(q, v)),
            "v": columns(model.v_names, model.v_units, range(v, v + model.nv)),
            "size": sum(self.sizes.values()), "factors": 0, "motion": plain(rows.ravel()), "rates": [], "weights": [],
            "outputs": {name: own.program.sizes for name, own in self.equations.items()},
            "follow": None if self.followed is None else self.followed.data(),
            "numbers": plain(self.tables.numbers), "points": list(model.points), "start": {"closing": None},
            "figures": self.named(), "reasons": {**REASONS, **MOVING_REASONS},
            "rules": {name: rule for name, (rule, _) in self.recorded.items()},
        }  # fmt: skip


def _within(section: str, figures: Figures) -> Figures:
    return {f"{section}.{name}": own for name, own in figures.items()}


def _title(section: str, figure: str, name: str) -> str:
    """Return what a figure is called."""
    words = figure.replace("_deg", "").replace("_", " ")
    if section == "ratio":
        return "smallest ratio of singular values" if figure == "smallest" else "time of that ratio"
    if section == "angle":
        end = "transmission angle"
        return f"time of the {words.split()[0]} {end}" if figure.endswith("_time") else f"{words} {end}"
    return f"{words} {'position ' if words in ('smallest', 'largest') else ''}of {name}"


# why a page leaves values to the command, by what did not hold
MOVING_REASONS = {
    "finite": "the motion is not finite",
    "follow": "the loops do not close along the whole motion, or come near a singular pose or another branch",
}
