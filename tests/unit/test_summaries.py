"""Summaries: every key is declared with its unit and meaning, and one walk finds it."""

from __future__ import annotations

import ast
import dataclasses
import math
import re
import typing
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest

from robodyn_cli.cli.words import coordinate_table
from robodyn_cli.commands import COMMANDS, SCENE_COMMANDS
from robodyn_cli.errors import SceneError
from robodyn_cli.over.many.command import error_of
from robodyn_cli.results.stated_errors import STATEMENTS
from robodyn_cli.results.summary import as_keys
from robodyn_cli.scene.load import load_scene
from robodyn_cli.summaries import keys
from robodyn_cli.summaries.facts import LOAD, RATE, Fact, Termination, UnitOf, rounded_up
from robodyn_cli.summaries.keys import (
    EVERY_RUN,
    SHORT,
    _written,
    fields_at,
    headline_rank,
    leaf_of,
    leaves_of,
    refusal,
)
from robodyn_cli.summaries.loops import LoopErrors, LoopMargins
from tests.source import files, name_of, nodes

pytestmark = pytest.mark.usefixtures("source_trees")
DESCRIBED = [name for name, command in COMMANDS.items() if command.summary]
NAMES = {
    "JOINT": ("theta1", "slide", "ball.wx"),
    "POINT": ("tip",),
    "LOOP": ("pin",),
    "ROW": ("pin.x", "latch.x"),
}
COORDINATES = {"theta1": "rad", "slide": "m", "ball.wx": "rad"}


def records(kind: Any) -> Iterator[type]:
    """Yield the records that a type holds, and those that they hold."""
    if dataclasses.is_dataclass(kind):
        yield kind  # type: ignore[misc]
        for inner, _ in fields_at(kind).values():  # type: ignore[arg-type]
            yield from records(inner)
    for inner in get_args(kind):
        yield from records(inner)


def of_command(command: str) -> dict[type, None]:
    """Return all records of the summary of a command."""
    fields = [fields_at(place).values() for place in (*EVERY_RUN, *COMMANDS[command].summary)]
    return dict.fromkeys(r for some in fields for kind, _ in some for r in records(kind))


ALL = dict.fromkeys(r for name in DESCRIBED for r in of_command(name))


@pytest.mark.parametrize("kind", ALL, ids=lambda kind: kind.__name__)
def test_every_field_says_what_it_is(kind: type) -> None:
    assert kind.__module__.startswith("robodyn_cli.summaries.")
    for field in dataclasses.fields(kind):
        fact = field.metadata["fact"]
        assert isinstance(fact, Fact) and fact.doc and fact.unit and fact.names, field.name
        assert "SI" not in str(fact.unit), field.name


@pytest.mark.parametrize("kind", ALL, ids=lambda kind: kind.__name__)
def test_types_hide_no_keys(kind: type) -> None:
    """Below ``Any`` a misspelt key is not found; what is known of the cause of a failure alone is open."""
    for name, (inner, _) in fields_at(kind).items():
        assert name == "termination" or Any not in _inner(inner), f"{kind.__name__}.{name}"


def _inner(kind: Any) -> set[Any]:
    return {kind, *(x for inner in typing.get_args(kind) for x in _inner(inner))}


@pytest.mark.parametrize("command", DESCRIBED)
def test_errors_are_keys_of_the_same_summary(command: str) -> None:
    for kind in of_command(command):
        for _, fact in fields_at(kind).values():
            assert all(key[1:].split(".")[0] in fields_at(kind) for key in fact.errors if key.startswith("."))
            for key in fact.errors:
                # a level of a quantile is one of a few words, other names may be any
                named = {"LEVEL": "5 %"}
                steps = [named.get(x, x.lower()) if x.isupper() else x for x in key.split(".")]
                leaf = leaf_of(command, ".".join(steps))
                # records that several commands share may have errors that one of them does not know
                assert leaf is None or leaf.is_number, f"{command}: {key}"


