"""A study: many runs of one scene with other values of some keys, and what they say together."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from robodyn_cli.commands import STUDIED
from robodyn_cli.errors import SceneError
from robodyn_cli.expr.statements import Variation
from robodyn_cli.kernels.cache import code_digest
from robodyn_cli.model.build import build_model
from robodyn_cli.model.model import Model
from robodyn_cli.over.batch.criteria import lookup, refuse_unknown
from robodyn_cli.over.many.command import number_of
from robodyn_cli.over.many.keys import Allowed, key_unit, setting, settings, understand
from robodyn_cli.over.study.design import Design, make_design
from robodyn_cli.over.study.rows import RowFile, RunRows, Task
from robodyn_cli.over.study.runs import make_one
from robodyn_cli.record import record
from robodyn_cli.results.summary import sha256
from robodyn_cli.scene.checks.check import EXTREMES, LOCKS
from robodyn_cli.scene.checks.keys import key_names, latch_units, places_of
from robodyn_cli.scene.load import Family
from robodyn_cli.scene.text.overrides import AskedSetting
from robodyn_cli.scene.types import Scene, StudyOptions
from robodyn_cli.scene.units import refuse_doubles
from robodyn_cli.summaries.keys import leaf_of, refusal

NO_NUMBERS = ("wall_time_s", "counters", "run_id")


@record
class AskedStudy:
    """A study as it was asked for.

    family : the scenes that are run. options : of the scene's section ``study``, with what the command line says in its
    place. indices : whether to compute Sobol's indices.
    """

    family: Family
    options: StudyOptions
    indices: bool = False


@record
class Study:
    """A study that makes sense, before it runs.

    scene : as it stands. units : by key that varies. output_units : by output. nominal : the row of the run
    of the scene as it stands, which took so many seconds.
    """

    asked: AskedStudy
    task: Task
    design: Design
    units: dict[str, str]
    output_units: dict[str, str]
    nominal: Any
    seconds: float

    @property
    def scene(self) -> Scene:
        return self.asked.family.own

    @property
    def digest(self) -> str:
        """What rows of an earlier study must share with this one to stand for its own."""
        task = self.task
        return sha256(
            "\n".join([code_digest(), self.scene.text, task.command, *task.keys, "", *task.outputs])
        )

    @property
    def rows_head(self) -> dict[str, str]:
        """What rows of an unfinished study must share with this one; see ``RowFile``."""
        return {"study": self.digest, "design": sha256(repr((self.asked.options, self.asked.indices)))}

    def repeat(self, values: Sequence[float]) -> str:
        """Return the command that repeats a run."""
        return repeated(self.asked.family, self.task, values)


def repeated(family: Family, task: Task, values: Sequence[float]) -> str:
    """Return the command line that repeats a run of a task with these values of its keys."""
    texts = [*family.overrides, *settings(task.keys, values)]
    options = " ".join(f"--set {_quoted(text)}" for text in texts)
    return f"robodyn {task.command} {family.path} {options}"


def _quoted(text: str) -> str:
    return "'" + text.replace("'", "'\\''") + "'" if any(c in text for c in " '\"$&|;<>()*?[]{}\\`") else text


def options_of(given: StudyOptions, **own: Any) -> StudyOptions:
    """Return the options of a scene with those of the command line in their place; None leaves one as it is."""
    changed = {name: value for name, value in own.items() if value is not None}
    return dataclasses.replace(given, **changed)


def prepare(asked: AskedStudy) -> Study:
    """Check a study, and run its scene once as it stands.

    Raises
    ------
    SceneError : the scene names no command, or a key does not exist or takes no such numbers; an output
        is not in the summary; the study makes no sense.
    """
    family, options = asked.family, asked.options
    scene = family.own
    if scene.command not in STUDIED:
        message = "is missing" if scene.command is None else f"is {scene.command}"
        raise SceneError(
            f"key 'command' {message}: it says what each run does; allowed: {', '.join(STUDIED)}",
            (family.path,),
        )
    if options.least_yield is not None and not scene.expect:
        raise SceneError(
            "key 'expect' is missing: a yield is the share of runs that hold what it says",
            (family.path,),
            key="expect",
        )
    design = make_design(options, asked.indices)
    for key, variation in options.vary.items():
        check_key(family, key, variation)
    refuse_doubles(family.root, options.vary, "--vary")
    wanted = options.of or tuple(key for key, e in scene.expect.items() if e.numeric and key != "exit_code")
    task = Task(family, scene.command, design.keys, wanted)
    source = "expect:" if not options.of else "study.of:" if options.of == scene.study.of else "--of"
    start = time.perf_counter()
    nominal = run_nominal(task, source).rows[0]
    seconds = time.perf_counter() - start
    model = build_model(scene)
    units = {key: key_unit(family, understand(family, key), model) for key in design.keys}
    output_units = units_of_keys(task, model)
    return Study(asked, task, design, units, output_units, nominal, seconds)


def check_key(family: Family, key: str, variation: Variation) -> None:
    """Refuse a key that the scene does not have, or a value of a grid that it does not take."""
    x, asked = variation.example, varied(key, variation)
    with_unit = AskedSetting(f"{key}={x!r} {variation.unit}", asked)
    family.scene([with_unit if variation.unit else setting(key, x, asked)])
    if variation.is_grid:
        allowed = Allowed(family, [understand(family, key, asked)], asked)
        for error in allowed.refusals(np.array(variation.values)[:, None]).values():
            raise error


def varied(key: str, variation: Variation) -> str:
    """Return the option that asks for a variation, as messages name it."""
    return f"--vary {key}={variation.text}"


def units_of_keys(task: Task, model: Model) -> dict[str, str]:
    """Return the units of the outputs of a study."""
    leaves = ((key, leaf_of(task.command, key)) for key in task.outputs)
    units, scene = dict(model.coordinate_units), task.family.own
    if any(key.startswith(LOCKS) for key in task.outputs):
        units |= latch_units(scene)
    if any(key.startswith(EXTREMES) for key in task.outputs):
        from robodyn_cli.scene.checks.columns import units_of_columns

        units |= {name: unit or "1" for name, unit in units_of_columns(scene, places_of(scene)).items()}
    return {key: leaf.unit(units) for key, leaf in leaves if leaf is not None}


def run_nominal(task: Task, source: str) -> RunRows:
    """Return what the run of the scene as it stands gave; source : what named the outputs.

    Raises
    ------
    SceneError : no output is named, or the summary of this run does not have one, or it is no number.
    """
    for key in task.outputs:
        if wrong := refusal(task.command, key, key_names(task.family.own), number=True):
            raise SceneError(f"{source} {key}: {wrong}", key=f"{source} {key}")
    made, summary = make_one(dataclasses.replace(task, keys=()), 0, np.empty(0))
    if not summary:
        raise SceneError(f"the scene as it stands does not run: {made.reasons[0]}", (task.family.path,))
    if not task.outputs:
        known = ", ".join(_numbers(summary))
        raise SceneError(
            f"no output is named; give --of KEY, or study.of; numbers here: {known}", (task.family.path,)
        )
    for key in task.outputs:
        asked = f"{source} {key}"
        refuse_unknown(summary, key, asked)
        value = lookup(summary, key)
        if not made.reasons and value is not None and math.isnan(number_of(summary, key)):
            raise SceneError(f"{asked}: is {value!r}, which is not a number")
    return made


def _numbers(facts: Mapping[str, Any], path: str = "") -> list[str]:
    keys = []
    for name, value in facts.items():
        if isinstance(value, Mapping) and name not in NO_NUMBERS:
            keys += _numbers(value, f"{path}{name}.")
        elif isinstance(value, (int, float)) and not isinstance(value, bool):
            keys.append(f"{path}{name}")
    return keys


Make = Callable[[Task, RowFile], Iterator[RunRows]]


def run_study(study: Study, file: RowFile, make: Make, tell: Callable[[int, int], None]) -> None:
    """Make all runs of a study that are not there.

    Parameters
    ----------
    file : that takes the rows. make : yields those of missing runs, some at a time, here or on a cluster.
    tell : is told how many of how many runs are done.
    """
    tell(file.done, len(file))
    for rows in make(study.task, file):
        file.add(rows)
        tell(file.done, len(file))
