"""Linear models: against neighbouring motions, closed forms and python-control."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from robodyn_cli import Mechanism, linearise, load_scene, load_scene_text, simulate, statics
from robodyn_cli.errors import CapabilityError, SceneError
from robodyn_cli.model.manifold import Manifold
from robodyn_cli.report.plots.linear import number_phases
from robodyn_cli.scene.types import Scene
from robodyn_cli.works.linearise.linearise import slowest_first
from tests.numeric import assert_close

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
PENDULUM = CONFIGS / "double_pendulum.yaml"
FOUR_BAR = CONFIGS / "benchmarks/drake_four_bar.yaml"
PASSIVE = (
    "schema: 1\ngravity: [0, -9.81, 0]\nrobot:\n  joints:\n"
    "    - {name: a, type: revolute, axis: [0, 0, 1], link: one}\n"
    "    - {name: b, type: revolute, axis: [0, 0, 1], parent: base, origin: {xyz: [3, 0, 0]}, link: two}\n"
    "  links:\n"
    "    - {name: one, mass: 2, com: [0, -0.5, 0], inertia: {zz: 0.1}}\n"
    "    - {name: two, mass: 1, com: [0, -0.8, 0], inertia: {zz: 0.2}}\n"
    "actuated: [a]\ninitial: {q: {a: 0, b: 0}}\n"
)
BALL = (
    "schema: 1\ngravity: [0.5, -9, 2]\nrobot:\n  joints:\n"
    "    - {name: a, type: revolute, axis: [0, 0, 1], link: one}\n"
    "    - {name: b, type: spherical, parent: one, origin: {xyz: [0.4, 0.1, 0]}, link: two}\n"
    "  links:\n"
    "    - {name: one, mass: 2, com: [0.2, 0.05, 0.1], inertia: {xx: 0.02, yy: 0.03, zz: 0.035, xy: 0.002, xz: 0.001,"
    " yz: -0.003}}\n"
    "    - {name: two, mass: 1, com: [0.1, -0.2, 0.05], inertia: {xx: 0.01, yy: 0.015, zz: 0.012, xy: -0.001}}\n"
    "torques: {a: 2*sin(3*t) - 4*q.a - 0.3*qd.a}\n"
    "initial: {q: {a: 0.3, b: {qw: 0.8, qx: 0.36, qy: -0.48, qz: 0}}, qd: {a: 1, b: {wx: 2, wy: -1, wz: 3}}}\n"
)


def moved(scene: Scene, q: dict[str, float], qd: dict[str, float], hold: tuple[str, ...]) -> Scene:
    initial = dataclasses.replace(scene.initial, q=q, qd=qd, hold=hold)
    return dataclasses.replace(scene, initial=initial)


def with_run(scene: Scene, duration: float, samples: int) -> Scene:
    run = dataclasses.replace(
        scene.simulate, duration=duration, samples=samples, rtol=1e-13, atol=1e-14, error_estimate=False
    )
    return dataclasses.replace(scene, simulate=run, command="simulate")


@pytest.mark.parametrize(
    ("scene", "duration", "samples"),
    [
        (load_scene(PENDULUM), 1.0, 201),
        (load_scene_text(BALL), 0.5, 201),
        (load_scene(CONFIGS / "tumbling_body.yaml"), 0.5, 201),
        (load_scene(FOUR_BAR), 0.5, 201),
        (load_scene(CONFIGS / "benchmarks/spatial_slider_crank.yaml"), 0.5, 2001),
    ],
    ids=("open", "ball", "floating", "loop", "spatial loop"),
)
def test_neighbouring_motions(scene: Scene, duration: float, samples: int) -> None:
    """Motions beside one of ``simulate`` differ from it by what A along it says: x-dot = A(t) x."""
    manifold = Manifold(Mechanism(scene)._problem.model)
    scene = with_run(scene, duration, samples)
    result = linearise(scene, about="motion")
    states = [s["name"] for s in result.summary["states"]]
    n = len(states) // 2
    A, h = result["linear/A"], result.time[2] - result.time[0]
    q_names, v_names = result.variables["q"].names, result.variables["qd"].names
    places = [v_names.index(name) for name in states[:n]]
    closed = bool(scene.loops or scene.couplers)
    for k in range(2 * n):
        x = np.eye(2 * n)[k]
        for i in range(0, len(A) - 1, 2):  # Runge and Kutta over two samples
            k1 = A[i] @ x
            k2 = A[i + 1] @ (x + 0.5 * h * k1)
            k3 = A[i + 1] @ (x + 0.5 * h * k2)
            k4 = A[i + 2] @ (x + h * k3)
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        ends = []
        for side in (1e-5, -1e-5):
            step, rates = np.zeros(len(v_names)), result["qd"][0].copy()
            if k < n:
                step[places[k]] = side
            else:
                rates[places[k - n]] += side
            q = manifold.integrate(result["q"][0], step)
            if closed:
                names = states[:n]
                there = moved(
                    scene,
                    dict(zip(q_names, q.tolist())),
                    {s: rates[v_names.index(s)] for s in names},
                    tuple(names),
                )
            else:
                there = moved(scene, dict(zip(q_names, q.tolist())), dict(zip(v_names, rates.tolist())), ())
            ends.append(simulate(there))
        dq = manifold.difference(result["q"][-1], ends[0]["q"][-1]) - manifold.difference(
            result["q"][-1], ends[1]["q"][-1]
        )
        dv = ends[0]["qd"][-1] - ends[1]["qd"][-1]
        found = np.concatenate([dq[places], dv[places]]) / 2e-5
        assert_close(x, found, 3e-6)


@pytest.mark.parametrize(("path", "name"), [(PENDULUM, "theta1"), (FOUR_BAR, "")])
def test_inputs_are_torques(path: Path, name: str) -> None:
    """B is the change of the accelerations that ``simulate`` begins with, by a torque of 1."""
    scene = load_scene(path)
    name = name or next(iter(scene.torques), "") or scene.robot.joints[0].name
    result = linearise(scene, inputs=[name])
    states = [s["name"] for s in result.summary["states"]]
    n = len(states) // 2
    found = []
    for torque in (1.0, -1.0):
        changed = load_scene(path, [f"torques.{name}={torque}"])
        run = simulate(with_run(changed, 1e-3, 2))
        found.append(dict(zip(run.variables["qdd"].names, run["qdd"][0])))
    for k, state in enumerate(states[:n]):
        assert result["linear/B"][n + k, 0] == pytest.approx(
            (found[0][state] - found[1][state]) / 2, rel=1e-8
        )
    assert not result["linear/B"][:n].any() and not result["linear/D"].any()


def test_frequencies_of_a_double_pendulum() -> None:
    """About rest M x-ddot + K x = 0 in closed form, with the lecture's arm: K = g of the masses' levers."""
    scene = load_scene(PENDULUM)
    result = linearise(scene, about="balance")
    one, two = scene.robot.links
    assert one.mass and two.mass and one.com and two.com
    m1, m2, I1, I2 = one.mass, two.mass, one.inertia.zz, two.inertia.zz
    assert I1 and I2
    l1 = 1.0
    # distances of the centres of mass from their joints, from the poses that robodyn finds
    m = Mechanism(scene)
    q = np.array([[0.0, 0.0]])
    r1 = float(m.forward_kinematics("link1.com", q)[0][0, 0])
    r2 = float(m.forward_kinematics("link2.com", q)[0][0, 0]) - l1
    g = 9.81
    M = np.array(
        [
            [I1 + m1 * r1**2 + I2 + m2 * (l1 + r2) ** 2, I2 + m2 * r2 * (l1 + r2)],
            [I2 + m2 * r2 * (l1 + r2), I2 + m2 * r2**2],
        ]
    )
    K = g * np.array([[m1 * r1 + m2 * (l1 + r2), m2 * r2], [m2 * r2, m2 * r2]])
    expected = np.sqrt(np.sort(np.linalg.eigvals(np.linalg.solve(M, K)).real))
    modes = result.summary["modes"]
    assert_close([mode["imaginary"] for mode in modes], expected, 1e-12)
    for mode, exact in zip(modes, expected):
        assert abs(mode["imaginary"] - exact) <= mode["error"] < 1e-10
    assert all(mode["real"] == 0.0 and mode["reached"] and mode["shown"] for mode in modes)
    assert result.summary["stability"] == "marginal" and "warnings" not in result.summary


def test_python_control_has_the_same_poles_and_response() -> None:
    control = pytest.importorskip("control")
    scene = load_scene(PENDULUM, ["robot.joints.0.damper={damping: 3}", "robot.joints.1.damper={damping: 2}"])
    result = linearise(scene, about="balance", inputs=["theta1"], outputs=["theta2", "qd.theta1", "tip"])
    system = control.ss(*(result[f"linear/{name}"] for name in "ABCD"))
    assert [s["name"] for s in result.summary["measured"]] == [
        "theta2",
        "qd.theta1",
        "tip.x",
        "tip.y",
        "tip.z",
    ]
    poles = result["linear/poles_real"] + 1j * result["linear/poles_imaginary"]
    assert_close(np.abs(np.sort_complex(system.poles()) - poles), np.zeros(4), 1e-9, 1.0)
    w = result["linear/frequency"][::40]
    response = (result["linear/response_real"] + 1j * result["linear/response_imaginary"])[::40, :, 0]
    expected = system(1j * w)[:, 0].T
    assert_close(
        np.abs(response - expected), np.zeros_like(w[:, None] * expected.real), 1e-9, np.abs(expected).max()
    )
    frequencies, damping, _ = control.damp(system, doprint=False)
    modes = result.summary["modes"]
    assert_close(
        sorted({round(2 * np.pi * m["frequency"], 9) for m in modes}),
        sorted({round(f, 9) for f in frequencies}),
        1e-8,
    )
    assert result.summary["stability"] == "stable" and min(damping) > 0


def test_points_move_by_their_jacobians() -> None:
    result = linearise(load_scene(PENDULUM), outputs=["tip"])
    m = Mechanism(load_scene(PENDULUM))
    J = m.jacobian("tip", result["q"][0])[3:]
    assert_close(result["linear/C"], np.concatenate([J, 0 * J], axis=1), 1e-14)


SIGNALS = (
    'outputs.signals={one: {value: "sin(q.a)*qd.b.wx + 0.3*tau.a*qd.a", unit: W}, two: "length(tip, base.origin)",'
    ' three: "tau.a - 2*q.a"}'
)


@pytest.mark.parametrize("about", ["state", "motion"])
def test_outputs_by_formulas(about: str) -> None:
    """C and D of signals against their values at neighbouring states and torques; torques have formulas of their own."""
    scene = load_scene_text(
        BALL.replace("torques:", "  points: {tip: {link: two, at: [0.1, 0.2, 0.3]}}\ntorques:")
        + "simulate: {duration: 0.1, samples: 3}\n",
        overrides=[SIGNALS],
    )
    found = linearise(scene, about=about, outputs=["one", "a", "two", "three"])
    model = Mechanism(scene)._problem
    manifold, names = Manifold(model.model), model.model.v_names
    step = 1e-6

    def signals(q: np.ndarray, v: np.ndarray, t: float, u: np.ndarray) -> np.ndarray:
        tau = dict(zip(names, u))
        tau["a"] += 2 * np.sin(3 * t) - 4 * q[0] - 0.3 * v[0]
        tip, _ = Mechanism(scene).forward_kinematics("tip", q)
        power = np.sin(q[0]) * v[1] + 0.3 * tau["a"] * v[0]
        return np.array([power, q[0], np.linalg.norm(tip), tau["a"] - 2 * q[0]])

    for k, t in enumerate(found.time):
        C, D = (found[f"linear/{name}"] for name in "CD")
        C, D = (C[k], D[k]) if about == "motion" else (C, D)
        q, v, zero = found["q"][k], found["qd"][k], np.zeros(4)
        for column, unit in enumerate(np.eye(4) * step):
            sides = [
                [signals(manifold.integrate(q, s * unit), v, t, zero) for s in (1, -1)],
                [signals(q, v + s * unit, t, zero) for s in (1, -1)],
                [signals(q, v, t, s * unit) for s in (1, -1)],
            ]
            by_q, by_v, by_u = ((plus - minus) / (2 * step) for plus, minus in sides)
            assert_close(C[:, column], by_q, 1e-8, 1.0)
            assert_close(C[:, 4 + column], by_v, 1e-8, 1.0)
            assert_close(D[:, column], by_u, 1e-8, 1.0)
    assert [s["unit"] for s in found.summary["measured"]] == ["W", "rad", "1", "1"]


def test_signals_of_the_controller_are_no_outputs() -> None:
    scene = load_scene(CONFIGS / "controlled_arm.yaml", ["outputs.signals.wanted=ref.theta1"])
    assert [s["name"] for s in linearise(scene, outputs=["power"]).summary["measured"]] == ["power"]
    with pytest.raises(SceneError, match="--output wanted: its formula needs ref.theta1 of the controller"):
        linearise(scene, outputs=["wanted"])


def test_the_order_of_equally_fast_poles_is_no_matter_of_rounding() -> None:
    rng = np.random.default_rng(0)
    exact = np.array([0.0, -0.5 + 2.6j, -0.5 - 2.6j, 0.5 + 2.6j, 0.5 - 2.6j, -6.5, 6.5, 1e-9])
    told = exact[slowest_first(exact)]
    assert [x.real for x in told] == [0.0, 1e-9, -0.5, -0.5, 0.5, 0.5, -6.5, 6.5]
    for _ in range(50):
        poles = rng.permutation(exact * (1.0 + 1e-15 * rng.normal(size=len(exact))))
        np.testing.assert_allclose(poles[slowest_first(poles)].real, told.real, rtol=1e-12, atol=1e-15)


def test_instants_of_a_motion() -> None:
    """Each is the linear model of the state there; the nearest sample is taken."""
    scene = load_scene(PENDULUM, ["simulate.duration=1", "simulate.samples=101"])
    result = linearise(scene, about=[0.0, 0.501, 0.499, 1.0])
    assert_close(result["linear/instant"], [0.0, 0.5, 1.0], 1e-12)
    for k, instant in enumerate(result.summary["instants"]):
        at = int(np.argmin(np.abs(result.time - instant["time"])))
        q, v = ([float(x) for x in result[name][at]] for name in ("q", "qd"))
        there = [
            f"initial={{q: {{theta1: {q[0]!r}, theta2: {q[1]!r}}}, qd: {{theta1: {v[0]!r}, theta2: {v[1]!r}}}}}"
        ]
        one = linearise(load_scene(PENDULUM, there))
        for mode, same in zip(instant["modes"], one.summary["modes"]):
            assert_close([mode["real"], mode["imaginary"]], [same["real"], same["imaginary"]], 1e-9)
        A, B, C, D = (result[f"linear/{name}"][at] for name in "ABCD")
        w = float(result["linear/frequency"][77])
        direct = C @ np.linalg.solve(1j * w * np.eye(4) - A, B) + D
        assert_close(result["linear/response_real"][k, 77], direct.real, 1e-10)
        assert_close(result["linear/response_imaginary"][k, 77], direct.imag, 1e-10)
    with pytest.raises(SceneError, match="--instants: 1.1 s is outside the motion; allowed: 0 to 1 s"):
        linearise(scene, about=[1.1])


def test_what_inputs_do_not_reach_is_said() -> None:
    scene = load_scene_text(PASSIVE)
    result = linearise(scene, outputs=["a"])
    modes = {
        complex(0, round(m["imaginary"], 6)): (m["reached"], m["shown"]) for m in result.summary["modes"]
    }
    assert modes == {
        complex(0, round(np.sqrt(2 * 9.81 * 0.5 / 0.6), 6)): (True, True),
        complex(0, round(np.sqrt(9.81 * 0.8 / 0.84), 6)): (False, False),
    }
    text = " ".join(result.summary["warnings"])
    assert "do not reach (uncontrollable)" in text and "do not show (unobservable)" in text


def test_holding_torques() -> None:
    """They are gravity's; with them the pose is an equilibrium, from which A and poles follow."""
    scene = load_scene(PENDULUM, ["initial.q.theta1=0.3", "initial.q.theta2=0.4", "torques={}"])
    result = linearise(scene, about="hold")
    G = Mechanism(scene).gravity(np.array([0.3, 0.4]))
    assert_close(list(result.summary["holding_torques"].values()), G, 1e-12)
    assert result.summary["largest_acceleration"] < 1e-12
    of_a = Mechanism(scene).forward_dynamics_derivatives([0.3, 0.4], [0.0, 0.0], G)
    assert_close(result["linear/A"][2:], np.concatenate([of_a.dq, of_a.dqd], axis=1), 1e-12)
    assert_close(result["linear/B"][2:], of_a.dtau, 1e-12)
    with pytest.raises(CapabilityError, match="a cannot hold this pose: a force of .* is left"):
        linearise(load_scene_text(PASSIVE.replace("b: 0}", "b: 0.5}")), about="hold")


