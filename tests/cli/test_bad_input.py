"""Scenes that are wrong: one line with file, line and key, a hint where there is one, exit code 2, nothing written."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.cli.tool import CONFIGS, PENDULUM, Done, files, invoke

SCENE = PENDULUM + 'torques: {j1: "2*sin(t)"}\nparameters: {k: 0.1}\n'

# (text that appears once, what replaces it, key, fragments of the message); the mark § is where it must point
TABLE: list[tuple[str, str, str, tuple[str, ...]]] = [
    # wrong types
    ("duration: 1,", "duration: §[1],", "simulate.duration", ("value [1]", "a number")),
    ("duration: 1,", "duration: §{a: 1},", "simulate.duration", ("map",)),
    ("duration: 1,", "duration: §true,", "simulate.duration", ("true",)),
    ("duration: 1,", "duration: §yes,", "simulate.duration", ("'yes'",)),
    ("duration: 1,", "duration: §null,", "simulate.duration", ("no value",)),
    ("samples: 11", "samples: §11.5", "simulate.samples", ("whole number",)),
    ("samples: 11", 'samples: §"11 "', "", ()),
    ("samples: 11", "samples: §1e12", "simulate.samples", ("too large",)),
    ("samples: 11", "samples: §1", "simulate.samples", ("too small",)),
    ("samples: 11", "samples: §0x0b", "simulate.samples", ("hexadecimal",)),
    ("[0, -9.81, 0]", "§down", "gravity", ("'down'",)),
    ("[0, -9.81, 0]", "§[0, -9.81]", "gravity", ("2 entries",)),
    ("[0, -9.81, 0]", "[0, §a, 0]", "gravity.1", ("'a'",)),
    ("[0, -9.81, 0]", "[0, §45 deg, 0]", "gravity.1", ("deg",)),
    ("title: Pendulum", "title: §7", "title", ("quotes",)),
    ("{j1: -1, j2: 0.3}", "§-1", "initial.q", ("map",)),
    # numbers that are none, or that nothing can have
    ("duration: 1,", "duration: §.nan,", "simulate.duration", ("not finite",)),
    ("duration: 1,", "duration: §.inf,", "simulate.duration", ("not finite",)),
    ("duration: 1,", "duration: §1e999,", "simulate.duration", ("not finite",)),
    ("duration: 1,", "duration: §-1,", "simulate.duration", ("too small",)),
    ("duration: 1,", "duration: §0,", "simulate.duration", ("too small",)),
    ("duration: 1,", "duration: §1/0,", "simulate.duration", ("division by zero",)),
    ("{j1: -1, j2: 0.3}", "{j1: §-.inf, j2: 0.3}", "initial.q.j1", ("not finite",)),
    ("name: l1, mass: 1", "name: l1, mass: §-1", "robot.links.0.mass", ("too small", "-1")),
    ("name: l1, mass: 1", "name: l1, mass: §.nan", "robot.links.0.mass", ("not finite",)),
    ("name: l1, mass: 1", "name: l1, mass: §1 m", "robot.links.0.mass", ("'1 m'",)),
    ("name: l1, mass: 1", "name: l1, mass: §1lbs", "robot.links.0.mass", ("'1lbs'",)),
    # keys
    ("gravity:", "§gravty:", "gravty", ("unknown key", "'gravity'")),
    ("duration: 1,", "§durration: 1,", "simulate.durration", ("did you mean 'duration'",)),
    ("name: l1, mass: 1", "name: l1, §Mass: 1", "robot.links.0.Mass", ("did you mean 'mass'",)),
    ("convention: standard", "convention: §standart", "robot.convention", ("did you mean 'standard'",)),
    ("name: j1, type: revolute", "name: j1, type: §revolut", "robot.joints.0.type", ("did you mean 'revolute'",)),
    ("schema: 1", "schema: §2", "schema", ("1",)),
    ("    - {name: j1, type: revolute,", "    - §{name: j1,", "robot.joints.0", ("'type' is missing",)),
    ("duration: 1,", "duration: 1, §duration: 2,", "simulate.duration", ("twice", "line 14")),
    # names
    ('{j1: "2*sin(t)"}', '{§j3: "2*sin(t)"}', "torques.j3", ("'j3'", "j1, j2")),
    ("{j1: -1, j2: 0.3}", "{j1: -1, j2: 0.3, §j4: 1}", "initial.q.j4", ("'j4'", "j1, j2")),
    ("name: j2, type", "name: §j1, type", "robot.joints.1.name", ("twice",)),
    ("name: l2, mass", "name: §base, mass", "robot.links.1.name", ("ground",)),
    ("name: j2, type", "name: §t, type", "robot.joints.1.name", ("meaning in formulas",)),
    ("name: j2, type", "name: §joint two, type", "robot.joints.1.name", ("letters",)),
    ("name: j2, type", "name: §gelenk\N{LATIN SMALL LETTER A WITH DIAERESIS}, type", "robot.joints.1.name", ("letters",)),
    ("{link: l2, at: end}", "{link: §l3, at: end}", "robot.points.tip.link", ("'l3'", "l1, l2")),
    ("{link: l2, at: end}", "{link: l2, at: §nd}", "robot.points.tip.at", ("did you mean 'end'",)),
    # formulas
    ('"2*sin(t)"', '§"__import__(1)"', "torques.j1", ("__import__", "unknown function")),
    ('"2*sin(t)"', "§'__import__(\"os\").system(\"touch owned\")'", "torques.j1", ("unexpected",)),
    ('"2*sin(t)"', '§"open(t)"', "torques.j1", ("unknown function 'open'",)),
    ('"2*sin(t)"', '§"t.__class__"', "torques.j1", ("unknown name",)),
    ('"2*sin(t)"', '§"(lambda: t)()"', "torques.j1", ("unexpected",)),
    ('"2*sin(t)"', '§"t()"', "torques.j1", ()),
    ('"2*sin(t)"', '§"sin"', "torques.j1", ("'sin'",)),
    ('"2*sin(t)"', '§"sin(t"', "torques.j1", ("')' is needed",)),
    ('"2*sin(t)"', '§"2 t"', "torques.j1", ("'*' is missing",)),
    ('"2*sin(t)"', '§"2*sinn(t)"', "torques.j1", ("did you mean 'sin'",)),
    ('"2*sin(t)"', '§"q.j9"', "torques.j1", ("unknown name 'q.j9'", "did you mean")),
    ('"2*sin(t)"', '§"kk*t"', "torques.j1", ("unknown name 'kk'", "did you mean 'k'")),
    ('"2*sin(t)"', '§"1e999*t"', "torques.j1", ("too large",)),
    ('"2*sin(t)"', '§"9^9^9^9"', "torques.j1", ("has no value",)),
    # YAML itself
    ("schema: 1", "schema: §*nowhere", "schema", ("no anchor",)),
    ("schema: 1", "schema: §!!python/object/apply:os.system [touch owned]", "schema", ("tag",)),
    ("title: Pendulum", "title: Pen§: dulum", "", ("not YAML",)),
    ("title: Pendulum", "§\ttitle: Pendulum", "", ("not YAML",)),
    ("{j1: -1, j2: 0.3}", "{§<<: {j1: 1}, j2: 0.3}", "initial.q", ("merge keys",)),
    ("gravity: [0, -9.81, 0]", "gravity: §nofile.yaml", "gravity", ("'nofile.yaml'",)),
]  # fmt: skip


def spoiled(old: str, new: str) -> tuple[str, int, int]:
    """Return the scene with ``old`` replaced, and line and column of the mark."""
    assert SCENE.count(old) == 1, old
    before, after = SCENE.replace(old, new).split("§")
    return before + after, before.count("\n") + 1, len(before) - (before.rfind("\n") + 1) + 1


def refused(done: Done, directory: Path, code: int = 2) -> str:
    """Check that there is a line for each fault and nothing else, and return the first: a wrong name is missed later."""
    assert done.code == code and done.out == "", done
    lines = done.err.splitlines()
    assert lines and all(line.startswith("robodyn: error: ") for line in lines), done.err
    assert not directory.exists(), "nothing was written"
    return lines[0].removeprefix("robodyn: error: ")


@pytest.mark.parametrize(("old", "new", "key", "fragments"), TABLE, ids=[f"{t[1][:38]}" for t in TABLE])
def test_one_line_with_the_place(
    old: str, new: str, key: str, fragments: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    text, line, column = spoiled(old, new)
    Path("bad.yaml").write_text(text, encoding="utf-8")
    done = invoke("simulate", "bad.yaml", "--out", tmp_path / "out", "--no-plots")
    if not key and not fragments:  # not wrong after all
        assert done.code == 0
        return
    message = refused(done, tmp_path / "out")
    assert message.startswith(f"bad.yaml:{line}:"), message
    if key:
        assert message.startswith(f"bad.yaml:{line}:{column}: {key}: "), message
    for fragment in fragments:
        assert fragment in message, message
    assert not Path("owned").exists()


@pytest.mark.parametrize(
    ("override", "key", "fragments"),
    [
        ("simulate.rtol=tight", "simulate.rtol", ("'tight'",)),
        ("simulate.rtoll=1e-9", "simulate.rtoll", ("did you mean 'rtol'",)),
        ("robot.links.l3.mass=1", "robot.links", ("'l3'", "l1, l2")),
        ("robot.links.7.mass=1", "robot.links", ("no item 7", "0 to 1")),
        ("robot.links.l1.mass=-2", "robot.links.0.mass", ("too small",)),
        ("simulate", "", ("no '='",)),
        ("simulate..rtol=1", "", ("not a path",)),
        ("simulate.rtol=", "simulate.rtol", ("no value",)),
        ("simulate.rtol=[1", "simulate.rtol", ("not YAML",)),
        ("simulate.rtol.deep=1", "simulate.rtol", ("",)),
        ("torques.j1=__import__('os')", "torques.j1", ("",)),
        ("robot=missing.yaml", "robot", ("missing.yaml", "no such file")),
    ],
)
def test_options_are_checked_alike(
    override: str, key: str, fragments: tuple[str, ...], tmp_path: Path
) -> None:
    scene = tmp_path / "scene.yaml"
    scene.write_text(SCENE)
    message = refused(
        invoke("simulate", scene, "--set", override, "--out", tmp_path / "out"), tmp_path / "out"
    )
    assert message.startswith(f"--set {override}: " + (f"{key}: " if key else "")), message
    for fragment in fragments:
        assert fragment in message


# -- files -------------------------------------------------------------------------------------------------
def write(directory: Path, **texts: str) -> Path:
    for name, text in texts.items():
        (directory / f"{name}.yaml").write_text(text)
    return directory / "scene.yaml"


def test_an_alias_bomb(tmp_path: Path) -> None:
    bomb = "a0: &a0 [x, x, x, x, x, x, x, x, x, x]\n"
    for k in range(1, 10):
        bomb += f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 10)}]\n"
    message = refused(
        invoke("simulate", write(tmp_path, scene=bomb), "--out", tmp_path / "o"), tmp_path / "o"
    )
    assert "aliases expand to more than" in message and ":" in message


def test_an_alias_inside_itself(tmp_path: Path) -> None:
    scene = write(tmp_path, scene="schema: 1\ninitial: &a {q: *a}\n")
    message = refused(invoke("simulate", scene, "--out", tmp_path / "o"), tmp_path / "o")
    assert f"{scene}:2:" in message and "its own anchor" in message


def test_includes_in_a_circle(tmp_path: Path) -> None:
    scene = write(
        tmp_path, scene=SCENE.split("robot:")[0] + "robot: one.yaml\n", one="include: two.yaml\n",
        two="include: one.yaml\n",
    )  # fmt: skip
    message = refused(invoke("simulate", scene, "--out", tmp_path / "o"), tmp_path / "o")
    assert "cycle" in message and "one.yaml" in message and "two.yaml" in message


def test_an_error_in_an_included_file_is_placed_there(tmp_path: Path) -> None:
    robot = SCENE.split("robot:\n")[1].split("initial:")[0]
    robot = "\n".join(line[2:] for line in robot.splitlines())
    scene = write(
        tmp_path,
        scene="schema: 1\ngravity: [0, 0, 0]\nrobot: arm.yaml\n",
        arm=robot.replace("mass: 1", "mass: x", 1),
    )
    message = refused(invoke("simulate", scene, "--out", tmp_path / "o"), tmp_path / "o")
    assert message.startswith(f"{tmp_path / 'arm.yaml'}:6:") and "robot.links.0.mass" in message


@pytest.mark.parametrize(
    ("content", "fragment"),
    [
        (b"", "nothing in it"),
        (b"\n\n# only words\n", "nothing in it"),
        (b"[1, 2]\n", "a map"),
        (b"just a text\n", "a map"),
        (b"schema: 1\n---\nschema: 1\n", "second document"),
        (b"schema: \xff\xfe\n", "UTF-8"),
        (b"schema: 1\x00\n", "not allowed"),
        (b"{" * 2000, "levels deep"),
        (b"- " * 3000 + b"x", "levels deep"),
        (b"a: " * 5 + b"1\n", "not YAML"),
        (b"%YAML 9.9\n---\nschema: 1\n", ""),
    ],
    ids=[
        "empty",
        "comment",
        "list",
        "text",
        "two documents",
        "bytes",
        "zero byte",
        "braces",
        "dashes",
        "colons",
        "future",
    ],
)
def test_files_that_are_no_scene(content: bytes, fragment: str, tmp_path: Path) -> None:
    scene = tmp_path / "scene.yaml"
    scene.write_bytes(content)
    message = refused(invoke("simulate", scene, "--out", tmp_path / "o"), tmp_path / "o")
    assert fragment in message and str(scene) in message


def test_a_cycle_of_links(tmp_path: Path) -> None:
    text = SCENE.replace("type: revolute, a: 1.0", "type: revolute, parent: l2, a: 1.0", 1)
    message = refused(
        invoke("simulate", write(tmp_path, scene=text), "--out", tmp_path / "o"), tmp_path / "o"
    )
    assert "cycle" in message and "l1" in message and "l2" in message


def test_a_link_that_nothing_moves_as_a_parent(tmp_path: Path) -> None:
    scene = tmp_path / "scene.yaml"
    scene.write_text(
        "schema: 1\ngravity: [0, 0, -9.81]\nrobot:\n  joints:\n"
        "  - {name: a, type: revolute, axis: [0, 0, 1], parent: second}\n"
        "  links: [{name: first}, {name: second}]\n"
    )
    done = invoke("info", scene)
    assert done.code == 2 and "no joint moves link 'second'" in done.err


def test_two_hundred_joints_in_one_wrong_order(tmp_path: Path) -> None:
    """A long chain given from the far end is fine; one link that nothing moves is not."""
    joints, links = [], []
    for k in range(40):
        parent = "base" if k == 0 else f"l{k - 1}"
        joints.append(f"    - {{name: j{k}, type: revolute, axis: [0, 0, 1], parent: {parent}, link: l{k}}}")
        links.append(f"    - {{name: l{k}, mass: 1, com: [0.5, 0, 0], inertia: {{zz: 0.1}}}}")
    q = ", ".join(f"j{k}: 0.1" for k in range(40))
    text = "schema: 1\ngravity: [0, 0, 0]\nrobot:\n  joints:\n" + "\n".join(reversed(joints)) + "\n  links:\n"
    tail = f"\ninitial: {{q: {{{q}}}}}\nsimulate: {{duration: 0.01, samples: 2}}\n"
    done = invoke(
        "simulate",
        write(tmp_path, scene=text + "\n".join(links) + tail),
        "--no-plots",
        "--out",
        tmp_path / "o",
    )
    assert done.code == 0 and "result.h5" in files(tmp_path / "o")
    stray = "\n    - {name: stray, mass: 1}"
    message = refused(
        invoke(
            "simulate", write(tmp_path, scene=text + "\n".join(links) + stray + tail), "--out", tmp_path / "p"
        ),
        tmp_path / "p",
    )
    assert "'stray'" in message and "scene.yaml:" in message


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (
            ("deploy", "four_bar_deploy", "--set", "torques.theta9=3"),
            "torques.theta9: unknown joint 'theta9'",
        ),
        (
            ("simulate", "mechanisms/crane", "--set", "actuated=[trolley]", "--set", "control.joints=[arm]"),
            "control.joints.0: unknown joint with one coordinate 'arm'",
        ),
        (("plan", "2r_circle", "--for", "statiks"), "--for statiks: has no plan"),
        (
            ("work-precision", "double_pendulum", "--methods", "gaus"),
            "--methods: unknown method 'gaus' (did you mean",
        ),
    ],
)
def test_one_mistake_is_one_error_about_what_was_typed(
    words: tuple[str, ...], told: str, tmp_path: Path
) -> None:
    command, scene, *rest = words
    out = () if command == "plan" else ("--out", tmp_path)
    done = invoke(command, CONFIGS / f"{scene}.yaml", *rest, *out)
    (line,) = done.err.splitlines()
    assert done.code == 2 and told in line and "allowed: " in line and "yaml:" not in line, done.err
