"""``robodyn export SCENE --c DIR``: folders that test themselves, what keys do, what is refused."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robodyn_cli import Mechanism, load_scene
from robodyn_cli.cli.app import run
from robodyn_cli.over.batch.stored import is_part
from robodyn_cli.results import atomic
from tests.exported_c import COMPILER, ExportedC, needs_compiler, self_test

ROOT = Path(__file__).parents[2]
CONFIGS = ROOT / "configs"
SCENES = sorted(path.relative_to(CONFIGS).as_posix() for path in CONFIGS.rglob("*.yaml") if not is_part(path))
# scenes with parts that no function of a state has, and what the message names
REFUSED = {
    "bouncing_pendulum.yaml": "robot.joints.theta1.limits: a rigid stop",
    "catching_arm.yaml": "payloads.0",
    "mechanisms/lift_arm.yaml": "robot.joints.lift.friction: friction that sticks",
    "stick_slip.yaml": "robot.joints.slide.friction: friction that sticks",
}
PENDULUM = CONFIGS / "double_pendulum.yaml"


def exported(folder: Path, scene: Path | str, *options: str) -> Path:
    assert run(["export", str(scene), "--c", str(folder), "--quiet", *options]) == 0
    return folder


@needs_compiler
@pytest.mark.parametrize("scene", SCENES)
def test_every_scene_tests_itself_or_is_refused(scene: str, tmp_path: Path, capsys: Any) -> None:
    out = tmp_path / "c"
    code = run(["export", str(CONFIGS / scene), "--c", str(out), "--quiet"])
    if scene in REFUSED:
        assert code == 2 and REFUSED[scene] in capsys.readouterr().err and not out.exists()
        return
    assert code == 0
    sources = sorted(path.name for path in out.glob("*.c"))
    assert len(sources) == 2 and "self_test.c" in sources
    assert sum("int main(" in (out / name).read_text(encoding="utf-8") for name in sources) == 1
    assert self_test(out).endswith("all agree\n")


@needs_compiler
@pytest.mark.parametrize(
    "scene",
    ["controlled_arm.yaml", "benchmarks/bennett.yaml", "seven_joint_arm.yaml", "four_bar_prescribed.yaml"],
)
def test_in_both_precisions_and_under_sanitizers(scene: str, tmp_path: Path) -> None:
    out = exported(tmp_path / "c", CONFIGS / scene)
    switch = f"-D{next(out.glob('*.h')).stem.upper()}_SINGLE"
    single = self_test(out, "-Wdouble-promotion", switch)
    # the errors of the page are those of single precision, which are not those of double
    worst = max(float(line.split()[2]) for line in single.splitlines() if " allowed " in line)
    assert 1e-8 < worst < 1e-2
    probe = tmp_path / "probe"
    probe.mkdir()
    (probe / "probe.c").write_text("int main(void)\n{\n    return 0;\n}\n", encoding="utf-8")
    flags = ["-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
    command = [str(COMPILER), *flags, str(probe / "probe.c"), "-o", str(probe / "probe")]
    if subprocess.run(command, capture_output=True).returncode:
        pytest.skip("the compiler has no sanitizers")
    self_test(out, *flags)
    self_test(out, *flags, switch)


def state(mechanism: Mechanism, seed: int) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(seed)
    nq, nv = len(mechanism.q_names), len(mechanism.qd_names)
    return rng.normal(size=nq), rng.normal(size=nv), rng.normal(size=nv)


@needs_compiler
def test_keys_give_what_the_scene_gives_with_them(tmp_path: Path) -> None:
    mass, length, twist = "robot.links.link1.mass", "robot.joints.theta2.a", "robot.joints.theta2.offset"
    out = exported(
        tmp_path / "c", PENDULUM, "--key", f"{mass}=2:30", "--key", length, "--key", "gravity.0",
        "--set", "robot.links.link2.mass=3",
    )  # fmt: skip
    library = ExportedC(out)
    assert library.set(mass, 30.5) == 1 and library.set(mass, np.nan) == 1 and library.set(twist, 0.1) == 1
    values = {mass: 2.0, length: 0.7, "gravity.0": 1.5}
    for key, value in values.items():
        assert library.set(key, value) == 0
    other = Mechanism(
        load_scene(PENDULUM, ["robot.links.link2.mass=3", *(f"{k}={x}" for k, x in values.items())])
    )
    q, qd, x = state(other, 3)
    (tau,) = library.call("inverse_dynamics", q, qd, x)
    assert tau == pytest.approx(other.inverse_dynamics(q, qd, x), rel=1e-12)
    assert library.set("gravity.0", 0.0) == 0  # a number all the same
    assert library.set(mass, 1.0) == 1  # below its bound; nothing has changed
    (M,) = library.call("mass_matrix", q)
    assert M.reshape(2, 2) == pytest.approx(other.mass_matrix(q), rel=1e-12)


@needs_compiler
def test_the_law_of_a_sampled_controller(tmp_path: Path) -> None:
    """Its states follow those of a simulation from sample to sample."""
    from robodyn_cli import simulate

    out = exported(tmp_path / "c", CONFIGS / "controlled_arm.yaml")
    library = ExportedC(out)
    count = 26
    scene = load_scene(
        CONFIGS / "controlled_arm.yaml", ["simulate.duration=0.05", f"simulate.samples={count}"]
    )
    result, period = simulate(scene), float(scene.control.period)
    assert result["time"][1] == pytest.approx(period)
    (z,) = library.call("control_start", result["q"][0])
    for k in range(count):
        q, qd = result["q"][k], result["qd"][k]
        (z,) = library.call("control_update", k * period, q, qd, z)
        assert z == pytest.approx(result["control/states"][k], rel=1e-9, abs=1e-9)
        (tau,) = library.call("control_torques", k * period, q, qd, z)
        assert tau == pytest.approx(result["control/torque"][k], rel=1e-9, abs=1e-9)
        (z,) = library.call("control_delayed", (k + 0.5) * period, q, qd, z)


LOOPS = [
    "four_bar_deploy.yaml",
    "benchmarks/bennett.yaml",
    "benchmarks/spatial_slider_crank.yaml",
    "published/delta.yaml",
]


@needs_compiler
@pytest.mark.parametrize("scene", LOOPS)
def test_accelerations_under_loops(scene: str, tmp_path: Path) -> None:
    """Redundant rows, massless links: qdd is that of ``Mechanism``, and the multipliers balance it."""
    library = ExportedC(exported(tmp_path / "c", CONFIGS / scene))
    mechanism = Mechanism(CONFIGS / scene)
    nq, nv = len(mechanism.q_names), len(mechanism.qd_names)
    q, qd = np.zeros(nq), np.zeros(nv)
    getattr(library.code, f"{library.name}_start")(library._at(q), library._at(qd))
    tau = np.random.default_rng(5).normal(size=nv)
    qdd, lam = library.call("forward_dynamics", q, qd, tau)
    assert library.status == 0
    expected = mechanism.forward_dynamics(q, qd, tau)
    assert qdd == pytest.approx(expected, abs=1e-9 * np.abs(expected).max())
    (psi,) = library.call("constraint_jacobian", q)
    psi = psi.reshape(-1, nv)
    assert psi == pytest.approx(mechanism.constraint_jacobian(q))
    assert np.abs(library.call("constraints", q)[0]).max() < 1e-6
    other = (
        tau + psi.T @ lam
    )  # with the forces of the loops as torques the opened tree has the same accelerations
    left = mechanism.mass_matrix(q) @ qdd - other
    still, _ = library.call("forward_dynamics", q, qd, 0.0 * tau)
    rest = mechanism.mass_matrix(q) @ still - psi.T @ library.call("forward_dynamics", q, qd, 0.0 * tau)[1]
    assert left == pytest.approx(rest, abs=1e-8 * max(1.0, np.abs(other).max()))


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--key", "initial.q.theta1"], "the start of a simulation"),
        (["--key", "simulate.duration"], "an option of a simulation"),
        (["--key", "robot.links.link1.mass=3"], "allowed: KEY, or KEY=LOW:HIGH"),
        (["--key", "robot.links.link1.mass=3:1"], "allowed: KEY, or KEY=LOW:HIGH"),
        (["--key", "robot.links.link1.mass=-3:20"], "robot.links.link1.mass"),
        (["--key", "robot.links.link1.mass=1:2"], "lies outside 1:2"),
        (["--key", "robot.links.link1.masse"], "masse"),
        (["--key", "robot.links.link1.mass", "--key", "robot.links.0.mass"], "is given twice"),
        (["--key", "robot.joints.theta1.type"], "robot.joints.theta1.type"),
        (["--key", "simulate.rtol"], "no function depends on it"),
        (["--to", "mjcf"], "either --to KIND with --out DIR, or --c DIR"),
        (["--out", "there"], "either --to KIND with --out DIR, or --c DIR"),
    ],
)
def test_keys_and_options_that_are_refused(
    options: list[str], said: str, tmp_path: Path, capsys: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(["export", str(PENDULUM), "--c", "c", *options]) == 2
    assert said in capsys.readouterr().err and not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ([], "either --to KIND with --out DIR, or --c DIR"),
        (["--to", "mjcf"], "either --to KIND"),
        (["--to", "mjcf", "--out", "out", "--key", "gravity.1"], "--key goes with --c"),
    ],
)
def test_one_form_is_asked_for(
    options: list[str], said: str, tmp_path: Path, capsys: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(["export", str(PENDULUM), *options]) == 2
    assert said in capsys.readouterr().err and not list(tmp_path.iterdir())


def test_a_controller_in_python_is_refused(tmp_path: Path, capsys: Any) -> None:
    options = ["--set", "control={type: python, period: 0.01}"]
    assert run(["export", str(PENDULUM), "--c", str(tmp_path / "c"), *options]) == 2
    assert "a function in Python has no C" in capsys.readouterr().err and not list(tmp_path.iterdir())


ODD = """\
schema: 1
gravity: [0, 0, -9.81]
robot:
  joints:
    - {name: q, type: revolute, axis: [0, 1, 0]}
    - {name: n, type: spherical, origin: {xyz: [0, 0, -0.4]}}
    - {name: ab, type: prismatic, axis: [1, 0, 0]}
    - {name: "a_b", type: revolute, axis: [1, 0, 0]}
  links:
    - {name: one, mass: 2, com: [0, 0, -0.2], inertia: {xx: 0.03, yy: 0.03, zz: 0.01}}
    - {name: double, mass: 1, com: [0.1, 0, -0.2], inertia: {xx: 0.02, yy: 0.02, zz: 0.01, xy: 0.001}}
    - {name: a-b, mass: 1, com: [0, 0.1, -0.2], inertia: {xx: 0.02, yy: 0.02, zz: 0.01}}
    - {name: a_b, mass: 1, com: [0, 0, -0.2], inertia: {xx: 0.02, yy: 0.02, zz: 0.01}}