def test_what_holds_a_pose_beside_the_scene_is_told() -> None:
    start = "initial={q: {theta1: 1.2, phi1: 1.4}, hold: [theta1]}"
    changes = ["torques.theta1=5 - 4*theta1", "statics={find: balance}", start]
    scene = load_scene(CONFIGS / "four_bar_deploy.yaml", changes)
    # the scene's own torque is 5 - 4*1.2 = 0.2 N m there, and nothing else acts
    result = linearise(scene, about="balance")
    assert_close(result.summary["holding_torques"]["theta1"], -0.2, 1e-12)
    assert_close(statics(scene).summary["equilibrium"]["holding"]["theta1"], -0.2, 1e-12)
    free = linearise(
        load_scene(CONFIGS / "four_bar_deploy.yaml", [*changes, "initial.hold=[]"]), about="balance"
    )
    assert "holding_torques" not in free.summary
    assert_close(free.summary["configuration"]["theta1"], 1.25, 1e-9)


def test_along_an_inverse_motion() -> None:
    """The torques along a given motion are inputs, not feedback: A is that of forward dynamics there."""
    scene = load_scene(CONFIGS / "2r_circle.yaml")
    result = linearise(scene, about="motion")
    m = Mechanism(scene)
    q, v = result["q"][::250], result["qd"][::250]
    tau = m.inverse_dynamics(q, v, result["qdd"][::250])
    of_a = m.forward_dynamics_derivatives(q, v, tau)
    assert_close(result["linear/A"][::250, 2:], np.concatenate([of_a.dq, of_a.dqd], axis=2), 1e-10)
    assert_close(result["linear/B"][::250, 2:], of_a.dtau, 1e-11)
    assert result.summary["growth"]["largest"] == pytest.approx(result["linear/poles_real"].max())


