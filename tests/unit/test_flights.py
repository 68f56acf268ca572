"""The flight of a released payload: its release, its way, where it comes down, and the errors of that."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robodyn_cli import load_scene_text, simulate
from robodyn_cli.errors import SceneError
from robodyn_cli.motion.contact.flight import _comes_down
from robodyn_cli.report.drawing.build import make_drawing
from robodyn_cli.results.result import Result
from tests.unit.test_payloads import ARM, BOX, DISC, scene_of, with_box

TREBUCHET = """
schema: 1
gravity: [0, -9.81, 0]
robot:
  joints:
    - {name: beam, type: revolute, parent: base, link: b, axis: [0, 0, 1], origin: {xyz: [0, 3, 0]}}
    - {name: cw, type: revolute, parent: b, link: w, axis: [0, 0, 1], origin: {xyz: [-1, 0, 0]}}
    - {name: sling, type: revolute, parent: b, link: s, axis: [0, 0, 1], origin: {xyz: [4, 0, 0]}}
  links:
    - {name: b, mass: 60, com: [1.5, 0, 0], inertia: {zz: 60*5^2/12}}
    - {name: w, mass: 1000, com: [0, -0.8, 0], inertia: {zz: 50}}
    - {name: s, mass: 0.5, com: [1.5, 0, 0], inertia: {zz: 0.5*3^2/12}}
  points: {pouch: {link: s, at: [3, 0, 0]}}
payloads:
  - {name: stone, at: pouch, mass: 10, inertia: {zz: 0.05}, range: {}, until: {when: "0.3 - pouch.x"}}
