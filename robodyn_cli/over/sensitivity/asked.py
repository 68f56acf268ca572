"""What is asked of a sensitivity: outputs of a scene's command, and keys that they may depend on."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from functools import cached_property

from robodyn_cli.commands import STUDIED
from robodyn_cli.errors import SceneError, of_option
from robodyn_cli.model.build import build_model
from robodyn_cli.model.places import numbers_at_places, with_free
from robodyn_cli.over.many.keys import (
    NUMBER,
    STRUCTURE,
    Key,
    key_unit,
    setting,
    settings,
    understand,
    value_of,
)
from robodyn_cli.over.study.rows import RunRows, Task
from robodyn_cli.over.study.study import run_nominal, units_of_keys
from robodyn_cli.record import record
from robodyn_cli.scene.checks.columns import asking
from robodyn_cli.scene.load import Family
from robodyn_cli.scene.text.nodes import Scalar, located
from robodyn_cli.scene.text.numbers import counted
from robodyn_cli.scene.types import Scene
from robodyn_cli.scene.units import node_at, refuse_doubles

NEARBY = 1e-3  # part of a key's value by which it is changed to see whether the scene takes other numbers


@record
class AskedSlopes:
    """Derivatives that make sense to ask for.

    task : the command, the keys and the outputs. keys : what each key is. values : of the keys, in SI units. nominal :
    the run of the scene as it stands. units, output_units : of keys and outputs. compared : keys, by number, and code
    of which it is known that the keys are no structure; others that are asked for at other values share it.
    """

    task: Task
    keys: tuple[Key, ...]
    values: tuple[float, ...]
    nominal: RunRows
    units: tuple[str, ...]
    output_units: tuple[str, ...]
    compared: set[tuple[int | str, ...]] = dataclasses.field(default_factory=set)

    @cached_property
    def scene(self) -> Scene:
        """The scene as it stands, whose keys are numbers even where they are zero, a default or an angle."""
        return self._free(self.task.family.own)

    def _free(self, scene: Scene) -> Scene:
        return with_free(asking(scene, self.task.outputs), self.freed)

    @property
    def freed(self) -> frozenset[str]:
        """Places of the keys that may be numbers of the equations."""
        return frozenset(key.place for key in self.keys if key.sort in (NUMBER, STRUCTURE))

    @property
    def outputs(self) -> list[float]:
        """The outputs of the scene as it stands."""
        outputs: list[float] = self.nominal.rows["outputs"][0].tolist()
        return outputs

    @property
    def errors(self) -> list[float]:
        """Their estimated errors, nan where the run tells none."""
        errors: list[float] = self.nominal.rows["errors"][0].tolist()
        return errors

    def changed(self, numbers: Iterable[int], part: float) -> Scene:
        """Return the scene with some keys, by number, changed by a part of their values."""
        values = {self.task.keys[k]: self.values[k] + part * (abs(self.values[k]) or 1.0) for k in numbers}
        return self._free(self.task.family.scene(settings(list(values), values.values())))

    def places(self, numbers: Iterable[int]) -> list[str]:
        """Return the places of some keys, empty of keys that are no numbers of the equations."""
        return [place if (place := self.keys[k].place) in self.placed else "" for k in numbers]

    @cached_property
    def placed(self) -> dict[str, float]:
        """The numbers that enter the equations, by place."""
        return numbers_at_places(self.scene)


def prepare(family: Family, to: Sequence[str], of: Sequence[str]) -> AskedSlopes:
    """Check what is asked for, and run the scene once as it stands.

    Raises
    ------
    SceneError : the scene names no command, or fails; a key does not exist, has no number, or takes no others; an
        output is not in the summary, or is no number.
    """
    scene = family.own
    if scene.command not in STUDIED:
        message = "is missing" if scene.command is None else f"is {scene.command}"
        raise SceneError(
            f"key 'command' {message}: it says whose summary is meant; allowed: {', '.join(STUDIED)}", (family.path,),
            file=family.path, key="command",
        )  # fmt: skip
    if not to:
        raise SceneError(
            "no key is named that varies; give --to KEY, e.g. robot.links.NAME.mass", (family.path,)
        )
    refuse_doubles(family.root, to, "--to")
    pairs = [_of_key(family, name) for name in to]
    task = Task(family, scene.command, tuple(to), tuple(dict.fromkeys(of)))
    nominal = run_nominal(task, "--of")
    for reason in nominal.reasons.values():
        raise SceneError(
            f"the scene as it stands fails, so nothing has a derivative: {reason}", (family.path,)
        )
    model = build_model(scene)
    return AskedSlopes(
        task, tuple(key for key, _ in pairs), tuple(value for _, value in pairs), nominal,
        tuple(key_unit(family, key, model) for key, _ in pairs),
        tuple(units_of_keys(task, model).values()),
    )  # fmt: skip


def _of_key(family: Family, name: str) -> tuple[Key, float]:
    """Return what a key is, and its value in the scene as it stands.

    Raises
    ------
    SceneError : it does not exist, has no number there, or does not take others nearby.
    """
    node, refused, asked = node_at(family.root, name), None, f"--to {name}"
    try:
        key, value = understand(family, name, asked), value_of(family, name, asked)
        if value is not None:
            family.scene([setting(name, value + NEARBY * (value or 1.0), asked)])
            return key, value
    except SceneError as error:
        refused = error
    is_number = counted(name)[1] or (isinstance(node, Scalar) and isinstance(node.value, (int, float)))
    if refused is not None and (node is None or is_number):
        # the key does not exist, or takes whole numbers alone; told without the value that it was tried with
        raise refused
    text = "the scene has no number there; allowed: a key with a number, or KEY#n, its n-th number"
    if node is None:
        raise of_option(f"--to {name}", text, key=name)
    raise located(node, name, text)
