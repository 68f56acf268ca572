"""A joint has one colour and one dash in all pictures of a result, whatever columns they keep."""

from __future__ import annotations

from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.colors import to_hex

from robodyn_cli import load_scene_text, simulate
from robodyn_cli.report import draw
from robodyn_cli.report.drawing.build import make_drawing
from robodyn_cli.report.looks import POINTS, looks_of
from robodyn_cli.report.registry import applicable
from robodyn_cli.report.style import COLOURS, dashed_style, line_styles
from robodyn_cli.results.hdf5 import read, write
from robodyn_cli.results.result import Result

KINDS = ("revolute", "prismatic", "cylindrical", "spherical")


def _tree(rng: np.random.Generator) -> str:
    """Return a random chain of joints of several kinds, with points on some links."""
    kinds = ["revolute", *rng.choice(KINDS, int(rng.integers(2, 6)))]
    names = [f"{'zyxwvu'[k]}{k}" for k in range(len(kinds))]
    start = {"spherical": "[1, 0, 0, 0]", "cylindrical": "[0.1, 0]"}
    lines = ["schema: 1", "command: simulate", "gravity: [0, -9.81, 0]", "robot:", "  joints:"]
    for k, (name, kind) in enumerate(zip(names, kinds)):
        place = f"{_axis(kind, k)}, origin: {{xyz: [0.3, 0, 0]}}"
        lines.append(f"    - {{name: {name}, type: {kind}{place}}}")
    lines.append("  links:")
    for k in range(len(kinds)):
        lines.append(
            f"    - {{name: l{k}, mass: 1, com: [0.1, 0.02, 0], inertia: {{xx: 0.01, yy: 0.02, zz: 0.02}}}}"
        )
    lines.append("  points:")
    lines += [f"    p{k}: {{link: l{k}, at: [0.3, 0.1, 0]}}" for k in rng.permutation(len(kinds))[:3]]
    at = ", ".join(f"{name}: {start.get(kind, '0.1')}" for name, kind in zip(names, kinds))
    lines += [
        f"initial: {{q: {{{at}}}}}",
        "outputs: {reactions: true}",
        "simulate: {duration: 0.2, samples: 21}",
    ]
    return "\n".join(lines)


def _axis(kind: str, k: int) -> str:
    return "" if kind == "spherical" else f", axis: [0, {k % 2}, {1 - k % 2}]"


def _curves(figure: Any) -> dict[str, tuple[str, str]]:
    """Return colour and dash by the first word of the legend's texts, where these are of joints or points."""
    found = {}
    for box in figure.legends:
        for handle, text in zip(box.legend_handles, box.get_texts()):
            name = text.get_text().strip().strip("|").partition(":")[0]
            if name:
                found[name] = to_hex(handle.get_color()), str(handle._unscaled_dash_pattern[1])
    return found


def _of_joint(name: str, looks: Any, kind: str) -> tuple[str, str] | None:
    from matplotlib.lines import Line2D

    if not any(name == x or name.partition(".")[0] == x.partition(".")[0] for x in looks.places[kind]):
        return None
    line = Line2D([], [], **looks.lines([name], kind)[0])
    return to_hex(line.get_color()), str(line._unscaled_dash_pattern[1])  # type: ignore[attr-defined]


@pytest.mark.parametrize("seed", range(3))
def test_a_name_looks_the_same_in_all_plots(seed: int, tmp_path: Path) -> None:
    result = simulate(load_scene_text(_tree(np.random.default_rng(seed))))
    looks, seen = looks_of(result), 0
    stored = read(write(result, tmp_path / "r.h5"))
    assert looks_of(stored) == looks
    for name in applicable(result):
        kind = POINTS if name in ("tip_path", "point_motion", "point_coordinates") else "joints"
        for label, look in _curves(draw(result, name)).items():
            wanted = _of_joint(label, looks, kind)
            assert wanted is None or look == wanted, (name, label)
            seen += wanted is not None
    assert seen > 10


