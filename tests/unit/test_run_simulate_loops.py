"""Forward dynamics with closed loops and prescribed joints, against absolute coordinates."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from robodyn_cli import InverseDynamics, deploy, load_scene, load_scene_text, simulate
from robodyn_cli.errors import SingularConfigurationError
from tests.mechanisms import (
    BENNETT,
    CONFIGS,
    SIX_BAR,
    SKEW,
    SLIDER,
    TWIST,
    close,
    failure,
    run,
)
from tests.planar_bodies import GROUND, Motor, Pin, PlanarBodies, Slide, turned

# -- loops ------------------------------------------------------------------------------------------------


def test_slider_crank() -> None:
    result = run(SLIDER)
    bodies = PlanarBodies(
        masses=[3, 1, 2],
        inertias=[0.2, 0.07, 0.1],
        pins=[
            Pin(GROUND, (0, 0), 0, (-0.1, 0)),
            Pin(0, (0.2, 0), 1, (-0.45, 0)),
            Pin(1, (0.45, 0), 2, (0, 0)),
        ],
        slides=[Slide(2, (1, 0))],
        motors=[Motor(GROUND, 0, lambda t, a, w: 5.0)],
        gravity=(0, -9.81),
    )
    crank, rod, slide = result["q"][0]
    angles = [crank, crank + rod, 0.0]
    places = [turned(crank, (0.1, 0)), turned(crank, (0.3, 0)) + turned(angles[1], (0.45, 0)), (slide, 0.0)]
    x = np.concatenate([[*p, a] for p, a in zip(places, angles)])
    eta, _, _ = bodies.constraints(x, np.zeros(9))
    assert np.abs(eta).max() < 1e-12
    moved, _ = bodies.run(x, np.zeros(9), result.time)
    close(result["q"][:, [0, 2]], moved[:, [2, 6]], 1e-8)
    close(result["q"][:, 1], moved[:, 5] - moved[:, 2], 1e-8)
    assert result.summary["constraint_residual"]["position"] < 1e-14
    assert result.summary["energy_drift"] < 1e-8


def test_six_bar_with_two_loops() -> None:
    result = run(SIX_BAR)
    lengths, masses = [0.4, 1.2, 0.9, 1.1, 0.8], [2, 1, 1.5, 1, 1]
    bodies = PlanarBodies(
        masses=masses,
        inertias=[0.05, 0.12, 0.1, 0.1, 0.06],
        pins=[
            Pin(GROUND, (0, 0), 0, (-0.2, 0)),
            Pin(0, (0.2, 0), 1, (-0.6, 0)),
            Pin(GROUND, (1.0, 0), 2, (-0.45, 0)),
            Pin(2, (0.45, 0), 3, (-0.55, 0)),
            Pin(GROUND, (2.1, 0), 4, (-0.4, 0)),
            Pin(1, (0.6, 0), 2, (0.45, 0)),
            Pin(3, (0.55, 0), 4, (0.4, 0)),
        ],
        motors=[Motor(GROUND, 0, lambda t, a, w: 14.0 - 0.5 * w)],
        gravity=(0, -9.81),
    )

    def absolute(q: np.ndarray) -> np.ndarray:
        return np.array([q[0], q[0] + q[1], q[2], q[2] + q[3], q[4]])

    angles = absolute(result["q"][0])
    starts = [np.zeros(2), turned(angles[0], (0.4, 0)), np.array([1.0, 0]), None, np.array([2.1, 0])]
    starts[3] = starts[2] + turned(angles[2], (0.9, 0))
    x = np.concatenate([[*(s + turned(a, (l / 2, 0))), a] for s, a, l in zip(starts, angles, lengths)])
    eta, _, _ = bodies.constraints(x, np.zeros(15))
    assert np.abs(eta).max() < 1e-12
    moved, rates = bodies.run(x, np.zeros(15), result.time)
    close([absolute(q) for q in result["q"]], moved[:, 2::3], 1e-7)
    # the multipliers of our cuts are those of the last two pins
    for k in (0, 10, 20):
        _, lam = bodies.accelerations(result.time[k], moved[k], rates[k])
        close(result["constraints/multipliers"][k], lam[10:], 1e-6)
    assert result.summary["energy_drift"] < 1e-8
    assert result.variables["constraints/multipliers"].names == ("first.x", "first.y", "second.x", "second.y")


BRANCH = """
gravity: [0, -9.81, 0]
robot:
  convention: standard
  joints:
    - {{name: carrier, type: revolute, parent: base, a: 0.5, alpha: 0, d: 0}}
    - {{name: crank, type: revolute, parent: frame, a: 0.3, alpha: 0, d: 0}}
    - {{name: coupler, type: revolute, parent: l1, a: 0.8, alpha: 0, d: 0}}
    - {{name: rocker, type: revolute, parent: frame, a: 0.5, alpha: 0, d: 0, origin: {{xyz: [0.7, 0, 0]}}}}
  links:
    - {{name: frame, mass: 3, com: [0.3, 0, 0], com_frame: joint, inertia: {{zz: 0.4}}}}
    - {{name: l1, mass: 1, com: [0.15, 0, 0], com_frame: joint, inertia: {{zz: 0.02}}}}
    - {{name: l2, mass: 1, com: [0.4, 0, 0], com_frame: joint, inertia: {{zz: 0.06}}}}
    - {{name: l3, mass: 1, com: [0.25, 0, 0], com_frame: joint, inertia: {{zz: 0.03}}}}
