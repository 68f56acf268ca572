"""The plan says what the command built: programs, events, corrections and states are those of the run."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robodyn_cli.errors import RobodynError, SceneError
from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.registry import methods
from robodyn_cli.integrators.runtime.integrator import Integrator
from robodyn_cli.integrators.stepping.loop import write_run
from robodyn_cli.integrators.stepping.writer import Writer
from robodyn_cli.joints.registry import joint_types
from robodyn_cli.kernels.lower import Programs
from robodyn_cli.kernels.program import Program
from robodyn_cli.kernels.samples import SampleKernel
from robodyn_cli.observe.evaluation import SampleFunction
from robodyn_cli.over.commands import command_of
from robodyn_cli.over.plan.plan import plan, subjects
from robodyn_cli.over.plan.subjects import title_of
from robodyn_cli.scene import load_scene, load_scene_text
from robodyn_cli.scene.types import Scene
from robodyn_cli.works.deploy.deploy import deploy
from robodyn_cli.works.inverse import inverse
from robodyn_cli.works.simulate import simulate
from tests.mechanisms import BENNETT, SIX_BAR, SLIDER

CONFIGS = Path(__file__).parents[2] / "configs"
COMMAND = {"inverse": inverse, "simulate": simulate, "deploy": deploy}


class BuiltError(Exception):
    """Ends a command where it would start to integrate."""


class Built:
    """What a command has built by the time that it integrates: system, method, functions of samples."""

    def __init__(self, scene: Scene, command: str) -> None:
        self.functions: list[SampleKernel | SampleFunction] = []
        self.integrated: list[tuple[System, str]] = []
        with pytest.MonkeyPatch.context() as patch:
            for member in (SampleKernel, SampleFunction):
                patch.setattr(member, "__init__", self._noting(member.__init__))
            patch.setattr(Integrator, "__init__", self._stop)
            if command == "inverse":
                inverse(scene)
                return
            with pytest.raises(BuiltError):
                COMMAND[command](scene)
        self.system, self.method = self.integrated[0]
        self.stepped = self._written(self.system, self.method)

    def _noting(self, make: Any) -> Any:
        def note(function: Any, *args: Any, **named: Any) -> None:
            make(function, *args, **named)
            # what closes the loops of the start comes before the equations of the run
            if "stepwise" not in named:
                self.functions.append(function)

        return note

    def _stop(self, system: System, method: str, *args: Any, **named: Any) -> None:
        self.integrated.append((system, method))
        raise BuiltError

    @staticmethod
    def _written(system: System, method: str) -> set[str]:
        """Return the digests of the programs that the code of a method for a system evaluates."""
        found: set[str] = set()
        write, call = Writer.evaluate, Programs.evaluate

        def note(w: Writer, program: Program, *args: Any, **named: Any) -> Any:
            found.add(program.digest[:12])
            return write(w, program, *args, **named)

        def note_call(p: Programs, f: Any, program: Program, *args: Any, **named: Any) -> Any:
            found.add(program.digest[:12])
            return call(p, f, program, *args, **named)

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(Writer, "evaluate", note)
            patch.setattr(Programs, "evaluate", note_call)
            write_run(system, methods[method], Programs(True))
        return found


def chosen(scene: Scene, command: str) -> Scene:
    """Return a scene with its method and Baumgarte's gains as chosen, so that their choice integrates nothing."""
    if command == "inverse":
        return scene
    motion = subjects[command](scene).motion
    options = dataclasses.replace(motion.scene.simulate, integrator=motion.choice.method)
    return dataclasses.replace(motion.scene, simulate=options)


def check(scene: Scene, command: str) -> None:
    """Fail unless a plan says what the command builds."""
    scene = chosen(scene, command)
    check_plan(plan(scene, command), scene, command)


def check_plan(found: dict[str, Any], scene: Scene, command: str) -> None:
    """Fail unless a plan says what the command builds for a scene whose choices are made."""
    assert found["status"] == "ok"
    built = Built(scene, command)
    planned = {k["digest"]: k for k in found["kernels"]}
    assert len(planned) == len(found["kernels"]), "each program once"
    if command == "inverse":
        # what solves for poses or for the time law comes before it, and is told as a term
        everything = next(f for f in built.functions if isinstance(f, SampleFunction))
        assert planned[everything.program.digest[:12]]["engine"] == engine(everything)
        return
    for function in built.functions:
        assert planned[function.program.digest[:12]]["engine"] in ("compiled", engine(function))
    assert {c["choice"]: c["taken"] for c in found["choices"]}["integrator"] == built.method
    check_system(found, built.system, built.stepped)


def engine(function: SampleKernel | SampleFunction) -> str:
    return "compiled" if function.compiled else "interpreted"


