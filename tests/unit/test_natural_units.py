"""Numbers with units: each key of the schema takes those of its kind and no others, and stores the SI value."""

from __future__ import annotations

import dataclasses
import itertools
import math
import re
from collections.abc import Iterator
from decimal import Decimal
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robodyn_cli.commands import SCENE_COMMANDS
from robodyn_cli.errors import SceneError
from robodyn_cli.expr import units
from robodyn_cli.expr.formula import parse
from robodyn_cli.expr.statements import IN_DEGREES, parse_expectation, parse_variation, written_arguments
from robodyn_cli.scene.load import load_scene_text
from robodyn_cli.scene.read import Reader
from robodyn_cli.scene.read_scalars import Names
from robodyn_cli.scene.text.nodes import Faults, Scalar, Source
from robodyn_cli.scene.types import Scene
from robodyn_cli.schema import fields as kinds
from robodyn_cli.summaries.keys import leaves_of

# by hand, from the definitions of the units (SI brochure; international yard and pound); those with pi are not exact
EXACT = {
    "m": "1", "km": "1e3", "dm": "0.1", "cm": "0.01", "mm": "1e-3", "um": "1e-6", "nm": "1e-9", "inch": "0.0254",
    "ft": "0.3048", "s": "1", "ms": "1e-3", "us": "1e-6", "min": "60", "h": "3600", "kg": "1", "g": "1e-3",
    "gram": "1e-3", "mg": "1e-6", "tonne": "1e3", "lb": "0.45359237", "N": "1", "mN": "1e-3", "kN": "1e3", "MN": "1e6",
    "lbf": "4.4482216152605", "Nm": "1", "Nmm": "1e-3", "Ncm": "0.01", "mNm": "1e-3", "kNm": "1e3", "J": "1",
    "mJ": "1e-3", "kJ": "1e3", "W": "1", "mW": "1e-3", "kW": "1e3", "Pa": "1", "kPa": "1e3", "MPa": "1e6",
    "GPa": "1e9", "bar": "1e5", "A": "1", "mA": "1e-3", "V": "1", "mV": "1e-3", "kV": "1e3", "ohm": "1",
    "mohm": "1e-3", "H": "1", "mH": "1e-3", "uH": "1e-6", "Hz": "1", "kHz": "1e3", "K": "1", "degC": "1", "rad": "1",
    "mrad": "1e-3",
}  # fmt: skip
WITH_PI = {
    "deg": math.pi / 180, "arcmin": math.pi / 10800, "arcsec": math.pi / 648000, "rev": 2 * math.pi, "rpm": math.pi / 30,
}  # fmt: skip


def numeric_keys(
    kind: kinds.Kind, path: str, unit: str, seen: set[type]
) -> Iterator[tuple[str, kinds.Kind, str]]:
    """Yield every key of the schema that holds numbers or formulas, with its unit."""
    if isinstance(kind, (kinds.Number, kinds.Vector, kinds.Formula, kinds.Integer)):
        yield path, kind, unit
    elif isinstance(kind, kinds.Section):
        if kind.cls in seen:
            return
        seen.add(kind.cls)
        for field in dataclasses.fields(kind.cls):
            if "kind" in field.metadata:
                key = f"{path}.{kinds.key_name(field)}"
                yield from numeric_keys(field.metadata["kind"], key, field.metadata["unit"], seen)
    elif isinstance(kind, (kinds.Tagged, kinds.Inline)):
        for name, cls in kind.registry().items():
            yield from numeric_keys(kinds.Section(cls), f"{path}.{name}", unit, seen)
    elif isinstance(kind, kinds.Either):
        for one in kind.kinds:
            yield from numeric_keys(one, path, unit, seen)
    elif hasattr(kind, "item"):
        yield from numeric_keys(kind.item, path, unit, seen)


KEYS = list(numeric_keys(kinds.Section(Scene), "", "", set()))
BY_UNIT = {(type(kind), unit): (path, kind) for path, kind, unit in KEYS}


def read(kind: kinds.Kind, unit: str, text: str) -> float:
    """Return the value of a text under a key of a kind, as the reader of scenes stores it."""
    reader = Reader(Names(), Faults(), {})
    node = Scalar(Source("scene.yaml", "."), 3, 7, text, text)
    if isinstance(kind, kinds.Formula):
        constant = reader.formula(kind, node, ("key",), unit).constant
        assert constant is not None
        return constant
    return reader.plain_number(kind, node, ("key",), unit or ("1" if isinstance(kind, kinds.Integer) else ""))


