"""``robodyn crosscheck --own-settings``: the figures are those of an engine's run that is written by hand."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robodyn_cli.cli.app import run
from robodyn_cli.errors import CapabilityError
from robodyn_cli.over.crosscheck.own_settings import of_rank, own_settings
from robodyn_cli.report.registry import applicable
from robodyn_cli.results.hdf5 import read
from robodyn_cli.results.result import Result
from robodyn_cli.scene.load import load_scene_text

LINKS = (
    ("crank", 1.0, 0.5, 0.02),
    ("coupler", 2.0, 1.5, 0.1),
    ("rocker", 1.5, 1.0, 0.05),
)  # mass, length, moment
FOUR_BAR = """
schema: 1
gravity: [0, -9.81, 0]
robot:
  joints:
    - {name: a, type: revolute, axis: [0, 0, 1], link: crank%s}
    - {name: b, type: revolute, axis: [0, 0, 1], parent: crank, link: coupler, origin: {xyz: [0.5, 0, 0]}, damper: {damping: 0.3}}
    - {name: c, type: revolute, axis: [0, 0, 1], parent: base, link: rocker, origin: {xyz: [1.2, 0, 0]}}
  links:
    - {name: crank, mass: 1, com: [0.25, 0, 0], inertia: {xx: 0.02, yy: 0.02, zz: 0.02}}
    - {name: coupler, mass: 2, com: [0.75, 0, 0], inertia: {xx: 0.1, yy: 0.1, zz: 0.1}}
    - {name: rocker, mass: 1.5, com: [0.5, 0, 0], inertia: {xx: 0.05, yy: 0.05, zz: 0.05}}
  points: {pin: {link: coupler, at: [1.5, 0, 0]}, top: {link: rocker, at: [1, 0, 0]}}
loops: [{name: join, type: spherical, between: [pin, top]}]
torques: {a: '0.7*cos(3*t)'}
initial: {q: {a: 1.2, b: -0.5, c: 1.4}, qd: {a: 2}, hold: [a]}
simulate: {duration: 0.4, samples: 11}
"""
BY_HAND = """
<mujoco>
  <compiler angle="radian"/>
  <option gravity="0 -9.81 0"><flag contact="disable"/></option>
  <worldbody>
    <body>
      <joint name="a" axis="0 0 1"/><inertial pos="0.25 0 0" mass="1" diaginertia="0.02 0.02 0.02"/>
      <body pos="0.5 0 0">
        <joint name="b" axis="0 0 1" damping="0.3"/><inertial pos="0.75 0 0" mass="2" diaginertia="0.1 0.1 0.1"/>
        <site name="end" pos="1.5 0 0"/><site name="end2" pos="1.5 0 0.1"/>
      </body>
    </body>
    <body pos="1.2 0 0">
      <joint name="c" axis="0 0 1"/><inertial pos="0.5 0 0" mass="1.5" diaginertia="0.05 0.05 0.05"/>
      <site name="top" pos="1 0 0"/><site name="top2" pos="1 0 0.1"/>
    </body>
  </worldbody>
  <equality><connect site1="end" site2="top"/>%s</equality>
</mujoco>
"""
CHAIN = """
schema: 1
gravity: [0, 0, -9.81]
robot:
  joints:
    - {name: base0, type: floating, link: trunk}
    - {name: hip, type: spherical, parent: trunk, link: thigh, origin: {xyz: [0.1, 0, 0]}}
    - {name: knee, type: universal, axis: [0, 1, 0], axis2: [0, 0, 1], parent: thigh, link: shin, origin: {xyz: [0, 0.1, -0.4]}}
  links:
    - {name: trunk, mass: 4, com: [0.02, 0, 0.1], inertia: {xx: 0.1, yy: 0.2, zz: 0.15, xy: 0.01}}
    - {name: thigh, mass: 2, com: [0, 0.01, -0.2], inertia: {xx: 0.03, yy: 0.03, zz: 0.01}}
    - {name: shin, mass: 1, com: [0.1, 0, -0.2], inertia: {xx: 0.02, yy: 0.02, zz: 0.005}}
initial:
  q: {base0: {xyz: [0, 0, 1], rpy: [0.2, -0.1, 0.3]}, hip: {rpy: [0.1, 0.4, 0]}, knee: [0.3, -0.2]}
  qd: {base0: [0.5, 0, 1, 1, -2, 0.5], hip: [1, 0.5, -1], knee: [1, 2]}
