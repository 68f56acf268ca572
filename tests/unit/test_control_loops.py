"""Controllers of mechanisms with loops: their errors by closed forms, their torques by the singular value
decomposition that ``inverse`` shares loads with, on bodies with full inertias and centres of mass off their axes."""

from __future__ import annotations

from functools import cache, cached_property
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm, solve_continuous_are

from robodyn_cli import load_scene_text, simulate
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import SceneError
from robodyn_cli.ready.prepare import prepare
from robodyn_cli.scene.types import Scene
from robodyn_cli.solve.load_sharing import share
from robodyn_cli.works.inverse import inverse
from tests.mechanisms import BENNETT, SLIDER
from tests.numeric import assert_close

ROBOTS = Path(__file__).parents[2] / "robodyn_cli" / "robots"
KP, KD = 60.0, 11.0


def robot(name: str) -> str:
    """Return the mechanism of a scene, without what moves it."""
    text = (ROBOTS / f"{name}.yaml").read_text("utf-8")
    return "\n".join(line for line in text.splitlines() if not line.startswith("command:"))


class Case:
    """A mechanism, the joints that drive it, and the sizes of their motions.

    more : driven joints beside those that would do.
    """

    def __init__(self, text: str, driven: dict[str, float], more: tuple[str, ...] = ()) -> None:
        self.text, self.driven, self.more = text, driven, more

    @cache  # noqa: B019 - of a few mechanisms that live as long as the tests
    def settings(self) -> list[str]:
        """Return options that give the bodies full inertias, and leave nothing but the controller to move them."""
        scene = load_scene_text(self.text)
        rng = np.random.default_rng(3)
        found = [f"{key}=null" for key in ("trajectory", "torques", "expect", "outputs", "inverse", "prescribed")
                 if f"\n{key}:" in self.text]  # fmt: skip
        for link in scene.robot.links:
            if link.mass:
                own = float(link.mass) * rng.uniform(-0.1, 0.1, (3, 3))
                J = 0.02 * float(link.mass) * np.eye(3) + own @ own.T
                entries = ", ".join(
                    f"{a}{b}: {J['xyz'.index(a), 'xyz'.index(b)]:.9g}"
                    for a, b in ("xx", "yy", "zz", "xy", "xz", "yz")
                )
                found.append(f"robot.links.{link.name}.inertia={{{entries}}}")
                com = (np.array(link.com, dtype=float) + rng.uniform(-0.03, 0.03, 3)).tolist()
                found.append(f"robot.links.{link.name}.com={com}")
        joints = [*self.driven, *self.more]
        return [*found, f"actuated=[{', '.join(joints)}]", "gravity=[0.7, -1.3, -9.5]"]

    def scene(
        self, control: str, duration: float = 0.6, more: tuple[str, ...] = (), estimate: bool = False
    ) -> Scene:
        """Return the mechanism under a controller; ``estimate`` : whether its run is made again for its error."""
        settings = [*self.settings(), *([f"control={control}"] if control else [])]
        estimated = "" if estimate else ", error_estimate: false"
        run = [f"simulate={{duration: {duration}, samples: 61, rtol: 1e-10, atol: 1e-12{estimated}}}"]
        return load_scene_text(self.text, overrides=[*settings, *run, *more])

    @cached_property
    def start(self) -> dict[str, float]:
        """Positions at the start by column."""
        setup = prepare(self.scene(""))
        return dict(zip(setup.problem.model.q_names, setup.assembled.q.tolist()))

    def reference(self, ahead: float = 0.3) -> str:
        """Return a motion of the driven joints, that begins beside the start."""
        start = self.start
        q = ", ".join(
            f"{name}: '{start[name]!r} + {size}*({ahead} + sin({4 + k}*t))'"
            for k, (name, size) in enumerate(self.driven.items())
        )
        return f"{{type: joint, duration: 3, q: {{{q}}}}}"


