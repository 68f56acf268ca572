"""Singular configurations that are passed: the motion keeps its branch, with any method, or the run says why not."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from robodyn_cli import load_scene, load_scene_text, simulate
from robodyn_cli.errors import SingularConfigurationError
from robodyn_cli.motion.build import build_motion
from robodyn_cli.motion.driver import Driver
from robodyn_cli.spatial.algebra import rotation_rpy
from tests.mechanisms import CONFIGS, close
from tests.windows import windows

DOUBLE = CONFIGS / "benchmarks" / "four_bar_n2.yaml"
AT_5 = -15.08355715985858581  # theta of the reference (80-bit Taylor integration)
SHORT = ["simulate.duration=5", "simulate.samples=501", "simulate.error_estimate=false"]


@pytest.mark.parametrize(
    ("method", "rtol", "tolerance"),
    [
        ("gauss", 1e-6, 1e-5),
        ("gauss", 1e-12, 1e-9),
        ("dop853", 1e-12, 1e-9),
        ("dopri5", 1e-12, 1e-7),
        ("rodas5p", 1e-8, 1e-4),
    ],
)
def test_the_double_four_bar_stays_a_parallelogram(method: str, rtol: float, tolerance: float) -> None:
    found = simulate(load_scene(DOUBLE, [*SHORT, f"simulate.integrator={method}", f"simulate.rtol={rtol}"]))
    q = found["q"]
    close(q[-1, 0], AT_5, tolerance)
    close(np.sin((q[:, [0, 0]] - q[:, [2, 4]]) / 2), 0.0, 1e-12)
    # all bars horizontal: the leg's angle there is a multiple of pi
    passed = found.summary["passed"]
    assert len(passed) == 5
    legs = np.interp(passed, found["time"], q[:, 0]) / np.pi
    close(legs, np.round(legs), 1e-3)
    residual = found.summary["constraint_residual"]
    assert residual["position"] < 1e-12 and residual["velocity"] < 1e-11


def test_an_overconstrained_one_passes_too() -> None:
    """The same mechanism in an oblique plane, where three rows of each pin are redundant."""
    rpy = (0.4, -0.7, 1.1)
    R = np.array(rotation_rpy(rpy), dtype=float)
    text = DOUBLE.read_text()
    for k in (1, 2):
        place = f"origin: {{xyz: {(R @ [k, 0, 0]).tolist()}, rpy: {list(rpy)}}}"
        text = text.replace(f"origin: {{xyz: [{k}, 0, 0]}}", place)
    text = text.replace(
        "leg0, type: revolute, parent: base,",
        f"leg0, type: revolute, parent: base, origin: {{rpy: {list(rpy)}}},",
    )
    text = text.replace("[0, -9.81, 0]", str((R @ [0, -9.81, 0]).tolist()))
    text = text.replace("{zz: 1/12}", "{xx: 0, yy: 1/12, zz: 1/12}")
    found = simulate(load_scene_text(text, overrides=SHORT))
    assert not found.summary["multipliers"]["unique"] and len(found.summary["passed"]) == 5
    close(found["q"][-1, 0], AT_5, 1e-8)


def test_work_is_carried_over_the_pose() -> None:
    """The parallelogram of the crank's torque: [2/3 + 2] theta'' = 1 exactly, through its flat poses."""
    scene = load_scene(CONFIGS / "parallelogram.yaml", ["simulate.singular=pass", "simulate.duration=8"])
    found = simulate(scene)
    t = found["time"]
    inertia = 2 / 3 + 2.0
    close(found["q"][:, 0], np.pi / 6 + t**2 / (2 * inertia), 1e-8)
    close(found["energy/work"], t**2 / (2 * inertia), 1e-8)
    assert len(found.summary["passed"]) == 3
    assert found.summary["error_estimate"]["state_max"] < 1e-7


def test_a_pose_that_is_only_near_is_not_stepped_over() -> None:
    """A coupler a little longer than the ground: the four-bar comes near its flat pose, and no more."""
    text = (CONFIGS / "parallelogram.yaml").read_text().replace("a: 2.0,", "a: 2.002,")
    text = text.replace("phi2: -30 deg, phi1: 30 deg", "phi2: -30.1 deg, phi1: 30.1 deg")
    found = simulate(load_scene_text(text, overrides=["simulate.singular=pass", "simulate.duration=3.9"]))
    sigma = found["singularity/psi"]
    assert (sigma[:, -1] / sigma[:, 0]).min() < 0.05
    assert found.summary["passed"] == []
    assert found.summary["energy_drift"] < 1e-7


