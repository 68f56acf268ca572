"""One run and many: the same figures and the same stated errors, which hold against references."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robodyn_cli import Mechanism, deploy, load_scene, load_scene_text, simulate
from robodyn_cli.errors import RobodynError
from robodyn_cli.over.many.command import ManyRuns, ended, error_of, number_of
from robodyn_cli.over.study.rows import Points, Task
from robodyn_cli.over.study.runs import Compiled, beyond, make_alone
from robodyn_cli.results.result import Result
from robodyn_cli.scene.load import Family
from robodyn_cli.scene.types import Scene
from tests.many import compare_all
from tests.unit.test_mechanism import PENDULUM, SCENES, around, own_scene, varied

# single runs are compared with many to the last digits
pytestmark = pytest.mark.usefixtures("lasting_code")

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
OF = ["error_estimate.steps", "error_estimate.q_end", "error_estimate.qd_end"]
COMPARED: dict[str, bool] = {}
LOCATED = 1e-15  # part of a time within which both find an event
ROUNDED = (
    2e-15  # of the fastest rate: the times of samples that are judged are rounded once more in many runs
)
VECTORS = 1e-5  # relative: runs in the lanes of vectors are rounded otherwise
SETTINGS = [
    ([], 1e-12),
    (["simulate.integrator=dopri5", "simulate.rtol=1e-6"], VECTORS),
    (["simulate.integrator=rodas5p", "simulate.rtol=1e-5"], VECTORS),
    (["simulate.integrator=gauss4", "simulate.parts=300"], 1e-12),
]


def compare(
    scene: Scene, values: dict[str, np.ndarray] | None = None, within: float = 1e-12, **options: Any
) -> bool | None:
    """Compare the first row of many runs with a run alone; tell whether their steps are equal, None if not compiled."""
    found = Mechanism(scene, list(values or ())).simulate_many(values, of=OF, **options)
    if found.one_by_one[0] or not found.ok[0]:
        return None
    return same(found, simulate(own_scene(scene, values, 0) if values else scene), within)


def same(found: ManyRuns, alone: Result, within: float) -> bool:
    """Compare the first of many runs with a run alone; tell whether their steps are equal."""
    own = alone.summary["error_estimate"]
    bound = 10.0 * max(own["q_end"], own["qd_end"])  # the last sample is dense output, rounded once more
    np.testing.assert_allclose(found.q[0], alone["q"][-1], rtol=1e-12, atol=bound)
    np.testing.assert_allclose(found.qd[0], alone["qd"][-1], rtol=1e-12, atol=bound)
    steps = alone.summary["counters"]["steps"], own["steps"]
    if (found.steps[0], found.outputs[OF[0]][0]) != steps:
        return False
    rounded = ROUNDED * max(1.0, float(np.abs(alone["qd"]).max(initial=0.0)))
    for key in OF[1:]:
        assert found.outputs[key][0] == pytest.approx(own[key.partition(".")[2]], rel=within, abs=rounded), (
            key
        )
    assert found.q_error[0].max() == found.outputs[OF[1]][0]
    return True


@pytest.mark.parametrize("path", SCENES, ids=lambda p: p.stem)
def test_example_scenes_state_the_same_errors(path: Path) -> None:
    found = compare(load_scene(path))
    if found is not None:
        COMPARED[path.stem] = found


def test_enough_scenes_could_be_compared() -> None:
    equal = sum(COMPARED.values())
    assert equal >= 18 or len(COMPARED) < 20, COMPARED
    # rounding decides steps of two, and where controllers and tables cut the motion, single steps of three
    assert len(COMPARED) - equal <= 5, COMPARED


@pytest.mark.parametrize("name", ["double_pendulum", "slider_crank", "adams_universal"])
@pytest.mark.parametrize("samples", [2, 9, 40, 200])
def test_samples_that_are_asked_for_leave_the_errors(name: str, samples: int) -> None:
    (path,) = [p for p in SCENES if p.stem == name]
    scene = load_scene(path, [f"simulate.samples={max(samples, 17)}"])
    values = around(scene, varied(scene, 2, seed=1), 3, seed=2)
    assert compare(scene, values)
    if samples > 16:
        assert compare(scene, values, samples=samples)


@pytest.mark.parametrize(
    ("seed", "setting", "within"),
    [
        (seed, *SETTINGS[(n + k) % 4])
        for n, seed in enumerate([0, 2, 7, 9, 15, 19, 26])
        for k in (0, 2 - n % 2)
    ],
)
def test_random_mechanisms_state_the_same_errors_which_are_true(
    seed: int, setting: list[str], within: float
) -> None:
    pytest.importorskip("pinocchio")
    from tests.proof.families import make
    from tests.proof.judge import truth

    _, m, _ = make(seed)
    own = [f"simulate.step={m.duration / 300:.4g}" if "parts" in s else s for s in setting]
    # with fewer samples than 17 many runs are judged by more than a run alone
    scene = load_scene_text(m.scene(), overrides=["simulate.samples=41", *own])
    try:
        found, alone = Mechanism(scene).simulate_many(of=OF), simulate(scene)
    except RobodynError:
        return
    if found.one_by_one[0] or not found.ok[0] or not same(found, alone, within):
        return
    ref = truth(m, alone["q"][0], alone["qd"][0], np.array([0.0, m.duration]))
    least = max(10.0 * float(ref.doubt.max()), 100.0 * alone.summary["error_estimate"]["rounding_floor"])
    for value, true, stated in ((found.q, ref.q, found.q_error), (found.qd, ref.v, found.qd_error)):
        off = float(np.abs(value[0] - true[-1]).max())
        assert off <= least or stated.max() >= 0.1 * off, (off, stated)


def test_locks_state_the_same_errors() -> None:
    for setting in ([], ["simulate.integrator=dopri5", "simulate.rtol=1e-7"], ["simulate.rtol=1e-5"]):
        scene = load_scene(CONFIGS / "four_bar_deploy.yaml", setting)
        found = Mechanism(scene).deploy_many(of=["lock.time", "lock.time_error"])
        assert not found.one_by_one[0]
        lock = deploy(scene).summary["lock"]
        within = LOCATED * lock["time"]
        assert found.time[0] == pytest.approx(lock["time"], rel=0.0, abs=within)
        # one of them counts the step in which it locks
        assert found.time_error[0] == pytest.approx(lock["time_error"], rel=0.05)


def test_the_conditioning_is_found_once_and_counts_for_runs_near_rounding() -> None:
    """A pendulum on four rods: of its accelerations rounding leaves a thousand times what it leaves of its state."""
    scene = load_scene(CONFIGS / "benchmarks" / "double_pendulum_rods.yaml", ["simulate.integrator=gauss"])
    key = "simulate.duration"
    values = scene.simulate.duration * np.array([1.0, 0.5, 1.0])
    mechanism = Mechanism(scene, [key])
    found = mechanism.simulate_many({key: values})
    floor = simulate(scene).summary["error_estimate"]["rounding_floor"]
    assert found.qd_error[0].max() == found.qd_error[2].max() >= floor
    assert 0.3 * floor <= found.qd_error[1].max() <= floor
    again = mechanism.simulate_many({key: values[1:]})
    np.testing.assert_array_equal(again.qd_error, found.qd_error[1:])


def test_a_far_error_is_not_lifted_to_the_conditioning() -> None:
    scene = load_scene(PENDULUM, ["simulate.integrator=dopri5", "simulate.rtol=1e-6"])
    found, loose = (
        Mechanism(Family.of(scene).scene(own)).simulate_many() for own in ([], ["simulate.rtol=1e-4"])
    )
    assert 1e-9 < found.q_error.max() < loose.q_error.max()


LOCK_KEYS = (
    "lock.time", "lock.angles.theta1", "lock.angles_deg.theta1", "lock.rates.theta1", "lock.errors.angles_deg",
    "lock.multipliers.start", "lock.multipliers.at_lock", "lock.multipliers.diverge", "lock.singular_values.psi.1",
    "lock.singular_values.passive.0", "constraint_residual.position", "constraint_residual.velocity",
    "criteria.dead_point", "termination.time",
)  # fmt: skip


@pytest.mark.parametrize(
    ("key", "values", "within"),
    [
        # the loops of all runs are the same: to the bit
        ("robot.links.crank.mass", [20.15, 21.0], 1e-14),
        # they close each on its own, near a fold, pass near a loss of rank, and some do not lock
        ("robot.joints.theta1.a", [1.241, 1.24353278, 1.23782842, 1.25], 1e-10),
    ],
)
def test_figures_of_locks_are_those_of_the_command(key: str, values: list[float], within: float) -> None:
    scene = load_scene(CONFIGS / "four_bar_deploy.yaml")
    found = Mechanism(scene, [key]).deploy_many({key: np.array(values)}, of=LOCK_KEYS)
    assert not found.one_by_one.any() and not found.left
    assert (found.code[:-1] == 0).all()
    for k, value in enumerate(values):
        alone = ended(lambda value=value: deploy(Family.of(scene).scene([f"{key}={value}"])))
        assert (found.code[k], found.reason[k]) == (alone.code, alone.reason)
        for name in LOCK_KEYS:
            own, error = number_of(alone.summary, name), error_of(alone.summary, name)
            floor = (
                1e-14 if name.startswith("constraint_residual") else 3.0 * (0.0 if np.isnan(error) else error)
            )
            if name == "lock.errors.angles_deg":
                floor = 0.5 * own
            assert found.outputs[name][k] == pytest.approx(own, rel=within, abs=floor, nan_ok=True), name
            assert np.isnan(found.errors[name][k]) == np.isnan(error), name
            # at rounding the two errors are draws of it
            assert np.isnan(error) or 0.02 < found.errors[name][k] / error < 50.0, name


def test_figures_of_locks_cover_what_rounding_leaves_of_closed_starts() -> None:
    """Runs and commands close their loops in other steps: at rounding, which a start folded together magnifies."""
    scene, key = load_scene(CONFIGS / "four_bar_deploy.yaml", ["expect={}"]), "robot.joints.theta1.a"
    values = np.random.default_rng(0).uniform(1.235, 1.2437, 6)
    names = ("lock.time", "lock.multipliers.start")
    found = Mechanism(scene, [key]).deploy_many({key: values}, of=names)
    for k, value in enumerate(values.tolist()):
        alone = deploy(Family.of(scene).scene([f"{key}={value!r}"])).summary
        for name in names:
            off = abs(found.outputs[name][k] - number_of(alone, name))
            assert off <= 2.0 * min(found.errors[name][k], error_of(alone, name)) + 1e-15, (name, value)
    assert found.errors["lock.time"].max() < 1e-11


@pytest.mark.parametrize(
    ("name", "keys"),
    [
        ("double_pendulum", ("robot.links.link1.mass", "initial.q.theta2")),
        ("benchmarks/slider_crank", ("robot.links.crank.mass", "robot.joints.psi.origin.xyz#1")),
    ],
)
def test_energies_and_residuals_are_those_of_the_command(name: str, keys: tuple[str, ...]) -> None:
    task = Task(Family(CONFIGS / f"{name}.yaml", ("expect={}",)), "simulate", keys, ())
    assert {"energy_drift", "energy_drift_relative", "final.time"} <= set(compare_all(task, 3))


def test_expectations_of_the_example_are_judged_in_compiled_runs() -> None:
    family = Family(CONFIGS / "four_bar_deploy.yaml")
    task = Task(family, "deploy", ("robot.joints.theta1.a",), ("lock.time",))
    assert not beyond(task)
    values = np.array(
        [[1.241], [1.24353278], [1.25]]
    )  # the expected angle is that of the first; the last has no lock
    made = Compiled(task, 1).make(Points(np.arange(3), values))
    alone = make_alone(task, Points(np.arange(3), values))
    assert len(made) == 3
    for name in ("code", "holds", "done"):
        assert made.rows[name].tolist() == alone.rows[name].tolist(), name
    assert made.reasons == alone.reasons
