"""``report --live``: what the page gets, units of values, and keys and results that are refused with exit code 2."""

from __future__ import annotations

import base64
import gzip
import json
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from robodyn_cli.cli.app import app
from tests.mechanisms import CONFIGS

MASS = "robot.links.link1.mass=5:25"


@pytest.fixture(scope="module")
def stored(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Results of a simulation and of inverse dynamics."""
    folder = tmp_path_factory.mktemp("stored")
    scenes = {
        "simulate": "double_pendulum.yaml",
        "inverse": "2r_circle.yaml",
        "statics": "double_pendulum.yaml",
    }
    for command, scene in scenes.items():
        words = [command, str(CONFIGS / scene), "--out", str(folder / command), "--no-plots", "--quiet"]
        assert CliRunner().invoke(app, words).exit_code == 0
    return {command: folder / command for command in scenes}


def report(target: Path, *words: object) -> tuple[int, str]:
    done = CliRunner().invoke(
        app, ["report", *map(str, words), "--file", str(target), "--no-plan", "--quiet"]
    )
    return done.exit_code, done.output


def live_of(target: Path) -> list[dict[str, Any] | None]:
    """Return what a page runs of each result."""
    text = target.read_text().split('<script type="application/json" id="data">')[1].split("</script>")[0]
    parts = json.loads(text).get("live", [])
    return [part and json.loads(gzip.decompress(base64.b64decode(part["data"]))) for part in parts]


def test_a_key_goes_to_every_scene_that_has_it(stored: dict[str, Path], tmp_path: Path) -> None:
    target = tmp_path / "page.html"
    angle = "initial.q.theta2=-30 deg:90 deg"
    code, told = report(target, stored["inverse"], stored["simulate"], "--live", MASS, "--live", angle)
    assert code == 0, told
    given, moved = live_of(target)
    assert given and moved
    assert [key["name"] for key in given["keys"]] == ["robot.links.link1.mass"]
    keys = moved["keys"]
    assert [key["unit"] for key in keys] == ["kg", "rad"]
    assert keys[1]["low"] == pytest.approx(-0.5235987755982988) and keys[1]["high"] == pytest.approx(
        1.5707963267948966
    )
    code, told = report(
        target, stored["inverse"], stored["simulate"], "--live", MASS, "--live", "parameters.torque=1:2"
    )
    assert code == 2 and "parameters.torque: it has no value" in " ".join(told.split())
    code, told = report(target, stored["simulate"])
    assert code == 0 and live_of(target) == []


@pytest.mark.parametrize(
    ("which", "asked", "words"),
    [
        ("simulate", "robot.links.link1.weight=1:2", "unknown key 'weight'"),
        ("simulate", "robot.links.link1.mass", "allowed: KEY=LOW:HIGH"),
        ("simulate", "robot.links.link1.mass=5:heavy", "heavy"),
        ("simulate", "robot.joints.theta1.alpha=-1:1", "give it another value by --set"),
        ("statics", MASS, "allowed: keys of scenes of simulate, deploy, inverse, kinematics"),
        ("simulate", "parameters.torque=1:2", "it has no value in the scene"),
    ],
)
def test_what_cannot_run_ends_with_2(
    which: str, asked: str, words: str, stored: dict[str, Path], tmp_path: Path
) -> None:
    code, told = report(tmp_path / "page.html", stored[which], "--live", asked)
    assert code == 2 and words in " ".join(told.split()), told
    assert not (tmp_path / "page.html").exists()
