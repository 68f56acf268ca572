"""Whatever the text, a scene loads or is refused with one SceneError; what loads survives its own text."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robodyn_cli.errors import SceneError
from robodyn_cli.expr.formula import parse
from robodyn_cli.scene import load_scene, load_scene_text
from robodyn_cli.scene.text.nodes import Node, Scalar, Source, mapping, scalar, sequence
from robodyn_cli.scene.text.yaml_text import emit
from tests.numeric import examples
from tests.unit.scene_text import composed, plain

CONFIGS = Path(__file__).parents[2] / "configs"
TEXTS = [load_scene(path).text for path in sorted(CONFIGS.glob("*.yaml"))]
PLACE = Scalar(Source("x", "."), 1, 1, "", None)

SNIPPETS = [
    *"-:?,[]{}#&*!|>'\"%@`~\t\n ",
    *("null", "true", ".nan", "-.inf", "1e999", "0x1", "1e-9", "-90 deg", "1/0", "theta1", "base", "end"),
    *(
        "&a ",
        "*a",
        "<<: ",
        "!!str ",
        "!!python/name:x ",
        "\n---\n",
        "include: ",
        "{}",
        "[]",
        "''",
        "é",
        "\x00",
    ),
    *(
        "\n  ",
        "\n- ",
        ": ",
        "name: ",
        "type: fixed",
        "file: ",
        "robot: ",
        "\ud800",
        "\u2028",
        "\ufeff",
        "9" * 400,
    ),
]


def survives(text: str, overrides: tuple[str, ...] = ()) -> bool:
    """Load a text: True if it is a scene, False if it is refused the way it must be."""
    try:
        scene = load_scene_text(text, overrides=overrides)
    except SceneError as error:
        assert "\n" not in error.message
        assert {"file", "line", "column", "key"} <= set(error.details)
        return False
    again = load_scene_text(scene.text)
    assert again == scene
    assert again.text == scene.text
    return True


@st.composite
def spoiled_scenes(draw: st.DrawFn) -> str:
    """A good scene with some pieces put in, taken out or moved."""
    text = draw(st.sampled_from(TEXTS))
    for _ in range(draw(st.integers(1, 3))):
        at = draw(st.integers(0, len(text)))
        end = min(len(text), at + draw(st.integers(0, 12)))
        other = draw(st.integers(0, len(text)))
        piece = draw(
            st.one_of(
                st.sampled_from(SNIPPETS),
                st.just(text[other : other + draw(st.integers(0, 60))]),
                st.text(max_size=5),
            )
        )
        text = text[:at] + piece + text[end:]
    return text


@given(spoiled_scenes())
@examples(600)
def test_spoiled_scenes(text: str) -> None:
    survives(text)


@given(st.text(max_size=60))
@examples(300)
def test_any_text(text: str) -> None:
    assert not survives(text)


@given(st.lists(st.sampled_from(SNIPPETS), max_size=25).map("".join))
@examples(400)
def test_any_yaml_like_text(text: str) -> None:
    assert not survives(text)


@given(st.binary(max_size=60))
@examples(100)
def test_any_bytes(tmp_path_factory: pytest.TempPathFactory, data: bytes) -> None:
    path = tmp_path_factory.mktemp("bytes") / "scene.yaml"
    path.write_bytes(data)
    with pytest.raises(SceneError):
        load_scene(path)


PATHS = st.one_of(
    st.sampled_from(
        [
            "title",
            "gravity",
            "gravity.1",
            "robot",
            "robot.joints",
            "robot.joints.0.a",
            "robot.joints.theta1.type",
            "robot.links.0.com",
            "robot.points.tip.at",
            "torques",
            "torques.theta1",
            "initial.q.theta1",
            "trajectory",
            "trajectory.q",
            "trajectory.type",
            "simulate.step",
            "simulate.stabilisation",
            "deploy.latch",
            "loops",
            "loops.0.between",
            "parameters.k",
            "schema",
        ]
    ),
    st.text(max_size=12),
)
VALUES = st.one_of(
    st.sampled_from(SNIPPETS), st.text(max_size=12), st.sampled_from(["1", "t", "[1, 2, 3]", "{a: 1}"])
)


@given(st.sampled_from(TEXTS), PATHS, VALUES, st.sampled_from(["=", "", "==", " = "]))
@examples(600)
def test_any_override(text: str, path: str, value: str, sign: str) -> None:
    survives(text, (f"{path}{sign}{value}",))


# -- formulas -----------------------------------------------------------------------------------------
TOKENS = [
    "1",
    "2.5",
    "1e-9",
    ".5",
    "t",
    "x",
    "q.x",
    "qd.x",
    "p.k",
    "k",
    "pi",
    "e",
    "deg",
    "+",
    "-",
    "*",
    "/",
    "^",
    "**",
    "(",
    ")",
    ",",
    "<",
    "<=",
    ">",
    ">=",
    "sin",
    "min",
    "max",
    "if(",
    "atan2(",
    "step(",
    "a.b",
]


@given(st.one_of(st.text(max_size=30), st.lists(st.sampled_from(TOKENS), max_size=20).map(" ".join)))
@examples(1500)
def test_any_formula(text: str) -> None:
    try:
        formula = parse(text).resolve(["x"], ["k"])
    except SceneError as error:
        assert "formula" in error.message and "\n" not in error.message
        return
    assert formula.names <= {"t", "q.x", "qd.x", "p.k"}
    assert formula.constant is None or math.isfinite(formula.constant)
    assert parse(formula.text).resolve(["x"], ["k"]) == formula


@st.composite
def sums(draw: st.DrawFn) -> tuple[str, float]:
    """A formula of constants with its value in Python's arithmetic, which follows the same precedence."""
    leaf = st.integers(1, 9).map(str)
    text = draw(
        st.recursive(
            leaf,
            lambda inner: st.one_of(
                st.tuples(inner, st.sampled_from(["+", "-", "*", "/"]), inner).map(" ".join),
                inner.map(lambda x: f"({x})"),
                inner.map(lambda x: f"-{x}"),
                st.tuples(inner, st.integers(0, 2)).map(lambda p: f"({p[0]})**{p[1]}"),
            ),
            max_leaves=12,
        )
    )
    try:
        return text, float(eval(text, {"__builtins__": {}}))  # the oracle: digits and operators made above
    except ZeroDivisionError:
        return text, math.nan


