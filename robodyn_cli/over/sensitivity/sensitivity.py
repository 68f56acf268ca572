"""Derivatives of outputs of a scene's command by keys of the scene, for Python."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence

from robodyn_cli.over.sensitivity.asked import prepare
from robodyn_cli.over.sensitivity.report import report
from robodyn_cli.over.sensitivity.slopes import sensitivities
from robodyn_cli.results.result import Result
from robodyn_cli.scene.load import Family
from robodyn_cli.scene.types import Scene


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