def spellings(form: str) -> list[str]:
    """Return a unit with each of its words in every other word for the same."""
    alike = {
        word: [other for other in (*EXACT, *WITH_PI) if units.table()[other].dims == units.table()[word].dims]
        for word in units.table()
    }
    # 1/s stands behind a number as s^-1
    form = {"1/(N m)^2": "N^-2 m^-2", "N m/(rad s)": "N m/rad/s", "N/(m s)": "N/m/s"}.get(form, form)
    if form.startswith("1/"):
        word, _, power = form[2:].partition("^")
        form = f"{word}^-{power or 1}"
    pieces = form.replace("^", " ^ ").replace("/", " / ").split(" ")
    choices = [alike.get(piece, [piece])[:6] for piece in pieces]
    texts = [" ".join(words).replace(" ^ ", "^").replace(" / ", "/") for words in itertools.product(*choices)]
    return [text for text in texts if units.of(text) is not None][:400]


def test_the_table_is_that_of_the_definitions() -> None:
    assert set(units.table()) == {*EXACT, *WITH_PI}
    for word, factor in EXACT.items():
        assert Fraction(units.table()[word].numerator, units.table()[word].denominator) == Fraction(factor)
    for word, value in WITH_PI.items():
        assert units.table()[word].factor == value


def test_every_unit_of_the_schema_is_understood() -> None:
    for path, _, unit in KEYS:
        for form in units.forms(unit) if unit else ():
            assert units.of(form) is not None, (path, form)


@pytest.mark.parametrize("sort, unit", sorted(BY_UNIT, key=str), ids=str)
def test_each_key_takes_its_units_and_refuses_others(sort: type, unit: str) -> None:
    path, kind = BY_UNIT[sort, unit]
    if not unit and not isinstance(kind, kinds.Integer):
        assert read(kind, unit, "250 mm") == 0.25  # parameters and gauges: of any kind
        return
    dims = set()
    for form in units.forms(unit or "1"):
        own = units.of(form)
        assert own is not None
        dims.add(own.dims)
        for spelling in spellings(form) if form != "1" else ():
            words = [word.partition("^") for word in spelling.replace("/", " /").split()]
            factor = Fraction(1)
            for word, _, power in words:
                exponent = int(power or 1) * (-1 if word[0] == "/" else 1)
                factor *= (
                    Fraction(EXACT.get(word.strip("/"), "0")) ** exponent if word.strip("/") in EXACT else 0
                )
            for number in ("3", "0.1", "12.75", "7.003e-4"):
                value = read(kind, unit, f"{number} {spelling}")
                if factor:
                    assert value == float(Fraction(Decimal(number)) * factor), (path, spelling)
                else:
                    own = units.of(spelling)
                    assert own is not None and value == pytest.approx(float(number) * own.factor, rel=1e-15)
    allowed_angle = any(form.startswith("rad") for form in units.forms(unit))
    for word, other in units.table().items():
        if other.dims in dims or (allowed_angle and other.dims == units.table()["rad"].dims):
            continue
        with pytest.raises(
            SceneError, match=rf"scene.yaml:3:7: key: '{word}' does not fit.*expected, 2 {word} is .*allowed"
        ):
            read(kind, unit, f"2 {word}")


@given(
    st.decimals(allow_nan=False, allow_infinity=False, min_value=0, max_value=10**9),
    st.sampled_from(sorted(EXACT)),
)
def test_a_number_with_an_exact_unit_is_the_nearest_float(number: Decimal, word: str) -> None:
    text = f"{number:f}"
    assert units.table()[word].value(text) == float(Fraction(Decimal(text)) * Fraction(EXACT[word]))


def test_numbers_of_very_many_digits_are_read() -> None:
    assert parse("0." + "1" * 6000 + " mm").constant == pytest.approx(1.0 / 9000.0, rel=1e-15)
    assert parse("1e-5000 mm").constant == 0.0


@pytest.mark.parametrize(
    "text, value, unit",
    [
        ("9.81 m/s^2 * 80 gram", 0.7848, "N"), ("(1 + 2) mm", 0.003, "m"), ("2*3 mm + 0.1", 0.106, "m"),
        ("sqrt(4 m^2)", 2.0, "m"), ("500mm", 0.5, "m"), ("5 N*m", 5.0, "N m"), ("max(1 mm, 2 mm)", 0.002, "m"),
        ("12 N cm", 0.12, "N m"), ("-90 deg", -math.pi / 2, "rad"), ("sin(90 deg)", 1.0, None), ("60 deg/2", math.pi / 6, "rad"),
        ("if(1 < 2, 3 mm, 4 mm)", 0.003, "m"), ("(2 s)^2", 4.0, "s^2"), ("1/(2 s)", 0.5, "1/s"),
    ],
)  # fmt: skip
def test_constants_have_the_unit_of_their_parts(text: str, value: float, unit: str | None) -> None:
    tree = parse(text)
    assert tree.constant == pytest.approx(value, rel=1e-15)
    assert (None if tree.dims is None else units.written(tree.dims)) == unit


