"""The result of sensitivities: derivatives with their errors, ranked by how much a part of a key moves an output.

Derivatives of outputs of a scene's command by keys of the scene, for Python.
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Sequence

import numpy as np

from robodyn_cli.observe.units import unit_text
from robodyn_cli.over.sensitivity.asked import prepare
from robodyn_cli.over.sensitivity.slope import EXACT, Slope, why_not
from robodyn_cli.over.sensitivity.slopes import Sensitivities, sensitivities
from robodyn_cli.results.result import Result
from robodyn_cli.scene.load import Family
from robodyn_cli.scene.types import Scene
from robodyn_cli.summaries.facts import ABSENT
from robodyn_cli.summaries.study import OF_KEY, OF_OUTPUT, NominalNumber, SensitivitySummary, SlopeKeys


def report(found: Sensitivities, seconds: float) -> Result:
    """Return the result: for each output its derivatives by the keys, their errors, and which are exact."""
    asked = found.asked
    task = asked.task
    result = Result("sensitivity", asked.scene.title or task.command, "ok", asked.scene.text)
    key_units = tuple(unit or "1" for unit in asked.units)
    result.add(
        "keys/value", asked.values, units=unit_text(key_units), column_units=key_units, names=task.keys
    )
    for k, (name, slopes) in enumerate(zip(task.outputs, found.slopes)):
        units = tuple(quotient(asked.output_units[k], unit) for unit in asked.units)
        value = asked.outputs[k]
        columns = {
            "derivatives": [s.value for s in slopes],
            "derivative_errors": [s.error for s in slopes],
            "normalised": [_nan(normalised(s, key, value)) for s, key in zip(slopes, asked.values)],
            "exact": [float(s.method == EXACT) for s in slopes],
        }
        for group, (meaning, own) in MEANINGS.items():
            result.add(
                f"{group}/{name}", columns[group], long_name=meaning.format(name),
                units="1" if own else unit_text(units), column_units=() if own else units, names=task.keys,
            )  # fmt: skip
    result.summarise(
        SensitivitySummary(
            of=task.command,
            nominal={
                name: NominalNumber(y, unit, None if math.isnan(error) else error)
                for name, y, unit, error in zip(task.outputs, asked.outputs, asked.output_units, asked.errors)
            },
            keys={
                name: NominalNumber(x, unit) for name, x, unit in zip(task.keys, asked.values, asked.units)
            },
            sensitivities={
                name: _ranked(found, k, slopes)
                for k, (name, slopes) in enumerate(zip(task.outputs, found.slopes))
            },
            seconds=seconds,
        )
    )
    return result


# of datasets: what they hold, and whether they are plain numbers
MEANINGS = {
    "derivatives": ("derivative of {} by each key", False),
    "derivative_errors": ("estimated error of the derivative of {} by each key", False),
    "normalised": ("derivative of {} by each key times the key over the output", True),
    "exact": ("1 where the derivative of {} is exact, 0 where it is by differences", True),
}


def _ranked(found: Sensitivities, output: int, slopes: Sequence[Slope]) -> dict[str, SlopeKeys]:
    """Return the derivatives of one output by key, those first that move it most."""
    asked = found.asked
    value, name_of = asked.outputs[output], asked.task.outputs[output]
    keys = {}
    for k, (name, slope) in enumerate(zip(asked.task.keys, slopes)):
        reason = slope.reason or ("" if slope.method == EXACT else found.obstacles.get(k, why_not(name_of)))
        keys[name] = SlopeKeys(
            derivative=_finite(slope.value),
            error=_finite(slope.error),
            unit=quotient(asked.output_units[output], asked.units[k]),
            normalised=normalised(slope, asked.values[k], value),
            method=slope.method,
            reason=reason or ABSENT,
        )
    return dict(sorted(keys.items(), key=lambda item: _weight(item[1]), reverse=True))


def _weight(slope: SlopeKeys) -> tuple[float, float]:
    """Return by what derivatives are ranked: the normalised one, else the plain one."""
    return abs(slope.normalised or 0.0), abs(slope.derivative or 0.0)


def normalised(slope: Slope, key: float, output: float) -> float | None:
    """Return (key / output) d output / d key, None where either is zero or there is no derivative."""
    if not (key and output and math.isfinite(slope.value)):
        return None
    return slope.value * key / output if abs(slope.value) > slope.error else 0.0


def quotient(unit: str, of: str) -> str:
    """Return the unit of a derivative; ``N/(unit of the key)`` where one of both is not known, as in a formula."""
    unit, of = unit or f"({OF_OUTPUT})", of or OF_KEY
    if of == "1":
        return unit
    below = f"({of})" if " " in of or "/" in of else of
    return f"{unit}/{below}"


def _finite(x: float) -> float | None:
    return x if math.isfinite(x) else None


def _nan(x: float | None) -> float:
    return np.nan if x is None else x


def sensitivity(
    scene: Scene | Family | str | os.PathLike[str], to: Sequence[str], of: Sequence[str], jobs: int = 1
) -> Result:
    """Return the derivatives d output / d key, each with its estimated error.

    Parameters
    ----------
    scene : names a command; its file, or as it was loaded.
    to : keys of the scene with a number, as in ``--set``; ``KEY#n`` is the n-th number of a formula.
    of : keys of the summary of the command.
    jobs : processes or threads for runs of central differences.

    Returns
    -------
    A Result with a dataset ``derivatives/OUTPUT`` (keys,) in SI units for each output, ``derivative_errors/OUTPUT``,
    ``normalised/OUTPUT`` (key / output times the derivative) and ``exact/OUTPUT``; ``summary["sensitivities"]`` ranks
    them and says why one is not exact.

    Raises
    ------
    SceneError : the scene names no command, or fails; a key does not exist, has no number, or takes no others; an
        output is not in the summary, or is no number.
    """
    start = time.perf_counter()
    family = (
        scene
        if isinstance(scene, Family)
        else Family.of(scene)
        if isinstance(scene, Scene)
        else Family(scene)
    )
    found = sensitivities(prepare(family, to, of), jobs)
    return report(found, time.perf_counter() - start)
