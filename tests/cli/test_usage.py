"""Mistakes on the command line are said as all other errors are."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from robodyn_cli.commands import COMMANDS, JOBS
from tests.cli.batch_scenes import arm
from tests.cli.tool import CONFIGS, ROOT, environment, invoke, run

SCENE = str(CONFIGS / "double_pendulum.yaml")
# words, what the message says, the command whose help it points to
MISTAKES = {
    "no scene": (["simulate"], "Missing argument 'SCENE.yaml'", "simulate"),
    "no command": (["simulat", SCENE], "No such command 'simulat' (did you mean 'simulate'?)", ""),
    "no option": (["simulate", SCENE, "--quite"], "No such option: --quite (did you mean --quiet?)", "simulate"),
    "no such option at all": (["simulate", SCENE, "--zebra"], "No such option: --zebra", "simulate"),
    "option of the program": (["--zebra"], "No such option: --zebra", ""),
    "no value": (["simulate", SCENE, "--set"], "'--set' requires an argument", "simulate"),
    "value of a flag": (["simulate", SCENE, "--quiet=yes"], "'--quiet' does not take a value", "simulate"),
    "too many": (["simulate", SCENE, SCENE], "unexpected extra argument", "simulate"),
    "no number": (["compare", "a", "b", "--rtol", "x"], "'--rtol': 'x'; allowed: a number >= 0", "compare"),
    "negative": (["compare", "a", "b", "--atol=-1"], "'--atol': '-1'; allowed: a number >= 0", "compare"),
    "not finite": (["compare", "a", "b", "--atol", "nan"], "'--atol': 'nan'; allowed: a number", "compare"),
    "too small": (["run", SCENE, "-j", "0"], "'-j': '0'; allowed: a whole number >= 1", "run"),
    "not whole": (["run", SCENE, "--jobs", "1.5"], "'1.5'; allowed: a whole number >= 1", "run"),
    "no time": (["run", SCENE, "--timeout", "inf"], "'--timeout': 'inf' is not a number; allowed: a number > 0", "run"),
    "too large": (["work-precision", SCENE, "--repeats", "1001"], "'1001'; allowed: a whole number from 1 to 1000", "work-precision"),
    "tolerance": (["work-precision", SCENE, "--tolerances", "1e-6,2"], "'--tolerances': '2'; allowed: numbers from 1e-15 to 0.1", "work-precision"),
    "no text": (["simulate", SCENE, "--set", "title=\udcff"], "'--set': b'title=\\xff' is no text; allowed: text in UTF-8", "simulate"),
}  # fmt: skip


@pytest.mark.parametrize("name", MISTAKES)
def test_prefix_and_exit_code(name: str) -> None:
    words, message, command = MISTAKES[name]
    done = invoke(*words)
    assert done.code == 2 and done.out == ""
    assert done.err.startswith("robodyn: error: ") and done.err.count("\n") == 1
    assert message in done.err and done.err.endswith(
        f" See '{' '.join(['robodyn', command]).strip()} --help'.\n"
    )


@pytest.mark.parametrize("name", MISTAKES)
def test_as_json(name: str) -> None:
    words, message, _ = MISTAKES[name]
    done = invoke(words[0], "--json", *words[1:])
    assert done.code == 2
    assert (done.data["status"], done.data["error"]["exit_code"]) == ("failed", 2)
    assert message in done.data["error"]["message"]


def test_in_a_process_of_its_own() -> None:
    done = run("simulate", "--json")
    assert done.code == 2 and done.data["status"] == "failed"
    assert done.err.startswith("robodyn: error: Missing")


def test_nothing_at_all_is_a_question() -> None:
    done = invoke()
    assert done.code == 2 and "Many runs:" in done.err + done.out


@pytest.mark.parametrize("words", [["--help"], ["simulate", "-h"], ["--version"]])
def test_help_is_no_mistake(words: list[str]) -> None:
    done = invoke(*words)
    assert done.code == 0 and done.out and done.err == ""


def test_help_is_plain_text_of_the_table() -> None:
    """The same in a terminal and in a log: no boxes, no colours."""
    text = invoke("--help").out
    assert text.isascii() and "\x1b" not in text
    for name, command in COMMANDS.items():
        assert f"  {name} " in text and command.help in " ".join(text.split())
    assert COMMANDS["simulate"].help in invoke("simulate", "--help").out


def test_every_file_of_a_command_is_in_the_table() -> None:
    files = (ROOT / "robodyn_cli" / "cli" / "commands").glob("[a-z]*.py")
    assert {path.stem.replace("_", "-") for path in files} == set(COMMANDS)


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_of_the_table_takes_help(name: str) -> None:
    done = invoke(name, "-h")
    assert done.code == 0 and done.out.startswith(f"Usage: robodyn {name} ")


@pytest.mark.parametrize(("typed", "offered"), [("sim", "simulate"), ("simulate --no-p", "--no-plots")])
def test_the_shell_completes_commands_and_options(typed: str, offered: str) -> None:
    words = f"robodyn {typed}"
    place = {"COMP_WORDS": words, "COMP_CWORD": str(len(words.split()) - 1)}
    done = run(env=environment(_ROBODYN_COMPLETE="complete_bash", **place))
    assert done.code == 0 and offered in done.out.split()


def test_one_command_imports_no_other() -> None:
    code = "import sys; from robodyn_cli.cli.app import run; run(sys.argv[1:]); print(*sys.modules)"
    words = [sys.executable, "-c", code, "new", "inverse", os.devnull]
    done = subprocess.run(words, capture_output=True, text=True, env=environment())
    loaded = set(done.stdout.split())
    found = {name for name in loaded if name.startswith("robodyn_cli.cli.commands.")}
    assert found == {"robodyn_cli.cli.commands.new"}
    assert not {"rich", "numpy", "matplotlib"} & loaded


@pytest.mark.skipif(os.name != "posix", reason="pipes with names")
@pytest.mark.parametrize("command", ["simulate", "validate", "run", "plan", "info", "stability"])
def test_a_pipe_is_no_scene(command: str, tmp_path: Path) -> None:
    """It would be waited for, for ever."""
    os.mkfifo(tmp_path / "pipe.yaml")
    done = invoke(command, tmp_path / "pipe.yaml")
    assert done.code == 2 and "pipe.yaml' is a pipe or a device; allowed: a file" in done.err


def test_a_time_limit_of_any_length(tmp_path: Path) -> None:
    done = invoke(
        "run", arm(tmp_path / "a.yaml"), "--timeout", "1e300", "--no-plots", "--out", tmp_path / "out"
    )
    assert done.code == 0, done.err


def test_quiet_validation_prints_errors(tmp_path: Path) -> None:
    path = tmp_path / "bad.yaml"
    path.write_text("schema: 1\ngravity: [0, 0]\n")
    done = invoke("validate", "-q", path)
    assert done.code == 2 and done.out == ""
    lines = done.err.splitlines()
    assert len(lines) >= 2 and all(line.startswith(f"robodyn: error: {path}:") for line in lines)


def test_help_by_word_is_help_by_option() -> None:
    assert invoke("help", "sweep") == invoke("sweep", "--help")
    assert invoke("help") == invoke("--help")
    assert "did you mean 'sweep'" in invoke("help", "sweeep").err


def test_the_list_of_commands_is_by_job() -> None:
    text = invoke("--help").out
    assert [line[:-1] for line in text.splitlines() if line.endswith(":") and line[:-1] in JOBS] == list(JOBS)
    assert all(f"\n  {name} " in text for name in COMMANDS)