def check_system(found: dict[str, Any], system: System, stepped: set[str]) -> None:
    """Fail unless a plan says what a system has."""
    in_loop = [k for k in found["kernels"] if "placed" in k]
    if not system.dynamics.any_size:
        assert {k["digest"] for k in in_loop} == stepped
        assert system.dynamics.program.operations == found["operations"]
    kept = {e["term"]: e for e in found["kept"]}
    left_out = {e["term"] for e in found["left_out"]}
    watched = {title_of(event) for event in system.events}
    assert {term for term in kept if term.startswith("event: ")} == watched
    assert ("events" in left_out) == (not watched)
    assert ("work integral" in kept) == bool(system.further)
    projected = "projection of positions and velocities"
    assert (projected in kept) == (system.positions is not None)
    if system.positions is not None and system.velocities is not None:
        assert kept[projected]["operations"] == system.positions.operations + system.velocities.operations
    assert ("positions back on the joints' manifolds" in kept) == (system.normal_form is not None)


SCENES = [path for path in sorted(CONFIGS.rglob("*.yaml")) if path.parent.name != "robots"]  # parts of scenes
PLANNED = [path for path in SCENES if load_scene(path).command in (None, *subjects)]


@pytest.mark.parametrize("path", PLANNED, ids=lambda path: path.stem)
def test_examples(path: Path) -> None:
    scene = load_scene(path)
    check(scene, command_of(scene))


@pytest.mark.parametrize(
    ("name", "term"), [("fastest_2r", "time law"), ("pick_and_place", "search for the first pose")]
)
def test_what_is_solved_before_the_samples_is_told(name: str, term: str) -> None:
    scene = load_scene(CONFIGS / "trajectories" / f"{name}.yaml")
    assert term in {entry["term"] for entry in plan(scene, "inverse")["kept"]}


MECHANISMS = {"slider": SLIDER, "six_bar": SIX_BAR, "bennett": BENNETT}
SWITCHES = {
    "none": "simulate.stabilisation=none",
    "independent": "simulate.stabilisation=independent",
    "baumgarte": "simulate.stabilisation={alpha: 5, beta: 5}",
    "stop": "simulate.singular=stop",
    "stiff": "simulate.integrator=radau13",
    "explicit": "simulate.integrator=dop853",
    "reactions": "outputs.reactions=true",
}
CASES = [
    *(("slider", switch) for switch in SWITCHES),
    ("six_bar", "independent"), ("six_bar", "stop"), ("bennett", "stiff"), ("bennett", "independent"),
]  # fmt: skip


@pytest.mark.parametrize(("mechanism", "switch"), CASES)
def test_mechanisms(mechanism: str, switch: str) -> None:
    scene = load_scene_text("schema: 1\n" + MECHANISMS[mechanism], overrides=[SWITCHES[switch]])
    check_or_refuse(scene, "simulate")


def check_or_refuse(scene: Scene, command: str) -> None:
    """Fail unless a plan says what the command builds, or why the command refuses."""
    try:
        ready = chosen(scene, command)
        found = plan(ready, command)
    except RobodynError as error:  # such as independent coordinates of rows that depend on each other
        with pytest.raises(type(error)) as refused:
            COMMAND[command](scene)
        assert refused.value.message == error.message
        return
    check_plan(found, ready, command)


# -- random open chains --------------------------------------------------------------------------------------

AXES: dict[str, dict[str, Any]] = {
    "spherical": {},
    "floating": {},
    "helical": {"axis": [0, 0, 1], "pitch": 0.05},
}
ONE_AXIS = ("revolute", "prismatic", "helical")
EXTRAS: tuple[dict[str, Any], ...] = (
    {},
    {"friction": {"viscous": 0.3}},
    {"friction": {"coulomb": 1.0, "transition_speed": 0.1}},
    {"friction": {"coulomb": 1.0, "law": "set_valued"}},
    {"spring": {"stiffness": 4.0}, "damper": {"damping": 0.2}},
    {"limits": {"lower": -2.0, "upper": 2.0, "stop": {"stiffness": 50.0, "damping": 1.0}}},
    {"limits": {"lower": -2.0, "upper": 2.0, "stop": {"restitution": 0.5}}},
)
TORQUES = ("3", "2*sin(t)", "-0.5*qd.{0}", "abs(q.{0})", "step(t - 0.01)")


def random_chain(seed: int, all_kinds: bool = True) -> str:
    """Return a random open chain as text."""
    rng = np.random.default_rng(seed)
    kinds = [kind for kind in joint_types if kind != "fixed"]
    joints, links, torques = [], [], {}
    q: dict[str, Any] = {}
    for k in range(int(rng.integers(1, 4))):
        kind = str(rng.choice(kinds if all_kinds and rng.uniform() < 0.4 else ONE_AXIS))
        axis = AXES.get(kind, {"axis": [0, 0, 1]})
        joint: dict[str, Any] = {"name": f"j{k}", "type": kind, "link": f"l{k}"} | axis
        if rng.uniform() < 0.7:
            joint["origin"] = {"xyz": [0.4, 0.0, 0.1], "rpy": [float(rng.choice([0.0, 0.5])), 0.0, 0.0]}
        if kind in ONE_AXIS:
            joint |= EXTRAS[int(rng.integers(len(EXTRAS)))]
            q[f"j{k}"] = 0.2
            if rng.uniform() < 0.4:
                torques[f"j{k}"] = str(rng.choice(TORQUES)).format(f"j{k}")
        else:
            member = joint_types[kind]
            q[f"j{k}"] = dict(zip(member.names, member.neutral()))
        joints.append(joint)
        inertia = {"xx": 0.1, "yy": 0.2, "zz": 0.2, "xy": 0.01}
        links.append({"name": f"l{k}", "mass": 1.0, "com": [0.2, 0.1, 0.0], "inertia": inertia})
    gravity = [[0.0, -9.81, 0.0], [0.0, 0.0, 0.0], [1.0, 2.0, -9.0]][int(rng.integers(3))]
    scene = {"schema": 1, "gravity": gravity, "robot": {"joints": joints, "links": links},
             "torques": torques, "initial": {"q": q}}  # fmt: skip
    return json.dumps(scene)


