"""Springs and bushings over many turns: counted where joints turn about parallels, an event and a warning elsewhere."""

from __future__ import annotations

import numpy as np
import pytest

from robodyn_cli.scene.load import load_scene_text
from robodyn_cli.works.inverse import inverse
from robodyn_cli.works.simulate import simulate

SPRINGS = {
    "torsional_spring": "{name: s, type: torsional_spring, between: [hub, pad], stiffness: 0.4, rest: 50 deg, damping: D}",
    "bushing": "{name: s, type: bushing, between: [hub, pad], stiffness: [0, 0, 0, 0.1, 0.2, 0.4], damping: [0, 0, 0, 0, 0, D]}",
}
# kind of a joint, what it turns by at an angle, and what else has to be said
TURNING = {
    "revolute": ("{}", ""),
    "cylindrical": ("[{}, 0.1]", ""),
    "helical": ("{}", ", pitch: 0.05"),
    "planar": ("[0.1, -0.2, {}]", ""),
}


def chain(
    kinds: list[str], rng: np.random.Generator, damping: float = 0.0, spring: str = "torsional_spring"
) -> str:
    """A chain of joints about parallels of z, with slides and fixed parts between; axes point either way."""
    joints, links, q, qd = [], [], [], []
    for k, kind in enumerate(kinds):
        origin = ", ".join(f"{x:.3f}" for x in rng.normal(size=3) * 0.3)
        yaw = rng.uniform(-180.0, 180.0)
        place = f"origin: {{xyz: [{origin}], rpy: [0, 0, {yaw:.3f} deg]}}"
        if kind in TURNING:
            shape, more = TURNING[kind]
            axis = int(rng.choice([-1, 1]))
            joints.append(f"{{name: j{k}, type: {kind}, {place}, axis: [0, 0, {axis}]{more}}}")
            q.append(f"j{k}: {shape.format(round(rng.normal(), 3))}")
            rate = (
                shape.replace("0.1", "0")
                .replace("-0.2", "0")
                .format(round(rng.choice([-1, 1]) * rng.uniform(3, 5) * 3**k, 3))
            )
            qd.append(f"j{k}: {rate}")
        elif kind == "prismatic":
            joints.append(f"{{name: j{k}, type: prismatic, {place}, axis: [1, 0, 2]}}")
            q.append(f"j{k}: 0.2")
            qd.append(f"j{k}: 0.1")
        else:
            joints.append(f"{{name: j{k}, type: fixed, {place}}}")
        a, b, c = rng.uniform(0.05, 0.08, 3)
        links.append(
            f"{{name: l{k}, mass: 1, com: [0.02, 0.05, 0.01], inertia: {{xx: {a}, yy: {b}, zz: {c}}}}}"
        )
    force = SPRINGS[spring].replace("D", str(damping))
    joints, links = ("\n".join(f"    - {x}" for x in rows) for rows in (joints, links))
    return f"""
schema: 1
gravity: [0, 0, 0]
robot:
  joints:
{joints}
  links:
{links}
  frames: {{hub: {{link: base, at: [0, 0, 0]}}, pad: {{link: l{len(kinds) - 1}, at: [0, 0, 0], rpy: [0, 0, 0.7]}}}}
forces: [{force}]
initial: {{q: {{{", ".join(q)}}}, qd: {{{", ".join(qd)}}}}}
simulate: {{duration: 4, samples: 401, rtol: 1e-11, atol: 1e-13}}
"""


@pytest.mark.parametrize("spring", sorted(SPRINGS))
@pytest.mark.parametrize("seed", range(6))
def test_chains_about_parallels_count_their_turns(seed: int, spring: str) -> None:
    rng = np.random.default_rng(seed)
    kinds = [str(k) for k in rng.choice([*TURNING, "prismatic", "fixed"], size=3)]
    kinds[seed % 3] = sorted(TURNING)[seed % 4]
    damping = float(rng.choice([0.0, 0.01]))
    found = simulate(load_scene_text(chain(kinds, rng, damping, spring)))
    assert "warnings" not in found.summary
    turned = np.sqrt(2.0 * found["forces/potential"][:, 0] / 0.4)
    assert turned.max() > np.pi + 0.2  # beyond half a turn
    assert np.abs(np.diff(turned)).max() < 1.0  # and without a jump
    assert found.summary["energy_drift"] < 1e-9 * np.abs(found["energy/total"]).max()


