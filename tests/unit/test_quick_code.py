"""Code that is made quickly: it serves the first steps and samples, and gives what code that lasts gives."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from robodyn_cli.expr import functions as f
from robodyn_cli.expr.graph import Graph
from robodyn_cli.integrators.runtime import engine
from robodyn_cli.integrators.runtime.integrator import Integrator
from robodyn_cli.kernels import compiler, samples
from robodyn_cli.kernels.bytecode import KINDS, SHAPE
from robodyn_cli.kernels.compiler import LASTING, QUICK
from robodyn_cli.kernels.samples import SampleKernel
from robodyn_cli.motion.build import build_motion
from robodyn_cli.motion.driver import Driver
from robodyn_cli.ready.integrable import integrable
from robodyn_cli.scene.load import load_scene
from robodyn_cli.works.simulate import simulate
from tests.kernels import SPECIAL, compiled
from tests.methods import FAMILIES, obstacle
from tests.source import ROOT

# events, impacts, stick and slip, quaternions, loops, partitions, sampled controllers, payloads
SCENES = [
    "configs/double_pendulum.yaml", "configs/stick_slip.yaml", "configs/bouncing_pendulum.yaml",
    "configs/tumbling_body.yaml", "configs/benchmarks/four_bar_n2.yaml", "configs/controlled_arm.yaml",
    "configs/catching_arm.yaml", "configs/cart_pole_lqr.yaml",
]  # fmt: skip
RNG = np.random.default_rng(3)

Levels = list[tuple[str, int]]


@pytest.fixture
def levels(monkeypatch: pytest.MonkeyPatch) -> Levels:
    """The first word of the key of each module that is asked for, and its level."""
    asked: Levels = []
    load = compiler.compile_module

    def noted(key: str, write: Any, level: int = LASTING) -> Any:
        asked.append((key.partition(" ")[0], level))
        return load(key, write, level)

    for module in (engine, samples):
        monkeypatch.setattr(module, "compile_module", noted)
    return asked


def change_over_after(steps: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engine, "LOOP", 1e9)
    monkeypatch.setattr(engine, "LOST", (steps + 0.5) * 1e9)


def run_levels(levels: Levels) -> set[int]:
    return {level for word, level in levels if word == "run"}


@pytest.mark.parametrize("scene", SCENES)
def test_runs_that_change_over_equal_those_of_lasting_code(
    scene: str, levels: Levels, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Quick code up to the 7th step, lasting code from there on: the same motion but for rounding."""
    changes = ["simulate.duration=1", "simulate.samples=40"]
    if "controlled" in scene:  # an encoder would read motions that differ by rounding differently
        changes += ["control.sensors=null"]
    found = {}
    for steps in (0, 7, 10**6):
        levels.clear()
        change_over_after(steps, monkeypatch)
        found[steps] = simulate(load_scene(ROOT / scene, changes)).variables
        assert run_levels(levels) >= ({QUICK} if steps == 10**6 else {QUICK, LASTING})
    assert LASTING not in run_levels(levels)
    for steps in (7, 10**6):
        for name in ("q", "qd"):
            one, two = found[steps][name].data, found[0][name].data
            np.testing.assert_allclose(one, two, rtol=1e-7, atol=1e-7, err_msg=f"{name} {steps}")


@pytest.mark.parametrize("method", FAMILIES)
def test_a_method_goes_on_where_code_changes_over(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """What a method keeps from step to step is still there: as many steps, and the same end but for rounding."""
    scene = load_scene(ROOT / "configs" / "double_pendulum.yaml", ["simulate.duration=1"])
    motion = build_motion(integrable(scene), work=False)
    if obstacle(method, motion.system):
        pytest.skip("not for this system")
    ends = []
    for steps in (0, 3, 50):
        change_over_after(steps, monkeypatch)
        driver = Driver(motion.system, method, motion.options)
        driver.start(0.0, motion.start)
        driver.integrator.advance(0.3)
        assert driver.integrator.engine.lasting == (driver.attempts >= steps)
        ends.append([*driver.state, driver.attempts])
    np.testing.assert_allclose(ends[1], ends[0], rtol=1e-9)
    np.testing.assert_allclose(ends[2], ends[0], rtol=1e-9)


def test_runs_of_many_numbers_and_integrators_by_themselves_take_lasting_code(levels: Levels) -> None:
    """Neither the order of many runs nor how often one is repeated decides about bits."""
    motion = build_motion(integrable(load_scene(ROOT / "configs" / "double_pendulum.yaml")), work=False)
    driver = Driver.of(motion)
    assert run_levels(levels) == {QUICK}
    driver.integrator.engine.take(driver.integrator.engine.tables.numbers)
    assert driver.integrator.engine.lasting
    levels.clear()
    assert Integrator(motion.system).engine.lasting
    assert run_levels(levels) == {LASTING}


def test_larger_programs_give_way_earlier(monkeypatch: pytest.MonkeyPatch) -> None:
    names = ("double_pendulum", "benchmarks/four_bar_n2", "benchmarks/andrews")
    patience = []
    for name in names:
        motion = build_motion(integrable(load_scene(ROOT / "configs" / f"{name}.yaml")), work=False)
        patience.append(Driver.of(motion).integrator.engine.patience(0, 10**9))
    assert patience[0] > patience[1] > patience[2] > 5000


def kernel() -> SampleKernel:
    a, b = Graph().symbols(["a", "b"], "q")
    return SampleKernel({"r": [f.sin(a * b) + a / b, a * b + a * a]}, ["q"])


def test_kernels_take_quick_code_for_their_first_samples(
    levels: Levels, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(samples, "MANY", 100)
    rows = RNG.uniform(0.5, 1.5, (60, 2))
    one = kernel()
    first = one(q=rows)["r"]
    assert levels == [("samples", QUICK)]
    second = one(q=rows)["r"]
    assert levels == [("samples", QUICK), ("samples", LASTING)]
    a, b = rows.T
    exact = np.stack([np.sin(a * b) + a / b, a * b + a * a], axis=1)
    for found in (first, second):
        np.testing.assert_allclose(found, exact, rtol=4e-16 * 4)


def test_a_short_kernel_that_is_loaded_ahead_takes_lasting_code(levels: Levels) -> None:
    one = kernel()
    one.load()
    one(q=np.ones((3, 2)))
    assert levels == [("samples", LASTING)]


def test_kernels_of_many_runs_take_lasting_code(levels: Levels) -> None:
    """Else the bits of a run would depend on how many samples of others came before."""
    one, other = kernel(), kernel()
    one.take([np.array(one.numbers[0])])
    one(q=np.ones((3, 2)))
    other.of_tables(other.program.table[None], 3, {"q": np.ones((3, 2))})
    assert {level for _, level in levels} == {LASTING}


@pytest.mark.parametrize("lanes", [1, 8])
def test_each_operation_is_the_same_in_quick_code(lanes: int) -> None:
    """To the bit, with infinities and what is no number: its error is that of lasting code."""
    graph = Graph()
    x, y = graph.symbols(["x0", "x1"], "x")
    entries = [graph.unary(kind, x) for kind, count in KINDS.items() if count == 1 and kind not in SHAPE]
    entries += [graph._binary(kind, x, y) for kind, count in KINDS.items() if count == 2]
    rows = np.array([*[(a, b) for a in SPECIAL for b in SPECIAL], *RNG.uniform(-3, 30, (2000, 2))])
    quick, lasting = (compiled({"r": entries}, lanes, rows, level=level)["r"] for level in (QUICK, LASTING))
    np.testing.assert_array_equal(quick, lasting)