@pytest.mark.parametrize("seed", range(24))
def test_random_chains(seed: int) -> None:
    check(load_scene_text(random_chain(seed)), "simulate")


@pytest.mark.parametrize("seed", range(100, 108))
def test_random_motions(seed: int) -> None:
    scene = json.loads(random_chain(seed, all_kinds=False))
    moves = {joint["name"]: "0.3*sin(t)" for joint in scene["robot"]["joints"]}
    scene["trajectory"] = {"type": "joint", "duration": 1, "q": moves}
    scene.pop("initial")
    scene["inverse"] = {"samples": 1 + 10 ** (seed % 6)}
    check_or_refuse(load_scene_text(json.dumps(scene)), "inverse")


# -- random mechanisms ---------------------------------------------------------------------------------------

CLOSURES: tuple[dict[str, Any], ...] = (
    {"type": "revolute", "axis": [0, 0, 1]},
    {"type": "spherical"},
    {"type": "point_on_line", "axis": [1, 0, 0]},
    {"type": "distance", "length": 0.3},
)
STABILISATIONS = ("projection", "projection", "none", "independent", "baumgarte", {"alpha": 5.0, "beta": 5.0})


def random_mechanism(seed: int) -> str:
    """Return a random chain of revolute joints whose end is tied to the base where it happens to be."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(3, 5))
    lengths, angles = rng.uniform(0.4, 1.0, count), rng.uniform(-0.9, 0.9, count)
    joints, links, torques = [], [], {}
    for k in range(count):
        place = {"xyz": [float(lengths[k - 1]) if k else 0.0, 0.0, 0.0]}
        joint = {"name": f"j{k}", "type": "revolute", "link": f"l{k}", "axis": [0, 0, 1], "origin": place}
        joints.append(joint | (EXTRAS[int(rng.integers(len(EXTRAS)))] if rng.uniform() < 0.4 else {}))
        inertia = {"xx": 0.1, "yy": 0.2, "zz": 0.2, "xy": 0.01}
        links.append(
            {"name": f"l{k}", "mass": 1.0, "com": [0.2, 0.1, 0.0], "com_frame": "joint", "inertia": inertia}
        )
        if rng.uniform() < 0.4:
            torques[f"j{k}"] = str(rng.choice(TORQUES)).format(f"j{k}")
    tip = lengths @ np.exp(1j * np.cumsum(angles))
    closure = CLOSURES[int(rng.integers(len(CLOSURES)))]
    anchor = [float(tip.real), float(tip.imag) + closure.get("length", 0.0), 0.0]
    points = {"tip": {"link": f"l{count - 1}", "at": [float(lengths[-1]), 0.0, 0.0]},
              "anchor": {"link": "base", "at": anchor}}  # fmt: skip
    lean = [float(rng.choice([0.0, 0.4])), 0.0, 0.0]  # then no coordinate axis is normal to the plane
    driven = {"j0": f"{angles[0]} + 0.2*t"} if rng.uniform() < 0.2 else {}
    scene = {
        "schema": 1,
        "gravity": [0.0, -9.81, 0.0],
        "robot": {"joints": joints, "links": links, "points": points, "base": {"rpy": lean}},
        "loops": [{"name": "pin", "between": ["tip", "anchor"], **closure}],
        "torques": {name: formula for name, formula in torques.items() if name not in driven},
        "prescribed": driven,
        "initial": {"q": {f"j{k}": float(x) for k, x in enumerate(angles)}},
        "simulate": {
            "stabilisation": STABILISATIONS[int(rng.integers(len(STABILISATIONS)))],
            "singular": str(rng.choice(["pass", "stop"])),
            "duration": 0.05,
        },
    }
    return json.dumps(scene)


@pytest.mark.parametrize("command", ["simulate", "deploy"])
@pytest.mark.parametrize("seed", range(16))
def test_random_mechanisms(seed: int, command: str) -> None:
    check_or_refuse(load_scene_text(random_mechanism(seed)), command)


def test_missing_data_are_named_not_raised() -> None:
    scene = load_scene(CONFIGS / "mechanisms" / "four_bar_kinematics.yaml")
    found = plan(scene, "simulate")
    with pytest.raises(SceneError, match="com") as refused:
        simulate(scene)
    assert found["status"] == "failed" and set(found["missing"]) <= set(refused.value.details["missing"])
    assert found["kernels"] == [] == found["choices"], "nothing can be compiled"
