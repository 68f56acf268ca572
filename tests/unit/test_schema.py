"""The JSON Schema of scenes: sound, open to every good scene, closed to what the reader refuses."""

from __future__ import annotations

import copy
import dataclasses
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from typer.testing import CliRunner

from robodyn_cli.cli.app import app
from robodyn_cli.errors import SceneError
from robodyn_cli.scene.load import load_scene, load_scene_text
from robodyn_cli.scene.read import Reader
from robodyn_cli.scene.read_scalars import Names
from robodyn_cli.scene.text.includes import Includer
from robodyn_cli.scene.text.nodes import Faults, Scalar, Source, mapping, sequence
from robodyn_cli.scene.types import Scene
from robodyn_cli.schema import fields as kinds
from robodyn_cli.schema.json_schema import _Maker, json_schema
from tests.unit.scene_text import plain

ROOT = Path(__file__).parents[2]
CONFIGS = sorted((ROOT / "configs").rglob("*.yaml"))
SCENES = [path for path in CONFIGS if re.search(r"^schema:", path.read_text("utf-8"), re.MULTILINE)]
SCHEMA = json_schema(Scene)
VALIDATOR = jsonschema.Draft202012Validator(SCHEMA)


def data(path: Path) -> Any:
    return plain(Includer(Faults()).open_root(str(path)))


def test_it_is_a_schema() -> None:
    """``check_schema`` raises an error else."""
    jsonschema.Draft202012Validator.check_schema(SCHEMA)


def test_the_command_prints_it() -> None:
    done = CliRunner().invoke(app, ["schema"])
    printed = json.loads(done.output)
    assert done.exit_code == 0 and printed["$schema"].endswith("2020-12/schema")
    assert printed["$defs"] == SCHEMA["$defs"]


@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)
def test_every_config_validates(path: Path, tmp_path: Path) -> None:
    assert not [e.message for e in VALIDATOR.iter_errors(data(path))]
    resolved = tmp_path / "resolved.yaml"
    resolved.write_text(load_scene(path).text)
    assert not [e.message for e in VALIDATOR.iter_errors(data(resolved))]


def test_every_key_has_words_and_numbers_their_unit() -> None:
    for name, section in SCHEMA["$defs"].items():
        for key, value in section["properties"].items():
            assert "const" in value or value.get("description"), f"{name}.{key}"
    mass = SCHEMA["$defs"]["Link"]["properties"]["mass"]
    assert mass["description"] == "Mass. A number >= 0 [kg]."
    assert {"type": "number", "minimum": 0.0} in mass["anyOf"][0]["anyOf"]


# lists and maps that say what there is, which may be nothing; all others ask for something
MAY_BE_EMPTY = {
    "Scene.loops", "Scene.forces", "Scene.payloads", "Scene.couplers", "Scene.actuated", "Scene.drives", "Scene.parameters",
    "Scene.expect", "Initial.hold", "Robot.points", "Robot.frames", "Robot.loops", "Robot.couplers", "Robot.attach",
    "Link.visual", "Attachment.visual", "Catalogue.motors", "Catalogue.gears", "Catalogue.brakes", "ByFormulas.state",
}  # fmt: skip


def collections(kind: Any, key: str, seen: set[type]) -> Iterator[tuple[str, kinds.Collection]]:
    """Yield the lists and maps that keys of a scene may hold."""
    if isinstance(kind, kinds.Collection):
        yield key, kind
    inner = [getattr(kind, "item", None), *getattr(kind, "kinds", ())]
    classes = [kind.cls] if isinstance(kind, kinds.Section) else []
    if isinstance(kind, (kinds.Tagged, kinds.Inline)):
        classes += kind.registry().values()
    for cls in classes:
        if cls not in seen:
            seen.add(cls)
            for field in dataclasses.fields(cls):
                yield from collections(
                    field.metadata.get("kind"), f"{cls.__name__}.{kinds.key_name(field)}", seen
                )
    for one in inner:
        if one is not None:
            yield from collections(one, key, seen)


COLLECTIONS = dict(collections(kinds.Section(Scene), "", set()))


