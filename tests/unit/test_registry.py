"""Registries: names at once, members when asked for; runs import what their scene names."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from robodyn_cli.forces.registry import force_types, joint_forces
from robodyn_cli.integration_methods import METHODS
from robodyn_cli.integrators.registry import methods
from robodyn_cli.joints.registry import joint_types
from robodyn_cli.loops.registry import loop_types
from robodyn_cli.registry import Registry
from robodyn_cli.trajectories.registry import trajectory_types

ROOT = Path(__file__).parents[2]
REGISTRIES: dict[str, Mapping[str, Any]] = {
    "joints": joint_types,
    "forces in joints": joint_forces,
    "forces": force_types,
    "loops": loop_types,
    "trajectories": trajectory_types,
    "integrators": methods,
}


@pytest.mark.parametrize("kind", REGISTRIES)
def test_every_member_is_where_its_line_says(kind: str) -> None:
    """Each is found in the folder of its registry, and two names never stand for the same member."""
    registry = REGISTRIES[kind]
    folder = kind.split()[0]
    members = list(registry.values())
    assert len(members) == len(registry) == len({id(member) for member in members})
    for member in members:
        cls = member if isinstance(member, type) else type(member)
        assert cls.__module__.startswith(f"robodyn_cli.{folder}.")


def test_a_registry_is_a_map() -> None:
    registry: Registry[Any] = Registry("robodyn_cli", {"b": "record:record", "a": "errors:SceneError"})
    assert list(registry) == ["b", "a"] and len(registry) == 2 and "a" in registry and "c" not in registry
    assert registry["a"].__name__ == "SceneError" and registry.get("c") is None
    with pytest.raises(KeyError, match="c"):
        registry["c"]
    registry["c"] = 3
    registry["a"] = 4
    assert dict(registry)["c"] == 3 and registry["a"] == 4 and list(registry) == ["b", "a", "c"]
    del registry["c"], registry["b"]
    assert list(registry) == ["a"]
    made: Registry[Any] = Registry("robodyn_cli.joints", {"one": "single_axis:Revolute"}, made=True)
    assert made["one"] is made["one"] and made["one"].nv == 1


CODE = """
import sys
from robodyn_cli.cli.app import run
code = run(sys.argv[2:])
assert code == int(sys.argv[1]), code
print(*sys.modules)
"""


def modules_of(*arguments: str, code: int = 0) -> set[str]:
    """Return the modules that robodyn has imported when such a run ends, with this exit code."""
    command = [sys.executable, "-c", CODE, str(code), *arguments]
    ended = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=240)
    assert ended.returncode == 0, ended.stderr
    return set(ended.stdout.splitlines()[-1].split())


def members_in(modules: set[str]) -> dict[str, set[str]]:
    """Return, for each registry, the names of its members whose modules are there."""

    def module(member: Any) -> str:
        return (member if isinstance(member, type) else type(member)).__module__

    return {
        kind: {name for name, member in registry.items() if module(member) in modules}
        for kind, registry in REGISTRIES.items()
    }


def test_a_run_imports_the_members_that_its_scene_names(tmp_path: Path) -> None:
    common = ("--no-plots", "--quiet", "--out", str(tmp_path))
    inverse = members_in(modules_of("inverse", "configs/2r_circle.yaml", *common))
    assert inverse["integrators"] == set() == inverse["loops"] == inverse["forces"]
    assert inverse["trajectories"] == {"circle"}
    simulate = members_in(modules_of("simulate", "configs/double_pendulum.yaml", *common))
    assert {METHODS[name].family for name in simulate["integrators"]} == {"gauss"}
    assert simulate["trajectories"] == set() == simulate["loops"]
    assert "revolute" in simulate["joints"] and "floating" not in simulate["joints"]
    deploy = members_in(modules_of("deploy", "configs/four_bar_deploy.yaml", *common))
    assert (
        "revolute" in deploy["loops"]
        and "distance" not in deploy["loops"]
        and deploy["trajectories"] == set()
    )


# budgets of start-up, with some room: modules of ours that a run may import, functions of ours that it may call. Each
# module costs a quarter of a millisecond; a run that needs more may raise its budget, knowingly
MOST = {"inverse configs/2r_circle.yaml": 136, "simulate configs/double_pendulum.yaml": 177}
MOST_CALLED = (
    # some 30 read units, as their starts are in degrees; five spare a run the import of pydantic; two choose code;
    # seven ask whether rounding is as usual, and give errors
    1411
)


@pytest.mark.parametrize("run", MOST)
def test_a_small_run_imports_few_modules(run: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROBODYN_CACHE", "off")  # or it may keep something
    found = modules_of(*run.split(), "--no-plots", "--quiet", "--out", str(tmp_path))
    ours = sorted(name for name in found if name.startswith("robodyn_cli."))
    assert len(ours) <= MOST[run], ours
    assert not any(
        name.startswith(("robodyn_cli.kernels.rolled", "robodyn_cli.formulations.rolled")) for name in ours
    )
    assert not {"pydantic", "scipy", "matplotlib"} & found, "each takes as long as the run itself, or longer"
    assert "llvmlite" in found or not {"tempfile", "random"} & found, "llvmlite imports them"


def test_a_failed_run_loads_no_drawings(tmp_path: Path) -> None:
    """It says last why it failed, in words that drawings and pages use too."""
    short = ("--set", "simulate.duration=0.2", "--set", "simulate.samples=3")
    found = modules_of(
        "deploy", "configs/four_bar_deploy.yaml", *short, "--no-plots", "--out", str(tmp_path), code=1
    )
    assert "robodyn_cli.report.page.verdict" in found and "matplotlib" not in found


COUNTED = """
import sys
called = set()