def parallelogram(count: int, times: NDArray[np.float64], speed: float = -1.0) -> NDArray[np.float64]:
    """Return the angle of the legs of ``count`` square windows that stay parallelograms, from one equation."""
    pull = 9.81 * ((count + 1) / 2 + count) / ((count + 1) / 3 + count)
    motion = solve_ivp(
        lambda t, y: [y[1], -pull * np.cos(y[0])], (0.0, times[-1]), [np.pi / 2, speed],
        method="DOP853", rtol=3e-14, atol=1e-15, t_eval=times,
    )  # fmt: skip
    found: NDArray[np.float64] = motion.y[0]
    return found


@pytest.mark.parametrize(("count", "speed"), [(1, -2.0), (4, -1.0), (7, -0.5)])
def test_any_number_of_windows_passes_its_flat_poses(count: int, speed: float) -> None:
    """As many constraint directions vanish there as there are windows, and the multipliers have a pole."""
    found = simulate(load_scene_text(windows(count, speed=speed, duration=6.0, samples=601)))
    exact = parallelogram(count, found["time"], speed)
    error = np.abs(found["q"][:, 0] - exact).max()
    assert error < 1e-8
    assert 0.1 * error < found.summary["error_estimate"]["q_max"] < 1e-6
    assert len(found.summary["passed"]) == len(np.flatnonzero(np.diff(np.floor(exact / np.pi))))
    for k in range(1, count + 1):
        close(np.sin((found["q"][:, 0] - found["q"][:, 2 * k]) / 2), 0.0, 1e-9)
    assert found.summary["energy_drift"] < 1e-6


@pytest.mark.parametrize("singular", ["pass", "stop"])
@pytest.mark.parametrize("rpy", [(0.0, 0.0, 0.0), (0.4, -0.7, 1.1)])
def test_a_look_ahead_hears_of_no_events(rpy: tuple[float, float, float], singular: str) -> None:
    """In an oblique plane rows are redundant, and combinations of them are chosen anew by events of their own.

    An owner that was asked on such a way ended it there, so that samples before the pose were those of another time.
    """
    motion = build_motion(load_scene_text(windows(1, rpy=rpy, singular=singular)))
    driver = Driver.of(motion)
    driver.start(0.0, motion.start)
    fine = np.linspace(0.0, 2.0, 20001)
    before = float(fine[np.flatnonzero(parallelogram(1, fine) < 0.01)[0]])
    driver.advance(before)
    assert driver.time == before
    close(motion.system.split(driver.state)[0][0], parallelogram(1, np.array([0.0, before]))[-1], 1e-8)


@pytest.mark.parametrize("count", [1, 5, 6, 7])
def test_a_run_that_is_to_stop_stops_at_the_first_flat_pose(count: int) -> None:
    with pytest.raises(SingularConfigurationError, match="bifurcation at") as caught:
        simulate(load_scene_text(windows(count, singular="stop")))
    time = caught.value.details["time"]
    close(parallelogram(count, np.array([0.0, time]))[-1], 0.0, 1e-8)
    assert (f"in {count} directions" in caught.value.message) == (count > 1)


@pytest.mark.parametrize("count", [1, 3])
@pytest.mark.parametrize(
    "change", [{}, {"damping": 0.3}, {"rpy": (0.4, -0.7, 1.1)}, {"bob": True, "damping": 0.2}]
)
def test_windows_unlike_each_other_pass_on_a_curved_branch(count: int, change: dict[str, Any]) -> None:
    """No closed form: the run and a second one with other nodes agree, and energy is balanced."""
    rng = np.random.default_rng(count)
    legs, bars = rng.uniform(0.8, 1.2, count + 1).tolist(), rng.uniform(0.9, 1.1, count).tolist()
    text = windows(count, legs, bars, start=0.5, speed=-3.0, duration=0.5, samples=51, **change)
    found = simulate(load_scene_text(text))
    assert len(found.summary["passed"]) == 1
    assert found.summary["error_estimate"]["state_max"] < 1e-7
    assert found.summary["energy_drift"] < 1e-8
    assert found.summary["constraint_residual"]["position"] < 1e-12