@pytest.mark.parametrize(
    "text, words",
    [
        ("1/2 mm", "'mm' after '/' is ambiguous"), ("2 mm + 3 kg", "m and kg do not add up"),
        ("5 kgg", "'kgg' is no unit .did you mean 'kg'"), ("60 deg deg", "'deg' is allowed once"),
        ("2 x", "'x' is no unit"), ("sqrt(2 m)", "sqrt of a quantity in m has no unit"), ("3 N/m s", "unexpected 's'"),
        ("1e308 km", "too large"),
    ],
)  # fmt: skip
def test_what_has_no_unit_is_refused(text: str, words: str) -> None:
    with pytest.raises(SceneError, match=words):
        parse(text)


SCENE = """
schema: 1
gravity: [0, 0, 0]
command: simulate
parameters: {{k: {k}, s: 2}}
robot:
  joints:
    - {{name: swing, type: revolute, axis: [0, 0, 1], limits: {{lower: {low}, speed: {speed}}}, damper: {{damping: {c}}}}}
    - {{name: slide, type: prismatic, axis: [1, 0, 0], origin: {{xyz: [{x}, 0, 0]}}, spring: {{stiffness: 2, rest: {rest}}}}}
  links: [{{name: a, mass: {mass}}}, {{name: b, mass: 1}}]
initial: {{q: {{slide: {q}}}, qd: {{slide: {qd}}}}}
torques: {{swing: "{torque}"}}
simulate: {{duration: {duration}}}
expect: {{final.q.slide: "{slide}"}}
"""  # fmt: skip
PLAIN = {
    "k": "0.5", "low": "-0.5", "speed": "0.25", "c": "0.005", "x": "0.5", "rest": "0.01", "mass": "0.08", "q": "0.02",
    "qd": "0.1", "torque": "0.12*sin(t)", "duration": "0.5", "slide": "0.1 .. 0.3",
}  # fmt: skip
NATURAL = {
    "k": "50 N cm/rad", "low": "-500 mrad", "speed": "250 mrad/s", "c": "5 N mm s/rad", "x": "50 cm", "rest": "10 mm",
    "mass": "80 gram", "q": "20 mm", "qd": "100 mm/s", "torque": "12 N cm * sin(t)", "duration": "500 ms",
    "slide": "0.1 .. 300 mm",
}  # fmt: skip


def test_a_scene_with_units_is_that_in_si_and_so_is_its_text() -> None:
    plain, natural = (load_scene_text(SCENE.format(**values)) for values in (PLAIN, NATURAL))
    unit = natural.expect["final.q.slide"].unit
    expect = {"final.q.slide": dataclasses.replace(plain.expect["final.q.slide"], unit=unit)}
    same = {key: dataclasses.replace(x, text="") for key, x in natural.expect.items()}
    assert same == {key: dataclasses.replace(x, text="") for key, x in expect.items()}
    assert dataclasses.replace(natural, expect={}) == dataclasses.replace(plain, expect={})
    assert dataclasses.replace(load_scene_text(natural.text), text="") == dataclasses.replace(
        natural, text=""
    )


@pytest.mark.parametrize(
    "key, value, words",
    [
        ("low", "3 mm", "robot.joints.0.limits.lower: 'mm' does not fit joint 'swing': angle in rad expected, 3 mm is a length"),
        ("rest", "3 deg", "'deg' does not fit joint 'slide': length in m expected, 3 deg is an angle"),
        ("qd", "3 deg/s", "initial.qd.slide: 'deg/s' does not fit joint 'slide': speed in m/s expected"),
        ("torque", "5 N", "torques.swing: 'N' does not fit joint 'swing': torque in N m expected, 5 N is a force"),
        ("mass", "5 mm", "mass in kg expected, 5 mm is a length"),
        ("slide", "< 5 kg", "expect.final.q.slide: '< 5 kg' does not fit: length in m expected"),
        ("torque", "30 deg/s * t", "'s' is a unit here, and the name of a parameter"),
    ],
)  # fmt: skip
def test_a_unit_that_does_not_fit_is_refused_by_name(key: str, value: str, words: str) -> None:
    with pytest.raises(SceneError) as caught:
        load_scene_text(SCENE.format(**{**PLAIN, key: value}))
    assert words in caught.value.message