simulate: {duration: 0.1, samples: 3}
"""
GRIPPER = """
schema: 1
gravity: [0, 0, -9.81]
robot:
  joints:
    - {name: left, type: revolute, axis: [0, 1, 0], link: driver_l, origin: {xyz: [-0.03, 0, 0]}, rotor_inertia: 1e-5, gear_ratio: 10}
    - {name: right, type: revolute, axis: [0, 1, 0], parent: base, link: driver_r, origin: {xyz: [0.03, 0, 0]}}
    - {name: rack, type: prismatic, axis: [0, 0, 1], parent: base, link: bar, spring: {stiffness: 50}}
  links:
    - {name: driver_l, mass: 0.1, com: [0, 0, 0.03], inertia: {xx: 1e-4, yy: 1e-4, zz: 1e-5}}
    - {name: driver_r, mass: 0.1, com: [0, 0, 0.03], inertia: {xx: 1e-4, yy: 1e-4, zz: 1e-5}}
    - {name: bar, mass: 0.2, com: [0, 0, 0], inertia: {xx: 1e-4, yy: 1e-4, zz: 1e-4}}
couplers:
  - {name: fingers, terms: {left: 1, right: 1}}
  - {name: pinion, terms: {rack: 1, left: -0.02}, value: 0.01}
initial: {q: {left: 0.3}, hold: [left]}
torques: {left: 0.2}
simulate: {duration: 0.1, samples: 3}
"""
ENGINES = ("mujoco", "drake")


def compared(text: str, engine: str = "mujoco", step: float | None = None) -> Result:
    """Return how far an engine is off."""
    pytest.importorskip({"mujoco": "mujoco", "drake": "pydrake"}[engine])
    return own_settings(load_scene_text(text), engine, step)


def by_hand(q: np.ndarray, v: np.ndarray, steps: int, more: str) -> tuple[np.ndarray, np.ndarray]:
    """Return gaps [m] and the accelerations' errors of the four-bar, from MuJoCo's own calls and a null space."""
    import mujoco

    model = mujoco.MjModel.from_xml_string(BY_HAND % more)
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = q, v
    gaps, errors = [], []
    for k in range(steps + 1):
        data.qfrc_applied[:] = [0.7 * np.cos(3 * k * model.opt.timestep), 0, 0]
        mujoco.mj_forward(model, data)
        gaps.append(np.linalg.norm(data.site("end").xpos - data.site("top").xpos))
        rows, gamma = np.zeros((2, 3)), np.zeros(2)
        for sign, name in ((1, "end"), (-1, "top")):
            site = model.site(name).id
            J, rate = np.zeros((3, 3)), np.zeros((3, 3))
            mujoco.mj_jacSite(model, data, J, None, site)
            mujoco.mj_jacDot(model, data, rate, None, data.site_xpos[site], model.site_bodyid[site])
            rows += sign * J[:2]
            gamma += sign * (rate @ data.qvel)[:2]
        M = np.zeros((3, 3))
        for j, unit in enumerate(np.eye(3)):
            mujoco.mj_mulM(model, data, M[j], unit)
        force = data.qfrc_applied + data.qfrc_passive - data.qfrc_bias
        saddle = np.block([[M, rows.T], [rows, np.zeros((2, 2))]])
        exact = np.linalg.solve(saddle, np.concatenate([force, -gamma]))[:3]
        errors.append(np.abs(data.qacc - exact).max())
        mujoco.mj_step(model, data)
    return np.array(gaps), np.array(errors)


@pytest.mark.parametrize(
    ("kind", "more"),
    [("spherical", ""), ("revolute, axis: [0, 0, 1]", '<connect site1="end2" site2="top2"/>')],
)
def test_the_figures_are_those_of_a_run_by_hand(kind: str, more: str) -> None:
    """A pin is two points, a decimetre apart along its axis."""
    result = compared((FOUR_BAR % "").replace("type: spherical", f"type: {kind}"))
    summary = result.summary
    assert summary["engine"] == "mujoco" and summary["step"] == 0.002 and summary["steps"] == 200
    assert summary["settings"]["solref"] == "0.02 1" and summary["settings"]["integrator"] == "EULER"
    gaps, errors = by_hand(result["crosscheck/q"][0], result["crosscheck/qd"][0], 200, more)
    (gap,) = summary["closures"]
    assert gap["closure"] == "join" and gap["unit"] == "m"
    assert gaps.max() > 1e-5 > 1e-12 > gap["here"]
    np.testing.assert_allclose(result["crosscheck/gap"][:, 0], gaps, atol=1e-12)
    assert gap["largest"] == pytest.approx(gaps.max(), abs=1e-12)
    assert gap["time"] == pytest.approx(0.002 * np.argmax(gaps))
    off = summary["accelerations"]
    assert off["start"] == pytest.approx(errors[0], rel=1e-9) and off["start_relative"] > 0.01
    assert off["largest"] == pytest.approx(errors.max(), rel=1e-7)
    assert off["error"] < 1e-10


@pytest.mark.parametrize("engine", ENGINES)
def test_what_is_off_falls_with_the_step(engine: str) -> None:
    """Energy and joints converge to the exact motion, with first order where the closure is hard, as Drake's."""
    off = {}
    for step in (1e-3, 2.5e-4):
        summary = compared(FOUR_BAR % "", engine, step).summary
        assert summary["step"] == step and summary["termination"]["reason"] == "end of the duration"
        assert summary["accelerations"]["error"] < 1e-9
        off[step] = summary
    coarse, fine = off[1e-3], off[2.5e-4]
    assert (
        fine["joints"][0]["largest"] < (0.35 if engine == "drake" else 1.0) * coarse["joints"][0]["largest"]
    )
    assert abs(fine["energy"]["largest"]) < abs(coarse["energy"]["largest"])
    assert fine["closures"][0]["largest"] <= 1.01 * coarse["closures"][0]["largest"]


