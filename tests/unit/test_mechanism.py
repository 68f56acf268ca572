"""Many runs of one compiled object give what single runs of their own scenes give."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from robodyn_cli import Mechanism, deploy, load_scene, load_scene_text, simulate, write_result
from robodyn_cli.errors import CapabilityError, RobodynError, SceneError
from robodyn_cli.expr import functions as f
from robodyn_cli.expr.fixed import Fixed, literal, witnessed
from robodyn_cli.expr.graph import Graph
from robodyn_cli.expr.many import Expressions, ManyNumbers, Recipe
from robodyn_cli.integrators.registry import methods
from robodyn_cli.integrators.runtime.options import JUDGED
from robodyn_cli.kernels.cache import REPORT
from robodyn_cli.model.places import with_places
from robodyn_cli.motion.build import build_motion
from robodyn_cli.over.many.command import ended, error_of, number_of
from robodyn_cli.over.many.groups import Built, Structures
from robodyn_cli.over.many.integrate import RunBatch
from robodyn_cli.over.many.keys import NUMBER, START, STRUCTURE, _parts, settings, understand
from robodyn_cli.over.many.simulate import Simulate
from robodyn_cli.over.many.structure import Structure
from robodyn_cli.ready.integrable import integrable
from robodyn_cli.scene.load import Family
from robodyn_cli.scene.types import Scene
from robodyn_cli.solve.closure import ManyConditions, least_steps, newton, newton_of_many
from robodyn_cli.works.reach import reach
from tests.numeric import assert_close

# single runs are compared with many to the last digits
pytestmark = pytest.mark.usefixtures("lasting_code")

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
PENDULUM = str(CONFIGS / "double_pendulum.yaml")
SCENES = sorted(
    p
    for p in CONFIGS.rglob("*.yaml")
    if "command: simulate" in p.read_text(encoding="utf-8") and p.stem != "bennett"
)
QUICK = [
    "double_pendulum",
    "tumbling_body",
    "adams_rot_spring",
    "adams_rev_spherical",
    "drake_four_bar",
    "slider_crank",
]
MASS, LENGTH = "robot.links.link1.mass", "robot.joints.theta1.a"


def numbers_of(x: Any, found: dict[str, float]) -> dict[str, float]:
    """Return the numbers of a scene by place."""
    if isinstance(x, Fixed):
        found[x.args[0]] = float(x)
        return found
    for _, part, _ in _parts(x) or ():
        numbers_of(part, found)
    return found


def varied(scene: Scene, count: int, seed: int) -> list[str]:
    """Return some keys of a scene whose numbers may be a little larger."""
    family = Family.of(scene)
    found = numbers_of(with_places(scene), {})
    places = [p for p in found if "#" not in p and "stop" not in p]
    np.random.default_rng(seed).shuffle(places)
    keys: list[str] = []
    for place in places:
        try:
            family.scene(settings([place], [1.01 * found[place]]))
        except SceneError:
            continue  # forces in joints have keys without "forces"
        keys.append(place)
        if len(keys) == count:
            break
    return keys


def around(scene: Scene, keys: list[str], runs: int, seed: int) -> dict[str, np.ndarray]:
    found = numbers_of(with_places(scene), {})
    rng = np.random.default_rng(seed)
    return {key: found[key] * rng.uniform(0.99, 1.01, runs) for key in keys}


def own_scene(scene: Scene, values: dict[str, np.ndarray], run: int) -> Scene:
    return Family.of(scene).scene(settings(list(values), [values[key][run] for key in values]))


# -- numbers ------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("path", SCENES, ids=lambda p: p.stem)
def test_recipe_gives_the_numbers_that_a_build_of_its_own_gives(path: Path) -> None:
    scene = load_scene(str(path))
    keys = varied(scene, 6, seed=2)
    values = around(scene, keys, 3, seed=3)

    def build(own: Scene) -> Any:
        motion = build_motion(integrable(own))
        return methods[motion.choice.method].tables(motion.system)

    with witnessed() as witnesses:
        tables = build(scene)
    places = {key: understand(Family.of(scene), key).place for key in keys}
    recipe = Recipe(list(places.values()))
    numbers = ManyNumbers(recipe, {places[key]: values[key] for key in keys}, 3)
    alike = numbers.decided_alike(recipe.deciding(witnesses))
    rows = np.hstack([numbers.table(p.numbers or (0.0,)) for p in tables.programs])
    for run in range(3):
        own = build(own_scene(scene, values, run))
        if alike[run]:
            assert own.digest == tables.digest
            np.testing.assert_allclose(rows[run], own.numbers, rtol=1e-12, atol=1e-300)


def test_what_a_comparison_decides_is_remembered() -> None:
    a, b = literal(2.0, "a"), literal(1.0, "b")
    with witnessed() as witnesses:
        assert a > b and a - 2.0 == 0.0 and bool(a)
    recipe = Recipe(["a"])
    numbers = ManyNumbers(recipe, {"a": np.array([2.0, 0.5, 3.0, 0.0])}, 4)
    deciding = recipe.deciding(witnesses)
    np.testing.assert_array_equal(numbers.decided_alike(deciding), [True, False, False, False])
    assert not Recipe(["c"]).deciding(witnesses)


def test_errors_near_rounding_are_those_of_the_run_whatever_ran_before() -> None:
    scene = load_scene(
        CONFIGS / "double_pendulum.yaml",
        {"simulate": {"duration": 0.5, "rtol": 1e-13, "atol": 1e-15}, "expect": None},
    )
    masses = np.array([[3.0], [0.01], [20.0], [11.0]])
    key = ["robot.links.link1.mass"]
    together = Mechanism(scene, key).simulate_many(masses)
    for order in ((0, 1, 2, 3), (2, 0, 3, 1)):
        arm = Mechanism(scene, key)
        for k in order:
            alone = arm.simulate_many(masses[k : k + 1])
            np.testing.assert_array_equal(alone.q_error[0], together.q_error[k])
            np.testing.assert_array_equal(alone.qd_error[0], together.qd_error[k])
    assert len(np.unique(together.q_error[:, 0])) > 2, "rounding is that of each run"


STEEP = """
schema: 1
command: simulate
gravity: [0, -9.81, 0]
robot:
  joints: [{name: a, type: revolute, axis: [0, 0, 1], friction: {coulomb: 1, transition_speed: 0.1, viscous: 0.02}}]
  links: [{name: l, mass: 1.0, com: [0.4, 0, 0], inertia: {zz: 0.05}}]
