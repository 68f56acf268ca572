"""A number of a scene that changes compiles nothing, and the code that is shared gives what code of its own would."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robodyn_cli import load_scene
from robodyn_cli.equations import problem as equations
from robodyn_cli.errors import RobodynError
from robodyn_cli.expr.fixed import Fixed, derived, literal, places
from robodyn_cli.expr.formula import FormulaTree
from robodyn_cli.expr.formula_tree import FormulaNode, Num
from robodyn_cli.expr.graph import Graph
from robodyn_cli.expr.rebuild import Interpreter, evaluate
from robodyn_cli.kernels.cache import REPORT
from robodyn_cli.kernels.program import make_program
from robodyn_cli.kernels.samples import SampleKernel
from robodyn_cli.model import build as models
from robodyn_cli.model.model import MOTION_GROUPS
from robodyn_cli.model.places import SECTIONS, numbers_at_places, with_places
from robodyn_cli.over.commands import execute
from robodyn_cli.ready.integrable import integrable
from robodyn_cli.scene.load import Family
from robodyn_cli.scene.types import Inertia, Orientation, Scene
from robodyn_cli.tools.progress import Stopwatch, no_progress

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
ATTITUDE = {field.name for field in dataclasses.fields(Orientation)}
LONGER = 1.01  # factor of all lengths, so that loops still close
# rods of Cassie do not reach where each length has a factor of its own, and numbers that are folded leave rounding of
# its attitudes in rows that are none
LEFT_OUT = "cassie_leg"
SCENES = sorted(
    p for p in CONFIGS.rglob("*.yaml") if "schema:" in p.read_text(encoding="utf-8") and p.stem != LEFT_OUT
)
RUNS = [p for p in SCENES if "command:" in p.read_text(encoding="utf-8")]


class Variation:
    """Other numbers in the place of all numbers of a scene: lengths by one factor, others each by its own."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)

    def scene(self, scene: Scene) -> Scene:
        # a prescribed motion belongs to the start of the run
        sections = [name for name in SECTIONS if name != "prescribed"]
        return dataclasses.replace(scene, **{name: self.value(getattr(scene, name), "") for name in sections})

    def factor(self, unit: str) -> float:
        return LONGER if unit == "m" else float(self.rng.uniform(1.001, 1.02))

    def value(self, x: Any, unit: str) -> Any:
        if isinstance(x, float):
            return x * self.factor(unit)
        if isinstance(x, FormulaTree):
            return dataclasses.replace(x, root=x.root.rebuilt(lambda node: self.leaf(node, unit)))
        if isinstance(x, dict):
            return {name: self.value(e, unit) for name, e in x.items()}
        if isinstance(x, tuple):
            return tuple(self.value(e, unit) for e in x)
        if isinstance(x, Inertia):  # moments that are nearly equal would be taken care of in another way
            given = {k: v for k, v in dataclasses.asdict(x).items() if v is not None}
            return Inertia(
                **{k: v * (self.factor(unit) + 0.2 * (n % 2)) for n, (k, v) in enumerate(given.items())}
            )
        if dataclasses.is_dataclass(x) and not isinstance(x, type):
            fields = [f for f in dataclasses.fields(x) if getattr(x, f.name) != f.default]
            fields = [
                f
                for f in fields
                if "rad" not in f.metadata.get("unit", "")
                and f.name not in ("axis", "axis2")
                and not (isinstance(x, Orientation) and f.name in ATTITUDE)  # structure, as directions are
            ]
            changed = {f.name: self.value(getattr(x, f.name), f.metadata.get("unit", "")) for f in fields}
            return dataclasses.replace(x, **changed)
        return x

    def leaf(self, node: FormulaNode, unit: str) -> FormulaNode:
        return Num(node.number * self.factor(unit)) if isinstance(node, Num) else node


def generic(path: Path) -> Scene:
    """Return a scene whose numbers cancel each other nowhere by chance, as those of the three equal arms of the delta
    do, which decides the structure."""
    scene = load_scene(str(path))
    return Variation(7).scene(scene) if path.stem == "delta" else scene


def run(scene: Scene) -> str:
    """Run a scene's command; returns the kind of its error, if any."""
    try:
        execute(str(scene.command), scene, no_progress, Stopwatch())
    except RobodynError as error:
        return type(error).__name__
    return ""


def looked_up() -> tuple[int, int]:
    """Return how many modules were compiled, and taken from the disk, so far; those in memory do not count."""
    return REPORT.compiled, REPORT.cached


@pytest.mark.parametrize("path", RUNS, ids=lambda p: p.stem)
def test_a_run_with_other_numbers_compiles_nothing(path: Path) -> None:
    scene = generic(path)
    # the model of a controller is read from the text of the scene
    other = Variation(3).scene(scene) if scene.control is None else reread(scene, path)
    error = run(scene)
    before = looked_up()
    assert run(other) == error
    assert looked_up() == before