def test_a_controller_is_left_out() -> None:
    """About a state, and along the motion that it makes, where its torques are constants."""
    control = "control={type: pd, reference: {type: joint, duration: 0.5, q: {theta1: -1, theta2: 0.2}}, gains: {kp: 200, kd: 30}}"
    scene = load_scene(PENDULUM, [control, "simulate.duration=0.5", "simulate.samples=11"])
    plain = load_scene(PENDULUM)
    assert_close(linearise(scene, about="state")["linear/A"], linearise(plain)["linear/A"], 1e-14)
    result = linearise(scene, about="motion")
    m, run = Mechanism(plain), simulate(scene)
    of_a = m.forward_dynamics_derivatives(run["q"], run["qd"], run["tau"])
    assert_close(result["linear/A"][:, 2:], np.concatenate([of_a.dq, of_a.dqd], axis=2), 1e-9)


def test_redundant_rows_change_nothing() -> None:
    """The parallelogram's rows depend on each other; it swings as one bar does."""
    scene = load_scene(CONFIGS / "parallelogram.yaml")
    result = linearise(scene)
    assert result.summary["freedoms"] == 1 and np.isfinite(result["linear/A"]).all()


@pytest.mark.parametrize("angle", [10, 30, 77, 131])
@pytest.mark.parametrize("about", ["state", "balance"])
def test_a_free_motion_is_one_mode_at_zero(angle: float, about: str) -> None:
    """Nothing pulls the parallelogram anywhere: what rounding leaves of its double pole is no oscillation."""
    start = f"initial={{q: {{theta1: {angle} deg, phi2: -{angle} deg, phi1: {angle} deg}}, hold: [theta1]}}"
    result = linearise(load_scene(CONFIGS / "parallelogram.yaml", [start]), about=about)
    (mode,) = result.summary["modes"]
    assert (mode["real"], mode["imaginary"], mode["frequency"]) == (0.0, 0.0, 0.0)
    assert mode["damping"] is None and 0.0 < mode["error"] < 1e-5 and mode["multiplicity"] == 2
    assert result.summary["stability"] == "marginal"
    assert not result["linear/poles_real"].any() and not result["linear/poles_imaginary"].any()