loops: [{{name: pin, type: revolute, between: {between}}}]
torques: {{crank: 1.5}}
initial: {{q: {{carrier: -1, crank: 0.8, coupler: -0.3, rocker: 1.2}}, hold: [carrier, crank]}}
simulate: {{duration: 1.5, samples: 16}}
"""


def test_a_loop_inside_a_branch() -> None:
    result = run(BRANCH.format(between="[l2.end, l3.end]"))
    bodies = PlanarBodies(
        masses=[3, 1, 1, 1],
        inertias=[0.4, 0.02, 0.06, 0.03],
        pins=[
            Pin(GROUND, (0, 0), 0, (-0.3, 0)),
            Pin(0, (0.2, 0), 1, (-0.15, 0)),
            Pin(1, (0.15, 0), 2, (-0.4, 0)),
            Pin(0, (0.9, 0), 3, (-0.25, 0)),
            Pin(2, (0.4, 0), 3, (0.25, 0)),
        ],
        motors=[Motor(0, 1, lambda t, a, w: 1.5)],
        gravity=(0, -9.81),
    )
    carrier, crank, coupler, rocker = result["q"][0]
    angles = np.array([carrier, carrier + crank, carrier + crank + coupler, carrier + rocker])
    end = turned(carrier, (0.5, 0))
    places = [
        turned(carrier, (0.3, 0)),
        end + turned(angles[1], (0.15, 0)),
        end + turned(angles[1], (0.3, 0)) + turned(angles[2], (0.4, 0)),
        turned(carrier, (1.2, 0)) + turned(angles[3], (0.25, 0)),
    ]
    x = np.concatenate([[*p, a] for p, a in zip(places, angles)])
    moved, _ = bodies.run(x, np.zeros(12), result.time)
    close(result["q"][:, 0], moved[:, 2], 1e-8)
    close(result["q"][:, 0] + result["q"][:, 3], moved[:, 11], 1e-8)


def test_the_order_of_between_turns_the_multipliers_and_nothing_else() -> None:
    one_way, other_way = (run(BRANCH.format(between=b)) for b in ("[l2.end, l3.end]", "[l3.end, l2.end]"))
    close(one_way["q"], other_way["q"], 1e-9)
    close(one_way["constraints/multipliers"], -other_way["constraints/multipliers"], 1e-7)


def test_bennett_linkage() -> None:
    result = run(BENNETT)
    assembly = result.summary["assembly"]
    assert len(assembly["redundant_rows"]) == 3 and not assembly["vanishing_rows"]
    q = result["q"]
    # Bennett (1903): opposite angles are equal, and neighbours satisfy tan tan = const
    close(q[:, 0] + q[:, 2], 0.0, 1e-12)
    ratio = np.sin((SKEW + TWIST) / 2) / np.sin((SKEW - TWIST) / 2)
    close(np.tan(q[:, 0] / 2) * np.tan(q[:, 1] / 2), ratio, 1e-8)
    assert np.ptp(q[:, 0]) > 1.0 and result.summary["energy_drift"] < 1e-7


def test_what_is_redundant_at_the_start_must_stay_so() -> None:
    """Two cranks of a linkage with one freedom, prescribed so that they fit at the start only."""
    text = BRANCH.format(between="[l2.end, l3.end]").replace("torques: {crank: 1.5}", "")
    fitting = run(text)
    _, crank, coupler, rocker = fitting["q"][0].tolist()
    driven = f"prescribed: {{carrier: -1, crank: {crank!r} + t, rocker: {rocker!r} - 3*t}}\n"
    error = failure(text.split("initial")[0] + driven + "initial: {q: {coupler: " + repr(coupler) + "}}\n")
    assert error.exit_code == 5 and "more than the mechanism can do" in error.message
    assert error.details["residual"] > 1e-3 and error.result.status == "failed"  # type: ignore[attr-defined]
    summary = run(BENNETT).summary
    assert summary["constraint_residual"]["redundant"] < 1e-13


def tilted(tmp_path: Path) -> str:
    """Return an override with the lecture's four-bar in an oblique plane."""
    text = (CONFIGS / "robots" / "four_bar.yaml").read_text()
    text = text.replace("parent: base, a: 1.241", "parent: base, origin: {rpy: [0.5, 0.3, 0]}, a: 1.241")
    foot = np.array([np.cos(0.3), 0, -np.sin(0.3)]) * 1.241
    text = text.replace(
        "origin: {xyz: [1.241, 0, 0]}", f"origin: {{xyz: {foot.tolist()}, rpy: [0.5, 0.3, 0]}}"
    )
    for zz in ("9.6", "0.06"):
        text = text.replace(f"{{zz: {zz}}}", f"{{xx: 0, yy: {zz}, zz: {zz}}}")
    (tmp_path / "tilted.yaml").write_text(text)
    return f"robot={tmp_path}/tilted.yaml"