initial: {q: {beam: -45 deg, cw: 45 deg, sling: -135 deg}}
simulate: {duration: 2, samples: 201}
"""


def vector(values: dict[str, float]) -> np.ndarray:
    return np.array([values[axis] for axis in "xyz"])


def test_a_ball_let_go_by_a_disc_goes_along_the_tangent() -> None:
    """Without gravity, from (0.5 cos, 0.5 sin) with speed 0.5 w; energy m (r w)^2 / 2 + I w^2 / 2."""
    text = DISC.replace("from: {time: 1}, ", "range: {through: [3, 0, 0], normal: [-1, 0, 0]}, ")
    result = simulate(load_scene_text(text))
    w = 3.0
    facts = result.summary["payloads"]["ball"]
    angle = w * 2.0
    place = 0.5 * np.array([np.cos(angle), np.sin(angle), 0.0])
    velocity = 0.5 * w * np.array([-np.sin(angle), np.cos(angle), 0.0])
    release, landing = facts["release"], facts["landing"]
    assert vector(release["position"]) == pytest.approx(place, abs=1e-12)
    assert vector(release["velocity"]) == pytest.approx(velocity, abs=1e-12)
    assert vector(release["angular_velocity"]) == pytest.approx([0.0, 0.0, w], abs=1e-12)
    assert release["energy"] == pytest.approx(0.5 * 1.2 * (0.5 * w) ** 2 + 0.5 * 0.05 * w**2, rel=1e-12)
    since = (3.0 - place[0]) / velocity[0]  # after the end of the run
    assert landing["time"] == pytest.approx(2.0 + since, rel=1e-12) and landing["time"] > 3.0
    assert landing["range"] == pytest.approx(abs(velocity[1]) * since, rel=1e-11)
    assert landing["highest"] == pytest.approx(3.0 - place[0], rel=1e-12)
    t, p, v = (result[f"flights/ball/{name}"] for name in ("time", "position", "velocity"))
    assert t[0] == 2.0 and t[-1] == landing["time"] and (np.diff(t) > 0.0).all()
    assert set(np.round(result.time[21:], 9)) <= set(np.round(t, 9))
    np.testing.assert_allclose(p, place + velocity * (t - 2.0)[:, None], atol=1e-11)
    np.testing.assert_allclose(v, np.broadcast_to(velocity, v.shape), atol=1e-11)


def test_an_arm_with_full_inertias_releases_what_was_welded_to_it() -> None:
    """Place, velocity and energy at the release are those of a link that is welded there and has the same data."""
    payload = {"name": "box", "at": "tool", **BOX, "until": {"time": 0.5}}
    released = simulate(scene_of(ARM, payloads=[payload]))
    box = {f"{name}": f"box.com.{name}" for name in ("x", "y", "z", "vx", "vy", "vz")}
    welded = simulate(scene_of({**with_box(ARM), "outputs": {"signals": box}}))
    release = released.summary["payloads"]["box"]["release"]
    at = {name: float(welded[f"signals/{name}"][5]) for name in box}
    assert vector(release["position"]) == pytest.approx([at[x] for x in "xyz"], abs=1e-9)
    assert vector(release["velocity"]) == pytest.approx([at[f"v{x}"] for x in "xyz"], abs=1e-8)
    spin = welded["frames/tool/twist"][5, :3]
    assert vector(release["angular_velocity"]) == pytest.approx(spin, abs=1e-8)
    quaternion = welded["frames/tool/quaternion"][5]
    w, x, y, z = quaternion
    R = np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip
    I = BOX["inertia"]
    own = np.array([[I["xx"], I["xy"], I["xz"]], [I["xy"], I["yy"], I["yz"]], [I["xz"], I["yz"], I["zz"]]])
    speed = vector(release["velocity"])
    energy = 0.5 * BOX["mass"] * speed @ speed + 0.5 * spin @ (R @ own @ R.T) @ spin
    assert release["energy"] == pytest.approx(energy, rel=1e-8)
    flown = released["flights/box/position"]
    t = released["flights/box/time"] - 0.5
    g = np.array(ARM["gravity"])
    along = vector(release["position"]) + speed * t[:, None] + 0.5 * g * t[:, None] ** 2
    np.testing.assert_allclose(flown, along, atol=1e-12)


def turns(quaternions: np.ndarray) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    return Rotation.from_quat(quaternions[:, [1, 2, 3, 0]]).as_matrix()


def tensor(I: dict[str, float]) -> np.ndarray:
    return np.array([[I["xx"], I["xy"], I["xz"]], [I["xy"], I["yy"], I["yz"]], [I["xz"], I["yz"], I["zz"]]])


def test_a_tumbling_box_keeps_its_angular_momentum_and_energy() -> None:
    payload = {"name": "box", "at": "tool", **BOX, "until": {"time": 0.5}}
    result = simulate(scene_of(ARM, payloads=[payload]))
    R, w = turns(result["flights/box/quaternion"]), result["flights/box/angular_velocity"]
    I, t = tensor(BOX["inertia"]), result["flights/box/time"]
    whole = simulate(scene_of(with_box(ARM)))  # the box is part of the arm, so that the frame turns with it
    np.testing.assert_allclose(w[0], whole["frames/tool/twist"][5, :3], atol=1e-8)
    np.testing.assert_allclose(R[0], turns(whole["frames/tool/quaternion"][5:6])[0], atol=1e-8)
    momentum = np.einsum("tij,jk,tlk,tl->ti", R, I, R, w)
    own = np.einsum("tji,tj->ti", R, w)
    assert len(t) > 4 and np.ptp(own, axis=0).max() > 1e-3
    np.testing.assert_allclose(momentum, np.broadcast_to(momentum[0], momentum.shape), atol=1e-12 * 10)
    energy = 0.5 * np.einsum("ti,ij,tj->t", own, I, own)
    np.testing.assert_allclose(energy, energy[0], rtol=1e-11)


def test_attitude_of_a_flight_is_that_of_a_free_body() -> None:
    payload = {"name": "box", "at": "tool", **BOX, "until": {"time": 0.5}}
    result = simulate(scene_of(ARM, payloads=[payload]))
    p, w, t = (result[f"flights/box/{name}"] for name in ("quaternion", "angular_velocity", "time"))
    own = turns(p[:1])[0].T @ w[0]
    free = simulate(scene_of({
        "schema": 1, "gravity": [0, 0, 0],
        "robot": {
            "joints": [{"name": "free", "type": "floating"}],
            "links": [{"name": "box", "mass": BOX["mass"], "com": [0, 0, 0], "inertia": BOX["inertia"]}],
            "frames": {"own": {"link": "box"}},
        },
        "initial": {
            "q": {"free": {"xyz": [0, 0, 0], "quaternion": p[0].tolist()}},
            "qd": {"free": {**dict(zip(("wx", "wy", "wz"), own.tolist())), "vx": 0, "vy": 0, "vz": 0}},
        },
        "simulate": {"duration": float(t[-1] - t[0]), "samples": 3, "rtol": 1e-13, "atol": 1e-14},
    }))  # fmt: skip
    np.testing.assert_allclose(turns(free["frames/own/quaternion"])[-1], turns(p)[-1], atol=1e-9)
    np.testing.assert_allclose(free["frames/own/twist"][-1, :3], w[-1], atol=1e-9)


def test_a_symmetric_top_turns_as_its_closed_form_says() -> None:
    """Its axis goes round the angular momentum at L / I_1, and it spins about the axis at (1 / I_3 - 1 / I_1) L_3."""
    from scipy.spatial.transform import Rotation

    from robodyn_cli.motion.contact.flight import Flight

    I, own = np.diag([0.3, 0.3, 0.5]), np.array([0.7, -0.4, 2.0])
    start = Rotation.from_rotvec([0.3, -0.5, 0.2])
    flight = Flight(1.0, np.zeros(3), np.zeros(3), start.apply(own), 0.0, np.zeros(3), start.as_matrix(), I)
    t = np.linspace(1.0, 9.0, 41)
    turning = flight.turning(t)
    assert turning is not None
    momentum, slip = start.apply(I @ own), (1 / 0.5 - 1 / 0.3) * (I @ own)[2]
    since = (t - 1.0)[:, None]
    closed = Rotation.from_rotvec(momentum / 0.3 * since) * start * Rotation.from_rotvec([0, 0, slip] * since)
    np.testing.assert_allclose(turns(turning[0]), closed.as_matrix(), atol=2e-12)


def test_a_flight_without_whole_inertia_turns_about_one_axis_or_not_at_all() -> None:
    result = simulate(load_scene_text(TREBUCHET))
    facts = result.summary["payloads"]["stone"]["release"]
    w, t = result["flights/stone/angular_velocity"], result["flights/stone/time"]
    np.testing.assert_allclose(w, np.broadcast_to(vector(facts["angular_velocity"]), w.shape), rtol=1e-12)
    R = turns(result["flights/stone/quaternion"])
    angle = np.unwrap(np.arctan2(R[:, 1, 0], R[:, 0, 0]))
    np.testing.assert_allclose(angle - angle[0], w[0, 2] * (t - t[0]), atol=1e-10)


def test_a_trebuchet_throws_as_far_as_a_body_that_begins_there() -> None:
    """The same flight as the motion of a floating body in a scene of its own; released where its pouch passes a place."""
    result = simulate(load_scene_text(TREBUCHET))
    facts = result.summary["payloads"]["stone"]
    release, landing = facts["release"], facts["landing"]
    assert release["position"]["x"] == pytest.approx(0.3, abs=1e-9)  # where its condition says
    since = landing["time"] - facts["released"]
    place, velocity = release["position"], release["velocity"]
    body = f"""