@pytest.mark.parametrize(
    ("command", "key", "unit"),
    [
        ("inverse", "joints.theta1.peak_torque", "N m"),
        ("inverse", "peak_torque.slide", "N"),
        ("inverse", "joints.ball.wx.peak_speed", "rad/s"),
        ("inverse", "joints.theta1.torque_range.0", "N m"),
        ("inverse", "drives.slide.joint.peak_torque", "N"),
        ("inverse", "drives.slide.shaft.peak_torque", "N m"),
        ("inverse", "drives.slide.ratio", "rad/m"),
        ("inverse", "error_estimate.torque_rounding", "N m or N"),
        ("inverse", "exit_code", "1"),
        ("kinematics", "points.tip.peak_speed", "m/s"),
        ("kinematics", "joints.slide.peak_acceleration", "m/s^2"),
        ("kinematics", "error_estimate.closure.velocity", "m/s or rad/s"),
        ("statics", "reactions.largest.base_wrench.peak_force", "N"),
        ("statics", "equilibrium.stiffness.0.1", "N m/rad or N/m"),
        ("reach", "branches.3.configuration.theta1", "rad"),
        ("size", "size.joints.slide.front.3.mass", "kg"),
        ("size", "drives.slide.joint.peak_torque", "N"),
        ("stability", "spectrum.fastest_decay", "1/s"),
        ("stability", "methods.3.seconds", "s"),
        ("stability", "cases.0.methods.rk4.relative", "1"),
        ("stability", "baumgarte.own.chosen.step", "s"),
        ("work-precision", "runs.0.run_time_s", "s"),
        ("work-precision", "baumgarte.alpha", "1/s"),
        ("sweep", "results.lock.time.quantiles.95 %", "as `unit` says"),
        ("sweep", "influence.peak_torque.theta1.robot.links.link2.mass.swing", "unit of the output"),
        ("sweep", "sobol_indices.lock.time.gravity.1.total_high", "1"),
        ("sweep", "yield.share", "1"),
        ("sensitivity", "sensitivities.lock.time.gravity.1.normalised", "1"),
        ("sensitivity", "seconds", "s"),
        ("plan", "kernels.0.operations", "1"),
        ("crosscheck", "compared.0.time", "s"),
        ("crosscheck", "accelerations.largest", "rad/s^2 or m/s^2"),
        ("compare", "results.3.datasets.0.ratio", "1"),
        ("run", "scenes.0.seconds", "s"),
        ("run", "scenes.0.baseline.datasets.0.stated", "unit of the dataset"),
        ("check", "criteria.0.found", "unit of the key"),
        ("validate", "scenes.0.findings.0.line", "1"),
        ("linearise", "modes.0.shape.theta1.1", "1 and rad"),
        ("linearise", "instants.2.modes.0.frequency", "Hz"),
        ("linearise", "holding_torques.slide", "N"),
    ],
)
def test_a_key_is_found_with_its_unit(command: str, key: str, unit: str) -> None:
    leaf = leaf_of(command, key)
    assert leaf is not None and leaf.is_number and leaf.fact.doc and leaf.fits(NAMES)
    assert leaf.unit(COORDINATES) == unit