initial: {q: {a: 0.3}, qd: {a: 0.2}}
simulate: {duration: 2.0, samples: 101, rtol: 1e-8, atol: 1e-10}
"""


def test_errors_on_slopes_of_friction_cover_where_second_runs_err_as_much() -> None:
    rng = np.random.default_rng(5)
    mass, coulomb, speed, viscous, q, qd, duration = (
        rng.uniform(low, high, 1000)
        for low, high in ((0.5, 3), (0.1, 2), (-3, -0.5), (0, 0.1), (-2.5, 1), (-2, 2), (0.5, 3))
    )
    values = np.stack([mass, coulomb, 10.0**speed, viscous, q, qd, duration], axis=1)
    values = values[[14, 15, 118, 201, 241, 326, 374]]  # of which two integrations said too little
    friction = "robot.joints.a.friction"
    keys = [
        "robot.links.l.mass",
        f"{friction}.coulomb",
        f"{friction}.transition_speed",
        f"{friction}.viscous",
    ]
    keys += ["initial.q.a", "initial.qd.a", "simulate.duration"]

    def runs(**changes: object) -> Any:
        return Mechanism(load_scene_text(STEEP, overrides={"simulate": changes}), keys).simulate_many(values)

    found = runs(integrator="dop853")
    truth = runs(integrator="gauss", rtol=4e-14, atol=1e-16)
    assert (np.abs(found.q - truth.q) <= found.q_error).all()
    assert (np.abs(found.qd - truth.qd) <= found.qd_error).all()


def test_a_run_alone_has_the_numbers_that_it_has_among_others() -> None:
    a, b = literal(0.7, "a"), literal(1.3, "b")
    one = [
        getattr(f, op)(a)
        for op in ("sin", "cos", "tan", "asin", "atan", "sinh", "tanh", "exp", "log", "sqrt")
    ]
    two = [op(a, b) for op in (f.power, f.atan2, f.minimum, f.maximum)]
    numbers = [
        *one,
        *two,
        b / a,
        1.0 / (a - b),
        abs(a - b) * 3.0,
        -(a * b) + 0.1,
        (a + 1e-17) - a,
        f.sin(a) * f.cos(b),
    ]
    recipe, rng = Recipe(["a", "b"]), np.random.default_rng(0)
    values = rng.uniform(-0.2, 1.0, (200, 2)) * rng.choice([1.0, 1e-9, 0.0], (200, 2))
    values[::7, 1] = values[::7, 0]
    values[values == 0.0] = 0.0
    together = ManyNumbers(recipe, dict(zip("ab", values.T)), len(values)).table(numbers)
    for row, (x, y) in zip(together, values):
        alone = ManyNumbers(recipe, {"a": np.array([x]), "b": np.array([y])}, 1).table(numbers)[0]
        np.testing.assert_array_equal(alone, row)


def test_keys_are_numbers_starts_or_structure() -> None:
    family = Family(PENDULUM)
    assert understand(family, MASS).sort == NUMBER
    assert understand(family, "gravity.1").special == (0.0,)
    assert understand(family, "initial.q.theta1").sort == START
    assert understand(family, "simulate.samples").sort == STRUCTURE
    with pytest.raises(SceneError, match="mas"):
        understand(family, "robot.links.link1.mas")


@pytest.mark.parametrize("shape", [(20, 2, 5), (20, 5, 2), (20, 3, 3), (20, 1, 1)])
@pytest.mark.parametrize("singular", [False, True])
def test_steps_of_many_newtons_are_the_least_ones(shape: tuple[int, int, int], singular: bool) -> None:
    rng = np.random.default_rng(0)
    J, F = rng.normal(size=shape), rng.normal(size=shape[:2])
    if singular:
        J[3] = 0.0
    wanted = (np.linalg.pinv(J) @ F[..., None])[..., 0]
    np.testing.assert_allclose(least_steps(J, F), wanted, rtol=1e-7, atol=1e-9)


class _Lines:
    """Lines atan(4 (x + 2 y)) = a, a run each, past which undamped steps go; they note how many runs are asked for."""

    lengths, sizes = np.ones(2), np.ones(1)

    def __init__(self, a: NDArray[np.float64], asked: list[int]) -> None:
        self.a, self.asked = a, asked

    def at_runs(self, q: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        self.asked.append(len(q))
        s = 4.0 * (q @ (1.0, 2.0))
        slope = 4.0 / (1.0 + s**2)
        return (np.arctan(s) - self.a)[:, None], np.stack([slope, 2.0 * slope], axis=1)[:, None]

    def part(self, rows: NDArray[np.intp]) -> ManyConditions:
        return _Lines(self.a[rows], self.asked)

    def at(self, q: NDArray[np.float64], t: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        F, J = self.at_runs(q[None])
        return F[0], J[0]

    def step(self, q: NDArray[np.float64], dq: NDArray[np.float64]) -> NDArray[np.float64]:
        return q + dq


def test_newtons_of_many_ask_for_those_alone_that_are_not_there() -> None:
    """A run ends as it does alone and by ``newton``, whoever is beside it, and one that never closes costs the others
    nothing."""
    rng = np.random.default_rng(0)
    a, q = rng.uniform(-1.0, 1.0, 400), rng.normal(size=(400, 2))
    a[0] = 2.0  # beyond a quarter turn
    asked: list[int] = []
    ends, left = newton_of_many(_Lines(a, asked), q, range(2))
    alone: list[int] = []
    for k in range(len(q)):
        end, own = newton_of_many(_Lines(a[k : k + 1], alone), q[k : k + 1], range(2))
        np.testing.assert_array_equal(np.hstack([ends[k], left[k]]), np.hstack([end[0], own]))
    assert left[0] > 0.4 and (left < 1e-12).mean() > 0.9
    assert sum(asked) == len(alone) and asked[-1] < 10
    for k in range(1, len(q)):
        end, _ = newton(_Lines(a[k : k + 1], []), q[k], range(2))
        np.testing.assert_allclose(ends[k], end, rtol=0.0, atol=1e-9)


def test_a_pose_that_is_off_by_rounding_is_no_failed_run() -> None:
    scene = load_scene(next(CONFIGS.rglob("puma_reach.yaml")))
    run = ended(lambda: reach(scene))
    assert 0.0 < run.summary["error"] < 1e-12 and (run.code, run.reason) == (0, "")


def test_numbers_of_some_runs_are_those_of_them_alone() -> None:
    """Also where one run is left of many, and where parts are taken of parts, before and after steps are added."""
    a = literal(2.0, "a")
    recipe = Recipe(["a"])
    values = np.linspace(1.0, 3.0, 7)
    whole = ManyNumbers(recipe, {"a": values}, len(values))
    part = whole.rows(np.array([5, 1, 1, 0]))
    later = [f.sin(a) * a, a + 1.0]
    for rows, own in (
        (part, [5, 1, 1, 0]),
        (part.rows(np.array([2])), [1]),
        (whole.rows(np.array([6])), [6]),
    ):
        alone = [ManyNumbers(recipe, {"a": values[k : k + 1]}, 1).table(later)[0] for k in own]
        np.testing.assert_array_equal(rows.table(later), alone)
        assert rows.runs == len(own) and np.shape(rows.value(a)) == ((len(own),) if len(own) > 1 else ())


# -- runs ---------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("name", QUICK)
def test_many_runs_are_those_of_their_own_scenes(name: str) -> None:
    (path,) = [p for p in SCENES if p.stem == name]
    scene = load_scene(str(path))
    keys = varied(scene, 4, seed=1)
    values = around(scene, keys, 4, seed=4)
    found = Mechanism(scene, keys).simulate_many(values, of=["final.time", "error_estimate.q_end"])
    assert found.ok.all() and not found.one_by_one.any(), found.reason
    for run in range(4):
        single = simulate(own_scene(scene, values, run))
        estimate = single.summary["error_estimate"]
        bound = 10 * max(estimate["q_end"], estimate["qd_end"]) + 1e-11
        np.testing.assert_allclose(found.q[run], single["q"][-1], atol=bound, rtol=0)
        np.testing.assert_allclose(found.qd[run], single["qd"][-1], atol=bound * 10, rtol=0)
        assert found.outputs["final.time"][run] == single.time[-1]
        assert found.outputs["error_estimate.q_end"][run] == pytest.approx(
            estimate["q_end"], rel=2, abs=2e-12
        )


@pytest.mark.parametrize("method", ["gauss", "rk4, step: 0.05", "gauss4, step: 0.05"])
def test_errors_at_the_end_follow_the_rule_of_single_runs(method: str) -> None:
    own = [
        f"simulate.integrator={method.partition(',')[0]}",
        f"simulate.samples={JUDGED + 1}",
        "simulate.rtol=1e-7",
    ]
    own += ["simulate.step=0.05"] * ("step" in method)
    scene = load_scene(PENDULUM, own)
    # of fixed steps that are longer than a run too
    values = {"simulate.duration": np.array([0.02, 0.6, 2.0]), MASS: np.array([12.0, 11.0, 10.0])}
    of = ["error_estimate.q_end", "error_estimate.qd_end", "error_estimate.steps"]
    found = Mechanism(scene, list(values)).simulate_many(values, of=of)
    assert found.ok.all() and not found.one_by_one.any(), found.reason
    for run in range(3):
        summary = simulate(own_scene(scene, values, run)).summary
        for key in of:
            estimate = summary["error_estimate"][key.partition(".")[2]]
            assert found.outputs[key][run] == pytest.approx(estimate, rel=1e-3, abs=1e-15), (key, run)


@pytest.mark.parametrize("method", ["dop853", "gauss"])
def test_estimated_errors_are_the_true_ones(method: str) -> None:
    q = np.random.default_rng(0).uniform(-1, 1, (60, 2))

    def states(own: str, rtol: float) -> Any:
        options = [
            f"simulate.integrator={own}",
            f"simulate.rtol={rtol}",
            f"simulate.atol={rtol}",
            "simulate.duration=5",
        ]
        return Mechanism(load_scene(PENDULUM, options)).simulate_many(q=q)

    found, exact = states(method, 1e-7), states("gauss", 1e-13)
    shares = np.abs(found.q - exact.q).max(axis=1) / found.q_error.max(axis=1)
    assert np.quantile(shares, 0.95) < 1.5 and np.median(shares) > 0.2


def test_the_bits_depend_neither_on_threads_nor_on_order() -> None:
    rng = np.random.default_rng(0)
    values = rng.uniform(10, 14, (300, 1))
    q = rng.uniform(-1, 1, (300, 2))
    mechanism = Mechanism(load_scene(PENDULUM, ["simulate.duration=1"]), [MASS])
    one = mechanism.simulate_many(values, q=q, threads=1)
    order = rng.permutation(300)
    for threads in (2, 3):
        other = mechanism.simulate_many(values[order], q=q[order], threads=threads)
        for field in ("q", "qd", "q_error", "time", "steps"):
            np.testing.assert_array_equal(getattr(other, field), getattr(one, field)[order])
    alone = mechanism.simulate_many(values[7:8], q=q[7:8])
    np.testing.assert_array_equal(alone.q[0], one.q[7])


@pytest.mark.parametrize("one_at_a_time", [False, True])
def test_numbers_are_confirmed_along_each_key_and_then_no_more(one_at_a_time: bool, monkeypatch: Any) -> None:
    scene = load_scene(PENDULUM, ["simulate.duration=0.1"])
    keys = [MASS, LENGTH, "gravity.1", "robot.links.link2.mass"]
    nominal = np.array([12.0, 1.0, -9.81, 13.0])
    rows = nominal * np.random.default_rng(0).uniform(0.9, 1.1, (20, 4))
    if one_at_a_time:
        rows = nominal * (1.0 + 0.1 * np.vstack([np.zeros(4), np.eye(4), -np.eye(4)]))
    built: list[np.ndarray] = []
    build = Structure.__init__

    def noted(self: Structure, family: Any, keys: Any, row: np.ndarray, command: Any) -> None:
        built.append(row)
        build(self, family, keys, row, command)

    monkeypatch.setattr(Structure, "__init__", noted)
    mechanism = Mechanism(scene, keys)
    assert mechanism.simulate_many(rows).ok.all()
    assert (np.ptp(built, axis=0) > 0).all() and len(built) <= 1 + len(keys)
    count = len(built)
    mechanism.simulate_many(rows[::-1])
    mechanism.simulate_many(nominal + 0.9 * (rows - nominal))
    assert len(built) == count


def test_a_value_that_is_structure_makes_a_group_of_its_own() -> None:
    scene = load_scene(PENDULUM, ["simulate.duration=1"])
    values = {"gravity.1": np.array([-9.81, 0.0, -1.62, 0.0])}
    found = Mechanism(scene, list(values)).simulate_many(values)
    assert found.ok.all() and not found.one_by_one.any()
    for run in range(4):
        single = simulate(own_scene(scene, values, run))
        np.testing.assert_allclose(found.q[run], single["q"][-1], atol=1e-11, rtol=0)
    np.testing.assert_array_equal(found.q[1], found.q[3])


def test_an_angle_of_a_placement_is_structure_and_still_right() -> None:
    scene = load_scene(PENDULUM, ["simulate.duration=0.5"])
    values = {"robot.joints.theta1.offset": np.array([0.1, 0.2, 0.1, -0.4])}
    found = Mechanism(scene, list(values)).simulate_many(values)
    assert found.ok.all()
    for run in range(4):
        single = simulate(own_scene(scene, values, run))
        np.testing.assert_allclose(found.q[run], single["q"][-1], atol=1e-11, rtol=0)


def test_a_changed_number_compiles_nothing() -> None:
    mechanism = Mechanism(load_scene(PENDULUM, ["simulate.duration=0.5"]), [MASS, LENGTH])
    mechanism.simulate_many([[12.0, 1.1]])
    before = REPORT.compiled, REPORT.cached
    mechanism.simulate_many(np.random.default_rng(0).uniform(1.0, 2.0, (50, 2)))
    assert (REPORT.compiled, REPORT.cached) == before


def test_a_run_that_fails_is_a_row_with_its_reason() -> None:
    mechanism = Mechanism(load_scene(PENDULUM, ["simulate.duration=0.5"]), [MASS, "simulate.duration"])
    found = mechanism.simulate_many({MASS: [12.0, -1.0, 13.0], "simulate.duration": [0.5, 0.5, 0.25]})
    assert found.code.tolist() == [0, 2, 0]
    assert "mass" in found.reason[1] and np.isnan(found.q[1]).all()
    assert found.time.tolist()[::2] == [0.5, 0.25]


def test_loops_that_cannot_close_are_rows_too() -> None:
    scene = load_scene(str(CONFIGS / "benchmarks" / "drake_four_bar.yaml"), ["simulate.duration=0.1"])
    family = Family.of(scene)
    lengths = [p for p in numbers_of(with_places(scene), {}) if p.endswith((".a", "origin.xyz.0", "at.0"))]
    keys = [key for key in lengths if understand(family, key).sort == NUMBER][:1]
    own = numbers_of(with_places(scene), {})[keys[0]]
    found = Mechanism(scene, keys).simulate_many({keys[0]: np.array([1.0, 1.01, 50.0]) * own})
    assert found.code.tolist()[:2] == [0, 0] and found.code[2]
    assert "close" in found.reason[2]


SWITCHING = """
schema: 1
command: simulate
gravity: [0, 0, -9.81]
robot:
  joints: [{name: swing, type: revolute, axis: [0, 1, 0]}]
  links: [{name: bob, mass: 1.3, com: [0.2, 0, -0.7], inertia: {yy: 0.02}}]