def note(frame, event, argument):
    code = frame.f_code
    if event == "call" and "robodyn_cli" in code.co_filename and not code.co_name.startswith("<"):
        called.add(code)

sys.setprofile(note)
from robodyn_cli.cli.app import run
from robodyn_cli.kernels import cache
cache.SWEEPERS = ""  # else the digest of the sources decides whether the cache is swept
code = run(sys.argv[1:])
sys.setprofile(None)
assert code == 0, code
print(len(called))
"""


def test_a_small_cold_run_calls_few_functions(tmp_path: Path) -> None:
    """Definitions of classes count, modules and comprehensions do not."""
    arguments = ("configs/double_pendulum.yaml", "--no-plots", "--quiet", "--out", str(tmp_path / "out"))
    environment = {**os.environ, "ROBODYN_CACHE": str(tmp_path / "cache")}
    ended = subprocess.run(
        [sys.executable, "-c", COUNTED, "simulate", *arguments],
        cwd=ROOT,
        env=environment,
        capture_output=True,
        text=True,
        timeout=240,
    )
    assert ended.returncode == 0, ended.stderr
    assert int(ended.stdout.splitlines()[-1]) <= MOST_CALLED


def test_figures_of_several_results_are_compared_without_drawings(tmp_path: Path) -> None:
    for name in ("first", "second"):
        modules_of(
            "statics", "configs/double_pendulum.yaml", "--no-plots", "--quiet", "--out", str(tmp_path / name)
        )
    found = modules_of("compare", str(tmp_path / "first"), str(tmp_path / "second"), "--figures", "--quiet")
    assert (
        "robodyn_cli.report.page.compared" in found and not {"matplotlib", "robodyn_cli.report.style"} & found
    )


def test_building_a_system_imports_neither_results_nor_runs() -> None:
    """Who only integrates (as the benchmarks do) gets scene, equations, kernels and integrator, and no more."""
    code = (
        "import sys\n"
        "import numpy\n"
        "before = set(sys.modules)  # numpy 1 imports its polynomials itself\n"
        "from robodyn_cli import load_scene\n"
        "from robodyn_cli.formulations.build import build_system\n"
        "from robodyn_cli.integrators.runtime.integrator import Integrator\n"
        "from robodyn_cli.ready.prepare import prepare\n"
        "Integrator(build_system(prepare(load_scene('configs/double_pendulum.yaml')).problem), 'gauss')\n"
        "print(*(sys.modules.keys() - before))\n"
    )
    ended = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=240
    )
    assert ended.returncode == 0, ended.stderr
    found = set(ended.stdout.split())
    assert not any(name.startswith(("robodyn_cli.results.", "robodyn_cli.report.")) for name in found)
    assert (
        not {"robodyn_cli.works.simulate", "robodyn_cli.observe.recorder", "h5py", "numpy.polynomial"} & found
    )


@pytest.mark.parametrize(
    "words",
    [
        "validate configs/double_pendulum.yaml",
        "validate configs/four_bar_deploy.yaml",
        "plan configs/four_bar_deploy.yaml",
        "plan configs/2r_circle.yaml",
        "info configs/2r_circle.yaml",
        "equations configs/four_bar_deploy.yaml",
        "export configs/four_bar_deploy.yaml --to mjcf --out {}/robot",
        "export configs/2r_circle.yaml --c {}/c",
        "import configs/robots/lift_arm.urdf {}/arm.yaml",
        "new --example four_bar_deploy {}",
        "schema",
        "cache",
        "help inverse",
        "sweep --help",
    ],
)
def test_commands_without_a_result_load_no_hdf5(words: str, tmp_path: Path) -> None:
    assert "h5py" not in modules_of(*words.format(tmp_path).split())


def test_a_sweep_loads_its_command_alone(tmp_path: Path) -> None:
    """Of what is by command, ``sweep`` of ``inverse`` loads that of ``inverse``."""
    study = ("--vary", "robot.links.link1.mass=[10, 12]", "--of", "joints.theta1.peak_torque")
    found = modules_of(
        "sweep", "configs/2r_circle.yaml", *study, "--no-plots", "--quiet", "--out", str(tmp_path)
    )
    others = (
        "motion",
        "over.sensitivity",
        "over.stability",
        "over.work_precision",
        "ready.controllers",
        "ready.reference",
        "ready.regulator",
        "works.deploy",
        "works.linearise",
        "works.simulate",
        "works.size",
    )
    loaded = sorted(name for name in found if name.startswith(tuple(f"robodyn_cli.{x}" for x in others)))
    assert not loaded
    assert "robodyn_cli.over.many.inverse" in found and "robodyn_cli.over.many.simulate" not in found