@pytest.mark.parametrize(
    ("command", "key", "near"),
    [
        ("inverse", "round_tripp", "round_trip"),
        ("inverse", "peak_torqe.theta1", "peak_torque.theta1"),
        ("inverse", "peak_torque.theta3", "peak_torque.theta1"),
        ("inverse", "joints.thta1.peak_torque", "joints.theta1.peak_torque"),
        ("inverse", "drives.slide.shaft.peak_torq", "drives.slide.shaft.peak_torque"),
        ("inverse", "reactions.largest.base_wrnch.peak_force", "reactions.largest.base_wrench.peak_force"),
        ("statics", "constraint_residual.positon", "constraint_residual.position"),
        ("simulate", "final.q.slid", "final.q.slide"),
        ("deploy", "lock.tiem", "lock.time"),
        ("assemble", "branches.0.residul", "branches.0.residual"),
        ("kinematics", "points.tp.peak_speed", "points.tip.peak_speed"),
        ("deploy", "lock.latch.impulse.latch.xx", "lock.latch.impulse.latch.x"),
    ],
)
def test_a_slip_of_the_pen_is_refused_with_the_nearest_key(command: str, key: str, near: str) -> None:
    assert refusal(command, near, NAMES) == ""
    assert f"no such key (did you mean {near!r}?)" in refusal(command, key, NAMES)


@pytest.mark.parametrize("command", DESCRIBED)
def test_no_key_is_refused_that_a_refusal_would_propose(command: str) -> None:
    """As ``drives.theta1.errors.margin``, in which ``theta1.errors`` could be a name too."""
    proposed = list(_written(command, NAMES))
    assert proposed and [key for key in proposed if refusal(command, key, NAMES)] == []


def test_refusals_say_what_is_allowed() -> None:
    assert refusal("kinematics", "quite_another", NAMES).startswith(
        "the summary of kinematics has no such key; allowed: "
    )
    assert refusal("deploy", "after_lock.latch", NAMES).startswith(
        "holds several values; name one: after_lock.latch.peak_force"
    )
    assert refusal("deploy", "lock.kind", NAMES, number=True) == "is not a number but a text"
    assert refusal("deploy", "lock.kind", NAMES) == "" == refusal("deploy", "lock.time", NAMES, number=True)


def test_errors_name_what_was_passed_on_the_way() -> None:
    leaf = leaf_of("inverse", "drives.ball.wx.shaft.rms_torque")
    assert leaf is not None and leaf.errors == ("drives.ball.wx.shaft.errors.rms_torque",)
    torque = leaf_of("inverse", "rms_torque.theta1")
    assert torque is not None and set(torque.errors) == {
        "error_estimate.torque_rounding",
        "joints.theta1.errors.rms_torque",
    }
    pole = leaf_of("linearise", "instants.2.modes.0.real")
    assert pole is not None and pole.errors == ("instants.2.modes.0.error",)
    mean = leaf_of("sweep", "results.lock.time.mean")
    assert mean is not None and mean.errors == ("results.lock.time.mean_error",)
    level = leaf_of("sweep", "results.lock.time.quantiles.95 %")
    assert level is not None and level.errors == ("results.lock.time.quantile_errors.95 %",)
    branch = leaf_of("assemble", "branches.1.configuration.ball.wx")
    assert branch is not None and branch.errors == ("branches.1.errors.ball.wx",)
    text = leaf_of("inverse", "status")
    assert text is not None and not text.is_number


def test_what_holds_several_values_is_no_leaf() -> None:
    assert leaf_of("inverse", "joints") is None and leaf_of("inverse", "joints.theta1") is None


@pytest.mark.parametrize("command", DESCRIBED)
def test_every_key_that_is_listed_is_found(command: str) -> None:
    keys = [".".join(steps) for steps, _ in leaves_of(command)]
    assert leaves_of(command) is leaves_of(command)  # walked once, not for each result of a page
    assert "status" in keys and all(leaf_of(command, key) is not None for key in keys)


@pytest.mark.parametrize("command", DESCRIBED)
def test_the_short_way_to_a_joint_s_key_is_no_other_key(command: str) -> None:
    """So it does not matter in which of the records of a command it is looked for first."""
    heads = {steps[0] for steps, _ in leaves_of(command)}
    short = {steps[2] for steps, _ in leaves_of(command) if steps[0] == SHORT and len(steps) > 2}
    assert not (heads & short) - {"error"}, "that of a run that failed has no names below it"
    leaf = leaf_of(command, "error.message")
    assert leaf is not None and leaf.key == "error.message"


