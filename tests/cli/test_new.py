"""``robodyn new``: every starter says what it is, is without fault, and runs."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

from robodyn_cli.cli.app import app
from robodyn_cli.over.commands import execute
from robodyn_cli.over.findings import findings
from robodyn_cli.robots.examples import example_names, examples_folder, find_example, texts_of
from robodyn_cli.scene.load import load_scene
from robodyn_cli.scene.starters import STARTERS
from robodyn_cli.tools.progress import Stopwatch
from robodyn_cli.trajectories.registry import trajectory_types


def new(*words: object) -> tuple[int, str]:
    done = CliRunner().invoke(app, ["new", *map(str, words)])
    return done.exit_code, done.output


@pytest.mark.parametrize("kind", STARTERS)
def test_every_starter_runs(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    assert new(kind, path)[0] == 0
    assert findings(path, strict=True) == []
    scene = load_scene(path)
    assert scene.command == STARTERS[kind].command and scene.expect
    result = execute(scene.command, scene, lambda done, total: None, Stopwatch())
    assert result.status == ("locked" if kind == "deploy" else "ok")


@pytest.mark.parametrize("kind", STARTERS)
def test_every_starter_is_commented(kind: str) -> None:
    text = STARTERS[kind].text("mine.yaml")
    assert f"robodyn {STARTERS[kind].command} mine.yaml" in text
    assert text.count("#") >= 8 and all(len(line) <= 110 for line in text.splitlines())
    sections = re.findall(r"^(trajectory|torques|initial|deploy|expect):", text, re.MULTILINE)
    assert "expect" in sections


def test_every_kind_of_trajectory_has_a_starter() -> None:
    text = "".join(starter.body for starter in STARTERS.values())
    # those that are written as another one, or that hold one
    alike = {"cubic", "monotone", "trapezoid", "fourier", "sequence", "fastest"}
    assert set(trajectory_types) - alike == set(re.findall(r"^  type: (\w+)$", text, re.MULTILINE))


def test_the_kinds_are_in_the_help() -> None:
    text = CliRunner().invoke(app, ["new", "--help"], env={"COLUMNS": "200"}).output
    assert all(kind in text for kind in STARTERS)


def test_default_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert new("deploy")[0] == 0
    assert (tmp_path / "deploy.yaml").read_text().startswith("# A mechanism unfolds")


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text("mine")
    code, output = new("inverse", path)
    assert code == 74 and "exists already" in output
    assert path.read_text() == "mine"
    assert new("inverse", tmp_path / "no" / "mine.yaml")[0] == 74


def test_unknown_kind(tmp_path: Path) -> None:
    code, output = new("deplyo", tmp_path / "x.yaml")
    assert code == 2 and "did you mean 'deploy'?" in output


@pytest.mark.parametrize("name", ["2r_circle", "mechanisms/solar_array", "lift_arm", "catching_arm.yaml"])
def test_an_example_comes_with_what_it_reads(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    code, text = new("--example", name)
    assert code == 0
    path = Path(text.split(":")[0])
    assert path.parts[0] == "configs" and path.name == f"{name.split('/')[-1].removesuffix('.yaml')}.yaml"
    assert f"robodyn {load_scene(path).command} {path}" in text
    shipped = examples_folder()
    for file in (file for file in Path("configs").rglob("*") if file.is_file()):
        assert file.read_text() == (shipped / file.relative_to("configs")).read_text()
    assert new("--example", name)[0] == 0  # what is there already with the same content stays


def test_an_example_never_replaces_another_file(tmp_path: Path) -> None:
    mine = tmp_path / "robots" / "four_bar.yaml"
    mine.parent.mkdir()
    mine.write_text("mine")
    code, text = new("--example", "four_bar_deploy", tmp_path)
    assert code == 74 and "robots/four_bar.yaml exists already" in text.replace("\n", "")
    assert mine.read_text() == "mine" and sorted(tmp_path.iterdir()) == [mine.parent]


def test_names_of_examples(tmp_path: Path) -> None:
    code, text = new("--example", "four_bar_deplo", tmp_path)
    assert code == 2 and "did you mean 'four_bar_deploy'" in text.replace("\n", " ")
    assert new("simulate", "--example", "2r_circle", "--from", "scara", tmp_path)[0] == 2
    folder = examples_folder()
    names = example_names(folder)
    assert {"four_bar_deploy", "published/delta", "search/counterweights"} < set(names)
    for name in names:  # each is found by its whole name, and reads nothing from beyond the folder
        path = find_example(name, folder)
        assert texts_of(path, load_scene(path).sources, folder)
