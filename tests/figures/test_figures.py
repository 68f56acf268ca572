"""Figures stay within their errors when samples and tolerances are others; ``python -m tests.figures`` tries many more."""

from __future__ import annotations

import dataclasses
import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
import yaml

from robodyn_cli.record import record
from robodyn_cli.summaries.apart import with_others
from robodyn_cli.summaries.facts import ABSENT, Absent, fact
from tests.figures.__main__ import CONFIGS, with_extremes
from tests.figures.judge import OFTEN, TIMES, Move, figures_of, moves, runs_of
from tests.figures.reached import reached_moves

ASKED = (
    "outputs={reactions: true, extremes: [q.theta1, qd.theta1, qdd.theta1, reactions/theta1.force, base_wrench.fx, "
    "energy/kinetic]}"
)
# command, file, samples, overrides: scenes with many kinds of figures, short
SCENES = {
    "drives": ("inverse", "2r_drives.yaml", 41, ()),
    "least time": ("inverse", "trajectories/fastest_2r.yaml", 41, ()),
    "few samples": ("inverse", "2r_drives.yaml", 11, ("outputs.reactions=true",)),
    "few samples of a path": ("kinematics", "trajectories/pick_and_place.yaml", 11, ()),
    "size": ("size", "2r_drives.yaml", 11, ()),
    "controller": ("simulate", "controlled_arm.yaml", 31, ("simulate.duration=0.4", ASKED)),
    "payload": ("simulate", "catching_arm.yaml", 21, (ASKED,)),
    "impacts": ("simulate", "bouncing_pendulum.yaml", 21, ("simulate.duration=1.5", ASKED)),
    "sweep": (
        "kinematics",
        "mechanisms/four_bar_kinematics.yaml",
        41,
        ("outputs.extremes=[q.rocker, qdd.rocker]",),
    ),
    "latch": ("deploy", "four_bar_deploy.yaml", 41, ("deploy.after=continue", ASKED)),
    "latches": ("deploy", "mechanisms/solar_array.yaml", 41, ("simulate.duration=5",)),
    "multipliers": ("deploy", "four_bar_deploy.yaml", 41, ("deploy.criterion=multipliers",)),
    "no lock": ("deploy", "four_bar_deploy.yaml", 41, ("deploy.criterion=multipliers", "deploy.growth=1e9")),
    "driven": ("deploy", "four_bar_prescribed.yaml", 41, ()),
}
# random scenes of older features in which figures were wrong, each with what it was
FOUND = sorted((Path(__file__).parent / "scenes").glob("*.yaml"))
SAMPLES = {"simulate": 11}


@pytest.mark.parametrize("name", SCENES)
def test_figures_stay_within_their_errors(name: str) -> None:
    command, file, samples, given = SCENES[name]
    check(CONFIGS / file, command, samples, given)


@pytest.mark.parametrize("path", FOUND, ids=lambda path: path.stem)
def test_what_was_wrong_once(path: Path) -> None:
    command = str(yaml.safe_load(path.read_text(encoding="utf-8"))["command"])
    check(path, command, SAMPLES.get(command, 31), with_extremes(path, command))


def test_poses_that_are_reached() -> None:
    """Errors are not told by other runs, which would come to the same rounding, but by fifty digits."""
    found = [x for seed in range(24) for x in reached_moves(seed)]
    assert not [str(x) for x in found if x.ratio > 1.0]
    assert len(found) > 200 and np.median([x.ratio for x in found]) > 1e-2


def check(path: Path, command: str, samples: int, given: tuple[str, ...]) -> None:
    found = moves(runs_of(path, command, samples, given))
    assert found
    assert not [str(x) for x in found if x.ratio > TIMES]
    beyond = [str(x) for x in found if x.ratio > 1.0]
    assert len(beyond) <= OFTEN * len(found), beyond


