"""The forms in which a frame's orientation is given: the same rotation, and what is no rotation is refused."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from robodyn_cli.errors import SceneError
from robodyn_cli.model.build import build_model
from robodyn_cli.model.model import Model
from robodyn_cli.scene.load import load_scene_text
from tests.numeric import assert_close
from tests.urdf_robots import real

SCENE = """\
schema: 1
gravity: [0, 0, -9.81]
robot:
  base: BASE
  joints: [{name: a, type: revolute, axis: [0, 0, 1], origin: ORIGIN}]
  links: [{name: l, mass: 1, com: [0, 0, 0]}]
  frames: {f: FRAME}
"""


def model(base: str = "{}", origin: str = "{}", frame: str = "{link: l}") -> Model:
    return build_model(
        load_scene_text(SCENE.replace("BASE", base).replace("ORIGIN", origin).replace("FRAME", frame))
    )


def listed(values: object) -> str:
    return str(np.asarray(values).tolist())


def forms(rotation: Rotation) -> list[str]:
    """Return the same rotation in every form; lengths of directions are any."""
    R = rotation.as_matrix()
    x, y, z, w = rotation.as_quat()
    turn = rotation.as_rotvec()
    angle = float(np.linalg.norm(turn))
    pairs = [("x", "y"), ("z", "x"), ("y", "z")]
    return [
        f"rpy: {listed(rotation.as_euler('xyz'))}",
        f"quaternion: {listed([w, x, y, z])}",
        f"quaternion: {listed([-w, -x, -y, -z])}",
        f"axis: {listed(3.0 * turn)}, angle: {angle!r}",
        f"axis: {listed(-turn)}, angle: {-angle!r}",
        f"matrix: {listed(R)}",
        *(
            f"{a}: {listed(7.0 * R[:, 'xyz'.index(a)])}, {b}: {listed(0.2 * R[:, 'xyz'.index(b)])}"
            for a, b in pairs
        ),
    ]


@pytest.mark.parametrize("seed", range(5))
def test_all_forms_of_a_rotation(seed: int) -> None:
    rotation = Rotation.random(random_state=seed)
    R = rotation.as_matrix()
    for form in forms(rotation):
        found = model(f"{{{form}}}", f"{{xyz: [1, 2, 3], {form}}}", f"{{link: l, {form}}}")
        assert_close(real(found.base.E).T, R, 1e-14)
        assert_close(real(found.bodies[0].X_tree.E).T, R, 1e-14)
        assert real(found.bodies[0].X_tree.r).tolist() == [1.0, 2.0, 3.0]
        assert_close(real(found.frames["f"].R), R, 1e-14)


def test_right_angles_are_exact() -> None:
    """Ones and zeros fold out of the equations."""
    for form in forms(Rotation.from_euler("xyz", [90, 0, 90], degrees=True)):
        assert set(real(model(origin=f"{{{form}}}").bodies[0].X_tree.E).ravel()) == {0.0, 1.0}, form


def test_few_digits_become_a_rotation() -> None:
    R = Rotation.from_euler("xyz", [0.3, -0.2, 1.1]).as_matrix()
    for digits, bound in ((4, 2e-4), (6, 2e-6)):
        rounded = np.round(R, digits)
        for form in (f"matrix: {listed(rounded)}", f"x: {listed(rounded[:, 0])}, y: {listed(rounded[:, 1])}"):
            found = real(model(origin=f"{{{form}}}").bodies[0].X_tree.E).T
            assert_close(found.T @ found, np.eye(3), 1e-14)
            assert np.abs(found - R).max() < bound
    kept = real(model(origin="{z: [0.1, 0, 1], x: [1, 0, -0.1003]}").bodies[0].X_tree.E).T
    assert_close(
        kept[:, 0], np.array([1, 0, -0.1003]) / np.hypot(1, 0.1003), 1e-15
    )  # the first in the order x, y, z


@pytest.mark.parametrize(
    ("form", "words"),
    [
        ("rpy: [0, 0, 0], quaternion: [1, 0, 0, 0]", "quaternion: gives the orientation twice, beside 'rpy'"),
        ("z: [0, 0, 1], x: [1, 0, 0], angle: 3", "twice"),
        ("axis: [0, 0, 1]", "axis: needs 'angle' beside it"),
        ("angle: 1", "angle: needs 'axis' beside it"),
        ("x: [1, 0, 0]", "1 of the axes x, y, z are given; allowed: two"),
        ("x: [1, 0, 0], y: [0, 1, 0], z: [0, 0, 1]", "3 of the axes"),
        ("x: [1, 0, 0], y: [0.1, 1, 0]", r"y: must be at right angles .*cosine 0.0995"),
        ("y: [0, 0, 0], x: [1, 0, 0]", "must not be zero"),
        ("quaternion: [1, 1, 0, 0]", "length 1.41421"),
        ("quaternion: [1, 0, 0]", "4 numbers"),
        ("matrix: [[1, 0, 0], [0, 1, 0], [0, 0, -1]]", "reflection"),
        ("matrix: [[1, 0, 0], [0, 1, 0.1], [0, 0, 1]]", "row 1 has length"),
        ("matrix: [[1, 0, 0], [0.6, 0.8, 0], [0, 0, 1]]", "rows 0 and 1 are not at right angles"),
        ("matrix: [[1, 0, 0], [0, 1, 0]]", "has 2 entries"),
    ],
)
def test_what_is_no_rotation(form: str, words: str) -> None:
    for place, where in ((0, "robot.base"), (1, "robot.joints.0.origin"), (2, "robot.frames.f")):
        given = [f"{{{form}}}" if place == k else "{}" for k in range(2)]
        frame = f"{{link: l, {form}}}" if place == 2 else "{link: l}"
        with pytest.raises(SceneError, match=words) as caught:
            model(*given, frame)
        assert caught.value.details["key"].startswith(where)