@pytest.mark.parametrize("excess", [1e-3, 1e-5, 1e-7])
@pytest.mark.parametrize("singular", ["pass", "stop"])
def test_a_pose_that_keeps_its_rank_is_neither_passed_nor_a_stop(excess: float, singular: str) -> None:
    text = windows(1, bars=[1.0 + excess], ground=1.0, duration=3.0, singular=singular)
    found = simulate(load_scene_text(text, overrides=["simulate.error_estimate=false"]))
    assert found.summary.get("passed", []) == []
    assert found.summary["energy_drift"] < 1e-6


def test_windows_that_cannot_lie_flat_together_are_refused() -> None:
    """One bar a little long: the others would have to bifurcate inside its corner."""
    text = windows(4, bars=[1.0 + 1e-5, 1.0, 1.0, 1.0], ground=1.0)
    with pytest.raises(SingularConfigurationError, match=r"w0, w1, w2, w3 .* cannot be passed") as caught:
        simulate(load_scene_text(text))
    assert caught.value.exit_code == 4
    assert 0.5 < caught.value.details["time"] < 0.8


class TestContactsBesideThePose:
    """A parallelogram of rods of length 1 that swings through its flat pose, with contacts on the way.

    All legs turn by theta, so J theta'' = tau; the pose lies at theta = 0.
    """

    J = 2 * (1.0 / 3.0) + 1.0  # two legs about their pivots, and a coupler of 1 kg that moves on a circle
    TEXT = """\
schema: 1
gravity: [0, 0, 0]
robot:
  joints:
    - {name: left, type: revolute, parent: base, axis: [0, 0, 1]}
    - {name: bar, type: revolute, axis: [0, 0, 1], origin: {xyz: [1, 0, 0]}}
    - {name: right, type: revolute, parent: base, axis: [0, 0, 1], origin: {xyz: [0.7, 0, 0]}}
  links:
    - {name: l1, mass: 1, com: [0.5, 0, 0], inertia: {zz: 1/12}}
    - {name: l2, mass: 1, com: [0.35, 0, 0], inertia: {zz: 0.02}}
    - {name: l3, mass: 1, com: [0.5, 0, 0], inertia: {zz: 1/12}}
  points: {joint: {link: l2, at: [0.7, 0, 0]}, tip: {link: l3, at: [1, 0, 0]}}
loops: [{name: pin, type: revolute, between: [joint, tip]}]
initial: {q: {left: 1, bar: -1, right: 1}, qd: {left: -1, bar: 1, right: -1}}
simulate: {duration: 2.5, samples: 51, singular: pass, rtol: 1e-9, atol: 1e-11}
"""

    def run(self, *options: str) -> Any:
        return simulate(load_scene_text(self.TEXT, overrides=options))

    def test_friction_slips_through_the_pose_and_holds_later(self) -> None:
        level = 0.5
        found = self.run(f"robot.joints.right.friction={{law: set_valued, coulomb: {level}}}")
        slowing = level / self.J
        t = np.minimum(found.time, 1.0 / slowing)
        theta = 1.0 - t + 0.5 * slowing * t * t
        assert theta[-1] < 0.0 and len(found.summary["passed"]) == 1
        close(found["q"][:, 0], theta, 1e-9)
        close(found["q"][:, 2], theta, 1e-9)
        assert np.abs(found["q"][:, 0] - theta).max() < 10.0 * found.summary["error_estimate"]["state_max"]

    @pytest.mark.parametrize("stop", [-0.4, -0.05, -0.01, -0.002])
    def test_a_stop_behind_the_pose_is_met(self, stop: float) -> None:
        e = 0.6
        found = self.run(f"robot.joints.right.limits={{lower: {stop}, stop: {{restitution: {e}}}}}")
        hit = 1.0 - stop
        theta = np.where(found.time < hit, 1.0 - found.time, stop + e * (found.time - hit))
        close(found["q"][:, 0], theta, 1e-6)

    def test_a_stop_in_the_pose_is_refused(self) -> None:
        with pytest.raises(SingularConfigurationError, match=r"stop lower right .* too close to the pose"):
            self.run("robot.joints.right.limits={lower: 0, stop: {restitution: 0.6}}")
