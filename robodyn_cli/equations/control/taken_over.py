"""States of a controller that a stored run had, for a run that goes on from there."""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np

from robodyn_cli.equations.control.control import MEASURED, MEASURED_RATES, Control
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Array

MOST_NAMES = 8  # that are listed
LAST = "last."  # what positions that were measured were called


@record
class TakenOver:
    """The states (nc,) of a controller, and what is to be told of them."""

    states: Array
    told: tuple[str, ...]


def taken_over(control: Control | None, stored: Mapping[str, float], q: Array, v: Array) -> TakenOver:
    """Return the states of a controller from stored ones by name.

    What its sensors gave last may be lacking: of a run of a version that did not store it, or of a controller that saw
    all as it is. Then that is what is there, positions q (nq,) and rates v (nv,), until its next sample.

    Raises
    ------
    ValueError : in words: the stored ones are of another controller.
    """
    needed = () if control is None else control.names
    have = {_renamed(name): x for name, x in stored.items()}
    there: dict[str, float] = {}
    if control is not None:
        model = control.problem.model
        there = {f"{MEASURED}.{name}": x for name, x in zip(model.q_names, q.tolist())}
        there |= {f"{MEASURED_RATES}.{name}": x for name, x in zip(model.v_names, v.tolist())}
    lacking = tuple(name for name in needed if name not in have)
    over = [name for name in have if name not in needed and not _is_seen(name)]
    if over or any(name not in there for name in lacking):
        raise ValueError(
            f"has states of a controller (control/states): {_listed(stored)}; this scene's controller has "
            f"{_listed(needed)}"
        )
    told = (
        f"what the sensors gave last is not in the stored run ({_listed(lacking)}); until the next sample it is what "
        "is there"
    )
    states = np.array([(there | have)[name] for name in needed], dtype=float)
    return TakenOver(states, (told,) if lacking else ())


def _listed(names: Collection[str]) -> str:
    shown = ", ".join(list(names)[:MOST_NAMES])
    return f"{shown}, ... ({len(names)})" if len(names) > MOST_NAMES else shown or "none"


def _is_seen(name: str) -> bool:
    return name.startswith((f"{MEASURED}.", f"{MEASURED_RATES}."))


def _renamed(name: str) -> str:
    """Return the name that a state has now."""
    return f"{MEASURED}.{name[len(LAST) :]}" if name.startswith(LAST) else name
