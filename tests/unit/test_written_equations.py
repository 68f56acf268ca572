"""The equations that ``robodyn equations`` writes: the lecture's, those of the compiled functions, in every form."""

from __future__ import annotations

import json
import math
import re
import shutil
import subprocess
import types
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from robodyn_cli.cli.app import app
from robodyn_cli.expr.graph import Expr, free_symbols
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.scene.load import Family, load_scene
from robodyn_cli.scene.types import Scene
from robodyn_cli.works.equations import written as writing
from robodyn_cli.works.equations.expand import MOST_ROOT, coefficient
from robodyn_cli.works.equations.latex import latex_of
from robodyn_cli.works.equations.names import Symbol
from robodyn_cli.works.equations.python import sympy_of
from robodyn_cli.works.equations.report import equations, written_of
from robodyn_cli.works.equations.terms import terms_of
from robodyn_cli.works.equations.text import WIDTH, TextForm, columns, text_of
from robodyn_cli.works.equations.tree import LONGEST, EquationFormula
from robodyn_cli.works.equations.written import Written, written
from robodyn_cli.works.functions.model import ModelFunctions
from tests.exported_robots import random_q, random_robot, scene_of

ROOT = Path(__file__).parents[2]
CONFIGS = ROOT / "configs"
FUNCTIONS = (
    "sin",
    "cos",
    "tan",
    "asin",
    "acos",
    "atan",
    "sinh",
    "cosh",
    "tanh",
    "exp",
    "log",
    "sqrt",
    "atan2",
)
EXACT = 1e-12  # of the largest entry: expanded sums of some hundred terms lose some digits


# -- what the forms say, as numbers ---------------------------------------------------------------------


def numeric(values: Mapping[str, float]) -> types.SimpleNamespace:
    """Return what stands for SymPy: its symbols are numbers."""
    return types.SimpleNamespace(
        Symbol=lambda name, real: values[name],
        Matrix=lambda rows: np.array(rows, dtype=float).reshape(len(rows), -1),
        Rational=lambda a, b: a / b,
        Abs=abs, Min=min, Max=max, floor=math.floor, sign=lambda x: float(np.sign(x)),
        Piecewise=lambda *pieces: next(value for value, holds in pieces if holds),
        **{name: getattr(math, name) for name in FUNCTIONS},
    )  # fmt: skip


def module_numbers(text: str, values: Mapping[str, float]) -> dict[str, Any]:
    """Return what the module of the equations gives with numbers in place of its symbols."""
    part = re.compile(
        r"^(w\d+_*) = sp\.Symbol\('\1', real=True\)\nwhere\.append\(\(\1,(.*?)\)\)$", re.M | re.S
    )
    text = part.sub(r"\1 = (\2)", text).replace("import sympy as sp", "")
    names: dict[str, Any] = {"sp": numeric(values)}
    exec(compile(text, "module", "exec"), names)
    return names


def state(w: Written, seed: int) -> tuple[dict[str, float], list[np.ndarray]]:
    """Return a number for each symbol, and the values of all terms of the graph there."""
    rng, problem = np.random.default_rng(seed), w.source.problem
    model = problem.model
    q, v, a = random_q(model, rng), rng.normal(size=model.nv), rng.normal(size=model.nv)
    values = {s.key: x for group, row in ((w.positions, q), (w.rates, v), (w.accelerations, a))
              for s, x in zip(group, row.tolist())}  # fmt: skip
    values |= {s.key: rng.uniform(0.5, 1.5) if s.value is None else s.value for s in w.legend}
    values |= {s.key: rng.normal() for s in w.multipliers}
    entries = [x for term in w.source.terms for x in term.entries.flat]
    inputs: dict[str, Any] = {"q": q, "v": v, "a": a}
    for symbol in free_symbols(entries):
        name, group, place = symbol.value
        if group not in ("q", "v", "a"):
            inputs.setdefault(group, {})[place] = values[w.names.symbol(name, group, place).key]
    numbers = evaluate(entries, inputs)
    sizes = [term.entries.size for term in w.source.terms]
    return values, [np.array(x, dtype=float) for x in np.split(np.array(numbers), np.cumsum(sizes)[:-1])]