@pytest.mark.parametrize("key", COLLECTIONS)
def test_what_asks_for_something_is_not_empty(key: str) -> None:
    kind = COLLECTIONS[key]
    assert (kind.minimum == 0) == (key in MAY_BE_EMPTY or (type(kind) is kinds.JointMap and not kind.minimum))
    is_list = isinstance(kind, kinds.ListOf)
    place = Scalar(Source("scene.yaml", "."), 3, 7, "", None)
    empty = sequence(place, []) if is_list else mapping(place, [])
    validator = jsonschema.Draft202012Validator(_Maker().kind(kind))
    faults = Faults()
    value = Reader(Names(), faults, {}).value(kind, empty, (key,))
    assert validator.is_valid([] if is_list else {}) == (kind.minimum == 0)
    if kind.minimum:
        assert faults.found[0].message.startswith(f"scene.yaml:3:7: {key}: has no entry (value an empty ")
    else:
        assert not faults.found and not value


def arm() -> dict[str, Any]:
    return copy.deepcopy(
        {
            "schema": 1,
            "gravity": [0, -9.81, 0],
            "robot": {
                "convention": "standard",
                "joints": [{"name": "j1", "type": "revolute", "a": 1.0}],
                "links": [{"name": "l1", "mass": 1, "com": [0.5, 0, 0], "com_frame": "joint"}],
            },
            "initial": {"q": {"j1": "30 deg"}},
            "expect": {"status": "ok", "energy_drift": "< 1e-9"},
            "simulate": {"rtol": 1e-9},
            "trajectory": {
                "type": "circle",
                "point": "l1.end",
                "center": [1, 1],
                "radius": 0.1,
                "duration": 1,
            },
        }
    )


def spoil(where: str, value: Any) -> dict[str, Any]:
    scene = arm()
    *steps, last = [int(s) if s.isdecimal() else s for s in where.split(".")]
    node: Any = scene
    for step in steps:
        node = node[step]
    if value is ...:
        del node[last]
    else:
        node[last] = value
    return scene


BAD = [
    ("schema", 2), ("schema", ...), ("robot", ...), ("gravity", [0, 1]), ("gravity", "down"), ("gravty", 1),
    ("robot.joints", []), ("robot.joints.0.name", "1a"), ("robot.joints.0.name", "a-b"),
    ("robot.joints.0.type", "hinge"),
    ("robot.joints.0.alpa", 0), ("robot.links.0.mass", -1), ("robot.links.0.mass", "heavy"), ("robot.convention", "dh"),
    ("initial.q", [1]), ("initial.q.j1", True), ("simulate.rtol", 1.0), ("simulate.samples", 1.5),
    ("simulate.integrator", "euler"), ("simulate.stabilisation", {"alpha": 1}), ("simulate.stabilisation", "penalty"),
    ("trajectory.type", "spiral"), ("trajectory.radius", ...), ("trajectory.radius", 0), ("trajectory.speed", 1),
    ("robot.joints.0.friction", {"viscous": -1}), ("robot.joints.0.friction", {"coulomb": {"positive": 1}}),
    ("torques", {"j1": [1]}), ("actuated", "j1"), ("expect", ["ok"]), ("command", "fly"),
]  # fmt: skip


@pytest.mark.parametrize(("where", "value"), BAD)
def test_what_it_refuses_the_reader_refuses_too(where: str, value: Any) -> None:
    scene = spoil(where, value)
    assert not VALIDATOR.is_valid(scene)
    with pytest.raises(SceneError):
        load_scene_text(json.dumps(scene))


def alternatives() -> Iterator[tuple[str, Any]]:
    yield "robot", "robots/arm.yaml"
    yield "robot", {"include": "robots/arm.yaml", "base": {"xyz": [0, 0, 1]}}
    yield "trajectory", {"include": "circle.yaml", "radius": 0.2}
    yield "trajectory", "circle.yaml"
    yield "robot.links.0.mass", "1/12"
    yield "robot.links.0.mass", None
    yield "robot.joints.0.friction", {"viscous": 0.1, "coulomb": {"positive": 1, "negative": -1}}
    yield "simulate.stabilisation", {"alpha": 5, "beta": 5}
    yield "torques", {"j1": "sin(t)"}
    yield "torques", {"j1": {"table": [[0, 1], [1, 2]]}}
    yield "torques", None
    yield "expect", {"lock": {"time": "1 +- 1"}}


@pytest.mark.parametrize(("where", "value"), list(alternatives()))
def test_it_allows_every_form(where: str, value: Any) -> None:
    assert not [e.message for e in VALIDATOR.iter_errors(spoil(where, value))]


def test_the_arm_itself_is_good() -> None:
    assert VALIDATOR.is_valid(arm())
    assert load_scene_text(json.dumps(arm())).robot.joints