@given(sums())
@examples(200)
def test_arithmetic_is_pythons(case: tuple[str, float]) -> None:
    text, value = case
    if math.isnan(value):
        with pytest.raises(SceneError, match="division by zero"):
            parse(text)
        return
    assert parse(text).constant == pytest.approx(value, rel=1e-12, abs=1e-12)


# -- writing ------------------------------------------------------------------------------------------
SCALARS = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-(10**18), 10**18),
    st.floats(allow_nan=False),
    st.text(st.characters(exclude_categories=["Cs"]), max_size=20),
    st.sampled_from(
        ["true", "null", "~", "1e-9", "010", "- a", "a: b", "# a", "yes", "", " ", "a\nb", "-90 deg"]
    ),
)
TREES = st.recursive(
    SCALARS,
    lambda inner: st.one_of(
        st.lists(inner, max_size=4),
        st.dictionaries(
            st.text(st.characters(exclude_categories=["Cs"]), min_size=1, max_size=6), inner, max_size=4
        ),
    ),
    max_leaves=15,
)


def node_of(value: Any) -> Node:
    if isinstance(value, dict):
        return mapping(PLACE, [(scalar(PLACE, key), node_of(item)) for key, item in value.items()])
    if isinstance(value, list):
        return sequence(PLACE, [node_of(item) for item in value])
    return scalar(PLACE, value)


@given(st.lists(TREES, min_size=1, max_size=3))
@examples(300)
def test_every_tree_can_be_written(tree: Any) -> None:
    text = emit(node_of(tree))
    again = composed(text)
    assert plain(again) == tree
    assert repr(plain(again)) == repr(tree)  # 1 and 1.0 and true are different values
    assert emit(again) == text