STOPS = f"""
schema: 1
gravity: [0, -9.81, 0]
robot: {CONFIGS / "robots" / "planar_2r.yaml"}
drives:
  theta1: {{motor: servo2p4_3000, gear: wave40_100, mass_on: none}}
  theta2: {{motor: servo1p27_3000, gear: wave32_100, mass_on: none}}
trajectory:
  type: trapezoid
  speed: {{theta1: 3, theta2: 3}}
  acceleration: {{theta1: 14, theta2: 19}}
  points: [{{q: {{theta1: -90 deg, theta2: 0}}}}, {{q: {{theta1: -30 deg, theta2: 30 deg}}}}, {{q: {{theta1: 40 deg, theta2: -30 deg}}}}]
control: {{type: computed_torque, gains: {{kp: 400, kd: 40}}}}
initial: {{q: {{theta1: -90 deg, theta2: 0}}}}
outputs: {{reactions: true}}
simulate: {{duration: 1.15, samples: 201}}
"""
NEAR = 1e-3  # of a figure, that its error may be: accelerations jump by as much as the loads themselves


def test_figures_along_a_motion_whose_accelerations_jump_are_those_of_its_pieces(tmp_path: Path) -> None:
    """Knots of the trajectory are no samples; errors covered the jumps, as wide as these are, and peaks were missed."""
    path = tmp_path / "stops.yaml"
    path.write_text(STOPS, encoding="utf-8")
    runs = runs_of(path, "simulate", 201)
    found = [x for x in moves(runs) if x.key.startswith(("reactions", "drives", "control.energy"))]
    assert len(found) > 100 and not [str(x) for x in found if x.ratio > TIMES]
    # losses of gears jump at other times too: where a joint is at rest, and where its load changes its sign
    figures = ("peak_force", "peak_moment", "joint.peak_torque", "joint.rms_torque", "energy.driving")
    peaks = [x for x in found if x.kind.endswith(figures)]
    assert len(peaks) > 50
    for x in peaks:
        assert None not in x.errors and max(x.errors) < NEAR * abs(x.values[0]), str(x)


# two knots 5.7 samples apart: the use of an envelope, which jumps at them, moved by 7 700 times its error
PAIR = """{type: quintic, points: [
    {t: 0, q: {theta1: -90 deg, theta2: 0}},
    {t: 0.38115, q: {theta1: -1.12226, theta2: -0.28057}, qd: {theta1: 0.03841, theta2: -1.09224}},
    {t: 0.43769, q: {theta1: -1.12152, theta2: -0.33356}, qd: {theta1: -0.01212, theta2: -0.78225}},
    {t: 1, q: {theta1: 0.3904, theta2: -0.16178}}]}
"""


def test_figures_of_knots_that_are_few_samples_apart(tmp_path: Path) -> None:
    path = tmp_path / "pair.yaml"
    text = re.sub(r"(?s)trajectory:.*?\ncontrol:", lambda _: f"trajectory: {PAIR}control:", STOPS)
    path.write_text(text.replace("1.15, samples: 201", "1.0, samples: 101"), encoding="utf-8")
    own = ("reactions", "drives", "control")
    found = [x for x in moves(runs_of(path, "simulate", 101)) if x.key.startswith(own)]
    assert len(found) > 100
    assert not [str(x) for x in found if x.ratio > TIMES]
    beyond = [str(x) for x in found if x.ratio > 1.0]
    assert len(beyond) <= OFTEN * len(found), beyond


TURNS = """
schema: 1
gravity: [0, -9.81, 0]
robot:
  joints:
    - {{name: a, type: revolute, axis: [0, 0, 1], friction: {{coulomb: 3}}}}
    - {{name: b, type: revolute, axis: [0, 0, 1], origin: {{xyz: [0.6, 0, 0]}}, friction: {{coulomb: 2}}}}
  links:
    - {{name: A, mass: 2, com: [0.3, 0, 0], com_frame: joint, inertia: {{zz: 0.1}}}}
    - {{name: B, mass: 1, com: [0.2, 0, 0], com_frame: joint, inertia: {{zz: 0.05}}}}
trajectory: {trajectory}
inverse: {{samples: 201}}
"""
CROWDED = {
    "another turn": "{type: joint, duration: 1, q: {a: 0.5*sin(7*t), b: 0.4*sin(7*t + 0.02)}}",
    "a knot": "{type: quintic, points: [{t: 0, q: {a: 0, b: 0}}, {t: 0.5, q: {a: 0.6, b: 0.5}, qd: {a: 0.01, b: -0.004}},"
    " {t: 1, q: {a: 0.1, b: 0.2}}]}",
}


