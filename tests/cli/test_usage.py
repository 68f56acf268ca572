"""Mistakes on the command line are said as all other errors are."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.cli.tool import CONFIGS, invoke, run

SCENE = str(CONFIGS / "double_pendulum.yaml")
MISTAKES = {
    "no scene": (["simulate"], "missing argument 'SCENE.yaml'; see 'robodyn simulate --help'"),
    "no command": (["simulat", SCENE], "no such command 'simulat' (did you mean 'simulate'?); see 'robodyn --help'"),
    "no option": (["simulate", SCENE, "--quite"], "no such option: --quite (did you mean --"),
    "no value": (["simulate", SCENE, "--set"], "'--set' requires an argument"),
    "too many": (["simulate", SCENE, SCENE], "unexpected extra argument"),
    "no number": (["compare", "a", "b", "--rtol", "x"], "must be a valid number (value 'x'); see 'robodyn compare"),
    "too small": (["run", SCENE, "-j", "0"], "must be at least 1 (value '0')"),
}  # fmt: skip


@pytest.mark.parametrize("name", MISTAKES)
def test_prefix_and_exit_code(name: str) -> None:
    words, message = MISTAKES[name]
    done = invoke(*words)
    assert done.code == 2 and done.out == ""
    assert done.err.startswith("robodyn: error: ") and done.err.count("\n") == 1
    assert message in done.err


@pytest.mark.parametrize("name", MISTAKES)
def test_as_json(name: str) -> None:
    words, message = MISTAKES[name]
    done = invoke(words[0], "--json", *words[1:])
    assert done.code == 2
    assert (done.data["status"], done.data["error"]["exit_code"]) == ("failed", 2)
    assert message in done.data["error"]["message"]


def test_in_a_process_of_its_own() -> None:
    done = run("simulate", "--json")
    assert (
        done.code == 2 and done.data["status"] == "failed" and done.err.startswith("robodyn: error: missing")
    )


def test_nothing_at_all_is_a_question() -> None:
    done = invoke()
    assert done.code == 2 and "Commands:" in done.err + done.out


@pytest.mark.parametrize("words", [["--help"], ["simulate", "-h"], ["--version"]])
def test_help_is_no_mistake(words: list[str]) -> None:
    done = invoke(*words)
    assert done.code == 0 and done.out and done.err == ""


def test_quiet_validation_prints_errors(tmp_path: Path) -> None:
    path = tmp_path / "bad.yaml"
    path.write_text("schema: 1\ngravity: [0, 0]\n")
    done = invoke("validate", "-q", path)
    assert done.code == 2 and done.out == ""
    lines = done.err.splitlines()
    assert len(lines) >= 2 and all(line.startswith(f"robodyn: error: {path}:") for line in lines)
