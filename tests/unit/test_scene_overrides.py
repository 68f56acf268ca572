"""``--set``: what it can address, in which order it applies, and how a wrong one is quoted."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from robodyn_cli.errors import SceneError
from robodyn_cli.scene import load_scene, load_scene_text
from robodyn_cli.scene.types import Scene
from tests.unit.scene_text import SCENE, complaint


def load(*overrides: str, text: str = SCENE) -> Scene:
    return load_scene_text(text, overrides=overrides)


def reach(value: Any, path: str) -> Any:
    """Follow attributes, keys and indices."""
    for step in path.split("."):
        if isinstance(value, dict):
            value = value[step]
        elif isinstance(value, tuple):
            value = value[int(step)]
        else:
            value = getattr(value, step)
    return value


@pytest.mark.parametrize(
    ("override", "path", "value"),
    [
        ("title=A title", "title", "A title"),
        ('title="12"', "title", "12"),
        ("title = spaced ", "title", "spaced"),
        ("title='a=b'", "title", "a=b"),
        ("gravity=[0, 0, -1.62]", "gravity", (0.0, 0.0, -1.62)),
        ("gravity.1=1e-9", "gravity.1", 1e-9),
        ("robot.joints.0.a=2", "robot.joints.0.a", 2.0),
        ("robot.joints.j1.a=pi/2", "robot.joints.0.a", 1.5707963267948966),
        ("robot.joints.j1.alpha=-90 deg", "robot.joints.0.alpha", -1.5707963267948966),
        ("robot.links.l3.com=[1, 2, 3]", "robot.links.2.com", (1.0, 2.0, 3.0)),
        ("robot.links.l1.mass=null", "robot.links.0.mass", None),
        ("simulate.rtol=1e-6", "simulate.rtol", 1e-6),
        ("simulate={duration: 3, samples: 7}", "simulate.samples", 7),
        ("initial.qd.j1=180 deg", "initial.qd.j1", 3.141592653589793),
        ("initial.q={}", "initial.q", {}),
        ("robot.points.tip.at=[1, 2, 3]", "robot.points.tip.at", (1.0, 2.0, 3.0)),
        ("robot.joints.j1.friction.viscous=0.3", "robot.joints.0.forces.0.1.viscous", 0.3),
        ("actuated=[j1]", "actuated", ("j1",)),
        ("simulate.error_estimate=false", "simulate.error_estimate", False),
        ("deploy.latch.between=[l1, base]", "deploy.latch.between", ("l1", "base")),
        ("command=simulate", "command", "simulate"),
    ],
)
def test_what_can_be_set(override: str, path: str, value: Any) -> None:
    assert reach(load(override), path) == value


def test_formulas_keep_their_commas() -> None:
    torque = load("torques.j1=if(t < 1, 2, 3)").torques["j1"]
    assert [torque.evaluate({"t": t}) for t in (0.0, 2.0)] == [2.0, 3.0]


def test_later_ones_win_and_build_on_earlier_ones() -> None:
    assert load("title=a", "title=b").title == "b"
    scene = load("loops=[{name: pin, type: revolute, between: [l1.end, l2.end]}]", "loops.pin.axis=[1, 0, 0]")
    assert scene.loops[0].axis == (1.0, 0.0, 0.0)


def test_nothing_else_changes() -> None:
    scene = load("robot.joints.0.a=1.0", "simulate.rtol=1e-10")
    assert scene == load()
    before, after = load().text.splitlines(), load("robot.joints.0.a=2.5").text.splitlines()
    assert [b for a, b in zip(before, after) if a != b] == [
        "    - {name: j1, type: revolute, a: 2.5, alpha: 0, d: 0}"
    ]


def test_null_removes() -> None:
    text = SCENE.replace("a: 1.0", "a: 1.0, friction: {viscous: 1}").replace(
        "com_frame: joint}", "com_frame: joint, inertia: {zz: 1}}"
    )
    text += "simulate: {duration: 3}\n"
    assert load(text=text) != load()
    gone = ("robot.joints.j1.friction", "simulate", "robot.links.l1.inertia.zz")
    assert load(*(f"{key}=null" for key in gone), text=text) == load()
    assert not load("torques.j1=null").torques
    pins = "loops=[{name: p, type: revolute, between: [l1.end, l2.end]}, {name: b, type: distance, between: [l1.end, l2.end], length: 1}]"
    assert [loop.name for loop in load(pins, "loops.p=null").loops] == ["b"]


@pytest.mark.parametrize(
    "override", ["title=null", "inverse.samples=null", "robot.joints.1.spring.rest=null"]
)
def test_null_removes_what_is_not_there_too(override: str) -> None:
    text = SCENE.replace("title: ", "# ")
    assert load(override, text=text) == load(text=text)


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("gravity=null", "'gravity' is missing"),
        ("gravity.0=null", "has 2 entries"),
        ("robot=null", "'robot' is missing"),
    ],
)
def test_what_is_needed_cannot_be_removed(override: str, words: str) -> None:
    assert words in complaint(SCENE, (override,)).message


def test_aliases_are_not_changed_together() -> None:
    text = SCENE.replace("- {name: l2, mass: 1}", "- {name: l2, mass: 1, inertia: &i {zz: 1}}")
    text = text.replace("- {name: l3, mass: 1}", "- {name: l3, mass: 1, inertia: *i}")
    scene = load("robot.links.l3.inertia.zz=5", text=text)
    assert [link.inertia.zz for link in scene.robot.links] == [None, 1.0, 5.0]


def test_the_text_holds_what_was_set() -> None:
    scene = load("gravity=[1, 2, 3]", "title='a: b'")
    assert load_scene_text(scene.text) == scene


# -- files --------------------------------------------------------------------------------------------
ROBOT = SCENE[SCENE.index("robot:\n") + len("robot:\n") : SCENE.index("torques")]


def with_files(tmp_path: Path) -> Path:
    (tmp_path / "robot.yaml").write_text("\n".join(line[2:] for line in ROBOT.splitlines()))
    (tmp_path / "other.yaml").write_text((tmp_path / "robot.yaml").read_text().replace("a: 1.0", "a: 7.0"))
    path = tmp_path / "scene.yaml"
    path.write_text("schema: 1\ngravity: [0, 0, 0]\nrobot: robot.yaml\n")
    return path


def test_what_stands_in_an_included_file(tmp_path: Path) -> None:
    path = with_files(tmp_path)
    assert load_scene(path, ["robot.joints.j1.a=3"]).robot.joints[0].a == 3.0
    assert load_scene(path, ["robot.base.xyz=[1, 0, 0]"]).robot.base.xyz == (1.0, 0.0, 0.0)


def test_another_file(tmp_path: Path) -> None:
    path = with_files(tmp_path)
    assert load_scene(path, ["robot=other.yaml"]).robot.joints[0].a == 7.0
    assert load_scene(path, ["robot=other.yaml", "robot.joints.j1.a=8"]).robot.joints[0].a == 8.0
    assert load_scene(path, ["robot={include: other.yaml, base: {xyz: [1, 2, 3]}}"]).robot.base.xyz[2] == 3.0
    # the file that is replaced need not exist
    (tmp_path / "robot.yaml").unlink()
    scene = load_scene(path, ["robot=other.yaml"])
    assert scene.sources == (str(path), str(tmp_path / "other.yaml"))


def test_missing_file_is_the_options_fault(tmp_path: Path) -> None:
    with pytest.raises(SceneError) as caught:
        load_scene(with_files(tmp_path), ["robot=none.yaml"])
    missing = tmp_path / "none.yaml"
    assert (
        caught.value.message
        == f"--set robot=none.yaml: robot: cannot read '{missing}': there is no such file; a path in an option starts "
        f"at the folder of the scene, '{tmp_path}'"
    )


# -- refused ------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("override", "key", "words"),
    [
        ("", "", "has no '='"),
        ("title", "", "has no '='; allowed: key.path=value"),
        ("=3", "", "'' is not a path of keys"),
        ("a..b=3", "", "'a..b' is not a path"),
        (".a=3", "", "'.a' is not a path"),
        ("a. b=3", "", "'a. b' is not a path"),
        ("title=", "title", "has no value; write null"),
        ("torques.j11=null", "torques", "has no key 'j11' to remove (did you mean 'j1'?); allowed: j1"),
        ("expect.lock=null", "expect", "has no key 'lock' to remove; it is empty"),
        ("titel=null", "titel", "unknown key 'titel'"),
        ("simulate.rtoll=null", "simulate.rtoll", "unknown key 'rtoll'"),
        ("title=[1", "title", "this is not YAML"),
        ("title={a: 1, a: 2}", "title.a", "appears twice"),
        ("title=!!python/name:os.system x", "title", "not allowed"),
        ("title=*x", "title", "no anchor &x"),
        ("title=1\n--- 2", "title", "second document"),
        ("title=x\x00y", "title", "'\\x00' is not allowed"),
        ("titel=x", "titel", "unknown key 'titel' (did you mean 'title'?)"),
        ("simulate.rtoll=1", "simulate.rtoll", "did you mean 'rtol'?"),
        ("nothing.at.all=1", "nothing", "unknown key 'nothing'"),
        ("robot.joints.0.aa=1", "robot.joints.0.aa", "did you mean 'a'?"),
        ("robot.joints.j1.a=x", "robot.joints.0.a", "'x' is part of it"),
        (
            "robot.joints.j9.a=1",
            "robot.joints",
            "no item named 'j9'; allowed: j1, j2, weld or an index",
        ),
        ("robot.joints.wedl.a=1", "robot.joints", "did you mean 'weld'?"),
        ("robot.joints.3.a=1", "robot.joints", "no item 3; allowed: 0 to 2"),
        ("robot.joints.-1.a=1", "robot.joints", "no item named '-1'"),
        ("gravity.3=1", "gravity", "no item 3; allowed: 0 to 2"),
        ("gravity.x=1", "gravity", "no item named 'x'; allowed: an index"),
        ("gravity.1.x=1", "gravity.1", "is -9.81, so it has no key 'x'"),
        ("title.x=1", "title", "value a map); allowed: text"),
        ("loops.0.name=a", "loops", "is empty, so it has no items; set the whole list"),
        ("robot.joints.j1.friction.viscos=1", "robot.joints.0.friction.viscos", "did you mean 'viscous'?"),
        ("robot.joints.j1.spring.rest=1", "robot.joints.0.spring", "'stiffness' is missing"),
        ("gravity=[1, 2]", "gravity", "has 2 entries"),
        ("simulate.duration=.inf", "simulate.duration", "not finite"),
        ("torques.j1=open('x')", "torques.j1", "unexpected"),
        ("torques.weld=1", "torques.weld", "is fixed"),
    ],
)
def test_refused_and_quoted(override: str, key: str, words: str) -> None:
    error = complaint(SCENE, (override,))
    quoted = " ".join(override.split()) or "''"
    prefix = f"--set {quoted}: "
    assert error.message.startswith(prefix + (f"{key}: " if key else "")), error.message
    assert words in error.message
    assert error.details["key"] == key
    assert error.details["line"] is None
    assert error.exit_code == 2


def test_long_options_are_shortened() -> None:
    error = complaint(SCENE, ("title=[" + "x" * 5000,))
    assert len(error.message) < 300


def test_a_scene_that_is_no_map() -> None:
    with pytest.raises(SceneError, match="a scene is a map"):
        load_scene_text("[1]", overrides=["a=1"])