STEWART = Case(robot("stewart_platform"), {f"slide{k}": 0.01 for k in range(1, 7)})
DELTA = Case(robot("delta"), {f"arm{k}": 0.1 for k in range(1, 4)})
FIVE_BAR = Case(robot("five_bar"), {"left": 0.15, "right": 0.1})
CRANK = Case("schema: 1\n" + SLIDER, {"crank": 0.3})
RING = Case("schema: 1\n" + BENNETT, {"j1": 0.3})
CASES = {"five_bar": FIVE_BAR, "slider": CRANK, "delta": DELTA, "ring": RING, "stewart": STEWART}


def bound(result) -> float:
    return max(1e-12, 30.0 * result.summary["error_estimate"]["state_max"])


class Plain:
    """M, h, tau_f, Psi and gamma of a scene as numbers, and torques by the decomposition of Psi."""

    def __init__(self, scene: Scene) -> None:
        self.problem = problem = Problem(load_scene_text(scene.text, overrides=["control=null"]))
        self.driven = [problem.model.v_names.index(name) for name in scene.control.joints]
        self.passive = sum(problem.passive_forces(smooth=True).values(), np.zeros(problem.model.nv))

    def at(self, entries, q, v):
        return np.array(self.problem.numbers(np.array(entries, dtype=object), q, v=v), dtype=float)

    def parts(self, q, v):
        p = self.problem
        return [self.at(x, q, v) for x in (p.mass_matrix, p.bias - self.passive, p.psi, p.constraints.gamma)]

    def accelerations(self, q, v, wanted):
        """Return the accelerations (nv,) that the loops allow and whose driven entries are nearest to the wanted."""
        _, _, psi, gamma = self.parts(q, v)
        first = -np.linalg.pinv(psi, rcond=1e-9) @ gamma
        N = share(psi[None], self.driven, {"": np.zeros((1, len(v)))}).N[0]
        z = np.linalg.lstsq(N[self.driven], wanted - first[self.driven], rcond=None)[0]
        return first + N @ z

    def torques(self, q, v, wanted):
        M, h, psi, _ = self.parts(q, v)
        load = M @ self.accelerations(q, v, wanted) + h
        return share(psi[None], self.driven, {"": load[None]}).tau[0][self.driven]

    def response(self, q, v):
        """Return A of qdd_d = a_0 + A tau."""
        M, _, psi, _ = self.parts(q, v)
        N = share(psi[None], self.driven, {"": np.zeros((1, len(v)))}).N[0]
        return N[self.driven] @ np.linalg.solve(N.T @ M @ N, N[self.driven].T)


