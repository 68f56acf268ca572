"""YAML 1.2 scalars, places of nodes, and everything that is refused before a key is looked at."""

from __future__ import annotations

import math
import os
import time
from pathlib import Path

import pytest

from robodyn_cli.errors import SceneError
from robodyn_cli.scene import load_scene, load_scene_text
from robodyn_cli.scene.load import examine
from robodyn_cli.scene.text.nodes import MOST, Faults, Mapping, Sequence, Source
from robodyn_cli.scene.text.yaml_text import MAX_BYTES, compose, emit
from tests.unit.scene_text import FILE, SCENE, check_place, complaint, composed, plain, unmarked


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1", 1),
        ("-3", -3),
        ("+7", 7),
        ("010", 10),
        ("1e-9", 1e-9),
        ("1E5", 1e5),
        ("-1.5e+3", -1500.0),
        (".5", 0.5),
        ("5.", 5.0),
        (".inf", math.inf),
        ("-.INF", -math.inf),
        ("true", True),
        ("false", False),
        ("null", None),
        ("~", None),
        ("True", "True"),
        ("yes", "yes"),
        ("no", "no"),
        ("on", "on"),
        ("1:30", "1:30"),
        ("1_000", "1_000"),
        ("2024-01-01", "2024-01-01"),
        ("-90 deg", "-90 deg"),
        ("=", "="),
        ("'1'", "1"),
        ('"true"', "true"),
        ("!!str 12", "12"),
        ("!!float 12", 12),
        ("!!int 12", 12),
        ("! 12", "12"),
        ("12e", "12e"),
        ("+", "+"),
        ("9" * 5000, math.inf),
    ],
)
def test_scalars(text: str, value: object) -> None:
    node = plain(composed(f"a: {text}"))
    assert isinstance(node, dict)
    assert node["a"] == value
    assert type(node["a"]) is type(value)


def test_nan_is_recognised() -> None:
    node = plain(composed("[.nan, .NaN]"))
    assert isinstance(node, list)
    assert all(isinstance(x, float) and math.isnan(x) for x in node)


def test_nodes_know_their_places() -> None:
    root = composed("a: 1\nb:\n  - x\n  - {c: é, d: 2}\n")
    assert isinstance(root, Mapping)
    b = root.get("b")
    assert isinstance(b, Sequence)
    last = b.items[1]
    assert isinstance(last, Mapping)
    d, key = last.get("d"), last.key("d")
    assert d is not None and key is not None
    assert (b.items[0].line, b.items[0].column) == (3, 5)
    assert (key.line, key.column) == (4, 12)
    assert (d.line, d.column) == (4, 15)


def test_aliases_stand_for_what_they_name() -> None:
    assert plain(composed("a: &x [1, 2]\nb: *x\nc: [*x, *x]")) == {
        "a": [1, 2],
        "b": [1, 2],
        "c": [[1, 2], [1, 2]],
    }
    assert plain(composed("- &k word\n- {*k : 1}")) == ["word", {"word": 1}]


@pytest.mark.parametrize(
    ("text", "key", "words"),
    [
        ("a: 1\nb: 2\n§a: 3\n", "a", "appears twice; first on line 1"),
        ("a:\n  b: 1\n  §'b': 2\n", "a.b", "appears twice; first on line 2"),
        ("a: {b: 1, §b: 2}\n", "a.b", "appears twice"),
        ("a: &x\n  b: [1, §*x]\n", "a.b.1", "its own anchor"),
        ("&a [§*a]", "0", "its own anchor"),
        ("a: [1, §*x]", "a.1", "no anchor &x"),
        ("a: 1\n§---\nb: 2\n", "", "second document"),
        (
            "a: §!!python/object/apply:os.system ['x']",
            "a",
            "'!!python/object/apply:os.system' is not allowed",
        ),
        ("a: §!thing 3", "a", "'!thing' is not allowed"),
        ("a: §!!set {x, y}", "a", "not allowed"),
        ("a: §!!seq {x: y}", "a", "not allowed"),
        ("a: §!!int x", "a", "does not fit its tag"),
        ("a: §!!bool 1", "a", "does not fit its tag"),
        ("a: §0x1F", "a", "hexadecimal"),
        ("a: §0o17", "a", "octal"),
        ("a: x§\x01y", "", "'\\x01' is not allowed"),
        ("a: é\nb: x§\x7f", "", "'\\x7f' is not allowed"),
        ("§[1]: 2", "", "plain word"),
        ("a: {? §: 2}", "a", "plain word"),
        ("a: {§{b: 1}: 2}", "a", "plain word"),
        ("§<<: {a: 1}", "", "merge keys"),
    ],
)
def test_refused(text: str, key: str, words: str) -> None:
    """The text is read on its own: what it lacks to be a scene does not count."""
    plain_text, line, column = unmarked(text)
    faults = Faults()
    with faults:
        compose(plain_text, Source(FILE, "."), faults)
    error = faults.in_order()[0]
    assert error.message.startswith(f"{FILE}:{line}:{column}: " + (f"{key}: " if key else ""))
    assert words in error.message and error.details["key"] == key