def reread(scene: Scene, path: Path) -> Scene:
    """Return a controlled scene with other numbers by ``--set``, those of the controller among them."""
    rng = np.random.default_rng(4)
    found = [(key, value) for key, value in numbers_at_places(scene).items() if "#" not in key]
    assert any(key.startswith("robot.links.") for key, _ in found)
    control = with_places(scene).control
    for name in control.numbers:
        found += [(key, value) for key, value in _numbers(getattr(control, name))]
    settings = [f"{key}={value * rng.uniform(1.001, 1.02)!r}" for key, value in found]
    for key, value in scene.control.model.set.items():
        settings.append(f"control.model.set.{key}={float(value) * 1.01!r}")
    return load_scene(str(path), settings)


def _numbers(value: Any) -> list[tuple[str, float]]:
    """Return the numbers of a part of a scene with their keys."""
    if isinstance(value, Fixed):
        return [(value.args[0], float(value))]
    if dataclasses.is_dataclass(value):
        return [x for f in dataclasses.fields(value) for x in _numbers(getattr(value, f.name))]
    return [x for part in value.values() for x in _numbers(part)] if isinstance(value, dict) else []


def programs_of(scene: Scene) -> dict[str, list[Any]]:
    """Return inverse dynamics, mass matrix, passive torques, constraints and energies of a scene."""
    p = equations.Problem(integrable(scene))
    rows = p.constraints.rows
    found = {
        "inverse": list(p.inverse_dynamics),
        "passive": [x for term in p.passive_forces(smooth=True).values() for x in term]
        + list(p.actuator_torques),
        "rows": [e for row in rows for e in (row.eta, row.gamma, row.eta_t, *row.psi)],
        "energy": [p.kinetic, p.potential],
    }
    return {name: entries for name, entries in found.items() if entries}