@pytest.mark.parametrize("seed", range(4))
def test_poles_do_not_depend_on_the_choice_of_coordinates(seed: int) -> None:
    """A four-bar that hangs in a random direction of gravity: each joint as the independent one gives the same poles."""
    rng = np.random.default_rng(seed)
    gravity = [float(x) for x in rng.normal(size=2)]
    changes = ["torques={}", f"gravity=[{gravity[0]}, {gravity[1]}, 0]", "initial.qd={}"]
    scene = load_scene(CONFIGS / "parallelogram.yaml", [*changes, "robot.joints.1.a=1.7"])
    found = []
    for name in ("theta1", "phi2", "phi1"):
        result = linearise(scene, about="balance", inputs=[name])
        assert result.summary["states"][0]["name"] == name
        found.append([result[f"linear/poles_{part}"] for part in ("real", "imaginary", "error")])
    for (real, imaginary, error), (*other, further) in zip(found, found[1:]):
        assert (np.abs(imaginary) > 0.1).all() and not real.any()
        # the balance itself is found to some 1e-10
        assert np.abs(np.hypot(real - other[0], imaginary - other[1])).max() <= max(error + further) + 1e-9


def test_a_pole_is_as_uncertain_as_it_says() -> None:
    """Disturbances of the entries within their rounding move no pole farther than its error: double ones, and others."""
    from robodyn_cli.works.linearise.linearise import pole_errors

    rng = np.random.default_rng(3)
    for size in (2, 4, 8):
        A = rng.normal(size=(size, size))
        A[0], A[:, 0] = 0.0, 0.0
        A[0, 1] = 1.0  # poles at 0: one of the block, one of its own
        rounding = 1e-13 * rng.random((size, size))
        poles = np.linalg.eigvals(A)
        errors = pole_errors(A, rounding, poles)
        for _ in range(200):
            moved = np.linalg.eigvals(A + rounding * rng.uniform(-1, 1, (size, size)))
            assert (np.abs(poles[:, None] - moved).min(axis=1) <= errors).all()