@pytest.mark.parametrize("seed", range(3))
def test_links_and_trails_have_the_colours_of_their_joints_and_points(seed: int) -> None:
    result = simulate(load_scene_text(_tree(np.random.default_rng(seed))))
    looks, drawing = looks_of(result), make_drawing(result)
    assert drawing.links and drawing.trails
    joints = list(dict.fromkeys(x.partition(".")[0] for x in looks.places["joints"]))
    for link, joint in zip(drawing.links, joints, strict=True):
        assert link.colour == looks.colour(joint)
    assert all(pin.colour == looks.colour(pin.name) for pin in drawing.pins)
    assert all(trail.colour == looks.colour(trail.name, POINTS) for trail in drawing.trails)


def test_columns_that_a_plot_leaves_out_change_no_look() -> None:
    """Torques of joints that have none are left out: the others keep their looks."""
    rng = np.random.default_rng(1)
    names, time = tuple(f"joint{k}" for k in range(12)), np.linspace(0.0, 1.0, 21)
    for _ in range(5):
        result = Result("inverse", "", "ok", "")
        result.add("time", time)
        work = rng.random(12) < 0.6
        work[int(rng.integers(12))] = True
        for path in ("q", "tau"):
            data = np.sin(np.outer(time, 1.0 + np.arange(12.0)))
            result.add(
                path,
                data * (work if path == "tau" else 1.0),
                names=names,
                units="rad" if path == "q" else "N m",
            )
        angles, torques = (_curves(draw(result, name)) for name in ("joint_angles", "torques"))
        assert torques and all(angles[name] == look for name, look in torques.items())


def test_looks_are_told_apart_by_colour_and_dash_and_the_first_by_dash_alone() -> None:
    looks = [(x["color"], str(x["linestyle"])) for x in map(dashed_style, range(64))]
    assert len(set(looks)) == 64
    assert len({dash for _, dash in looks[: len(COLOURS)]}) == len({x for x, _ in looks[: len(COLOURS)]}) == 8
    assert [x["color"] for x in line_styles(3)] == [x["color"] for x in line_styles(20)[:3]]


def test_rates_of_a_ball_go_by_its_position() -> None:
    result = Result("simulate", "", "ok", "")
    names = ("a", "ball.qw", "ball.qx", "ball.qy", "ball.qz", "b")
    result.add("q", np.zeros((2, 6)), names=names, units="1")
    result.add("qd", np.zeros((2, 5)), names=("a", "ball.wx", "ball.wy", "ball.wz", "b"), units="1/s")
    looks = looks_of(result)
    assert looks.placed(["a", "ball.wx", "ball.wz", "b", "ball", "other"]) == [0, 2, 4, 5, 1, 6]


def test_colours_differ_to_the_colour_blind() -> None:
    """By the matrices of Machado, Oliveira and Fernandes (2009), in CIELAB: 12 units at least, 2 are just seen."""
    kinds = {
        "normal": np.eye(3),
        "protan": [
            [0.152286, 1.052583, -0.204868],
            [0.114503, 0.786281, 0.099216],
            [-0.003882, -0.048116, 1.051998],
        ],
        "deutan": [
            [0.367322, 0.860646, -0.227968],
            [0.280085, 0.672501, 0.047413],
            [-0.011820, 0.042940, 0.968881],
        ],
        "tritan": [
            [1.255528, -0.076749, -0.178779],
            [-0.078411, 0.930809, 0.147602],
            [0.004733, 0.691367, 0.303900],
        ],
    }
    for kind, matrix in kinds.items():
        labs = [
            _lab(np.clip(np.array(matrix) @ _linear(colour), 0.0, 1.0)) for colour in (*COLOURS, "#000000")
        ]
        assert min(np.linalg.norm(a - b) for a, b in combinations(labs, 2)) > 12.0, kind


def _linear(colour: str) -> Any:
    c = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) / 255.0
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)


def _lab(rgb: Any) -> Any:
    m = [
        [0.4124564, 0.3575761, 0.1804375],
        [0.2126729, 0.7151522, 0.0721750],
        [0.0193339, 0.1191920, 0.9503041],
    ]
    xyz = np.array(m) @ rgb / np.array([0.95047, 1.0, 1.08883])
    f = np.where(xyz > 216 / 24389, np.cbrt(xyz), (24389 / 27 * xyz + 16) / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])