@pytest.mark.parametrize("path", SCENES, ids=lambda p: p.stem)
def test_shared_code_gives_what_folded_numbers_give(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = generic(path)
    groups = (*MOTION_GROUPS, "z", "unknown")
    try:
        nominal = programs_of(scene)
    except RobodynError as error:
        pytest.skip(error.message)  # friction that only set-valued laws and inverse dynamics take
    other = Variation(5).scene(scene)
    one, two = SampleKernel(nominal, groups), SampleKernel(programs_of(other), groups)
    assert one.program.digest == two.program.digest
    assert one.program.numbers != two.program.numbers

    monkeypatch.setattr(equations, "with_places", lambda scene: scene)
    monkeypatch.setattr(models, "with_places", lambda scene: scene)
    folded = programs_of(other)
    # tables are read from the numbers whatever they hold
    assert not any(isinstance(x, Fixed) for x in make_program(dict(folded), groups).numbers)
    rng = np.random.default_rng(1)
    inputs = {g: rng.uniform(0.1, 0.9, (16, max(1, n))) for g, n in two.program.inputs.items()}
    inputs = {g: x[0] if g == "p" else x for g, x in inputs.items()}
    one(**inputs)  # its code is what the other finds in memory
    before = looked_up()
    found = two(**inputs)
    assert looked_up() == before
    columns = {g: list(x) if g == "p" else list(x.T) for g, x in inputs.items()}
    everything = {g: columns.get(g, [np.zeros(16)] * 64) for g in groups}
    for name, entries in folded.items():
        expected = np.array([np.broadcast_to(x, 16) for x in evaluate(entries, everything)]).T
        scale = np.abs(expected).max(initial=1e-300)
        np.testing.assert_allclose(found[name], expected, rtol=1e-11, atol=1e-13 * scale, err_msg=name)


def test_setting_one_value_keeps_the_programs() -> None:
    path = str(CONFIGS / "double_pendulum.yaml")
    plain = make_program(programs_of(load_scene(path)), MOTION_GROUPS)
    for override in ("robot.links.link1.mass=13", "gravity.1=-1.62", "robot.joints.theta1.a=1"):
        assert (
            make_program(programs_of(load_scene(path, [override])), MOTION_GROUPS).digest == plain.digest
        ), override
    weightless = make_program(programs_of(load_scene(path, ["gravity.1=0"])), MOTION_GROUPS)
    assert weightless.digest != plain.digest, "a zero is structure"
    assert weightless.operations < plain.operations


@pytest.mark.parametrize("path", SCENES, ids=lambda p: p.stem)
def test_places_are_keys_that_set_takes(path: Path) -> None:
    family = Family(path)
    own = tuple(f"couplers.{x.name}." for x in family.own.couplers if x not in family.own.robot.couplers)
    found = {
        key: value
        for key, value in numbers_at_places(family.own).items()
        # KEY#n is in the unit that is written; couplers of a robot are keys of it
        if "#" not in key and (not key.startswith("couplers.") or key.startswith(own))
    }
    again = family.scene([f"{key}={value!r}" for key, value in found.items()])
    assert numbers_at_places(again) == numbers_at_places(family.own)


def test_places_are_the_keys_of_the_scene() -> None:
    scene = with_places(load_scene(str(CONFIGS / "mechanisms" / "four_bar_overload.yaml")))
    for link in scene.robot.links:
        if isinstance(link.mass, Fixed):
            assert places([link.mass]) == [f"robot.links.{link.name}.mass"]
    program = make_program(programs_of(scene), (*MOTION_GROUPS, "unknown"))
    used = places(program.numbers)
    assert used and all(place.split(".")[0] in SECTIONS for place in used)


# -- arithmetic ----------------------------------------------------------------------------------------------


def test_numbers_of_equal_value_stay_apart_and_equal_computations_are_one() -> None:
    a, b = literal(2.0, "a"), literal(2.0, "b")
    assert a == b and a is not b and a is literal(2.0, "a")
    assert a * b is b * a and a + b is b + a
    negative = -a
    assert a * 1.0 is a and a + 0.0 is a and -negative is a
    assert a - b == 0.0 and not isinstance(a - b, Fixed), "what cancels is structure"
    assert isinstance(a * literal(1.0, "one"), Fixed), "a one of the scene is a number like any other"
    assert not isinstance(literal(0.0, "zero"), Fixed)
    assert (0.1 + literal(0.2, "x")) - literal(0.3, "y") == 0.0, "what rounding leaves of a zero is zero"


def test_numbers_keep_their_places_in_arrays_of_objects_and_not_in_arrays_of_doubles() -> None:
    a = literal(3.0, "a")
    objects = np.array([1.0, 2.0], dtype=object) * a
    assert objects[0] is a and isinstance(objects[1], Fixed)
    assert places(list(a * np.array([2.0], dtype=object) / literal(5.0, "b"))) == ["a", "b"]
    for doubles in (np.arange(3.0) * a, a - np.arange(3.0), np.arange(3.0) % a, np.arange(3.0) ** a):
        assert doubles.dtype == np.float64
    np.testing.assert_array_equal(np.arange(5.0) < a, [True, True, True, False, False])
    np.testing.assert_array_equal(a >= np.arange(5.0), [True, True, True, True, False])


def test_derived_numbers_are_structure_only_where_they_are_zero_for_all_values() -> None:
    inputs = [literal(2.0, "xx"), literal(2.0, "yy"), 0.0]
    difference, nothing = derived(lambda x: [x[0] - x[1], x[2] * x[0]], inputs)
    assert isinstance(difference, Fixed) and difference == 0.0
    assert nothing == 0.0 and not isinstance(nothing, Fixed)


def test_like_terms_are_collected_but_equal_numbers_do_not_cancel() -> None:
    graph = Graph()
    x = graph.symbol("x", "q")
    a, b = literal(2.0, "a"), literal(2.0, "b")
    collected: Any = a * x + b * x
    assert collected.op == "mul" and make_program({"r": [collected]}, ["q"]).operations == 1
    kept: Any = a * x - b * x
    assert kept.op == "mul", "that the two are equal is no structure"
    assert evaluate([kept], {"q": [3.0]}) == [0.0]
    assert 3.0 * x - 3.0 * x == 0.0


def test_results_of_one_function_share_their_inputs() -> None:
    """Base parameters depend on all inertias of a robot: each entry keeping them all would take the square of it."""
    inputs = [literal(float(k + 1), f"x{k}") for k in range(50)]
    first, second = (derived(lambda x: [sum(x), *x], inputs) for _ in range(2))
    assert all(isinstance(x, Fixed) for x in first)
    assert len({id(x.args[0]) for x in first if isinstance(x, Fixed)}) == 1
    assert len({id(x) for x in (*first, *second)}) == 102
    assert places([first[0] + 2.0]) == places(first) == sorted(f"x{k}" for k in range(50))


def test_interpreted_expressions_compute_with_plain_numbers() -> None:
    graph = Graph()
    x = graph.symbol("x", "q")
    a, b = literal(2.0, "a"), literal(3.0, "b")
    found = Interpreter([a * x + b, a])({"q": np.array([[1.0, 2.0]])})
    assert [type(value) for value in found] == [np.ndarray, float]
    assert found[0].dtype == np.float64 and found[0].tolist() == [5.0, 7.0] and found[1] == 2.0
