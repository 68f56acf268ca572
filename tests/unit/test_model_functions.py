"""The functions of a model from Python: shapes, scenes with springs, loops and missing data, and what they refuse."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robodyn_cli import Mechanism, inverse, load_scene, load_scene_text
from robodyn_cli.errors import CapabilityError, SceneError
from robodyn_cli.works.info import info
from tests.numeric import assert_close, first_derivative

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
ARM = str(CONFIGS / "benchmarks/puma560.yaml")
FOUR_BAR = str(CONFIGS / "four_bar_deploy.yaml")
SPRUNG = load_scene_text(
    "schema: 1\ngravity: [0.5, -9, 2]\nrobot:\n  joints:\n"
    "    - {name: a, type: revolute, axis: [0, 0, 1], origin: {xyz: [0, 0, 0]}, link: one,"
    " spring: {stiffness: 30, rest: 0.2}, damper: {damping: 0.4}, friction: {viscous: 0.3, coulomb: 0.7}}\n"
    "    - {name: b, type: spherical, origin: {xyz: [0.4, 0.1, 0]}, link: two}\n"
    "  links:\n"
    "    - {name: one, mass: 2, com: [0.2, 0.05, 0.1], inertia: {xx: 0.02, yy: 0.03, zz: 0.035, xy: 0.002, xz: 0.001,"
    " yz: -0.003}}\n"
    "    - {name: two, mass: 1, com: [0.1, -0.2, 0.05], inertia: {xx: 0.01, yy: 0.015, zz: 0.012, xy: -0.001}}\n"
    "  points: {tip: {link: two, at: [0.1, 0.2, 0.3]}}\n"
    "forces:\n  - {name: tie, type: spring, between: [tip, base.origin], stiffness: 50, length: 0.4}\n"
)


def states(mechanism: Mechanism, count: int = 5) -> list[np.ndarray]:
    """States away from each other; quaternions of unit length."""
    from robodyn_cli.model.manifold import Manifold

    rng = np.random.default_rng(4)
    manifold = Manifold(mechanism._problem.model)
    nv = len(mechanism.qd_names)
    q = [manifold.integrate(manifold.neutral(), rng.normal(size=nv)) for _ in range(count)]
    return [np.array(q), *(rng.normal(size=(count, nv)) for _ in range(2))]


def calls(m: Mechanism, frame: str) -> dict[str, Any]:
    """All functions of (q, qd, x) by name, each as one array."""
    return {
        "mass_matrix": lambda q, v, x: m.mass_matrix(q),
        "coriolis": lambda q, v, x: m.coriolis(q, v),
        "coriolis_torques": lambda q, v, x: m.coriolis_torques(q, v),
        "gravity": lambda q, v, x: m.gravity(q),
        "inverse_dynamics": lambda q, v, x: m.inverse_dynamics(q, v, x),
        "forward_dynamics": lambda q, v, x: m.forward_dynamics(q, v, x),
        "torque_derivatives": lambda q, v, x: m.inverse_dynamics_derivatives(q, v, x).dq,
        "acceleration_derivatives": lambda q, v, x: m.forward_dynamics_derivatives(q, v, x).dqd,
        "regressor": lambda q, v, x: m.regressor(q, v, x),
        "position": lambda q, v, x: m.forward_kinematics(frame, q)[0],
        "rotation": lambda q, v, x: m.forward_kinematics(frame, q)[1],
        "jacobian": lambda q, v, x: m.jacobian(frame, q),
        "centre_of_mass": lambda q, v, x: m.centre_of_mass(q),
    }


@pytest.mark.parametrize(
    ("scene", "frame"),
    [(ARM, "link6"), (SPRUNG, "tip"), (SPRUNG, "two.com")],
    ids=("arm", "sprung", "com"),
)
def test_one_state_many_states_and_none(scene: Any, frame: str) -> None:
    m = Mechanism(scene)
    many = states(m)
    for name, call in calls(m, frame).items():
        found = call(*many)
        assert len(found) == 5 and np.isfinite(found).all(), name
        one = call(*(x[2] for x in many))
        assert one.shape == found.shape[1:], name
        np.testing.assert_array_equal(one, found[2], err_msg=name)
        np.testing.assert_array_equal(call(*(x[2].tolist() for x in many)), found[2], err_msg=name)
        np.testing.assert_array_equal(call(*(np.asfortranarray(x) for x in many)), found, err_msg=name)
        assert call(*(x[:0] for x in many)).shape == (0, *found.shape[1:]), name


def test_results_lie_in_one_block() -> None:
    """Arrays of their own cost a page fault for every 4 kB; vectors of a block that begins with a cache line fill lines."""
    m = Mechanism(ARM)
    for count in (1, 7, 64):
        found = m.inverse_dynamics_derivatives(*states(m, count))
        assert found.dq.base is found.dqd.base is found.dqdd.base is not None
        assert found.dq.ctypes.data % 64 == 0


def test_shapes_that_do_not_fit() -> None:
    m = Mechanism(ARM)
    q, v, a = states(m)
    with pytest.raises(
        CapabilityError, match=r"^q has shape \(5, 5\); needed: \(samples, 6\).*or \(6,\) for one"
    ):
        m.mass_matrix(q[:, :5])
    with pytest.raises(
        CapabilityError, match="arrays of different lengths: q .*needed: as many rows of each"
    ):
        m.coriolis(q, v[:3])
    with pytest.raises(CapabilityError, match="arrays of different lengths"):
        m.inverse_dynamics(q, v[0], a)
    with pytest.raises(SceneError, match="unknown frame 'link7' .did you mean 'link6'"):
        m.jacobian("link7", q)


@pytest.mark.parametrize("given", ["x", None, [[1, 2], [3]], {"q1": 0}, np.zeros(6) + 1j, ["1"] * 6])
def test_what_is_no_array_of_numbers(given: Any) -> None:
    m = Mechanism(ARM)
    zero = np.zeros(6)
    for call in (
        m.mass_matrix,
        lambda q: m.inverse_dynamics(zero, q, zero),
        lambda q: m.jacobian("link6", q),
    ):
        with pytest.raises(CapabilityError, match=r"^qd? is .*; needed: an array of real numbers"):
            call(given)
    with pytest.raises(SceneError, match="frame 3 is no name; allowed: a named point"):
        m.jacobian(3, zero)  # type: ignore[arg-type]


def test_they_belong_together() -> None:
    """tau = M qdd + C qd + G; forward dynamics undoes it; a frame's twist is the rate of its pose."""
    m = Mechanism(ARM)
    q, v, a = states(m)
    M, C = m.mass_matrix(q), m.coriolis(q, v)
    tau = np.einsum("tij,tj->ti", M, a) + np.einsum("tij,tj->ti", C, v) + m.gravity(q)
    rigid = m.regressor(q, v, a) @ m.inertial_parameters.values
    assert_close(rigid, tau, 1e-13)
    assert_close(M, np.swapaxes(M, 1, 2), 0.0)
    assert (np.linalg.eigvalsh(M) > 0).all()
    J = m.jacobian("link6.com", q) @ v[..., None]
    moved = first_derivative(lambda t: m.forward_kinematics("link6.com", q + t * v)[0], 0.01)
    assert_close(J[:, 3:, 0], moved, 1e-11)
    turned = first_derivative(lambda t: m.forward_kinematics("link6", q + t * v)[1], 0.01)
    spin = turned @ np.swapaxes(m.forward_kinematics("link6", q)[1], 1, 2)
    w = np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], axis=1)
    assert_close(J[:, :3, 0], w, 1e-11)
    p, R = m.forward_kinematics("link6.com", q)
    found = m.inverse_kinematics("link6.com").solve(p, R)
    assert found.reached.all()
    again, turned = m.forward_kinematics("link6.com", found.q)
    assert_close(again, p, 1e-9)
    assert_close(turned, R, 1e-9)