def test_a_planar_loop_tilted_in_space_moves_as_in_its_plane(tmp_path: Path) -> None:
    overrides = ["simulate.duration=6", "simulate.samples=13"]
    flat = simulate(load_scene(CONFIGS / "four_bar_deploy.yaml", overrides))
    space = simulate(load_scene(CONFIGS / "four_bar_deploy.yaml", [*overrides, tilted(tmp_path)]))
    close(flat["q"], space["q"], 1e-10)
    assert len(space.summary["assembly"]["redundant_rows"]) == 3
    assert len(flat.summary["assembly"]["vanishing_rows"]) == 3
    assert not flat.summary["assembly"]["redundant_rows"] and flat.summary["multipliers"]["unique"]
    # the least multipliers are the force in the plane, and nothing else
    size = np.linalg.norm(flat["constraints/multipliers"], axis=1)
    close(np.linalg.norm(space["constraints/multipliers"], axis=1), size, 1e-8)


@pytest.mark.parametrize("scene", ["four_bar_deploy", "four_bar_prescribed"])
def test_a_planar_loop_tilted_in_space_locks_as_in_its_plane(scene: str, tmp_path: Path) -> None:
    flat = deploy(load_scene(CONFIGS / f"{scene}.yaml")).summary["lock"]
    space = deploy(load_scene(CONFIGS / f"{scene}.yaml", [tilted(tmp_path)])).summary["lock"]
    assert space["kind"] == flat["kind"] == "dead_point"
    close(space["time"], flat["time"], 1e-10)
    close(list(space["angles"].values()), list(flat["angles"].values()), 1e-9)
    if flat["latch"] is not None:
        close(space["latch"]["energy_lost"], flat["latch"]["energy_lost"], 1e-9)
        close(space["latch"]["angular_impulse"], flat["latch"]["angular_impulse"], 1e-9)


@pytest.mark.parametrize("stabilisation", ["none", "{alpha: 10, beta: 10}", "{alpha: 0, beta: 0}"])
def test_stabilisations_give_the_motion_of_projection(stabilisation: str) -> None:
    overrides = ["simulate.duration=10", "simulate.samples=21"]
    scene = CONFIGS / "four_bar_deploy.yaml"
    projected = simulate(load_scene(scene, overrides))
    other = simulate(load_scene(scene, [*overrides, f"simulate.stabilisation={stabilisation}"]))
    close(projected["q"], other["q"], 1e-8)
    assert projected.summary["constraint_residual"]["position"] < 1e-14
    assert other.summary["constraint_residual"]["position"] < 1e-8


def test_drift_of_the_loops_is_reported_where_nothing_holds_them() -> None:
    scene = load_scene(
        CONFIGS / "four_bar_deploy.yaml",
        ["simulate.duration=10", "simulate.rtol=1e-4", "simulate.atol=1e-5", "simulate.stabilisation=none",
         "simulate.integrator=dopri5"],
    )  # fmt: skip
    result = simulate(scene)
    residual = np.abs(result["constraints/position_residual"]).max()
    assert residual > 1e-8
    assert result.summary["constraint_residual"]["position"] == residual


# -- prescribed joints ------------------------------------------------------------------------------------
DRIVEN = """
gravity: [0, -9.81, 0]
robot: {robot}
prescribed: {{theta1: "0.5*sin(2*t) - 1"}}
torques: {{theta2: "3*cos(t)"}}
initial: {{q: {{theta2: 0.3}}}}
simulate: {{duration: 4, samples: 81}}
"""