@pytest.mark.parametrize("engine", ENGINES)
def test_an_open_chain_has_no_gap_and_exact_accelerations(engine: str) -> None:
    """Free bodies and turns in space are handed over and read in the engine's own coordinates."""
    summary = compared(CHAIN, engine).summary
    assert summary["closures"] == []
    off = summary["accelerations"]
    assert 0.0 < off["error"] < 1e-8 and off["relative"] < 1e-9 and off["start_relative"] < 1e-9
    assert [one["unit"] for one in summary["joints"]] == ["m", "rad"]
    assert 1e-9 < summary["joints"][1]["largest"] < 0.01
    assert 1e-9 < abs(summary["energy"]["relative"]) < 0.05


@pytest.mark.parametrize("engine", ENGINES)
def test_couplers_springs_and_rotors(engine: str) -> None:
    summary = compared(GRIPPER, engine).summary
    assert [(one["closure"], one["unit"]) for one in summary["closures"]] == [
        ("fingers", "rad"),
        ("pinion", "m"),
    ]
    assert all(0.0 < one["largest"] < 0.05 and one["here"] < 1e-12 for one in summary["closures"])
    assert summary["accelerations"]["error"] < 1e-9
    assert summary["of_the_engine"] == ["spring of rack"] and summary["handed_over"] == ["torque of left"]


@pytest.mark.parametrize("engine", ENGINES)
def test_pins_and_welds(engine: str) -> None:
    """In a plane a pin holds what a ball does; a weld's angle is read too."""
    pin = (FOUR_BAR % "").replace("type: spherical, between", "type: revolute, axis: [0, 0, 1], between")
    assert [one["unit"] for one in compared(pin, engine).summary["closures"]] == ["m"]
    weld = (
        (FOUR_BAR % "")
        .replace(
            "parent: base, link: rocker, origin: {xyz: [1.2, 0, 0]}}",
            "parent: base, link: rocker, origin: {xyz: [1.2, 0, 0]}}\n"
            "    - {name: d, type: revolute, axis: [0, 0, 1], parent: rocker, link: tip, origin: {xyz: [1, 0, 0]}}",
        )
        .replace(
            "  points:",
            "    - {name: tip, mass: 0.1, com: [0, 0, 0], inertia: {xx: 0.01, yy: 0.01, zz: 0.01}}\n  points:",
        )
    )
    weld = weld.replace("link: rocker, at: [1, 0, 0]", "link: tip, at: [0, 0, 0]").replace(
        "type: spherical", "type: fixed"
    )
    summary = compared(weld, engine).summary
    assert [(one["closure"], one["unit"]) for one in summary["closures"]] == [("join", "m"), ("join", "rad")]
    assert all(one["start"] < 1e-12 < one["largest"] < 0.02 for one in summary["closures"])
    assert summary["accelerations"]["error"] < 1e-9


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("kind", ["spherical", "revolute, axis: [0, 0, 1]"])
def test_loops_may_end_on_the_ground(kind: str, engine: str) -> None:
    text = (FOUR_BAR % "").replace("parent: base, link: rocker", "parent: coupler, link: rocker")
    text = text.replace("[1.2, 0, 0]", "[1.5, 0, 0]").replace("link: rocker, at", "link: base, at")
    text = text.replace("at: [1.5, 0, 0]}, top", "at: [1, 0, 0]}, top").replace(
        "pin: {link: coupler", "pin: {link: rocker"
    )
    summary = compared(text.replace("type: spherical", f"type: {kind}"), engine).summary
    assert 1e-12 < summary["closures"][0]["largest"] < 0.02
    assert summary["accelerations"]["error"] < 1e-9