def test_derivatives_of_a_scene_with_springs_friction_and_a_tie() -> None:
    m = Mechanism(SPRUNG)
    q, v, a = (x[0] for x in states(m))
    from robodyn_cli.model.manifold import Manifold

    manifold = Manifold(m._problem.model)
    tau = m.inverse_dynamics(q, v, a)
    assert_close(m.forward_dynamics(q, v, tau), a, 1e-12)
    of_tau, of_a = m.inverse_dynamics_derivatives(q, v, a), m.forward_dynamics_derivatives(q, v, tau)
    for k, unit in enumerate(np.eye(len(v))):
        by_q = first_derivative(
            lambda t, u=unit: m.inverse_dynamics(manifold.integrate(q, t * u), v, a), 0.01
        )
        assert_close(of_tau.dq[:, k], by_q, 1e-9, float(np.abs(of_tau.dq).max()))
        by_v = first_derivative(lambda t, u=unit: m.inverse_dynamics(q, v + t * u, a), 0.01)
        assert_close(of_tau.dqd[:, k], by_v, 1e-9, float(np.abs(of_tau.dqd).max()))
    assert_close(of_tau.dqdd, m.mass_matrix(q), 1e-15)
    for by_x, of_x in ((of_tau.dq, of_a.dq), (of_tau.dqd, of_a.dqd)):
        assert_close(of_tau.dqdd @ of_x, -by_x, 1e-12)
    assert_close(of_tau.dqdd @ of_a.dtau, np.eye(len(v)), 1e-12)


def test_the_command_line_has_no_coriolis_matrix_to_compute_at_rest() -> None:
    """C is linear in qd; a small rate of one joint gives what the function gives."""
    m = Mechanism(ARM)
    q = states(m)[0][0]
    for rates in np.zeros(len(m.qd_names)), 1e-3 * np.eye(len(m.qd_names))[0]:
        found = info(Path(ARM), (), [f"q={q.tolist()}, qd={rates.tolist()}"]).summary
        C = m.coriolis(q, rates)
        assert_close(C, found["coriolis_matrix"], 1e-12)
        assert C.any() == rates.any()