def test_a_prescribed_joint_follows_and_its_torque_is_that_of_inverse_dynamics() -> None:
    robot = CONFIGS / "robots" / "planar_2r.yaml"
    result = run(DRIVEN.format(robot=robot))
    t = result.time
    close(result["q"][:, 0], 0.5 * np.sin(2 * t) - 1, 1e-13)
    close(result["qd"][:, 0], np.cos(2 * t), 1e-12)
    close(result["qdd"][:, 0], -2 * np.sin(2 * t), 1e-11)
    arm = load_scene_text(f"schema: 1\ngravity: [0, -9.81, 0]\nrobot: {robot}\n")
    tau = InverseDynamics(arm)(result["q"], result["qd"], result["qdd"])
    close(result["tau"], tau, 1e-9)
    close(result["tau"][:, 1], 3 * np.cos(t), 1e-12)
    assert result.summary["energy_drift"] < 1e-8 * np.abs(result["energy/work"]).max()


def test_all_joints_prescribed_is_inverse_dynamics() -> None:
    robot = CONFIGS / "robots" / "planar_2r.yaml"
    text = DRIVEN.format(robot=robot).replace('torques: {theta2: "3*cos(t)"}', "")
    text = text.replace('- 1"}', '- 1", theta2: "0.3 + t"}')
    result = run(text)
    close(result["q"][:, 1], 0.3 + result.time, 1e-13)
    arm = load_scene_text(f"schema: 1\ngravity: [0, -9.81, 0]\nrobot: {robot}\n")
    close(result["tau"], InverseDynamics(arm)(result["q"], result["qd"], result["qdd"]), 1e-9)


@pytest.mark.parametrize(
    ("old", "new", "code", "words"),
    [
        ("{theta2: 0.3}", "{theta1: 0.2, theta2: 0.3}", 2, ("initial.q.theta1", "0.2", "-1")),
        ("0.5*sin(2*t) - 1", "sqrt(t)", 3, ("prescribed.theta1", "rate")),
        ("0.5*sin(2*t) - 1", "1/t", 3, ("prescribed.theta1", "t = 0")),
        ("0.5*sin(2*t) - 1", "t^1.5", 3, ("prescribed.theta1", "acceleration")),
        ("{theta2: 0.3}}", "{theta2: 0.3}, qd: {theta1: 5}}", 5, ("rates", "prescribed.theta1", "rad/s")),
        ("0.5*sin(2*t) - 1", "1/(t - 2)^2", 3, ("t = ",)),
        ("0.5*sin(2*t) - 1", "abs(t - 1)", 2, ("prescribed.theta1", "rate", "t = 1 s", "from -1 to 1")),
        ("0.5*sin(2*t) - 1", "if(t < 1.5, 0, 0.2)", 2, ("prescribed.theta1", "position", "t = 1.5 s")),
        ("0.5*sin(2*t) - 1", "min(t, 3)", 2, ("rate", "t = 3 s")),
    ],
)
def test_prescribed_motion_that_cannot_be(old: str, new: str, code: int, words: tuple[str, ...]) -> None:
    text = DRIVEN.format(robot=CONFIGS / "robots" / "planar_2r.yaml")
    assert text.count(old) == 1
    error = failure(text.replace(old, new), "simulate.max_steps=20000")
    assert error.exit_code == code, error.message
    for word in words:
        assert word in error.message


@pytest.mark.parametrize(
    "motion", ["if(t < 1, 0, (t - 1)^2)", "max(t - 1, 0)^3", "abs(sin(t))^3", "abs(t - 5)"]
)
def test_prescribed_motions_may_have_kinks_in_their_acceleration(motion: str) -> None:
    text = DRIVEN.format(robot=CONFIGS / "robots" / "planar_2r.yaml").replace("0.5*sin(2*t) - 1", motion)
    result = run(text)
    assert result.summary["energy_drift"] < 1e-7 * max(1.0, np.abs(result["energy/work"]).max())
    assert result.summary["error_estimate"]["state_max"] < 1e-8


def test_a_crank_driven_through_the_dead_point_names_it() -> None:
    with pytest.raises(SingularConfigurationError) as caught:
        simulate(load_scene(CONFIGS / "four_bar_prescribed.yaml"))
    error = caught.value
    assert "dead point" in error.message and "theta1" in error.message
    crank = 2 * np.arcsin(1.2 / 1.241)
    assert error.details["time"] == pytest.approx(np.sqrt((crank - 0.01) / 0.02), abs=1e-9)
    result = error.result  # type: ignore[attr-defined]
    assert result.status == "failed" and 11.0 < result.time[-1] <= error.details["time"]