@pytest.mark.parametrize("turning", ["", ", com: [0, 0, 0], inertia: {xx: 1e-3, yy: 1e-3, zz: 1e-3}"])
def test_massless_links_get_a_little_mass_on_both_sides(turning: str) -> None:
    text = (
        (FOUR_BAR % "")
        .replace("name: c, type: revolute", "name: c0, type: revolute")
        .replace("parent: base, link: rocker", "parent: base, link: stub")
    )
    text = (
        text.replace("loops:", "    # \nloops:")
        .replace(
            "  links:",
            "    - {name: c, type: revolute, axis: [0, 1, 0], parent: stub, link: rocker}\n  links:\n"
            f"    - {{name: stub, mass: 0{turning}}}",
        )
        .replace("c: 1.4}", "c0: 1.4}")
    )
    summary = compared(text).summary
    assert summary["with_small_mass"] == ["stub"]
    assert summary["accelerations"]["error"] < 1e-6 * summary["accelerations"]["size"]


def test_redundant_rows_keep_their_rank() -> None:
    """Rows that depend on each other where loops are closed stay dependent where they are open."""
    psi = np.array([[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0, 1e-4]]])
    gamma = np.array([[1.0, 2.0, 5.0]])
    rows, right = of_rank(psi, gamma, 2)
    assert np.linalg.matrix_rank(rows[0]) == 2 and np.abs(rows - psi).max() < 1e-4
    a = np.linalg.lstsq(rows[0], -right[0], rcond=None)[0]
    assert np.abs(rows[0] @ a + right[0]).max() < 1e-12 and np.abs(a).max() < 10.0
    assert of_rank(psi, gamma, 3)[0] is psi


def test_a_run_that_blows_up_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: Any
) -> None:
    """To the last step that is a state, with exit code 0, and without a word or a file of MuJoCo's."""
    pytest.importorskip("mujoco")
    scene, out = tmp_path / "bar.yaml", tmp_path / "out"
    scene.write_text((FOUR_BAR % ", spring: {stiffness: 1000}").replace("duration: 0.4", "duration: 20"))
    monkeypatch.chdir(tmp_path)
    words = [
        "crosscheck",
        str(scene),
        "--with",
        "mujoco",
        "--own-settings",
        "--step",
        "0.02",
        "--out",
        str(out),
    ]
    assert run([*words, "--set", "simulate.error_estimate=false"]) == 0
    said = capsys.readouterr()
    assert "blows up" in said.out and "WARNING" not in said.err
    assert not (tmp_path / "MUJOCO_LOG.TXT").exists()
    summary = json.loads((out / "summary.json").read_text())
    assert summary["command"] == "crosscheck" and summary["steps"] < 1000
    assert "blows up" in summary["termination"]["reason"]
    stored = read(out / "result.h5")
    assert applicable(stored) == ["own_settings"] and (out / "own_settings.png").exists()
    assert len(stored["crosscheck/gap"]) == len(stored.time) == summary["steps"] + 1
    assert np.isfinite(stored["crosscheck/energy_made"]).all()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            ["--with", "pinocchio", "--own-settings"],
            "--with pinocchio: not with --own-settings; allowed: mujoco, drake",
        ),
        (["--with", "drake"], "--with drake: not without --own-settings; allowed: pinocchio, mujoco"),
        (["--with", "mujoco", "--step", "1e-3"], "--step: only with --own-settings"),
        (["--with", "mujoco", "--out", "x"], "--out: only with --own-settings"),
        (["--with", "mujoco", "--own-settings", "--step", "-1"], "'-1'; allowed: a number > 0"),
        (["--with", "mujoco", "--own-settings", "--command", "inverse"], "allowed: --command simulate"),
        (["--with", "mujoco", "--own-settings", "--step", "1"], "0.4 steps of 1 s; allowed: 1 to 100000"),
        (["--with", "mujoco", "--own-settings", "--step", "1e-9"], "allowed: 1 to 100000 (--step)"),
    ],
)
def test_wrong_options_have_one_message(
    words: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("mujoco")
    scene = tmp_path / "bar.yaml"
    scene.write_text(FOUR_BAR % "")
    assert run(["crosscheck", str(scene), *words]) == 2
    assert message in capsys.readouterr().err


def test_what_an_engine_cannot_have_is_refused() -> None:
    pytest.importorskip("mujoco")
    driven = (FOUR_BAR % "").replace("torques: {a: '0.7*cos(3*t)'}", "prescribed: {a: 1.2 + 2*t}")
    with pytest.raises(CapabilityError, match="prescribed motion"):
        compared(driven)
    with pytest.raises(CapabilityError, match=r"masses that are gripped or released \(load\)"):
        compared((FOUR_BAR % "") + "payloads: [{name: load, mass: 1, at: pin, until: {time: 0.1}}]\n")
    with pytest.raises(CapabilityError, match="is helical, which is not built in MuJoCo"):
        compared((FOUR_BAR % "").replace("name: b, type: revolute", "name: b, type: helical, pitch: 0.1"))


def test_a_missing_drake_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pydrake", None)
    with pytest.raises(CapabilityError, match=r"pip install 'robodyn\[peers\]'"):
        own_settings(load_scene_text(FOUR_BAR % ""), "drake")