forces:
  - {name: wind, type: force, at: double.com, force: ["3*sin(t)", 0, 0]}
"""


@needs_compiler
def test_names_that_c_cannot_have_and_forces_in_time(tmp_path: Path) -> None:
    path = tmp_path / "2 new-scene.yaml"
    path.write_text(ODD, encoding="utf-8")
    out = exported(tmp_path / "c", path)
    assert sorted(x.name for x in out.iterdir()) == [
        "CMakeLists.txt", "README.md", "robot_2_new_scene.c", "robot_2_new_scene.h", "robot_2_new_scene.pc.in", "self_test.c",
    ]  # fmt: skip
    self_test(out)
    assert all(line.isascii() for line in (out / "robot_2_new_scene.h").read_text("utf-8").splitlines())


def test_nothing_is_left_half_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "deep" / "c"

    def failing(path: Path, *_: Any, **__: Any) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_text", failing)
        assert run(["export", str(PENDULUM), "--c", str(out), "--quiet"]) == 74
    assert not out.exists() and not list((tmp_path / "deep").iterdir())
    exported(out, PENDULUM)
    before = {path.name: path.read_bytes() for path in out.iterdir()}
    (out / "mine.txt").write_text("kept", encoding="utf-8")
    with monkeypatch.context() as patch:
        patch.setattr(atomic, "publish", failing)
        assert run(["export", str(PENDULUM), "--c", str(out), "--set", "gravity=[0, 0, 0]"]) == 74
    assert {path.name: path.read_bytes() for path in out.iterdir()} == {**before, "mine.txt": b"kept"}
    exported(out, PENDULUM, "--set", "gravity=[0, 1, 0]")
    assert (out / "double_pendulum.c").read_bytes() != before["double_pendulum.c"]
    assert sorted(path.name for path in (tmp_path / "deep").iterdir()) == ["c"]


def test_what_is_said(tmp_path: Path, capsys: Any) -> None:
    """Functions that a scene has no data for are left out, with what they lack."""
    out, scene = tmp_path / "c", CONFIGS / "mechanisms" / "four_bar_kinematics.yaml"
    assert run(["export", str(scene), "--c", str(out), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert len(said["files"]) == 6 and any(
        "mass_matrix" in note and "mass of arm" in note for note in said["notes"]
    )
    assert "mass_matrix" in (out / "README.md").read_text(encoding="utf-8")
    robot = tmp_path / "arm.urdf"
    assert run(["export", str(PENDULUM), "--to", "urdf+", "--out", str(tmp_path), "--quiet"]) == 0
    (tmp_path / "double_pendulum.urdf").rename(robot)
    weights = {}
    for name, options in {
        "own": [],
        "standard": ["gravity=[0, 0, -9.81]"],
        "none": ["gravity=[0, 0, 0]"],
    }.items():
        own = exported(tmp_path / name, robot, *(x for o in options for x in ("--set", o)))
        weights[name] = (own / "arm.c").read_text(encoding="utf-8")
    assert weights["own"] == weights["standard"] != weights["none"]  # a URDF says nothing of gravity


@needs_compiler
def test_cmake_installs_what_pkg_config_finds(tmp_path: Path) -> None:
    import shutil

    if not shutil.which("cmake"):
        pytest.skip("no cmake is installed")
    out = exported(tmp_path / "c", PENDULUM)
    build, there = tmp_path / "build", tmp_path / "there"
    for command in (
        ["cmake", "-S", str(out), "-B", str(build), f"-DCMAKE_INSTALL_PREFIX={there}"],
        ["cmake", "--build", str(build)],
        ["ctest", "--test-dir", str(build)],
        ["cmake", "--install", str(build)],
    ):
        done = subprocess.run(command, capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr
    assert (there / "include" / "double_pendulum.h").exists()
    (config,) = there.rglob("double_pendulum.pc")
    text = config.read_text(encoding="utf-8")
    assert f"prefix={there}" in text and "-ldouble_pendulum" in text and "@" not in text