def test_set_and_numbers_as_they_are_written() -> None:
    text = SCENE.format(**NATURAL)
    assert load_scene_text(text, overrides=["robot.links.a.mass=70 gram"]).robot.links[0].mass == 0.07
    assert load_scene_text(text, overrides=["robot.links.a.mass#1=70"]).robot.links[0].mass == 0.07
    again = load_scene_text(text, overrides=["parameters.k=3 kg cm^2", "parameters.k#1=4"])
    assert again.parameters["k"] == 4e-4
    with pytest.raises(SceneError, match="has 1 number .3."):
        load_scene_text(text, overrides=["parameters.k=3 kg cm^2", "parameters.k#2=4"])


def test_statements_are_stored_in_si() -> None:
    for text, low, high in (
        ("12 s +- 10 ms", 11.99, 12.01),
        ("< 500 N mm", -math.inf, 0.5),
        ("1 mm .. 2 cm", 1e-3, 0.02),
    ):
        expected = parse_expectation(text)
        assert (expected.low, expected.high) == pytest.approx((low, high), rel=1e-15)
    assert parse_variation("uniform(80 gram, 0.1 kg)").arguments == (0.08, 0.1)
    assert written_arguments(parse_variation("uniform(5 deg, (5 + 5) deg)")) == ["5 deg", "(5 + 5) deg"]
    assert parse_variation(["1 mm", 0.002]).values == (0.001, 0.002)
    assert parse_variation("normal(500 mm, 5 %)").arguments == (0.5, 0.025)
    for text in ("uniform(1 mm, 2 kg)", "linspace(1, 2, 3 m)"):
        with pytest.raises(SceneError):
            parse_variation(text)


def test_figures_in_degrees_are_those_that_the_reader_knows() -> None:
    for command in SCENE_COMMANDS:
        for steps, leaf in leaves_of(command):
            assert (str(leaf.fact.unit) == "deg") == bool(IN_DEGREES.intersection(steps)), steps


POINTED = """
schema: 1
gravity: [0, 0, -9.81]
robot:
  joints:
    - {name: swing, type: revolute, axis: [0, 1, 0]}
    - {name: slide, type: prismatic, axis: [1, 0, 0]}
  links: [{name: a, mass: 1, com: [0.5, 0, 0]}, {name: b, mass: 1}]
  points: {tip: {link: a, at: [1, 0, 0]}}
torques: {swing: "SWING", slide: "SLIDE"}
"""
FITTING = [
    "-5 N m/rad * swing - 20 N mm s * qd.swing", "5 N * tip.z", "3 N m * sin(2 Hz * t) * cos(swing)", "3 N m * t",
    "-10*(qd.swing - 5 rpm)", "2*tip.z - 5 N m", "5 N*(tip.x - 3 mm)", "if(t < 500 ms, 1, 2)", "3 N m/s*t",
    "0.1 m*swing*5 N + 2 N m", "5 N/m*length(tip, base.origin)^2", "max(5 N m, 2*tip.x)", "p.free*tip.x - 3 N m",
    "20*(angle(tip, base.origin, a.com) - 5 deg)", "tip.x + tip.vx", "3 N*sqrt(tip.x^2 + (2 mm)^2)",
    "sin(t - 2 s)", "t - 2 s", "3 N m*t^2", "3 N m*(t - 2 s)^2", "sin(t/(3 s))", "exp(-(t - 500 ms)/(20 ms))",
    "3 N m*sin(90 deg/s*t)", "3 N m*sin(90 deg*t)", "step(t - 500 ms)", "sign(tip.x - 3 mm)", "3 N m*t/(2 s)",
    "5 N m*tip.x/(3 mm)", "3*atan2(tip.y, 3 mm)", "5 N m - 3 N m*t", "sin(tip.x - 3 mm)", "2^(t/(3 s))", "free*3 m*t",
]  # fmt: skip
UNFIT = {
    "tip.z - 5 s": "m and s do not add up",
    "if(t < 5 mm, 1, 2)": "s and m do not add up",
    "length(tip, base.origin) - 3 deg": "m and rad do not add up",
    "angle(tip, a.com, base.origin) - 3 mm": "rad and m do not add up",
    "speed(tip) - 3 rpm": "m/s and rad/s do not add up",
    "tip.vx - 3 mm": "m/s and m do not add up",
    "length_rate(tip, base.origin) - 3 mm": "m/s and m do not add up",
    "swing - 3 mm": "rad and m do not add up",
    "qd.slide*2 + (slide - 3 mm/s)": "m and m/s do not add up",
    "min(tip.x, 5 kg)": "m and kg do not add up",
    "t - 5 deg": "s and rad do not add up",
    "atan2(tip.y, 5 s)": "m and s do not add up",
    "10 m*t + swing": "m s and rad do not add up",
    "5 N m * tip.z": "torque in N m expected, the formula '5 N m * tip.z' is",
    "2*tip.z - 5 kg": "torque in N m expected, the formula '2*tip.z - 5 kg' is a mass",
    "3 N m/s*qd.slide": "torque in N m expected",
    "2 m * t": "torque in N m expected, the formula '2 m * t' is in m s",
    "30 deg * t": "torque in N m expected",
    "3 kg * t^2": "torque in N m expected",
    "2 N * sin(t)": "torque in N m expected, the formula '2 N * sin(t)' is a force",
    "3 kg / t": "torque in N m expected",
    "sin(3 m)": "sin takes a number or an angle, not a quantity in m",
    "3 N m*cos(3 m * t)": "cos takes a number or an angle, not a quantity in m s",
    "exp(2 kg*tip.x)": "exp takes a number or an angle, not a quantity in kg m",
    "2^(3 s)": "^ takes a number or an angle, not a quantity in s",
}