@pytest.mark.parametrize("near", CROWDED)
def test_friction_that_turns_near_something_else_is_cut_there(near: str, tmp_path: Path) -> None:
    """A joint turned back less than three samples from a knot or from another joint: as wide an error as friction."""
    path = tmp_path / "turns.yaml"
    path.write_text(TURNS.format(trajectory=CROWDED[near]), encoding="utf-8")
    found = moves(runs_of(path, "inverse", 201))
    assert not [str(x) for x in found if x.ratio > TIMES]
    own = [x for x in found if x.kind.endswith(("peak_torque", "rms_torque", "torque_range.N"))]
    assert len(own) >= 12
    for x in own:
        assert None not in x.errors and max(x.errors) < 0.1 * NEAR * max(map(abs, x.values)), str(x)


# -- the judge, and what adds the errors of a second run ---------------------------------------------------------
def test_a_figure_without_an_error_that_moves_is_found() -> None:
    runs = [figures_of("simulate", {"final": {"q": {"a": x}}, "error_estimate": {"q_end": e}}) for x, e in
            ((1.0, 1e-9), (1.0 + 1e-8, 1e-9), (1.0, None))]  # fmt: skip
    ratios = {x.runs: x.ratio for x in moves(dict(zip("abc", runs)))}
    assert ratios["a", "b"] == pytest.approx(5.0, rel=1e-3) and ratios["a", "c"] == 0.0
    assert ratios["b", "c"] == math.inf


def test_numbers_about_a_run_are_no_figures() -> None:
    summary = {
        "energy_drift": 1e-9,
        "wall_time_s": {"total": 1.0},
        "error_estimate": {"q_end": 1e-9, "q_max": 1e-8},
    }
    assert not figures_of("simulate", {**summary, "tolerances": {"rtol": 1e-6}})


@record
class Parts:
    peak: float = fact("")
    times: float | Absent | None = fact("", default=ABSENT)


@record
class Whole:
    peak: float = fact("", errors=(".errors.peak",))
    times: list[float] = fact("", errors=("run.NAME.errors.times",))
    left: dict[str, float] = fact("", errors=("run.NAME.left_error.JOINT",))
    other: float = fact("", errors=("elsewhere.error",))
    errors: Parts = fact("")
    left_error: dict[str, float] = fact("")


def test_errors_grow_by_how_far_a_second_run_is() -> None:
    one = Whole(2.0, [1.0, 3.0], {"a": 1.0}, 5.0, Parts(0.25), {"a": 0.5})
    two = dataclasses.replace(one, peak=2.5, times=[1.25, 2.0], left={"a": 1.125}, other=6.0)
    own = with_others({"x": one}, [{"x": two}], 2.0, ("run", "NAME"))["x"]
    assert own.errors.peak == pytest.approx(0.25 + 2.0 * 0.5) and own.errors.times == pytest.approx(2.0)
    assert own.left_error["a"] == pytest.approx(0.5 + 0.25) and (own.peak, own.other) == (2.0, 5.0)


def test_an_error_is_not_known_where_the_second_run_has_no_such_figure() -> None:
    one = Whole(2.0, [1.0, 3.0], {"a": 1.0}, 5.0, Parts(0.25), {"a": 0.5})
    own = with_others(one, [dataclasses.replace(one, times=[1.0])], 1.0, ("run", "NAME"))
    assert own.errors.times is None and own.errors.peak == pytest.approx(0.25)


def test_a_move_says_where_it_is() -> None:
    move = Move("final.q.a", "final.q.JOINT", ("x", "y"), (1.0, 2.0), (0.1, None), math.inf)
    assert json.dumps(str(move)).count("final.q.a") == 1