@pytest.mark.parametrize("text", ["§- 1\n- 2\n", "§just text", "§3"])
def test_a_scene_is_a_map(text: str) -> None:
    check_place(text, "", "a scene is a map")


@pytest.mark.parametrize("text", ["", "\n\n", "# only a comment\n", "---\n", "---\n...\n", "null", "~"])
def test_empty(text: str) -> None:
    assert complaint(text).message == f"{FILE}:1:1: there is nothing in it; allowed: a map of keys and values"


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("a: [1, 2\nb: 3", 2),
        ("a: b: c", 1),
        ("a:\n  b: 1\n c: 2\n", 3),
        ("a: 1\nb: 'open", 2),
        ("a: b\n\tc: d", 2),
        ("a: 1\nb: @x", 2),
        ("%YAML 3.0\n---\na: 1", 1),
    ],
)
def test_broken_syntax_names_the_line(text: str, line: int) -> None:
    error = complaint(text)
    assert "this is not YAML: " in error.message
    assert error.details["line"] == line


@pytest.mark.parametrize(
    "text", ["<robot name='arm'/>", '<?xml version="1.0"?>\n<sdf version="1.7">', "\n<!-- a: b -->"]
)
def test_robots_of_other_formats_are_no_scenes(text: str) -> None:
    assert (
        complaint(text).message.startswith(f"{FILE}:1:1: this is XML; ")
        and "robot: FILE" in complaint(text).message
    )


def test_half_a_surrogate_pair() -> None:
    check_place("a: 1\nb: x§\ud800", "", "surrogate")


def test_billion_laughs() -> None:
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 10)}]" for k in range(1, 30)]
    start = time.perf_counter()
    error = complaint("\n".join(lines))
    assert "aliases expand to more than" in error.message
    assert error.details["line"] == 5
    assert time.perf_counter() - start < 1.0


@pytest.mark.parametrize("text", ["[" * 100_000, "{a: " * 50_000, "- " * 50_000, "? " * 50_000])
def test_deep_nesting_is_refused_at_once(text: str) -> None:
    start = time.perf_counter()
    assert "levels deep" in complaint(text).message
    assert time.perf_counter() - start < 2.0


def test_the_slow_parser_gives_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    import yaml

    from robodyn_cli.scene.text import yaml_text as yaml_nodes

    text = SCENE + "title: 'é: \"x\"'\n"
    fast = composed(text)
    monkeypatch.setattr(yaml_nodes, "_LOADER", yaml.SafeLoader)
    assert composed(text) == fast
    assert "not allowed in YAML" in complaint("a: x\x01y").message
    assert complaint(SCENE + "schema: 1").details["line"] == SCENE.count("\n") + 1


# -- files --------------------------------------------------------------------------------------------
def refuse(path: Path) -> str:
    with pytest.raises(SceneError) as caught:
        load_scene(path)
    assert "\n" not in caught.value.message
    assert caught.value.details["file"] == str(path)
    return caught.value.message


def test_missing_file(tmp_path: Path) -> None:
    path = tmp_path / "none.yaml"
    assert refuse(path) == f"{path}: cannot be read: there is no such file"


def test_directory(tmp_path: Path) -> None:
    assert "it is a directory" in refuse(tmp_path)


def test_zero_byte_in_the_path() -> None:
    assert "cannot be read" in refuse(Path("a\0b.yaml"))


