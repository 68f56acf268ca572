"""Threads: the linear algebra gets one; programs that build and run mechanisms in several get the bits of one."""

from __future__ import annotations

import hashlib
import json
import os
import pickle
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robodyn_cli import InverseKinematics, Mechanism, deploy, inverse, load_scene, simulate
from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.fixed import Fixed, literal, witnessed
from robodyn_cli.integrators.registry import methods
from robodyn_cli.integrators.runtime.fleet import Fleet
from robodyn_cli.kernels import compiler
from robodyn_cli.kernels.cache import REPORT
from robodyn_cli.kernels.samples import IterationKernel, SampleKernel
from robodyn_cli.motion.build import build_motion
from robodyn_cli.over.many.groups import Structures
from robodyn_cli.over.many.simulate import Simulate
from robodyn_cli.registry import Registry
from robodyn_cli.threads import VARIABLES, single_thread
from robodyn_cli.torques.dynamics import InverseDynamics, StateFunction
from robodyn_cli.works.functions.derivatives import Regressor

# an import of numpy that comes too early would not hear what is asked for later
WATCHED = """
import os, sys
class Watch:
    def find_spec(self, name, *rest):
        if name == "numpy":
            print(*(os.environ.get(x) for x in {names!r}))
            sys.meta_path.remove(self)
sys.meta_path.insert(0, Watch())
sys.argv = ["robodyn", "validate", "configs/double_pendulum.yaml", "--quiet"]
from robodyn_cli.cli.main import main
main()
"""
CONFIGS = Path(__file__).resolve().parents[2] / "configs"
MASS, LENGTH = "robot.links.link1.mass", "robot.joints.theta1.a"
Action = Callable[[], Any]


# -- of the linear algebra ---------------------------------------------------------------------------------
def test_what_the_user_says_stays() -> None:
    environment = {VARIABLES[1]: "4", "PATH": "x"}
    single_thread(environment)
    assert environment == {"PATH": "x", **dict.fromkeys(VARIABLES, "1"), VARIABLES[1]: "4"}


def test_commands_ask_before_numpy_is_imported() -> None:
    environment = {k: v for k, v in os.environ.items() if k not in VARIABLES}
    environment[VARIABLES[2]] = "3"
    code = WATCHED.format(names=VARIABLES)
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True)
    assert done.stdout.split() == ["1", "1", "3"], done.stderr


