"""The figures of ``inverse`` as rules, recorded along the motion of the scene from the functions of the command."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property, reduce
from typing import Any

import numpy as np

from robodyn_cli.observe.rounding import largest_differences
from robodyn_cli.over.live.rules import Tape
from robodyn_cli.solve.extremes import Extreme, largest_of_each
from robodyn_cli.solve.guided import same_branch
from robodyn_cli.solve.load_sharing import Hold, borne, borne_least, shared_rows
from robodyn_cli.solve.quadrature import Breaks
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.inverse import ROUNDING
from robodyn_cli.summaries.keys import leaf_of
from robodyn_cli.torques.checks import FIGURES, Loaded

Rule = dict[str, Any]
NAMES = {"torque_range.0": "smallest torque", "torque_range.1": "largest torque", "rms_torque": "RMS torque",
         "peak_torque_time": "time of the peak torque", "energy_net": "net energy"}  # fmt: skip
KINDS = {"peak_torque": "torque", "rms_torque": "torque", "torque_range": "torque", "peak_speed": "speed",
         "peak_power": "power", "energy": "energy", "energy_net": "energy"}  # fmt: skip
CERTAIN = 1e6  # condition of actuators and loops, from which on they are near to losing their hold
DOUBTED = 3.0  # times an error where a function may jump or bend between samples that say so


class LoadedTogether(Loaded):
    """Columns of joints whose peaks are looked for all at once, which takes fewer operations."""

    @cached_property
    def _peaks(self) -> list[Extreme]:
        """The largest values of torques, rates and power, and of each with its sign changed."""
        columns = [x for y in (self.tau, self.qd, self.power) for x in (y, -y)]
        return largest_of_each(self.times, columns, self.breaks)

    @cached_property
    def most(self) -> Extreme:
        return self._peaks[0]

    @cached_property
    def least(self) -> Extreme:
        return self._peaks[1]

    def largest(self, y: Array) -> tuple[Array, Array]:
        k = 2 if y is self.qd else 4
        found = self._peaks[k].or_larger(self._peaks[k + 1])
        return found.value, found.error


def rule_of(tape: Tape, outputs: Mapping[str, Any]) -> tuple[Rule, dict[str, Any]]:
    """Return a rule with whether all holds that it takes for granted (``good``), and the values of its example."""
    own = {key: tape.lift(x) for key, x in outputs.items()}
    if tape.assumed:
        good = [x.reshape(-1).all() for x in tape.assumed]
        own["good"] = reduce(np.logical_and, [own["good"], *good] if "good" in own else good)
    return (
        {"code": list(tape.code), "outputs": {key: x.place for key, x in own.items()}},
        {key: x.example for key, x in own.items()},
    )


def with_doubts(tape: Tape, figures: Mapping[str, tuple[Any, Any]], since: int = 0) -> dict[str, Any]:
    """Return figures (n,) and their errors as outputs of a rule; since : doubts noted before are of others.

    Where nobody states a jump or a bend its place is not looked for here, as the command does; the differences that it
    makes are part of the errors all the same, of which some are a little small then.
    """
    found: dict[str, Any] = {}
    for name, (value, error) in figures.items():
        found[name], n = value, value.size
        parts = [x.reshape(-1, n).any(axis=0) for x in tape.doubts[since:]]
        found[f"{name}.error"] = (
            error * np.where(reduce(np.logical_or, parts), DOUBTED, 1.0) if parts else error
        )
    return found


def figures_rule(times: Array, tau: Array, qd: Array, breaks: Breaks) -> tuple[Rule, dict[str, Any]]:
    """Return the rule of the figures of joints with torques and rates (T, n): ``NAME`` and ``NAME.error`` (n,)."""
    tape = Tape()
    loaded = LoadedTogether(times, tape.input("tau", tau), tape.input("qd", qd), breaks)  # type: ignore[arg-type]
    return rule_of(tape, with_doubts(tape, {name: figure(loaded) for name, figure in FIGURES.items()}))


def rounding_rule(load: Array, psi: Array | None, shared: Hold | None) -> tuple[Rule, dict[str, Any]]:
    """Return the rule of how far rounding puts any torque off, from loads (draw, S, nv) and Psi (draw, S, m, nv);
    shared : how actuators and loops share loads."""
    tape = Tape()
    tau: Any = tape.input("load", load)
    if psi is not None and shared is not None:
        rows: Any = tape.input("psi", psi)
        count, samples, nv = load.shape
        rows, tau = rows.reshape(-1, *psi.shape[2:]), tau.reshape(-1, nv)
        if is_determined(shared):
            tau = borne(rows, shared.columns, tau)
        else:
            tau = borne_least(rows, shared.columns, tau, shared.tolerance)
        tau = tau.reshape(count, samples, -1)
    return rule_of(tape, {"rounding": largest_differences(tau[None])})


def borne_rule(load: Array, psi: Array, driven: Sequence[int]) -> tuple[Rule, dict[str, Any]]:
    """Return the rule of torques (T, n) that bear loads (T, nv) with Psi (T, m, nv), and whether these hold them safely
    at all samples, and between them with the same sign."""
    tape = Tape()
    rows: Any = tape.input("psi", psi)
    u: Any = tape.input("load", load)
    both = shared_rows(rows, driven)
    inverse = np.linalg.solve(both, np.broadcast_to(np.eye(load.shape[1]), both.shape))
    condition: Any = np.abs(both).sum(axis=2).max(axis=1) * np.abs(inverse).sum(axis=2).max(axis=1)
    good = (condition < CERTAIN).all() & same_branch(both[:-1], both[1:]).all()
    return rule_of(tape, {"tau": (inverse @ u[:, :, None])[:, : len(driven), 0], "good": good})


def is_determined(shared: Hold) -> bool:
    """Tell whether actuators and rows of the loops are just as many as it takes."""
    return len(shared.columns) == shared.commanded and shared.rank == shared.psi.shape[1]


def named_figures(joints: Sequence[str], units: Sequence[Mapping[str, str]]) -> list[dict[str, Any]]:
    """Return the figures of joints in the order of the page, each with its place in the rule's outputs."""
    found = []
    for k, joint in enumerate(joints):
        for figure in FIGURES:
            leaf = leaf_of("inverse", f"joints.{joint}.{figure}")
            assert leaf is not None
            unit = "s" if figure.endswith("_time") else units[k][KINDS[figure.partition(".")[0]]]
            found.append({
                "name": f"{NAMES.get(figure, figure.replace('_', ' '))} of {joint}", "unit": unit, "of": figure,
                "entry": k, "rounded": ROUNDING in leaf.errors,
            })  # fmt: skip
    return found