@pytest.mark.parametrize("formula", FITTING)
def test_formulas_whose_units_go_together_are_taken(formula: str) -> None:
    text = POINTED.replace("SWING", formula).replace("SLIDE", "0") + "parameters: {free: 2}\n"
    load_scene_text(text)


@pytest.mark.parametrize("formula", UNFIT)
def test_formulas_whose_units_do_not_go_together_are_refused(formula: str) -> None:
    with pytest.raises(SceneError, match="torques.swing") as caught:
        load_scene_text(POINTED.replace("SWING", formula).replace("SLIDE", "0"))
    assert UNFIT[formula] in caught.value.message


@pytest.mark.parametrize(
    "joint, formula, words",
    [
        ("swing", "10 m * t", "angle in rad expected, the formula '10 m * t' is in m s"),
        ("swing", "3 kg * t", "angle in rad expected"),
        ("slide", "30 deg * t", "length in m expected"),
        ("slide", "3 m/s^2 * t", "length in m expected"),
        ("swing", "30 deg * t", ""),
        ("swing", "30 deg/s * t + 5 deg * sin(t)", ""),
        ("swing", "2 Hz * t", ""),
        ("slide", "10 m * t", ""),
        ("slide", "3 m/s^2 * t^2", ""),
        ("slide", "t - 2 s", ""),
    ],
)
def test_formulas_of_positions_are_of_their_joint(joint: str, formula: str, words: str) -> None:
    text = POINTED[: POINTED.index("torques")] + f"prescribed: {{{joint}: '{formula}'}}\n"
    if not words:
        load_scene_text(text)
        return
    with pytest.raises(SceneError) as caught:
        load_scene_text(text)
    assert words in caught.value.message


def test_a_formula_of_very_many_times_is_read_at_once() -> None:
    load_scene_text(POINTED.replace("SWING", "2 s" + "*t" * 2000).replace("SLIDE", "2 N*sin(t)"))


def test_a_formula_is_of_the_kind_of_its_own_joint() -> None:
    text = POINTED.replace("SWING", "0").replace("SLIDE", "5 N m*sin(t)")
    with pytest.raises(SceneError, match="torques.slide: force in N expected.*is a torque"):
        load_scene_text(text)


@given(
    st.recursive(
        st.sampled_from(
            [
                "tip.x",
                "2",
                "3 mm",
                "4 s",
                "swing",
                "qd.slide",
                "t",
                "5 deg",
                "7 N",
                "free",
                "length(tip, base.origin)",
            ]
        ),
        lambda inner: st.one_of(
            st.builds("({} {} {})".format, inner, st.sampled_from("+-*"), inner),
            st.builds("sin({})".format, inner),
            st.builds("max({}, {})".format, inner, inner),
            st.builds("if({} < {}, 1, {})".format, inner, inner, inner),
            st.builds("({})^2".format, inner),
        ),
        max_leaves=8,
    )
)
def test_a_formula_without_units_fits_every_key(formula: str) -> None:
    """What is refused is refused for a unit that stands in the formula: without units it is taken."""
    bare = re.sub(r"([0-9]) (mm|s|deg|N)", r"\1", formula)
    for text in (bare, formula):
        try:
            load_scene_text(POINTED.replace("SWING", text).replace("SLIDE", "0") + "parameters: {free: 2}\n")
        except SceneError as error:
            assert text != bare and (
                "add up" in error.message or "expected" in error.message or "takes a number" in error.message
            )
