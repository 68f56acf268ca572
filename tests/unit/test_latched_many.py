"""Many deployments with latches on equations that are built once: each run is that of the command."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from robodyn_cli import Mechanism
from robodyn_cli.over.many.command import error_of, number_of
from robodyn_cli.works.deploy.deploy import deploy
from tests.latched_panels import LatchedPanels
from tests.panels import Panels

# single runs are compared with many to the last digits
pytestmark = pytest.mark.usefixtures("lasting_code")

KEYS = (
    "robot.joints.hinge0.spring.stiffness",
    "robot.links.panel1.mass",
    "initial.q.hinge2",
    "simulate.duration",
)
OF = (
    "locks.latch0.time", "locks.latch1.speed", "locks.latch2.energy_lost", "locks.latch0.angular_impulse",
    "locks.latch1.order", "locks.latch1.errors.speed", "missed.latch0.nearest", "missed.latch2.time", "lock.time",
    "lock.time_error", "lock.angles.hinge1", "lock.rates.hinge0", "lock.errors.rates", "termination.time",
    "counters.steps", "error_estimate.steps", "energy_drift", "energy_drift_relative",
)  # fmt: skip


def three_panels(**case: Any) -> dict[str, Any]:
    panels = Panels.random(np.random.default_rng(5), 3)
    rigid = {"hold": np.zeros(3), "damping": np.zeros(3), "opens": np.full(3, np.inf), **case}
    return LatchedPanels(panels, **rigid).scene(60.0, "all")


def written(tree: dict[str, Any], folder: Path) -> Path:
    path = folder / "scene.yaml"
    path.write_text(yaml.safe_dump(tree), encoding="utf-8")
    return path


def rows(tree: dict[str, Any], keys: tuple[str, ...]) -> np.ndarray:
    """Return rows about the scene as it stands; the last of them ends before its latches are closed."""
    own = {
        KEYS[0]: tree["robot"]["joints"][0]["spring"]["stiffness"], KEYS[1]: tree["robot"]["links"][1]["mass"],
        KEYS[2]: tree["initial"]["q"]["hinge2"], KEYS[3]: 60.0, "deploy.latches.latch1.hold.stiffness": 50.0,
    }  # fmt: skip
    values = np.array([own[key] for key in keys]) * (
        1.0 + 0.02 * np.arange(5)[:, None] * (-1.0) ** np.arange(len(keys))
    )
    if KEYS[3] in keys:
        values[-1, keys.index(KEYS[3])] = 2.0
    return values


def compare(path: Path, keys: tuple[str, ...], values: np.ndarray, of: tuple[str, ...], alone: bool) -> None:
    mechanism = Mechanism(path, keys)
    many = mechanism.deploy_many(values, of=of)
    assert many.one_by_one.all() if alone else not many.one_by_one.any(), many.left
    for k, row in enumerate(values.tolist()):
        summary = deploy(mechanism.family.scene([f"{key}={x!r}" for key, x in zip(keys, row)])).summary
        assert many.code[k] == {"locked": 0, "no_lock": 1}[summary["status"]]
        assert many.reason[k] == ("" if many.code[k] == 0 else summary["termination"]["reason"])
        for key in of:
            np.testing.assert_equal(many.outputs[key][k], number_of(summary, key), key)
            np.testing.assert_equal(many.errors[key][k], error_of({**summary, "command": "deploy"}, key), key)
        for own, words in ((many.q, "angles"), (many.qd, "rates")):
            lock = summary["lock"] or {words: {}}
            np.testing.assert_equal(own[k], list(lock[words].values()) or np.full(own.shape[1], np.nan))


def test_each_of_many_runs_is_that_of_the_command(tmp_path: Path) -> None:
    tree = three_panels()
    compare(written(tree, tmp_path), KEYS, rows(tree, KEYS), OF, alone=False)


def test_couplers_and_a_latch_that_opens(tmp_path: Path) -> None:
    tree = three_panels(opens=np.array([7.0, np.inf, np.inf]))
    tree["deploy"]["until"], tree["simulate"]["duration"] = "end", 9.0
    compare(
        written(tree, tmp_path), KEYS[:3], rows(tree, KEYS[:3]), (*OF, "locks.latch0.opened"), alone=False
    )
    synchronised = Panels.random(np.random.default_rng(6), 3).synchronised().scene()
    keys, of = (
        KEYS[:2],
        (*OF[:6], "energy_drift", "constraint_residual.position", "constraint_residual.velocity"),
    )
    compare(written(synchronised, tmp_path), keys, rows(synchronised, keys), of, alone=False)


@pytest.mark.parametrize("keys", [KEYS[:2], (*KEYS[:1], "deploy.latches.latch1.hold.stiffness")])
def test_springs_of_latches_and_other_springs(tmp_path: Path, keys: tuple[str, ...]) -> None:
    tree = three_panels(hold=np.array([0.0, 50.0, 0.0]), damping=np.array([0.0, 2.0, 0.0]))
    of = ("locks.latch1.peak_moment", "locks.latch1.peak_time", "locks.latch1.rebounds", *OF)
    compare(written(tree, tmp_path), keys, rows(tree, keys), of, alone=False)


def test_friction_that_sticks_is_left_to_the_command(tmp_path: Path) -> None:
    tree = three_panels(rough=1, grip=0.05)
    compare(written(tree, tmp_path), KEYS[:2], rows(tree, KEYS[:2]), OF[:3], alone=True)


def test_words_of_a_run_with_latches_are_its_own(tmp_path: Path) -> None:
    from robodyn_cli.over.many.latched import command_for
    from robodyn_cli.over.many.simulate import Deploy

    scene = Mechanism(written(three_panels(), tmp_path)).scene
    command = command_for(Deploy(), scene)
    summary = deploy(scene).summary
    for key, word in command.words.items():
        assert summary["lock"][key.removeprefix("lock.")] == word
    assert not command.is_plain("criteria.chosen") and not command.is_plain("assembly.position_residual")


SHIPPED = [
    path
    for path in sorted((Path(__file__).parents[2] / "configs").rglob("*.yaml"))
    if "  latches:" in path.read_text(encoding="utf-8")
]


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_studies_of_shipped_scenes_with_latches_run_in_compiled_code(path: Path) -> None:
    """What they expect of a run is among what compiled code gives."""
    from robodyn_cli.over.study.rows import Task
    from robodyn_cli.over.study.runs import beyond
    from robodyn_cli.scene.load import Family

    task = Task(Family.of(path), "deploy", (), ("lock.time",))
    assert beyond(task) == [] and len(SHIPPED) > 3
