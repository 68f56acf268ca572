"""``report --live``: what the page gets, units of values, and keys and results that are refused with exit code 2."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from robodyn_cli.cli.app import app
from tests.mechanisms import CONFIGS

MASS = "robot.links.link1.mass=5:25"


@pytest.fixture(scope="module")
def stored(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Results of a simulation and of inverse dynamics."""
    folder = tmp_path_factory.mktemp("stored")
    scenes = {"simulate": "double_pendulum.yaml", "inverse": "2r_circle.yaml"}
    for command, scene in scenes.items():
        words = [command, str(CONFIGS / scene), "--out", str(folder / command), "--no-plots", "--quiet"]
        assert CliRunner().invoke(app, words).exit_code == 0
    return {command: folder / command for command in scenes}


def report(target: Path, *words: object) -> tuple[int, str]:
    done = CliRunner().invoke(
        app, ["report", *map(str, words), "--file", str(target), "--no-plan", "--quiet"]
    )
    return done.exit_code, done.output


def live_of(target: Path) -> list[dict[str, object]]:
    text = target.read_text().split('<script type="application/json" id="data">')[1].split("</script>")[0]
    return list(json.loads(text).get("live", []))


def test_a_key_goes_to_every_scene_that_has_it(stored: dict[str, Path], tmp_path: Path) -> None:
    target = tmp_path / "page.html"
    angle = "initial.q.theta2=-30 deg:90 deg"
    code, told = report(target, stored["inverse"], stored["simulate"], "--live", MASS, "--live", angle)
    assert code == 0, told
    (scene,) = live_of(target)
    keys = scene["keys"]
    assert isinstance(keys, list)
    assert [key["unit"] for key in keys] == ["kg", "rad"]
    assert keys[1]["low"] == pytest.approx(-0.5235987755982988) and keys[1]["high"] == pytest.approx(
        1.5707963267948966
    )
    code, told = report(target, stored["simulate"])
    assert code == 0 and live_of(target) == []


@pytest.mark.parametrize(
    ("which", "asked", "words"),
    [
        ("simulate", "robot.links.link1.weight=1:2", "unknown key 'weight'"),
        ("simulate", "robot.links.link1.mass", "allowed: KEY=LOW:HIGH"),
        ("simulate", "robot.links.link1.mass=5:heavy", "heavy"),
        ("simulate", "robot.joints.theta1.alpha=-1:1", "give it another value by --set"),
        ("inverse", MASS, "allowed: keys of scenes of simulate, deploy"),
    ],
)
def test_what_cannot_run_ends_with_2(
    which: str, asked: str, words: str, stored: dict[str, Path], tmp_path: Path
) -> None:
    code, told = report(tmp_path / "page.html", stored[which], "--live", asked)
    assert code == 2 and words in " ".join(told.split()), told
    assert not (tmp_path / "page.html").exists()
