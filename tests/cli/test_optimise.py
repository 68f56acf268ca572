"""``optimise`` as a user meets it: exit codes, what is printed and stored, the line that repeats the run, interrupts."""

from __future__ import annotations

import json
import shlex
import signal
import time
from pathlib import Path

import pytest

from robodyn_cli.cli.words import error_text, stated
from robodyn_cli.results.hdf5 import read
from tests.cli.tool import CONFIGS, files, invoke, start
from tests.unit.test_search import ARM, STIFFNESS

VARY = ("--vary", f"{STIFFNESS}=uniform(10, 500)")


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    path = tmp_path / "arm.yaml"
    path.write_text(ARM)
    return path


def test_the_line_that_is_told_repeats_the_figure_to_the_last_digit(scene: Path, tmp_path: Path) -> None:
    done = invoke("optimise", scene, *VARY, "--reach", "peak_torque.arm=2", "--json", "--out", tmp_path / "o")
    assert done.code == 0 and done.data["status"] == "ok"
    assert done.data == json.loads((tmp_path / "o" / "summary.json").read_text())
    words = shlex.split(done.data["repeat"])
    again = invoke(*words[1:], "--json", "--no-plots", "--out", tmp_path / "again")
    assert again.data["joints"]["arm"]["peak_torque"] == done.data["figures"]["peak_torque.arm"]["value"]
    assert again.data["joints"]["arm"]["peak_torque"] == pytest.approx(2, abs=1e-9)


def test_what_is_stored_and_drawn(scene: Path, tmp_path: Path) -> None:
    out = tmp_path / "o"
    done = invoke("optimise", scene, *VARY, "--minimise", "energy_net.arm", "--keep", "peak_torque.arm <= 5",
                  "--starts", "2", "--out", out)  # fmt: skip
    assert done.code == 0, done.err
    assert files(out) == {"result.h5", "summary.json", "search_path.png", "search_keys.png"}
    assert (
        "<= 5 (active)" in done.out and "price" in done.out and "--set forces.spring.stiffness=" in done.out
    )
    result = read(out / "result.h5")
    runs = len(result["runs/exit_code"])
    assert runs + 1 == result.summary["search"]["runs"] and result["runs/best"].sum() == 1
    assert set(result["runs/start"][:2]) == {0, 1}
    best = int(result["runs/best"].argmax())
    assert result[f"inputs/{STIFFNESS}"][best] == result.summary["keys"][STIFFNESS]["value"]
    assert result["runs/holds"][best] == 1


def test_a_search_that_misses_ends_with_1_and_says_what(scene: Path, tmp_path: Path) -> None:
    done = invoke("optimise", scene, "--vary", f"{STIFFNESS}=uniform(10, 100)", "--reach", "peak_torque.arm=0",
                  "--no-plots", "--out", tmp_path / "o")  # fmt: skip
    assert done.code == 1
    assert "peak_torque.arm is 2.715" in done.err and "(missed)" in done.out
    assert json.loads((tmp_path / "o" / "summary.json").read_text())["status"] == "missed"


def test_options_come_before_the_scene_and_a_goal_takes_the_place_of_its(scene: Path, tmp_path: Path) -> None:
    scene.write_text(
        ARM
        + f"search: {{vary: {{{STIFFNESS}: 'uniform(10, 500)'}}, reach: {{peak_torque.arm: 2}}, starts: 2, seed: 3}}\n"
    )
    whole = invoke("optimise", scene, "--json", "--no-plots", "--out", tmp_path / "a").data
    assert whole["goal"] == "peak_torque.arm = 2" and whole["search"]["starts"] == 2
    invoke("optimise", scene, "--seed", "0", "--no-plots", "--out", tmp_path / "c")
    first, other = (read(tmp_path / name / "result.h5")[f"inputs/{STIFFNESS}"][:2] for name in "ac")
    assert first[0] == other[0] == 50 and first[1] != other[1]
    other = invoke("optimise", scene, "--minimise", "rms_torque.arm", "--starts", "1", "--json", "--no-plots",
                   "--out", tmp_path / "b").data  # fmt: skip
    assert other["goal"] == "least rms_torque.arm" and other["search"]["starts"] == 1


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--reach", "peak_torque.arm"), "is not OUTPUT=VALUE"),
        (("--reach", "peak_torque.arm=x"), "--reach peak_torque.arm: 'x' is no value"),
        (("--reach", "peak_torque.arm=1", "--reach", "peak_torque.arm=2"), "is given twice"),
        (("--minimise", "energy.arm", "--keep", "peak_torque.arm"), "is no inequality"),
        (("--minimise", "energy.arm", "--keep", "peak_torque.arm <= x"), "'x' is not a finite number"),
        (("--minimise", "energy.arm", "--maximise", "energy.arm"), "stands beside 'minimise'"),
        (("--minimise", "energy.arn"), "did you mean"),
        (("--starts", "0", "--minimise", "energy.arm"), "allowed: a whole number >= 1"),
    ],
)  # fmt: skip
def test_what_makes_no_sense_is_refused_with_2(
    scene: Path, words: tuple[str, ...], message: str, tmp_path: Path
) -> None:
    done = invoke("optimise", scene, *VARY, *words, "--out", tmp_path / "o")
    assert done.code == 2 and message in done.err, done.err
    assert not (tmp_path / "o" / "result.h5").exists()


def test_validate_says_what_is_wrong_with_a_search(scene: Path) -> None:
    scene.write_text(ARM + "search: {minimise: peak_torque.leg}\n")
    done = invoke("validate", scene)
    assert (
        done.code == 2
        and f"{scene}:13:20: search.minimise: the summary of inverse has no such key" in done.out
    )


def test_an_interrupted_search_keeps_its_runs_and_goes_on(scene: Path, tmp_path: Path) -> None:
    """The runs here are whole commands, 8 or so a second."""
    text = ARM.replace("samples: 101", "samples: 301") + "outputs: {reactions: true}\n"
    scene.write_text(text)
    words = ("optimise", scene, *VARY, "--minimise", "rms_torque.arm", "--starts", "6", "--no-plots", "-j", "1",
             "--out", tmp_path / "o")  # fmt: skip
    kept = tmp_path / "o" / "unfinished.search"
    process = start(*words)
    for _ in range(600):
        if kept.exists() and len(kept.read_text().splitlines()) > 3:
            break
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130 and "the same command goes on from there" in err
    scene.write_text(text)
    done = invoke(*words)
    assert done.code == 0 and "runs are there from an earlier search" in done.err
    assert not kept.exists()


def test_the_terminal_says_within_what_a_target_is_met(tmp_path: Path) -> None:
    scene = CONFIGS / "search" / "spring_balance.yaml"
    done = invoke("optimise", scene, "--no-plots", "--starts", "1", "--out", tmp_path / "out")
    found = json.loads((tmp_path / "out" / "summary.json").read_text())
    key, output = found["keys"]["forces.spring.stiffness"], found["figures"]["peak_torque.arm"]
    assert f"0 (met, within {error_text(output['tolerance'])})" in done.out
    assert f" {stated(key['value'], key['uncertainty'])} N/m " in " ".join(done.out.split())
    assert f"with exact derivatives at {found['search']['derivatives']} points" in done.out