def of_text(text: str, w: Written, values: Mapping[str, float]) -> float:
    """Return the value of a formula as it is printed on a terminal."""
    symbols: list[Symbol] = [*w.inputs.values(), *(s for s, _ in w.where)]
    by_text = {s.text: s.key for s in symbols}
    names = "|".join(re.escape(x) for x in sorted(by_text, key=len, reverse=True))
    functions = "|".join((*FUNCTIONS, "sign", "min", "max", "if", "else"))
    text = re.sub(f"(?<!\\w)({functions})(?!\\w)|({names})", lambda m: m[1] or f"({by_text[m[2]]})", text)
    text = re.sub(
        "[⁰¹²³⁴⁵⁶⁷⁸⁹⁻]+", lambda m: "**" + m[0].translate(str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻", "0123456789-")), text
    )
    text = re.sub(r"√(\d+)", r"sqrt(\1)", text).replace("·", "*").replace("^", "**")
    text = re.sub(r"\|([^|]*)\|", r"abs(\1)", text)
    text = text.replace("[", "(").replace("]", ")").replace(", else", " else")
    known = {name: getattr(math, name) for name in FUNCTIONS} | {"sign": np.sign}
    return float(eval(text, known | dict(values)))


def compare(w: Written, seed: int = 1, text_too: bool = True) -> None:
    """Check the module, and the text, against the graph and the compiled functions at a random state."""
    values, terms = state(w, seed)
    module = module_numbers(sympy_of(w), values)
    compiled = ModelFunctions(w.source.problem)
    q, v = (np.array([values[s.key] for s in group]) for group in (w.positions, w.rates))
    switched = any(s.value is None and s.key not in ("t",) and not s.key.startswith("tau") for s in w.legend)
    known = {} if switched else {
        "M": compiled.mass_matrix(q), "C": compiled.coriolis_torques(q, v), "G": compiled.gravity(q),
    }  # fmt: skip
    for name, array in known.items():
        got = module.get(name, np.zeros(array.shape))
        np.testing.assert_allclose(
            got.reshape(array.shape), array, rtol=0, atol=EXACT * (1 + np.abs(array).max())
        )
    parts = dict(values)
    for symbol, formula in w.where if text_too else ():
        parts[symbol.key] = of_text(TextForm().plain(TextForm().formula(formula)), w, parts)
    for term, expected in zip(w.terms, terms):
        least = EXACT * (1 + np.abs(expected).max())
        name = term.term.name
        if name != "tau":  # to which the module adds torques that are not given
            np.testing.assert_allclose(module[name].ravel(), expected, rtol=0, atol=least, err_msg=name)
        if text_too:
            entries = [TextForm().plain(TextForm().formula(x)) for row in term.rows for x in row]
            shown = [math.nan if "table" in x else of_text(x, w, parts) for x in entries]
            at = [k for k, x in enumerate(shown) if not math.isnan(x)]
            np.testing.assert_allclose(np.array(shown)[at], expected[at], rtol=0, atol=least, err_msg=name)


KINDS = [
    (("revolute", "prismatic"), ("spring", "damper", "rotor")),
    (("helical", "cylindrical", "fixed"), ("damper", "friction")),
    (("universal",), ()),
    (("planar", "revolute"), ("spring", "limits")),
    (("spherical",), ("spring", "ball rotor")),
    (("floating",), ()),
    (("revolute", "spherical", "prismatic", "universal", "helical"), ("friction", "rotor")),
]


@pytest.mark.parametrize(("kinds", "acting"), KINDS)
def test_random_robots(kinds: tuple[str, ...], acting: tuple[str, ...]) -> None:
    rng = np.random.default_rng(len(kinds) + len(acting))
    scene = scene_of(random_robot(rng, kinds, acting, len(kinds)))
    w = written("random", terms_of(scene), lambda key: "1")
    compare(w)
    assert bool(w.where) or w.expanded


SCENES = (
    "four_bar_deploy", "stick_slip", "catching_arm", "spinning_top", "four_bar_prescribed", "benchmarks/puma560",
    "benchmarks/spatial_slider_crank", "mechanisms/lift_arm", "search/spring_balance", "deployable_hinge",
)  # fmt: skip


@pytest.mark.parametrize("name", SCENES)
def test_example_scenes(name: str) -> None:
    w = written_of(Family(CONFIGS / f"{name}.yaml"))
    compare(w, seed=3)
    assert max(map(columns, text_of(w).split("\n"))) <= WIDTH
    balanced(latex_of(w))


def test_numbers_in_place_of_names() -> None:
    family = Family(CONFIGS / "2r_circle.yaml")
    plain, named = written_of(family, as_numbers=True), written_of(family)
    values, _ = state(named, 5)
    got, expected = (module_numbers(sympy_of(w), values) for w in (plain, named))
    for name in ("M", "C", "G"):
        np.testing.assert_allclose(got[name], expected[name], rtol=1e-14)
    assert not [s for s in plain.legend if s.value is not None]


def test_many_terms_and_many_joints_get_names_for_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = load_scene(CONFIGS / "arm_tilted.yaml")
    assert not written_as(scene).where
    monkeypatch.setattr("robodyn_cli.works.equations.expand.MOST_ALL", 20)
    assert written_as(scene).where
    compare(written_as(scene))
    monkeypatch.undo()
    monkeypatch.setattr(writing, "MOST_EXPANDED", 1)
    assert written_as(scene).where


def written_as(scene: Scene) -> Written:
    return written("", terms_of(scene), lambda key: "")


# -- the lecture ---------------------------------------------------------------------------------------


def lecture(sp: Any, e: Mapping[str, Any], second: str, links: tuple[str, str]) -> dict[str, Any]:
    """Return M, C and G of the lecture's planar 2R arm in its own symbols, angles theta1 and ``second``."""
    (m1, r1, I1), (m2, r2, I2) = ([e[f"{x}_{link}"] for x in ("m", "cx", "Izz")] for link in links)
    l1, g = e["a_theta1"], e.get("g", 0)
    q1, q2, v1, v2 = e["theta1"], e[second], e["theta1_d"], e[f"{second}_d"]
    c2, s2 = sp.cos(q2), sp.sin(q2)
    M12 = m2 * (r2**2 + l1 * r2 * c2) + I2
    return {
        "M": sp.Matrix([[m1 * r1**2 + I1 + I2 + m2 * (l1**2 + r2**2 + 2 * l1 * r2 * c2), M12], [M12, m2 * r2**2 + I2]]),
        "C": sp.Matrix([-m2 * l1 * r2 * s2 * (2 * v1 * v2 + v2**2), m2 * l1 * r2 * s2 * v1**2]),
        "G": sp.Matrix([m1 * g * r1 * sp.cos(q1) + m2 * g * (l1 * sp.cos(q1) + r2 * sp.cos(q1 + q2)),
                        m2 * g * r2 * sp.cos(q1 + q2)]),
    }  # fmt: skip


def same_at_20_states(sp: Any, got: Any, expected: Any, e: Mapping[str, Any]) -> None:
    """Check that a difference is zero, with 30 digits, at random states and numbers."""
    rng = np.random.default_rng(4)
    difference = sp.Matrix(got) - sp.Matrix(expected)
    for _ in range(20):
        at = {
            s: sp.Rational(int(rng.integers(-999, 999)), 300)
            for s in sorted(difference.free_symbols, key=str)
        }
        assert all(abs(x) < 1e-25 for x in difference.subs(at).evalf(30))


def sympy_module(name: str) -> dict[str, Any]:
    names: dict[str, Any] = {}
    exec(sympy_of(written_of(Family(CONFIGS / f"{name}.yaml"))), names)
    return names


def test_the_arm_is_the_lectures() -> None:
    sp = pytest.importorskip("sympy")
    e = sympy_module("2r_circle")
    for name, expected in lecture(sp, e, "theta2", ("link1", "link2")).items():
        same_at_20_states(sp, e[name], expected, e)
    tau = e["M"] * e["qdd"] + e["C"] + e["G"] - e["tau"]
    same_at_20_states(sp, e["residual"], tau, e)
    assert [e["values"][e[key]] for key in ("m_link2", "cx_link1", "g")] == [12.456, 0.773, 9.81]


def test_the_four_bar_is_the_lectures() -> None:
    sp = pytest.importorskip("sympy")
    e = sympy_module("four_bar_deploy")
    arm = lecture(sp, e, "phi2", ("crank", "coupler"))
    M = sp.diag(arm["M"], e["m_follower"] * e["cx_follower"] ** 2 + e["Izz_follower"])
    same_at_20_states(sp, e["M"], M, e)
    same_at_20_states(sp, e["C"], [*arm["C"], 0], e)
    q1, q2, q3 = e["q"]
    l1, l2, l3, l0 = (e[key] for key in ("a_theta1", "a_phi2", "a_phi1", "x_phi1"))
    eta = sp.Matrix([l1 * sp.cos(q1) + l2 * sp.cos(q1 + q2) - l0 - l3 * sp.cos(q3),
                     l1 * sp.sin(q1) + l2 * sp.sin(q1 + q2) - l3 * sp.sin(q3)])  # fmt: skip
    Psi = eta.jacobian(e["q"])
    gamma = (Psi * e["qd"]).jacobian(e["q"]) * e["qd"]
    for got, expected in ((e["eta"], eta), (e["Psi"], Psi), (e["gamma"], gamma)):
        same_at_20_states(sp, got, expected, e)
    same_at_20_states(sp, e["tau"], [1.96 - 0.1 * q1, 0, 0], e)


# -- forms ---------------------------------------------------------------------------------------------


def balanced(document: str) -> None:
    """Check that braces and environments of a LaTeX document are closed, and that all of it is plain letters."""
    assert document.isascii()
    bare = re.sub(r"\\[{}\\]", "", document)
    depth = np.cumsum([(x == "{") - (x == "}") for x in bare])
    assert depth.min() == 0 and depth[-1] == 0
    opened: list[str] = []
    for kind, name in re.findall(r"\\(begin|end)\{(\w+\*?)\}", document):
        if kind == "begin":
            opened.append(name)
        else:
            assert opened.pop() == name
    assert not opened


ODD = r"""
schema: 1
title: "Odd \\ \" titles ''' \"\"\" and $math_{x}$ #1 %"
gravity: [0.1, -9.81, 0]
command: simulate
parameters: {k0: 3.5}
robot:
  joints:
    - {name: M, type: revolute, axis: [0, 0, 1], parent: base, link: a}
    - {name: w1, type: prismatic, axis: [1, 0, 0], parent: a, link: theta1, origin: {xyz: [0.5, 0, 0]}}
    - {name: lambda, type: revolute, axis: [0, 0, 1], parent: theta1, link: theta_1, origin: {xyz: [0.5, 0, 0]}}
  links:
    - {name: a, mass: 1, com: [0.2, 0.1, 0], inertia: {zz: 0.1}}
    - {name: theta1, mass: 2 lb, com: [0.2, 0.1, 0], inertia: {zz: 0.1}}
    - {name: theta_1, mass: 1, com: [0.2, 0.1, 0], inertia: {}}
  points:
    tip: {link: theta_1, at: [0.4, 0, 0]}
    anchor: {link: base, at: [1, 1, 0]}
forces:
  - {name: cord, type: spring, between: [anchor, tip], stiffness: 20, length: 0.5}
torques: {M: "k0*sin(2*t) - 3*abs(qd.M)", w1: {table: [[0, 0], [1, 1], [2, 4]]}}
initial: {q: {M: 0.1, w1: 0, lambda: 0.2}}
"""


@pytest.fixture
def odd(tmp_path: Path) -> Family:
    path = tmp_path / "odd.yaml"
    path.write_text(ODD)
    return Family(path)


def test_names_that_mean_something_else(odd: Family) -> None:
    """Joints called as matrices, words of Python and parts are; titles that end texts; data that are not given."""
    w = written_of(odd)
    compare(w, seed=2)
    keys = [s.key for s in w.inputs.values()]
    texts = [s.text for s in (*w.inputs.values(), *(s for s, _ in w.where))]
    assert len(set(texts)) == len(texts) and len(set(keys)) == len(keys)
    assert {"M_", "lambda_", "w1", "m_theta1", "m_theta_1", "Izz_theta_1"} <= set(keys)
    unknown = w.inputs["Izz_theta_1"]
    assert unknown.value is None and "not given" in unknown.meaning
    assert w.inputs["m_theta1"].value == pytest.approx(2 * 0.45359237) and w.inputs["m_theta1"].unit == "kg"
    balanced(latex_of(w))


def test_a_table_is_a_function(odd: Family) -> None:
    w = written_of(odd)
    values, _ = state(w, 1)
    at = [float(module_numbers(sympy_of(w), {**values, "t": t})["tau"][1, 0]) for t in (-1, 0.5, 1.25, 3)]
    assert at == pytest.approx([0, 0.5, 1.75, 4])


def nodes(w: Written) -> Iterator[EquationFormula]:
    """Yield all parts of all formulas."""
    pending = [x for term in w.terms for row in term.rows for x in row] + [x for _, x in w.where]
    while pending:
        yield (x := pending.pop())
        pending += x.args


GEAR = """
schema: 1
gravity: [0, -9.81, 0]
command: inverse
robot:
  joints:
    - {name: theta, type: revolute, axis: [0, 0, 1], gear_ratio: 10, rotor_inertia: 0.001, gear: {efficiency: 0.8},
       friction: {viscous: 0.1, coulomb: 0.2}}
  links: [{name: a, mass: 1, com: [0.3, 0, 0], inertia: {zz: 0.01}}]
trajectory: {type: joint, duration: 1, q: {theta: "sin(2*t)"}}
"""


def test_losses_of_gears_follow_from_the_load(tmp_path: Path) -> None:
    """With a given motion they are part of the equations, and alternatives that are long have names."""
    path = tmp_path / "gear.yaml"
    path.write_text(GEAR)
    w = written_of(Family(path))
    for seed in range(4):
        compare(w, seed)
    assert w.forces == ["friction", "gear"] and not w.source.notes
    choices = [x for x in nodes(w) if x.op == "where"]
    assert choices and all(a.leaves <= LONGEST for x in choices for a in x.args)


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="no LaTeX here")
def test_the_document_compiles(odd: Family, tmp_path: Path) -> None:
    for k, family in enumerate((odd, Family(CONFIGS / "four_bar_deploy.yaml"))):
        (tmp_path / f"{k}.tex").write_text(latex_of(written_of(family)))
        command = ["pdflatex", "-draftmode", "-interaction=nonstopmode", "-halt-on-error", f"{k}.tex"]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, check=False)
        assert done.returncode == 0 and b"Overfull" not in done.stdout, done.stdout[-2000:]