def test_the_command_line_has_the_same_numbers() -> None:
    m = Mechanism(ARM)
    q, v, _ = (x[0] for x in states(m))
    at = [f"q={q.tolist()}, qd={v.tolist()}"]
    found = info(Path(ARM), (), at).summary
    assert_close(m.mass_matrix(q), found["mass_matrix"], 1e-13)
    assert_close(m.coriolis(q, v), found["coriolis_matrix"], 1e-12)
    assert_close(m.gravity(q), list(found["gravity_torques"].values()), 1e-13)
    for name, frame in found["frames"].items():
        p, R = m.forward_kinematics(name, q)
        assert_close(p, frame["position"], 1e-14, 1.0)
        assert_close(R, frame["rotation"], 1e-14)
    scene = load_scene(CONFIGS / "seven_joint_arm.yaml")
    result = inverse(scene)
    tau = Mechanism(scene).inverse_dynamics(result["q"], result["qd"], result["qdd"])
    assert_close(tau, result["tau"], 1e-12)


def test_a_mechanism_has_the_functions_of_its_tree() -> None:
    """M, C and G of the opened tree, as ``info`` prints them; loops share the load, so torques are refused."""
    m = Mechanism(FOUR_BAR)
    found = info(Path(FOUR_BAR)).summary
    q = np.array(list(found["state"]["q"].values()))
    assert_close(m.mass_matrix(q), found["mass_matrix"], 1e-13)
    assert_close(m.constraint_jacobian(q), found["constraints"]["psi"], 1e-13)
    assert m.centre_of_mass(q[None]).shape == (1, 3)
    for function in (m.inverse_dynamics_derivatives, lambda *state: m.inverse_dynamics(*state)):
        with pytest.raises(CapabilityError, match="open chains only.*use `inverse` or `simulate`"):
            function(q, q, q)
    assert Mechanism(ARM).constraint_jacobian(np.zeros((4, 6))).shape == (4, 0, 6)


def test_data_that_are_missing() -> None:
    """In the plane only zz matters: what is not given counts as 0 where nothing depends on it, and is named elsewhere."""
    text = (
        "schema: 1\ngravity: [0, -9.81, 0]\nrobot:\n  joints:\n"
        "    - {name: a, type: revolute, axis: [0, 0, 1], link: l}\n    - {name: b, type: revolute, axis: AXIS,"
        " origin: {xyz: [1, 0, 0]}, link: m}\n  links:\n"
        "    - {name: l, mass: 2, com: [0.5, 0, 0], inertia: {zz: 0.1}}\n"
        "    - {name: m, mass: 1, com: [0.5, 0, 0], inertia: {zz: 0.2}}\n"
    )
    flat = Mechanism(load_scene_text(text.replace("AXIS", "[0, 0, 1]")))
    q, v, a = states(flat)
    known = flat.inertial_parameters
    assert_close(flat.regressor(q, v, a) @ known.values, flat.inverse_dynamics(q, v, a), 1e-13)
    assert known.values[known.names.index("l.Ixx")] == 0.0
    assert known.units[known.names.index("l.mx")] == "kg m"
    bent = Mechanism(load_scene_text(text.replace("AXIS", "[0, 1, 0]")))
    with pytest.raises(SceneError, match="need .*inertia.*which the scene does not give"):
        bent.mass_matrix(q)
    with pytest.raises(SceneError, match="need .*which the scene does not give"):
        _ = bent.inertial_parameters
    assert bent.regressor(q, v, a).shape == (5, 2, 20)


def test_gears_with_losses() -> None:
    """Their torque depends on accelerations too, so d tau / d qdd is not M; accelerations do not follow from torques."""
    m = Mechanism(
        load_scene_text(
            "schema: 1\ngravity: [0, -9.81, 0]\nrobot:\n  joints:\n    - {name: a, type: revolute, axis: [0, 0, 1],"
            " gear_ratio: 50, rotor_inertia: 1e-4, gear: {efficiency: 0.8}, link: l}\n"
            "  links:\n    - {name: l, mass: 2, com: [0.5, 0, 0], inertia: {zz: 0.1}}\n"
        )
    )
    q, v, a = np.array([0.3]), np.array([0.7]), np.array([2.0])
    found = m.inverse_dynamics_derivatives(q, v, a)
    by_a = first_derivative(lambda t: m.inverse_dynamics(q, v, a + t), 0.01)
    assert_close(found.dqdd[:, 0], by_a, 1e-10)
    assert abs(found.dqdd - m.mass_matrix(q)).max() > 0.05
    with pytest.raises(CapabilityError, match="gear losses depend on the drive"):
        m.forward_dynamics_derivatives(q, v, a)