schema: 1
gravity: [0, -9.81, 0]
robot:
  joints: [{{name: free, type: floating}}]
  links: [{{name: stone, mass: 10, com: [0, 0, 0], inertia: {{xx: 0.05, yy: 0.05, zz: 0.05}}}}]
initial:
  q: {{free: {{xyz: [{place["x"]}, {place["y"]}, 0], quaternion: [1, 0, 0, 0]}}}}
  qd: {{free: {{vx: {velocity["x"]}, vy: {velocity["y"]}, vz: 0, wx: 0, wy: 0, wz: 0}}}}
simulate: {{duration: {since}, samples: 11}}
"""
    free = simulate(load_scene_text(body))
    assert free["q"][-1, :3] == pytest.approx(vector(landing["position"]), abs=1e-9)
    assert landing["position"]["y"] == pytest.approx(0.0, abs=1e-12)
    assert landing["range"] == pytest.approx(abs(landing["position"]["x"] - place["x"]), rel=1e-13)
    # energies at both ends
    drop = 9.81 * place["y"]
    ends = [0.5 * sum(x * x for x in one["velocity"].values()) for one in (release, landing)]
    assert ends[1] - ends[0] == pytest.approx(drop, rel=1e-12)


def figures(result: Result) -> dict[str, tuple[float, float]]:
    """Return the figures of the flight with their errors."""
    found = {}
    for part in ("release", "landing"):
        facts: dict[str, Any] = result.summary["payloads"]["stone"][part]
        for name, value in facts.items():
            if name.endswith("_error"):
                continue
            values = value if isinstance(value, dict) else {"": value}
            found |= {f"{part}.{name}.{axis}": (x, facts[f"{name}_error"]) for axis, x in values.items()}
    return found


@pytest.mark.parametrize("rtol", [1e-5, 1e-7, 1e-9])
def test_errors_of_a_flight_cover_it(rtol: float) -> None:
    scene = load_scene_text(TREBUCHET)
    exact = figures(simulate(with_rtol(scene, 1e-13)))
    for name, (value, error) in figures(simulate(with_rtol(scene, rtol))).items():
        assert abs(value - exact[name][0]) <= 3.0 * error + exact[name][1], name
        assert error <= 1e-2 * max(1.0, abs(value)), name


def with_rtol(scene: Any, rtol: float) -> Any:
    return dataclasses.replace(
        scene, simulate=dataclasses.replace(scene.simulate, rtol=rtol, atol=0.01 * rtol)
    )


@given(*(st.floats(-5.0, 5.0) for _ in range(3)))
def test_the_time_of_coming_down_is_the_first_falling_root(height: float, rise: float, bend: float) -> None:
    times = np.linspace(0.0, 50.0, 200_001)[1:]
    heights = height + rise * times + 0.5 * bend * times**2
    falls = np.flatnonzero((heights[:-1] > 1e-9) & (heights[1:] <= -1e-9))
    found = _comes_down(height, rise, bend)
    if len(falls):
        assert found is not None and times[falls[0]] - 1e-3 <= found <= times[falls[0] + 1] + 1e-3
    elif found is not None:
        assert found > 49.0 or abs(height + rise * found + 0.5 * bend * found**2) < 1e-6


def test_what_never_comes_down_is_told() -> None:
    result = simulate(load_scene_text(TREBUCHET.replace("range: {}", "range: {through: [0, 1000, 0]}")))
    facts = result.summary["payloads"]["stone"]
    assert "landing" not in facts and facts["release"]["energy"] > 0.0
    assert any("never comes down" in text for text in result.summary["warnings"])
    assert result["flights/stone/time"][-1] == result.time[-1]


@pytest.mark.parametrize(
    "text, words",
    [
        (TREBUCHET.replace(', until: {when: "0.3 - pouch.x"}', ""), "it is not released; add 'until'"),
        (TREBUCHET.replace("-9.81", "0"), "key 'normal' is missing: without gravity no side is up"),
    ],
)
def test_a_range_that_means_nothing_is_refused(text: str, words: str) -> None:
    with pytest.raises(SceneError) as caught:
        load_scene_text(text)
    assert words in caught.value.message


def test_pictures_show_the_payload_where_it_flies() -> None:
    result = simulate(load_scene_text(TREBUCHET))
    drawing = make_drawing(result, np.arange(len(result.time)))
    (part,) = (part for part in drawing.parts if part.kind == "payload")
    centres = drawing.vertices[:, list(part.vertices)].mean(axis=1)
    t, p = result["flights/stone/time"], result["flights/stone/position"]
    for k, time in enumerate(result.time):
        if time <= t[0]:
            continue
        expected = p[-1] if time >= t[-1] else p[int(np.argmin(np.abs(t - time)))]
        assert centres[k] == pytest.approx(expected, abs=1e-9)
    assert np.isfinite(centres).all()