def test_the_docs_show_what_is_printed() -> None:
    page = (ROOT / "docs" / "cli.md").read_text("utf-8")
    shown = page.partition("### Options of equations")[2].partition("```\n  M(q)")[2].partition("```")[0]
    document = equations(CONFIGS / "2r_circle.yaml").document
    assert f"  M(q){shown.partition(chr(10))[0]}" in document
    assert shown.partition("\n\n")[2].strip() in document


def test_what_is_no_part_is_named() -> None:
    left_out = {
        "cart_pole_lqr": "controller (lqr)", "four_bar_deploy": "latch", "stick_slip": "sticking",
        "bouncing_pendulum": "rigid stop", "2r_drives": "brakes",
    }  # fmt: skip
    for name, part in left_out.items():
        notes = written_of(Family(CONFIGS / f"{name}.yaml")).source.notes
        assert any(part in note for note in notes), name


@pytest.mark.parametrize(
    "value", [0.5, 2.0, math.sqrt(3) / 2, -math.sqrt(2) / 4, math.sqrt(MOST_ROOT), 0.3, 1 / 3]
)
def test_roots_are_written_as_roots(value: float) -> None:
    got = math.prod(math.sqrt(f.args[0].value) if f.op == "sqrt" else f.value for f in coefficient(value))
    assert got == pytest.approx(abs(value), rel=1e-14)