parameters: {dry: 0.3}
torques: {swing: "-dry*sign(qd.swing) - 0.1*qd.swing"}
initial: {q: {swing: 1.2}, qd: {swing: 0.5}}
simulate: {duration: 1.5, samples: 11}
"""


def test_runs_go_on_over_switches_of_their_formulas() -> None:
    scene = load_scene_text(SWITCHING)
    values = {"parameters.dry": np.linspace(0.05, 0.6, 5), "robot.links.bob.mass": np.linspace(1.0, 2.0, 5)}
    found = Mechanism(scene, list(values)).simulate_many(values, samples=11)
    assert found.ok.all()
    assert not found.one_by_one.all(), "a switch that comes in one place is located in compiled code"
    for run in range(5):
        single = simulate(own_scene(scene, values, run))
        np.testing.assert_allclose(found.q[run], single["q"][-1], atol=1e-8, rtol=0)
        np.testing.assert_allclose(found.samples["q"][run], single["q"], atol=1e-8, rtol=0)
        np.testing.assert_allclose(found.samples["time"][run], single.time, atol=1e-14)


def test_contacts_are_made_one_by_one() -> None:
    scene = load_scene(str(CONFIGS / "stick_slip.yaml"))
    keys = varied(scene, 1, seed=0)
    values = around(scene, keys, 2, seed=1)
    found = Mechanism(scene, keys).simulate_many(values, of=["energy_drift"])
    assert found.ok.all() and found.one_by_one.all()
    for run in range(2):
        single = simulate(own_scene(scene, values, run))
        np.testing.assert_array_equal(found.q[run], single["q"][-1])
        assert found.outputs["energy_drift"][run] == single.summary["energy_drift"]


def test_stiff_runs_choose_their_method_one_by_one() -> None:
    scene = load_scene_text(
        SWITCHING.replace("sign(qd.swing)", "qd.swing").replace("0.1*", "1.0*").replace("1.5,", "3,")
    )
    values = {"parameters.dry": np.array([0.1, 3e4])}
    found = Mechanism(scene, list(values)).simulate_many(values, of=["counters.steps"])
    assert found.ok.all() and not found.one_by_one.any(), found.reason
    singles = [simulate(own_scene(scene, values, run)) for run in range(2)]
    assert singles[0].summary["integrator"] != singles[1].summary["integrator"]
    for run, single in enumerate(singles):
        assert found.steps[run] == pytest.approx(single.summary["counters"]["steps"], rel=0.1)
        np.testing.assert_allclose(found.q[run], single["q"][-1], atol=1e-8, rtol=0)


def test_shapes_and_keys_that_do_not_fit_are_refused() -> None:
    mechanism = Mechanism(PENDULUM, [MASS])
    with pytest.raises(CapabilityError, match="needed"):
        mechanism.simulate_many({"robot.links.link2.mass": [1.0]})
    with pytest.raises(CapabilityError, match="shape"):
        mechanism.simulate_many([[1.0, 2.0]])
    with pytest.raises(CapabilityError, match="needed"):
        mechanism.simulate_many([[1.0]], q=np.zeros((2, 2)))
    with pytest.raises(CapabilityError, match="of: .title.: is not a number but a text"):
        mechanism.simulate_many([[1.0]], of=["final.time", "title"])
    with pytest.raises(RobodynError):
        Mechanism(PENDULUM, [MASS, MASS])


# -- lanes --------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(("method", "within"), [("dop853", 2e-8), ("dopri5", 2e-8), ("taylor12", 1e-7)])
def test_lanes_make_the_steps_of_the_scalar_loop(method: str, within: float) -> None:
    """Where rounding decides whether a step counts they are apart by as much as each is off."""
    scene = load_scene(
        PENDULUM, [f"simulate.integrator={method}", "simulate.duration=2", "simulate.rtol=1e-9"]
    )
    mechanism = Mechanism(scene, [MASS, "simulate.duration"])
    rng = np.random.default_rng(3)
    values = np.stack([rng.uniform(10, 15, 101), rng.uniform(0.1, 3.0, 101)], axis=1)
    ((structure, _),) = Structures(mechanism.family, mechanism.keys, Simulate().structure).groups(values)
    assert structure is not None
    fleet = structure.fleet(method)
    batch = RunBatch.of(structure, values, rng.uniform(-1, 1, (101, 2)), None, threads=2)
    if fleet.lanes == 1:
        pytest.skip("this processor has no vectors of doubles")
    found = batch.drive(method, batch.options)
    fleet.lanes = 1
    expected = batch.drive(method, batch.options)
    assert found.arrived.all()
    np.testing.assert_array_equal(found.time, values[:, 1])
    np.testing.assert_allclose(found.y, expected.y, atol=within, rtol=0)
    assert np.abs(found.steps - expected.steps).max() <= 3
    assert abs(found.steps.mean() - expected.steps.mean()) < 0.5
    if method == "taylor12":
        # what judges a step begins the next one: rates are evaluated anew at a start and to try a step again
        tries = found.steps + found.rejected
        np.testing.assert_array_equal(found.evaluations, 12 * tries + 1 + found.rejected)


def test_a_lane_that_fails_leaves_the_others_alone() -> None:
    scene = load_scene(
        PENDULUM, ["simulate.integrator=dop853", "simulate.duration=1", "simulate.max_steps=200"]
    )
    mechanism = Mechanism(scene, [])
    q = np.random.default_rng(1).uniform(-1, 1, (40, 2))
    q[::7] = np.nan
    qd = np.zeros((40, 2))
    qd[5] = 1e4  # more steps than are allowed
    found = mechanism.simulate_many(q=q, qd=qd)
    fails = np.isin(np.arange(40), [*range(0, 40, 7), 5])
    np.testing.assert_array_equal(found.ok, ~fails)
    assert "steps" in found.reason[5]
    alone = mechanism.simulate_many(q=q[3:4], qd=qd[3:4])
    np.testing.assert_array_equal(alone.q[0], found.q[3])


# -- deployments --------------------------------------------------------------------------------------------
def test_locks_of_many_runs_are_those_of_their_own_scenes() -> None:
    scene = load_scene(str(CONFIGS / "four_bar_deploy.yaml"))
    keys = [
        "robot.links.crank.mass",
        "robot.links.follower.com.0",
        "robot.joints.theta1.a",
        "simulate.duration",
    ]
    rng = np.random.default_rng(2)
    values = np.array([20.15, 0.6, 1.241, 20.0]) * rng.uniform(
        [0.9, 0.9, 0.9999, 1], [1.1, 1.1, 1.0001, 1], (6, 4)
    )
    values[4, 3] = 1.0  # too short to lock
    of = ["lock.time", "lock.time_error", "lock.angles.phi1", "lock.rates.phi1"]
    found = Mechanism(scene, keys).deploy_many(values, of=of)
    assert found.code.tolist() == [0, 0, 0, 0, 1, 0] and "no lock" in found.reason[4]
    assert not found.one_by_one.any()
    for run in (0, 1, 2, 3, 5):
        lock = deploy(Family.of(scene).scene(settings(keys, values[run]))).summary["lock"]
        assert found.time[run] == found.outputs["lock.time"][run] == pytest.approx(lock["time"], abs=1e-11)
        assert found.time_error[run] == pytest.approx(lock["time_error"], rel=3, abs=1e-12)
        assert found.outputs["lock.angles.phi1"][run] == pytest.approx(lock["angles"]["phi1"], abs=1e-9)
        assert found.outputs["lock.rates.phi1"][run] == pytest.approx(lock["rates"]["phi1"], rel=1e-8)


def test_deployments_that_code_does_not_judge_are_made_one_by_one() -> None:
    scene = load_scene(str(CONFIGS / "mechanisms" / "four_bar_overload.yaml"))
    found = Mechanism(scene, ["robot.links.crank.mass"]).deploy_many([[20.0], [20.3]])
    assert found.one_by_one.all() and found.code.tolist() == [1, 1]


@pytest.mark.parametrize(
    ("given", "statuses"),
    [
        ("after: continue", ["no_lock", "locked"]),
        ("loads: {pin: {force: 100}}", ["no_lock", "overload"]),
        ("loads: {pin: {force: 2000}}", ["no_lock", "locked"]),
    ],
)
def test_only_what_follows_a_lock_or_an_overload_is_left_to_the_command(
    given: str, statuses: list[str]
) -> None:
    setting = f"deploy={{criterion: dead_point, latch: {{between: [coupler, follower]}}, {given}}}"
    scene = load_scene(str(CONFIGS / "four_bar_deploy.yaml"), [setting, "expect={}"])
    key, of, durations = "simulate.duration", "final.q.theta1", [3.0, 13.0]
    found = Mechanism(scene, [key]).deploy_many([[x] for x in durations], of=[of])
    for run, (duration, status) in enumerate(zip(durations, statuses)):
        alone = ended(lambda x=duration: deploy(Family.of(scene).scene(settings([key], [x]))))
        assert alone.summary["status"] == status and found.code[run] == alone.code
        left = status == "overload" or (status == "locked" and "continue" in given)
        assert found.one_by_one[run] == left
        error = max(error_of(alone.summary, of), 1e-13)
        assert found.outputs[of][run] == pytest.approx(number_of(alone.summary, of), abs=2.0 * error)


SIX_BAR = Path(__file__).resolve().parents[2] / "benchmarks" / "six_bar.yaml"


def test_loops_are_closed_as_assembly_closes_them() -> None:
    scene = load_scene(str(SIX_BAR))
    keys = ["forces.0.stiffness", "robot.joints.a2.a", "robot.joints.a3.origin.xyz.0", "initial.q.a1"]
    rng = np.random.default_rng(5)
    values = np.array([2.0, 1.6, 2.5, np.radians(20)]) * rng.uniform(0.98, 1.02, (5, 4))
    found = Mechanism(scene, keys).simulate_many(values, samples=3)
    assert found.ok.all() and not found.one_by_one.any(), found.reason
    for run in range(5):
        single = simulate(Family.of(scene).scene(settings(keys, values[run])))
        np.testing.assert_allclose(found.samples["q"][run][0], single["q"][0], atol=1e-12)
        np.testing.assert_allclose(found.q[run], single["q"][-1], atol=1e-10)


FIXED_STEPS = """
schema: 1
gravity: [0, -9.81, 0]
robot: {include: robots/planar_2r.yaml}
initial: {q: {theta1: -60 deg, theta2: 20 deg}}
torques: {theta1: "if(q.theta1 < -1.3, 5, -5)"}
simulate: {duration: 2, integrator: rk4, step: 0.05}
"""


def test_fixed_steps_at_jumps_are_made_one_by_one() -> None:
    """Only the driver comes close to a jump before it goes there."""
    scene = load_scene_text(FIXED_STEPS, str(CONFIGS / "scene.yaml"))
    runs = Mechanism(scene, vary=[MASS]).simulate_many({MASS: np.array([12.0, 13.0])})
    assert runs.one_by_one.all() and (runs.code == 0).all()


def test_runs_that_go_on_from_a_stored_one_begin_there(tmp_path: Path) -> None:
    before = load_scene(PENDULUM)
    write_result(simulate(before), tmp_path / "result.h5")
    text = FIXED_STEPS.replace(
        "initial: {q: {theta1: -60 deg, theta2: 20 deg}}", f"initial: {{from: {tmp_path}}}"
    )
    text = text.replace("duration: 2, integrator: rk4, step: 0.05", "duration: 12, error_estimate: false")
    text = text.replace('torques: {theta1: "if(q.theta1 < -1.3, 5, -5)"}\n', "")
    scene = load_scene_text(text, str(CONFIGS / "scene.yaml"))
    values = np.array([11.0, 13.0])
    runs = Mechanism(scene, vary=[MASS]).simulate_many({MASS: values})
    for k, mass in enumerate(values):
        own = simulate(Family.of(scene).scene([f"{MASS}={mass}"]))
        assert_close(runs.q[k], own["q"][-1], 1e-12)


def test_rows_that_cannot_be_built_leave_the_others_to_compiled_code() -> None:
    scene = load_scene(CONFIGS / "four_bar_deploy.yaml")
    key = "robot.joints.phi2.a"
    length = numbers_of(with_places(scene), {})[key]
    values = length * np.array([0.999, 1.0, 1.001, 25.0])
    runs = Mechanism(scene, vary=[key]).deploy_many({key: values})
    assert runs.code[-1] != 0 and (runs.code[:3] == 0).all()
    assert not runs.one_by_one[:3].any()


def test_a_structure_whose_numbers_are_refuted_is_never_trusted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Built, "has_numbers_of", lambda self, other: False)
    mechanism = Mechanism(load_scene(PENDULUM), vary=[MASS])
    for _ in range(2):
        runs = mechanism.simulate_many({MASS: np.array([11.0, 12.0, 13.0])}, of=["final.time"])
        assert runs.one_by_one.all()


def test_errors_of_many_runs_are_no_less_than_rounding() -> None:
    scene = Family(PENDULUM).scene(["simulate.duration=2", "simulate.rtol=1e-13", "simulate.atol=1e-13"])
    runs = Mechanism(scene, vary=[MASS]).simulate_many({MASS: np.array([12.0, 13.0])})
    assert (runs.q_error > 1e-15).all()


def test_tables_have_the_numbers_of_each_run() -> None:
    graph = Graph()
    x = graph.symbol("x", "q", 0)
    table = graph.interpolate(x, (0.0, 1.0, 2.0), (0.0, 3.0, 4.0))
    many = ManyNumbers(Recipe([]), {}, 3)
    found = many.evaluate(Expressions([table]), {"q": [np.array([0.5, 1.5, 9.0])]})
    assert_close(found[:, 0], [1.5, 3.5, 4.0], 1e-15)