@pytest.mark.parametrize(
    ("change", "options", "words"),
    [
        ([], {"inputs": ["theta3"]}, "--input theta3: unknown .did you mean 'theta"),
        ([], {"inputs": ["theta1", "theta1"]}, "a joint is given twice"),
        ([], {"outputs": ["top"]}, "--output top: unknown.*allowed: theta1, theta2, qd.theta1"),
        ([], {"about": "there"}, "allowed: state, balance, hold, motion, controller, times"),
        (
            ["command=statics", "expect=null"],
            {"about": "motion"},
            "the command is 'statics'; allowed: simulate, inverse, or none",
        ),
    ],
)
def test_mistakes(change: list[str], options: dict[str, Any], words: str) -> None:
    with pytest.raises(SceneError, match=words):
        linearise(load_scene(PENDULUM, change), **options)


def test_what_has_no_linear_model() -> None:
    sticking = ["robot.joints.0.friction={coulomb: 1, law: set_valued}"]
    with pytest.raises(CapabilityError, match="'theta1' has friction that sticks, and is at rest") as raised:
        linearise(load_scene(PENDULUM, sticking))
    assert raised.value.details["joint"] == "theta1"  # the error stands at it
    sliding = load_scene(PENDULUM, [*sticking, "initial.qd.theta1=1"])
    assert linearise(sliding).summary["freedoms"] == 2
    with pytest.raises(CapabilityError, match="losses of gears depend on the direction of power"):
        linearise(load_scene(PENDULUM, ["robot.joints.0.gear={efficiency: 0.8}"]))
    with pytest.raises(CapabilityError, match="nothing can move"):
        linearise(load_scene(CONFIGS / "four_bar_prescribed.yaml"))


@pytest.mark.parametrize(
    "low, high", [(-180, -180), (-181, -179), (-170, -75), (-265, -95), (-500, 40), (-2000, 7)]
)
def test_an_axis_of_phases_has_numbers_that_can_be_read(low: float, high: float) -> None:
    ax = Figure().add_subplot()
    ax.plot([0, 1], [low, high])
    number_phases(ax.yaxis)
    bottom, top = ax.get_ylim()
    ticks = [x for x in ax.get_yticks() if bottom <= x <= top]
    assert bottom <= low and high <= top and 3 <= len(ticks) <= 7
    assert all(x % 5.0 == 0.0 for x in ticks)