@pytest.mark.parametrize("kind", sorted(TURNING))
@pytest.mark.parametrize("spring", sorted(SPRINGS))
def test_other_joints_turn_as_a_hinge_does(kind: str, spring: str) -> None:
    """A balanced wheel on any joint that can turn: I theta'' = -k theta, over several turns."""
    shape, more = TURNING[kind]
    q, qd = (
        shape.replace("0.1", "0").replace("-0.2", "0").format(0),
        shape.replace("0.1", "0").replace("-0.2", "0").format(20),
    )
    found = simulate(
        load_scene_text(
            f"""
schema: 1
gravity: [0, 0, 0]
robot:
  joints: [{{name: a, type: {kind}, axis: [0, 0, 1]{more}}}]
  links: [{{name: w, mass: 1, com: [0, 0, 0], inertia: {{xx: 0.1, yy: 0.1, zz: 0.1}}}}]
  frames: {{hub: {{link: base, at: [0, 0, 0]}}, pad: {{link: w, at: [0, 0, 0]}}}}
forces: [{SPRINGS[spring].replace("50 deg", "0").replace("D", "0")}]
initial: {{q: {{a: {q}}}, qd: {{a: {qd}}}}}
simulate: {{duration: 3, samples: 301, rtol: 1e-11, atol: 1e-13}}
"""
        )
    )
    inertia = 0.1 + (0.05**2 if kind == "helical" else 0.0)
    w = np.sqrt(0.4 / inertia)
    theta = found["q"][:, -1 if kind == "planar" else 0]
    assert np.abs(theta - 20.0 / w * np.sin(w * found["time"])).max() < 1e-8
    assert theta.max() > 2.0 * np.pi


WIDE = {
    "universal": ("[0.3, 0.2]", "[9, 1]"),
    "spherical": ("[1, 0, 0, 0]", "[0.4, 0.7, 9]"),
    "floating": ("[1, 0, 0, 0, 0, 0, 0]", "[0.4, 0.7, 9, 0, 0, 0]"),
}


@pytest.mark.parametrize("spring", sorted(SPRINGS))
@pytest.mark.parametrize("kind", sorted(WIDE))
def test_elsewhere_the_jump_at_half_a_turn_is_an_event_and_a_warning(kind: str, spring: str) -> None:
    q, qd = WIDE[kind]
    order = ("[0, 0, 0, 1, 0, 0, 0]", "[0, 0, 0, 0.4, 0.7, 9]") if kind == "floating" else (q, qd)
    scene = load_scene_text(
        f"""
schema: 1
gravity: [0, 0, 0]
robot:
  joints: [{{name: a, type: {kind}}}]
  links: [{{name: w, mass: 1, com: [0, 0, 0], inertia: {{xx: 0.1, yy: 0.11, zz: 0.12}}}}]
  frames: {{hub: {{link: base, at: [0, 0, 0]}}, pad: {{link: w, at: [0, 0, 0]}}}}
forces: [{SPRINGS[spring].replace("50 deg", "0").replace("D", "0")}]
initial: {{q: {{a: {order[0]}}}, qd: {{a: {order[1]}}}}}
simulate: {{duration: 2, samples: 201, rtol: 1e-11, atol: 1e-13}}
"""
    )
    found = simulate(scene)
    assert [w for w in found.summary["warnings"] if w.startswith("force 's': its ends are half a turn apart")]
    assert found.summary["energy_drift"] < 1e-8
    # without the event steps would creep up to the jump or go over it
    assert found.summary["error_estimate"]["state_max"] < 1e-8


def test_inverse_warns_of_the_jump() -> None:
    text = """
schema: 1
gravity: [0, 0, 0]
robot:
  joints: [{name: a, type: universal}]
  links: [{name: w, mass: 1, com: [0, 0, 0], inertia: {xx: 0.1, yy: 0.11, zz: 0.12}}]
forces: [{name: s, type: torsional_spring, between: [base.origin, w.origin], stiffness: 2}]
trajectory: {type: joint, duration: 1, q: {a: ["RATE*t", "0.1*t"]}}
"""
    assert "warnings" not in inverse(load_scene_text(text.replace("RATE", "3"))).summary
    (warning,) = inverse(load_scene_text(text.replace("RATE", "5"))).summary["warnings"]
    assert "force 's'" in warning and "half a turn" in warning