def test_a_joint_s_key_loads_no_records_of_what_few_runs_have(monkeypatch: pytest.MonkeyPatch) -> None:
    looked: list[str | type] = []
    monkeypatch.setattr(keys, "fields_at", lambda place: looked.append(place) or fields_at(place))
    leaf = leaf_of.__wrapped__("inverse", "peak_torque.theta1")
    assert leaf is not None and leaf.key == "joints.theta1.peak_torque"
    assert {place for place in looked if isinstance(place, str)} == {"inverse:InverseSummary"}


def test_units_follow_coordinates() -> None:
    unit = UnitOf("N m", "N")
    assert (unit("rad"), unit("m"), unit(), str(unit)) == ("N m", "N", "N m or N", "N m or N")


def test_what_is_added_to_a_summary_hides_none_of_its_keys() -> None:
    """Names of files, of the run and of its times are written over a command's own keys."""
    added = {key for place in EVERY_RUN for key in fields_at(place)} - {"status", "command", "title", "error"}
    written = [name for name in SCENE_COMMANDS if name in DESCRIBED] + ["sensitivity", "sweep"]
    for name in (*written, "stability", "work-precision"):
        own = {key for place in COMMANDS[name].summary for key in fields_at(place)}
        assert not own & added, name
    leaf = leaf_of("inverse", "baseline.datasets.0.stated")
    assert leaf is not None and leaf.unit({}) == "unit of the dataset"


@pytest.mark.parametrize(
    ("name", "key", "near"),
    [
        ("four_bar_deploy", "lock.latch.impulse.latch.mw", "lock.latch.impulse.latch."),
        ("four_bar_deploy", "lock.latch.impulse.pni.x", "lock.latch.impulse.pin.x"),
        ("four_bar_kinematics", "points.tpi.path_length", "points."),
    ],
)
def test_names_of_points_and_rows_are_those_of_the_scene(name: str, key: str, near: str) -> None:
    """Misspelt ones are refused when the scene is read, with the nearest; those that runs have are not."""
    path = next((Path(__file__).parents[2] / "configs").rglob(f"{name}.yaml"))
    with pytest.raises(SceneError, match=re.escape(f"did you mean '{near}")):
        load_scene(str(path), [f"expect={{{key}: 1}}"])


def test_errors_are_read_from_declarations() -> None:
    summary = {"command": "inverse", "error_estimate": {"torque_rounding": 1e-14}}
    errors = {"rms_torque": 3e-9, "peak_torque": 1e-15}
    summary["joints"] = {"a": {"rms_torque": 1.0, "peak_torque": 2.0, "peak_speed": 3.0, "errors": errors}}
    assert error_of(summary, "rms_torque.a") == error_of(summary, "joints.a.rms_torque") == 3e-9
    assert error_of(summary, "peak_torque.a") == 1e-14 and math.isnan(error_of(summary, "peak_speed.a"))
    lock = {"command": "deploy", "lock": {"time": 1.0, "time_error": 1e-9}}
    assert error_of(lock, "lock.time") == 1e-9 and math.isnan(error_of({}, "lock.time"))


def test_errors_that_results_state_are_keys_of_summaries() -> None:
    """Each statement belongs to some command, and its key is a number there, with a unit."""
    for statement in STATEMENTS:
        leaves = [leaf for name in DESCRIBED if (leaf := leaf_of(name, ".".join(statement.key))) is not None]
        assert leaves and all(leaf.is_number and leaf.unit({}) for leaf in leaves), statement.key
        assert len({leaf.unit({}) for leaf in leaves}) == 1, statement.key