def test_not_utf8(tmp_path: Path) -> None:
    path = tmp_path / "latin.yaml"
    path.write_bytes(b"schema: 1\ntitle: caf\xe9\n")
    assert "it is not UTF-8 text (byte 20, line 2)" in refuse(path)


def test_pipes_and_devices_are_refused_at_once(tmp_path: Path) -> None:
    """As the scene, as a file that it includes and as a table; reading them would wait for ever."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    for path in (pipe, Path("/dev/zero")):
        assert "is a pipe or a device" in refuse(path)
        head = "schema: 1\ngravity: [0, 0, 0]\n"
        for text in (
            f"{head}robot: {path}\n",
            f"{head}robot: {{include: {path}}}\n",
            f"{SCENE}trajectory: {{type: table, file: {path}}}\n",
        ):
            assert "is a pipe or a device" in complaint(text).message


def test_many_faults_end_the_reading(tmp_path: Path) -> None:
    """Of any number of faults the first thousand are listed, and finding them takes no longer than in proportion."""
    many = ", ".join(["j1"] * 20_000)
    path = tmp_path / "scene.yaml"
    for text in (f"actuated: [{many}]", f"prescribed: {{{', '.join(f'x{k}: 1' for k in range(20_000))}}}"):
        path.write_text(f"{SCENE}{text}\n")
        errors = examine(path).errors
        assert len(errors) == MOST
        assert errors[0].details["line"] == SCENE.count("\n") + 1


def test_huge_file(tmp_path: Path) -> None:
    path = tmp_path / "huge.yaml"
    with path.open("wb") as file:
        file.truncate(MAX_BYTES + 1)
    assert "larger than 10 MB" in refuse(path)


def test_byte_order_mark_is_dropped(tmp_path: Path) -> None:
    path = tmp_path / "bom.yaml"
    path.write_bytes(b"\xef\xbb\xbf" + SCENE.encode())
    assert load_scene(path) == load_scene_text(SCENE)


def test_windows_line_ends() -> None:
    assert load_scene_text(SCENE.replace("\n", "\r\n")) == load_scene_text(SCENE)


# -- writing ------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "text",
    [
        "[]",
        "{}",
        "a: {}",
        "[[], {}, [[]]]",
        "a: ''",
        "a: null",
        "'null': 'true'",
        "a: '1'",
        "a: '1e-9'",
        "a: '- x'",
        "a: 'x: y # z'",
        "a: ' x '",
        'a: "tab\\t, newline\\n, bell\\a, \\u0085 \\u2028 \\uFEFF \\U0001F600"',
        "a: 0.1\nb: 1e-300\nc: 123456789.123456789\nd: 1e22",
        "a: -.inf",
        "a: [1, {b: [2, {c: [3, {d: 4}]}]}]",
        "'a b': {'c-d': 1, 'é': 2}",
        "a: [" + ", ".join(["123456.789"] * 50) + "]",
    ],
)
def test_emitted_text_reads_back(text: str) -> None:
    tree = composed(text)
    written = emit(tree)
    again = composed(written)
    assert plain(again) == plain(tree)
    assert emit(again) == written


def test_place_in_an_error_is_the_given_path() -> None:
    assert complaint("a: 1", path=FILE).details["file"] == FILE
    with pytest.raises(SceneError) as caught:
        load_scene_text("a: 1")
    assert caught.value.message.startswith("<text>:1:1: a: unknown key")


def test_a_tab_is_named() -> None:
    with pytest.raises(SceneError, match="a tab begins a token here; allowed: spaces"):
        load_scene_text("schema: 1\nrobot:\n\tjoints: []\n")


def test_commas_in_numbers_are_hinted_at(tmp_path: Path) -> None:
    text = "schema: 1\ngravity: [0, 0, 0]\nrobot:\n  joints: [{name: x, type: prismatic, axis: [1, 0, 0]}]\n  links: [{name: a, mass: 1,5}]\n"
    with pytest.raises(SceneError, match="unknown key '5'.*decimals have a point"):
        load_scene_text(text)
    (tmp_path / "t.csv").write_text("t;x\n0;0\n1;0,5\n")
    scene = tmp_path / "scene.yaml"
    scene.write_text(text.replace("1,5", "1") + "command: inverse\ntrajectory: {type: table, file: t.csv}\n")
    with pytest.raises(SceneError, match="value '0;0'.*separated by commas"):
        load_scene(scene)