def test_formulas_have_names_only_of_symbols() -> None:
    """Every leaf is a number or a symbol, and no symbol of the graph is without a name."""
    w = written_of(Family(CONFIGS / "four_bar_deploy.yaml"))
    for x in nodes(w):
        assert x.args or x.op in ("name", "number")
    assert not isinstance(w.terms[0].rows[0][0], Expr)


def test_the_command_line(tmp_path: Path) -> None:
    scene, file = str(CONFIGS / "2r_circle.yaml"), tmp_path / "arm.py"
    call = CliRunner().invoke
    done = call(app, ["equations", scene, "--sympy", "--file", str(file), "--json"])
    report = json.loads(done.stdout)
    assert done.exit_code == 0 and file.read_text("utf-8").strip() == report["document"].strip()
    assert report["terms"]["M"]["entries"][1][1] == "Izz_link2 + m_link2*cx_link2**2"
    assert {s["name"]: (s["value"], s["unit"], s["key"]) for s in report["symbols"]}["m_link2"] == (
        12.456,
        "kg",
        "robot.links.link2.mass",
    )
    again = call(app, ["equations", scene, "--file", str(file)])
    assert again.exit_code == 74 and "exists already" in again.stderr
    both = call(app, ["equations", scene, "--latex", "--sympy"])
    assert both.exit_code == 2 and "one form at a time" in both.stderr
    changed = call(app, ["equations", scene, "--numbers", "--set", "robot.links.link2.inertia.zz=0"])
    assert changed.exit_code == 0 and f"M₂₂       = {12.456 * 0.583**2:.12g}" in changed.stdout