# -- of programs -------------------------------------------------------------------------------------------
def together(actions: Sequence[Action]) -> list[Any]:
    """Return what actions give that start at the same time, a thread each; the first error is raised."""
    start, results = threading.Barrier(len(actions)), [None] * len(actions)
    errors: list[BaseException] = []

    def run(k: int) -> None:
        start.wait()
        try:
            results[k] = actions[k]()
        except BaseException as error:
            errors.append(error)

    threads = [threading.Thread(target=run, args=(k,)) for k in range(len(actions))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for error in errors:
        raise error
    return results


@pytest.mark.parametrize("first_leaves_first", [True, False])
def test_each_thread_has_its_own_comparisons(first_leaves_first: bool) -> None:
    """Whichever of two threads leaves first, none gets or loses comparisons, and nothing stays behind."""
    inside, left = threading.Barrier(2), threading.Event()

    def work(name: str, leaves_first: bool) -> list[Any]:
        number = literal(2.0, name)
        with witnessed() as witnesses:
            inside.wait()
            assert number > 1.0
            inside.wait()
            if not leaves_first:
                left.wait()
                assert number < 3.0
        if leaves_first:
            left.set()
        return [(op, getattr(a, "args", ("",))[0]) for op, a, _, _ in witnesses]

    order = {"a": first_leaves_first, "b": not first_leaves_first}
    found = together([lambda name=name, first=first: work(name, first) for name, first in order.items()])
    for (name, first), own in zip(order.items(), found):
        assert own == [("gt", name)] if first else [("gt", name), ("lt", name)]
    with witnessed() as outer:
        with witnessed() as inner:
            assert literal(2.0, "c") > 1.0
        assert literal(2.0, "c") < 3.0
    assert [w[0] for w in inner] == ["gt"] and [w[0] for w in outer] == ["lt"]


def test_a_number_is_one_object_in_all_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two threads that find a number missing at the same time make one of it: equal terms have to be merged."""
    from robodyn_cli.expr import fixed

    missed = threading.Barrier(2)

    class Slow(type(fixed._known)):  # type: ignore[misc]
        def get(self, key: Any, default: Any = None) -> Any:
            found = super().get(key, default)
            missed.wait()
            return found

    monkeypatch.setattr(fixed, "_known", Slow())
    one, other = together([lambda: literal(2.0, "a")] * 2)
    assert one is other


def test_a_member_is_one_object_in_all_threads() -> None:
    """Kinds of joints and methods are told apart by identity."""
    made = threading.Barrier(2)

    class Slow(Registry[Any]):
        def make(self, name: str, found: Any) -> Any:
            made.wait()
            return found()

    members = Slow("robodyn_cli.joints", {"revolute": "single_axis:Revolute"}, made=True)
    one, other = together([lambda: members["revolute"]] * 2)
    assert one is other


def test_code_that_two_threads_compile_stays_in_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """Both get the module that is kept: what the other one has compiled goes, and addresses in it with it."""
    monkeypatch.setenv("ROBODYN_CACHE", "off")
    writing = threading.Barrier(2)

    def write() -> str:
        writing.wait()
        return "define double @twice(double %x) {\n %y = fadd double %x, %x\n ret double %y\n}"

    one, other = together([lambda: compiler.compile_module("compiled by two threads", write)] * 2)
    assert one is other


def test_times_of_stages_are_those_of_the_thread() -> None:
    before = REPORT.seconds
    together([lambda: REPORT.spend(1.0)])
    assert REPORT.seconds == before


def test_order_of_factors_does_not_depend_on_the_memory() -> None:
    """The estimate of rounding goes through the factors in their order, and derivatives are written in it."""
    kept: list[Fixed] = []
    for k in range(200):
        names = ("a", "b") if k % 2 else ("b", "a")
        kept += [x for name in names if isinstance(x := literal(1.0 + k, name), Fixed)]
    pairs = [sorted(pair, key=lambda x: str(x.args[0])) for pair in zip(kept[::2], kept[1::2])]
    assert {(id(a) < id(b)) for a, b in pairs} == {True, False}
    for a, b in pairs:
        assert a * b is b * a and a + b is b + a
    assert len({tuple(x.args[0] for x in (a * b).args) for a, b in pairs}) == 1


# -- bits ----------------------------------------------------------------------------------------------------
def bits(*arrays: Any) -> str:
    """Return a digest of arrays and texts."""
    found = hashlib.sha256()
    for x in arrays:
        found.update(x.encode() if isinstance(x, str) else np.ascontiguousarray(x).tobytes())
    return found.hexdigest()


def of_command(command: Callable[[Any], Any], name: str, *overrides: str) -> Action:
    """Return an action: all datasets of a run, and the errors that it states."""

    def action() -> str:
        result = command(load_scene(str(CONFIGS / name), overrides))
        arrays = [result[path] for path in sorted(result.variables)]
        return bits(*arrays, str(result.summary.get("error_estimate")))

    return action


def controlled() -> str:
    scene = load_scene(
        str(CONFIGS / "double_pendulum.yaml"), ["simulate.duration=0.2", "simulate.samples=21"]
    )
    result = simulate(scene, controller=lambda t, q, qd: [-30.0 * q[0] - 2.0 * qd[0], np.sin(t)], period=0.01)
    return bits(result["q"], str(result.summary["error_estimate"]))


def arm() -> str:
    mechanism = Mechanism(str(CONFIGS / "benchmarks" / "puma560.yaml"))
    q, qd, qdd = np.random.default_rng(0).uniform(-1.0, 1.0, (3, 20, 6))
    found = mechanism.inverse_dynamics_derivatives(q, qd, qdd)
    return bits(mechanism.mass_matrix(q), mechanism.inverse_dynamics(q, qd, qdd), found.dq, found.dqd)


def masses_and_lengths() -> str:
    mechanism = Mechanism(
        load_scene(str(CONFIGS / "double_pendulum.yaml"), ["simulate.duration=0.3"]), [MASS, LENGTH]
    )
    values = np.random.default_rng(1).uniform(1.0, 2.0, (8, 2))
    found = mechanism.simulate_many(values, samples=5, threads=2)
    return bits(found.q, found.qd, found.q_error, found.steps, found.samples["q"])


def torques_of_masses() -> str:
    mechanism = Mechanism(load_scene(str(CONFIGS / "2r_circle.yaml"), ["inverse.samples=51"]), [MASS])
    found = mechanism.inverse_many({MASS: np.linspace(1.0, 2.0, 5)}, of=["peak_torque.theta1"])
    return bits(found.samples["tau"], found.outputs["peak_torque.theta1"])


def digest_and_comparisons(name: str, *keys: str) -> Action:
    """Return an action: code, numbers and comparisons of the structure that many runs share."""

    def action() -> str:
        family = Mechanism(str(CONFIGS / name), keys).family
        mechanism = Mechanism(family, keys)
        structures = Structures(family, mechanism.keys, Simulate().structure)
        ((structure, _),) = structures.groups(np.full((1, len(keys)), 1.1))
        decisions = [(a, b, bool(outcome)) for _, a, b, outcome in structure.deciding]
        return bits(structure.tables.digest, structure.tables.numbers, str(decisions))

    return action


def digest_of(name: str) -> Action:
    def action() -> str:
        motion = build_motion(load_scene(str(CONFIGS / name)))
        return bits(motion.system.digest, methods[motion.choice.method].tables(motion.system).numbers)

    return action


JOBS: dict[str, Action] = {
    "torques of a chain": of_command(inverse, "seven_joint_arm.yaml", "inverse.samples=51"),
    "loop": of_command(simulate, "benchmarks/drake_four_bar.yaml", "simulate.duration=0.2"),
    "deployment": of_command(deploy, "four_bar_deploy.yaml", "simulate.samples=201"),
    "formulas": of_command(inverse, "arm_in_plane.yaml", "inverse.samples=51"),
    "controller in Python": controlled,
    "arm": arm,
    "many runs": masses_and_lengths,
    "many torques": torques_of_masses,
    "digest of a loop": digest_of("benchmarks/spatial_slider_crank.yaml"),
    "structure of a pendulum": digest_and_comparisons("double_pendulum.yaml", MASS, LENGTH),
    "structure of a four-bar": digest_and_comparisons(
        "four_bar_deploy.yaml", "robot.links.crank.mass", "robot.links.coupler.mass"
    ),
}


THREADS = 3
# as a program of its own: nothing is loaded, compiled or on the disk when the threads begin
STRESS = """
import json, random
from tests.unit.test_threads import JOBS, THREADS, together

def work(seed):
    return [(name, JOBS[name]()) for name in random.Random(seed).sample(list(JOBS), len(JOBS))]

print(json.dumps(sum(together([lambda k=k: work(k) for k in range(THREADS)]), [])))
"""


def test_several_threads_get_the_bits_of_one(tmp_path: Path) -> None:
    """Different mechanisms, built and run at the same time in a cold process, with the default switch interval."""
    environment = {**os.environ, "ROBODYN_CACHE": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-c", STRESS], env=environment, cwd=CONFIGS.parent, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert len(found) == THREADS * len(JOBS)
    alone = {name: job() for name, job in JOBS.items()}
    assert sorted({name for name, own in found if own != alone[name]}) == []


class Occupancy:
    """Counts how many threads are inside of functions at the same time, which it makes slow."""

    def __init__(self) -> None:
        self.calls = self.inside = self.most = 0

    def watched(self, function: Callable[..., Any]) -> Callable[..., Any]:
        def slow(*args: Any, **options: Any) -> Any:
            self.calls += 1
            self.inside += 1
            self.most = max(self.most, self.inside)
            time.sleep(0.01)
            try:
                return function(*args, **options)
            finally:
                self.inside -= 1

        return slow


def test_functions_of_a_shared_mechanism_are_built_by_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whichever asks first; each is built once. Nodes that two threads add to one graph could take one number.

    Functions share subexpressions with those that were built before, so that their rounding is another.
    """
    occupancy = Occupancy()
    for function in (StateFunction, InverseDynamics, Problem, Regressor):
        monkeypatch.setattr(function, "__init__", occupancy.watched(function.__init__))  # type: ignore[misc]
    scene = load_scene(str(CONFIGS / "double_pendulum.yaml"))
    q, qd, qdd = np.random.default_rng(0).uniform(-1.0, 1.0, (3, 20, 2))
    asked: list[Callable[[Mechanism], Any]] = [
        lambda m: m.mass_matrix(q),
        lambda m: m.coriolis(q, qd),
        lambda m: m.inverse_dynamics(q, qd, qdd),
        lambda m: m.inverse_dynamics_derivatives(q, qd, qdd).dq,
        lambda m: m.regressor(q, qd, qdd),
        lambda m: m.jacobian("tip", q),
    ]
    alone = [ask(Mechanism(scene)) for ask in asked]
    shared, occupancy.calls = Mechanism(scene), 0
    found = together([lambda ask=ask: ask(shared) for ask in [*asked, *asked]])
    # beside the functions the equations, and a record of the regressor
    assert occupancy.most == 1 and occupancy.calls == len(asked) + 2
    for own, other in zip(found, [*alone, *alone]):
        np.testing.assert_allclose(own, other, rtol=1e-11, atol=1e-11)


def test_runs_of_a_shared_mechanism_are_made_for_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs of two threads would write into the same memory: wrong states without a word."""
    occupancy = Occupancy()
    monkeypatch.setattr(Fleet, "drive", occupancy.watched(Fleet.drive))
    scene = load_scene(str(CONFIGS / "double_pendulum.yaml"), ["simulate.duration=0.3"])
    rows = np.random.default_rng(2).uniform(10.0, 15.0, (THREADS, 20, 1))
    alone = [Mechanism(scene, [MASS]).simulate_many(x).q for x in rows]
    shared = Mechanism(scene, [MASS])
    found = together([lambda x=x: shared.simulate_many(x).q for x in rows])
    np.testing.assert_array_equal(found, alone)
    assert occupancy.most == 1


def test_a_mechanism_may_go_to_another_process() -> None:
    mechanism = Mechanism(str(CONFIGS / "double_pendulum.yaml"), [MASS])
    other = pickle.loads(pickle.dumps(mechanism))
    np.testing.assert_array_equal(other.gravity(np.ones(2)), mechanism.gravity(np.ones(2)))


def test_poses_of_shared_inverse_kinematics_are_solved_for_one_thread(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    occupancy = Occupancy()
    for kernel in (SampleKernel, IterationKernel):
        monkeypatch.setattr(kernel, "__init__", occupancy.watched(kernel.__init__))  # type: ignore[misc]
    scene = load_scene(str(CONFIGS / "benchmarks" / "puma560.yaml"))
    q = np.random.default_rng(3).uniform(-1.0, 1.0, (10, 6))
    alone, shared = (InverseKinematics(scene, "link6", method="damped") for _ in range(2))
    target = alone.forward(q)
    asked: list[Callable[[InverseKinematics], Any]] = [
        lambda ik: ik.forward(q)[0],
        lambda ik: ik.solve(*target).q,
        lambda ik: ik.freedom,
        lambda ik: [way.q for way in ik.ways(target[0][0], target[1][0])],
    ]
    found = together([lambda ask=ask: ask(shared) for ask in asked])
    assert occupancy.most == 1
    for own, ask in zip(found, asked):
        np.testing.assert_allclose(own, ask(alone), atol=1e-9)