@pytest.mark.parametrize(
    ("error", "digits", "printed"),
    [
        (1.924e-12, 2, 2.0e-12),
        (1.9e-12, 2, 1.9e-12),
        (0.2, 1, 0.2),
        (100.0 * 0.003, 1, 0.3),
        (9.91, 2, 10.0),
        (-1.21, 2, -1.3),
        (0.0, 2, 0.0),
        (math.inf, 2, math.inf),
        (5e-324, 1, 5e-324),
    ],
)
def test_errors_are_printed_rounded_up(error: float, digits: int, printed: float) -> None:
    assert rounded_up(error, digits) == printed
    assert abs(float(f"{printed:.{digits}g}")) >= abs(error) * (1.0 - 1e-15)


def printed_as_they_are(values: Iterable[ast.AST]) -> list[int]:
    """Return the lines of values in f-strings that round an error as any number."""
    return [
        node.lineno
        for node in values
        if isinstance(node, ast.FormattedValue)
        and node.format_spec is not None
        and re.search(r"[ge]$", ast.literal_eval(ast.unparse(node.format_spec).removeprefix("f")))
        and not isinstance(node.value, ast.Call)
        and re.search(r"error|residual|drift", re.split(r"[.\[]", ast.unparse(node.value))[-1])
    ]


def test_every_printed_error_is_rounded_up() -> None:
    for text, lines in (
        ("f\"{c['error']:.1e}\"", [1]),
        ("f'{one.our_error:.{n}g}'", [1]),
        ("f'{rounded_up(error):.1g} {error} {value:.6g}'", []),
    ):
        assert printed_as_they_are(ast.walk(ast.parse(text))) == lines
    some = [
        path for path in files() if re.search(r":[^\"\n]{0,20}[ge]\}", path.read_text(encoding="utf-8"))
    ]  # with such a format
    found = {name_of(path): printed_as_they_are(nodes(path, ast.FormattedValue)) for path in some}
    assert some and not {name: lines for name, lines in found.items() if lines}


def test_what_is_nothing_beside_its_peers_is_zero_on_the_terminal() -> None:
    units = {"a": "rad", "b": "rad", "c": "m"}
    told = coordinate_table(units, [("torque", {"a": 7.4, "b": -1.2e-18, "c": 5e-17}, LOAD, 6)])
    assert [line.split()[1:] for line in told.splitlines()[1:]] == [
        ["7.4", "N", "m"],
        ["0", "N", "m"],
        ["5e-17", "N"],
    ]
    alone = coordinate_table(units, [("torque", {"a": 5e-17}, LOAD, 6), ("rate", {"b": 1.0}, RATE, 6)])
    assert [line.split() for line in alone.splitlines()[1:]] == [["a", "5e-17", "-"], ["b", "-", "1"]]
    assert alone.splitlines()[0].split("  ")[-2:] == ["torque [N m]", "rate [rad/s]"]


def test_numbers_of_a_summary_are_those_of_python() -> None:
    """Also in maps and lists: what numpy makes of arrays prints as ``np.float64(0.1)``."""
    margin = LoopErrors(*np.arange(10.0))
    told = as_keys(LoopMargins(*[np.float64(1.5)] * 10, margin))
    assert {type(x) for x in (*told["errors"].values(), *list(told.values())[:-1])} == {float}
    spread = as_keys(Termination("end", np.float64(2.0)))
    assert repr(spread) == "{'reason': 'end', 'time': 2.0}"


HEADED = [name for name, command in COMMANDS.items() if command.headlines]


@pytest.mark.parametrize("command", HEADED)
def test_headlines_are_figures_with_words_and_an_error(command: str) -> None:
    """Only costs and masses of a catalogue are exact."""
    leaves = {".".join(steps): leaf for steps, leaf in leaves_of(command)}
    for k, key in enumerate(COMMANDS[command].headlines):
        leaf = leaves[key]
        assert leaf.fact.column, key
        assert leaf.fact.errors or command == "size" or key.endswith(".step"), key
        assert headline_rank(command, re.sub("[A-Z]{2,}", "a.b", key)) == k
    assert headline_rank(command, "no.such.key") == len(COMMANDS[command].headlines)
