"""InverseDynamics and ForwardDynamics: long chains take a loop over their bodies, with the same results."""

from __future__ import annotations

import numpy as np
import pytest

from robodyn_cli.errors import CapabilityError
from robodyn_cli.kernels import crossover
from robodyn_cli.scene import load_scene, load_scene_text
from robodyn_cli.scene.types import Scene
from robodyn_cli.torques.dynamics import ForwardDynamics, InverseDynamics

TWO = (
    "schema: 1\ngravity: [0, -9.81, 0]\nrobot:\n  convention: standard\n"
    "  joints: [{name: a, type: revolute, a: 1, alpha: 0, d: 0}, {name: b, type: revolute, a: 1, alpha: 0, d: 0}]\n"
    "  links:\n"
    "    - {name: l, mass: 2, com: [0.5, 0, 0], com_frame: joint, inertia: {zz: 0.1}}\n"
    "    - {name: m, mass: 1, com: [0.5, 0, 0], com_frame: joint, inertia: {zz: 0.1}}\n"
)
JOINTS = crossover.CROSSOVER + 1


def chain(forces: str) -> Scene:
    """A chain of arms at right angles; ``forces`` acts in every third joint."""
    lines = ["schema: 1", "gravity: [0.3, -1, -9.81]", "robot:", "  convention: modified", "  joints:"]
    for k in range(JOINTS):
        extra = f", {forces}" if forces and k % 3 == 0 else ""
        twist = (90, 0, -90)[k % 3]
        lines.append(
            f"    - {{name: q{k}, type: revolute, a: {0.1 + 0.01 * k}, alpha: {twist} deg, d: 0.05{extra}}}"
        )
    lines.append("  links:")
    for k in range(JOINTS):
        lines.append(
            f"    - {{name: l{k}, mass: {1 + 0.1 * k}, com: [0.05, 0.02, -0.01], com_frame: link, "
            "inertia: {xx: 0.012, yy: 0.013, zz: 0.015, xy: 0.001, xz: -0.002, yz: 0.0005}}"
        )
    return load_scene_text("\n".join(lines) + "\n")


@pytest.mark.parametrize(
    "forces", ["", "friction: {viscous: 0.3, coulomb: 0.4}, gear_ratio: 50, rotor_inertia: 1e-4"]
)
def test_rolled_and_unrolled_agree(forces: str, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = chain(forces)
    rng = np.random.default_rng(3)
    q, qd, qdd = (np.asfortranarray(rng.normal(size=(11, JOINTS))) for _ in range(3))
    inverse, forward = InverseDynamics(scene), ForwardDynamics(scene)
    assert (inverse.shape, forward.shape) == ("rolled", "rolled")
    tau = inverse(q, qd, qdd)
    assert tau.flags.f_contiguous and tau.shape == q.shape
    monkeypatch.setattr(crossover, "CROSSOVER", JOINTS + 1)
    unrolled = InverseDynamics(scene)
    assert unrolled.shape == "unrolled"
    assert inverse.joints == unrolled.joints
    assert unrolled.operations > 0 and inverse.operations > 0
    np.testing.assert_allclose(tau, unrolled(q, qd, qdd), rtol=0, atol=1e-13 * abs(tau).max())
    np.testing.assert_allclose(forward(q, qd, tau), qdd, rtol=0, atol=1e-9)


def test_short_chains_are_unrolled() -> None:
    scene = load_scene_text(
        "schema: 1\ngravity: [0, -9.81, 0]\nrobot:\n  convention: standard\n"
        "  joints: [{name: q, type: revolute, a: 1, alpha: 0, d: 0}]\n"
        "  links: [{name: l, mass: 2, com: [0.5, 0, 0], com_frame: joint, inertia: {zz: 0.1}}]\n"
    )
    inverse = InverseDynamics(scene)
    assert inverse.shape == "unrolled"
    zero = np.zeros((1, 1))
    assert inverse(zero, zero, zero)[0, 0] == pytest.approx(9.81)


@pytest.mark.parametrize("kind", [InverseDynamics, ForwardDynamics])
@pytest.mark.parametrize("long", [False, True])
def test_arrays_with_columns_to_spare_are_refused(kind: type, long: bool) -> None:
    """A column too many would be ignored, or shift what the others mean."""
    dynamics = kind(chain("") if long else load_scene_text(TWO))
    n = len(dynamics.joints)
    good, wide, narrow = (np.zeros((9, n + extra)) for extra in (0, 1, -1))
    assert dynamics(good, good, good).shape == (9, n)
    for bad in (wide, narrow, wide[0], np.zeros((1, 9, n))):
        for place in range(3):
            arrays = [good, good, good]
            arrays[place] = bad
            name = dynamics.names[place]
            with pytest.raises(CapabilityError, match=rf"^{name} has shape .*needed: \(samples, {n}\)"):
                dynamics(*arrays)


def test_closed_loops_are_refused_with_the_commands_that_take_them() -> None:
    with pytest.raises(CapabilityError, match="open chains only.*`inverse` or `simulate`"):
        InverseDynamics(load_scene("configs/four_bar_deploy.yaml"))