def asked(scene: Scene, result, k: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return error, its rate and the acceleration that computed torque asks for at a sample."""
    names = result.variables["q"].names
    own = scene.control.reference.motion(result.time, scene.control.joints, {})
    places = [names.index(name) for name in scene.control.joints]
    rates = [result.variables["qd"].names.index(name) for name in scene.control.joints]
    e, ed = own.q[k] - result["q"][k, places], own.qd[k] - result["qd"][k, rates]
    return e, ed, own.qdd[k] + KP * e + KD * ed


@pytest.mark.parametrize("name", CASES)
def test_computed_torque_leaves_linear_errors_of_the_driven_joints(name: str) -> None:
    case = CASES[name]
    scene = case.scene(
        f"{{type: computed_torque, reference: {case.reference()}, gains: {{kp: {KP}, kd: {KD}}}}}",
        estimate=True,
    )
    result = simulate(scene)
    A = np.array([[0.0, 1.0], [-KP, -KD]])
    for k, (size, error) in enumerate(zip(case.driven.values(), result["control/error"].T)):
        start = np.array([0.3 * size, (4 + k) * size])
        exact = np.array([(expm(A * t) @ start)[0] for t in result.time])
        assert_close(error, exact, bound(result))


@pytest.mark.parametrize("name", ["five_bar", "delta", "ring"])
def test_a_payload_that_the_model_does_not_know(name: str) -> None:
    """e'' + kd e' + kp e = A (tau that the payload needs - tau that it gets), A from another way than the law's."""
    case = CASES[name]
    link = {"five_bar": "arm_left", "delta": "platform", "ring": "l2"}[name]
    scene = case.scene(
        f"{{type: computed_torque, reference: {case.reference()}, gains: {{kp: {KP}, kd: {KD}}}, "
        f"model: {{set: {{robot.links.{link}.mass: 0.3}}}}}}"
    )
    result = simulate(scene)
    assert np.abs(result["control/error"][-1]).max() > 1e-4
    plant = Plain(scene)
    model = Plain(load_scene_text(scene.text, overrides=[f"robot.links.{link}.mass=0.3"]))
    places = [result.variables["qdd"].names.index(joint) for joint in scene.control.joints]
    for k in range(0, 61, 12):
        q, v = result["q"][k], result["qd"][k]
        e, ed, wanted = asked(scene, result, k)
        given = model.torques(q, v, wanted)
        assert_close(result["control/torque"][k], given, 1e-8)
        own = scene.control.reference.motion(result.time, scene.control.joints, {}).qdd[k]
        error = own - result["qdd"][k, places] + KD * ed + KP * e
        expected = plant.response(q, v) @ (plant.torques(q, v, wanted) - given)
        assert_close(error, expected, 1e-6)


@pytest.mark.parametrize("period", [None, 0.01])
@pytest.mark.parametrize("law", ["computed_torque", "gravity"])
def test_more_joints_than_freedoms_share_a_load_by_least_norm(law: str, period: float | None) -> None:
    case = Case(FIVE_BAR.text, FIVE_BAR.driven, ("bend_left",))
    keys = "" if period is None else f"period: {period}, "
    start = case.start
    hold = ", ".join(f"{name}: {start[name] + 0.02!r}" for name in ("left", "right", "bend_left"))
    still = f"{{type: joint, duration: 3, q: {{{hold}}}}}"
    scene = case.scene(f"{{type: {law}, {keys}reference: {still}, gains: {{kp: {KP}, kd: {KD}}}}}")
    result = simulate(scene)
    plant = Plain(scene)
    for k in range(0, 60, 10):
        q, v = result["q"][k], result["qd"][k]
        e, ed, wanted = asked(scene, result, k)
        if law == "gravity":
            load = plant.at(plant.problem.bias, q, 0.0 * v)
            psi = plant.parts(q, v)[2]
            expected = share(psi[None], plant.driven, {"": load[None]}).tau[0][plant.driven]
            expected = expected + KP * e + KD * ed
        else:
            expected = plant.torques(q, v, wanted)
        assert_close(result["control/torque"][k], expected, 1e-8)


@pytest.mark.parametrize("name", ["five_bar", "delta", "ring"])
def test_gravity_is_held_in_any_pose(name: str) -> None:
    case = CASES[name]
    result = simulate(case.scene("{type: gravity}"))
    assert np.abs(result["qd"]).max() < 1e-9
    assert np.abs(result["control/torque"]).max() > 0.1


@pytest.mark.parametrize("name", ["five_bar", "delta", "ring"])
def test_feed_forward_is_the_inverse_and_moves_as_the_reference(name: str) -> None:
    case = CASES[name]
    motion = case.reference(0.0)
    until = (
        "trajectory.duration=0.4",
        "command=inverse",
        "inverse={samples: 41}",
    )  # as long as it is followed
    torques = inverse(case.scene("", more=(f"trajectory={motion}", *until)))
    names = torques.variables["qd"].names
    driven = [names.index(joint) for joint in case.driven]
    rates = ", ".join(f"{joint}: {x!r}" for joint, x in zip(case.driven, torques["qd"][0, driven].tolist()))
    scene = case.scene(
        f"{{type: feed_forward, reference: {motion}}}",
        0.4,
        (f"initial.qd={{{rates}}}", "simulate.samples=41"),
        estimate=True,
    )
    result = simulate(scene)
    assert np.abs(result["control/error"]).max() < bound(result) + 1e-9
    assert_close(result["control/torque"], torques["tau"][:, driven], 1e-7)


def test_a_point_of_a_mechanism_is_led_by_the_driven_joints_or_by_a_force() -> None:
    circle = "{type: circle, point: tip, center: [0.3, 0.9], radius: 0.1, duration: 3}"
    scene = FIVE_BAR.scene(f"{{type: task_pd, reference: {circle}, gains: {{kp: 900, kd: 60}}}}")
    result = simulate(scene)
    plant = Plain(scene)
    tip = plant.problem.world_point(plant.problem.model.place("tip"))
    for k in range(0, 61, 15):
        q, v = result["q"][k], result["qd"][k]
        h = 1e-6
        J = np.array(
            [(plant.at(tip, q + h * u, v) - plant.at(tip, q - h * u, v)) / (2 * h) for u in np.eye(4)]
        ).T
        phi = 2.0 * np.pi * result.time[k] / 3.0
        wanted = np.array([0.3 + 0.1 * np.cos(phi), 0.9 + 0.1 * np.sin(phi)])
        rate = 0.1 * 2.0 * np.pi / 3.0 * np.array([-np.sin(phi), np.cos(phi)])
        force = 900.0 * (wanted - plant.at(tip, q, v)[:2]) + 60.0 * (rate - (J @ v)[:2])
        load = J[:2].T @ force + plant.at(plant.problem.bias, q, 0.0 * v)
        psi = plant.parts(q, v)[2]
        expected = share(psi[None], plant.driven, {"": load[None]}).tau[0][plant.driven]
        assert_close(result["control/torque"][k], expected, 1e-6)
    by_joints = FIVE_BAR.scene(
        f"{{type: computed_torque, reference: {circle}, gains: {{kp: 400, kd: 40}}}}", 1.5
    )
    found = simulate(by_joints)
    phi = 2.0 * np.pi * found.time[-1] / 3.0
    assert_close(found["points/tip"][-1, :2], [0.3 + 0.1 * np.cos(phi), 0.9 + 0.1 * np.sin(phi)], 1e-6)


def test_a_platform_leads_the_arms_that_drive_it() -> None:
    """The reference is the motion of the platform of a delta robot, whose arms are driven."""
    motion = "{type: joint, duration: 3, q: {x: '0.02*sin(3*t)', y: '0.03*t', z: '-0.774 + 0.02*t^2'}}"
    scene = DELTA.scene(f"{{type: computed_torque, reference: {motion}, gains: {{kp: 900, kd: 60}}}}", 0.6)
    result = simulate(scene)
    names, t = result.variables["q"].names, result.time[-1]
    wanted = [0.02 * np.sin(3 * t), 0.03 * t, -0.774 + 0.02 * t**2]
    assert np.abs(result["q"][-1, [names.index(x) for x in "xyz"]] - wanted).max() < 1e-5
    assert {"arm1", "x", "elbow1.theta1"} <= set(result.variables["control/error"].names)


def test_sampled_laws_use_the_rows_that_the_motion_uses() -> None:
    """Rows of a ring depend on each other; combinations of them are chosen anew while it turns."""
    control = f"{{type: computed_torque, period: 0.001, reference: {RING.reference()}, gains: {{kp: {KP}, kd: {KD}}}}}"
    scene = RING.scene(control)
    result = simulate(scene)
    plant = Plain(scene)
    for k in range(0, 61, 15):
        _, _, wanted = asked(scene, result, k)
        expected = plant.torques(result["q"][k], result["qd"][k], wanted)
        assert_close(result["control/torque"][k], expected, 1e-8)


def test_the_regulator_of_a_parallelogram_is_that_of_a_pendulum() -> None:
    """Upright: (J_1 + J_2 + m a^2) x'' = g (m_1 c_1 + m_2 c_2 + m a) x + u; the coupler only moves along."""
    text = """\
schema: 1
gravity: [0, -9.81, 0]
robot:
  convention: standard
  joints:
    - {name: one, type: revolute, parent: base, a: 0.7, alpha: 0, d: 0}
    - {name: bar, type: revolute, parent: crank, a: 2.0, alpha: 0, d: 0}
    - {name: two, type: revolute, parent: base, origin: {xyz: [2.0, 0, 0]}, a: 0.7, alpha: 0, d: 0}
  links:
    - {name: crank, mass: 1.1, com: [0.3, 0, 0], com_frame: joint, inertia: {zz: 0.09}}
    - {name: coupler, mass: 2.3, com: [0.9, 0.2, 0], com_frame: joint, inertia: {zz: 0.8}}
    - {name: follower, mass: 0.6, com: [0.4, 0, 0], com_frame: joint, inertia: {zz: 0.05}}
loops: [{name: pin, type: revolute, between: [coupler.end, follower.end]}]
actuated: [one]
initial: {q: {one: 1.5, bar: -1.5, two: 1.5}, hold: [one]}
"""
    weights = "q: {one: 5, two: 3, bar: 2}, qd: {one: 1, two: 2}, tau: 0.1"
    scene = load_scene_text(
        f"{text}control: {{type: lqr, pose: {{one: 90 deg}}, gains: {{{weights}}}}}\n"
        "simulate: {duration: 2, samples: 101}\n"
    )
    result = simulate(scene)
    inertia = 0.09 + 1.1 * 0.3**2 + 0.05 + 0.6 * 0.4**2 + 2.3 * 0.7**2
    weight = 9.81 * (1.1 * 0.3 + 0.6 * 0.4 + 2.3 * 0.7)
    A, B = np.array([[0.0, 1.0], [weight / inertia, 0.0]]), np.array([[0.0], [1.0 / inertia]])
    P = solve_continuous_are(A, B, np.diag([5.0 + 3.0 + 2.0, 1.0 + 2.0]), np.array([[0.1]]))
    K = (B.T @ P)[0] / 0.1
    x, xd = result["q"][:, 0] - np.pi / 2, result["qd"][:, 0]
    assert_close(result["control/torque"][:, 0], -K[0] * x - K[1] * xd, 1e-7)
    assert abs(x[-1]) < 0.02 * abs(x[0])


def test_a_platform_is_regulated_about_its_pose() -> None:
    scene = STEWART.scene("{type: lqr, gains: {q: 1e4, qd: 100, tau: 0.01}}", 1.5)
    result = simulate(scene)
    assert np.abs(result["qd"]).max() < 1e-7
    moved = STEWART.scene(
        "{type: lqr, gains: {q: 1e4, qd: 100, tau: 0.01}}", 1.5, ("initial.qd={slide1: 0.05, slide4: -0.03}",)
    )
    result = simulate(moved)
    assert np.abs(result["qd"][-1]).max() < 0.05 * np.abs(result["qd"][0]).max()


@pytest.mark.parametrize("law", ["computed_torque", "gravity", "feed_forward", "task_pd"])
def test_too_few_driven_joints_are_refused(law: str) -> None:
    case = Case(FIVE_BAR.text, {"left": 0.1})
    own = "{type: circle, point: tip, center: [0.3, 0.9], radius: 0.1, duration: 3}"
    more = "" if law == "gravity" else f", reference: {own}"
    with pytest.raises(
        SceneError, match="2 degrees of freedom, and at the start the driven joints .left. command 1"
    ):
        simulate(case.scene(f"{{type: {law}, gains: {{kp: 1}}{more}}}"))
