"""Run a scene by a command in this process, as the command line does, and say what must not be."""

from __future__ import annotations

import contextlib
import dataclasses
import io
import json
import os
import re
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import yaml

from robodyn_cli.cli.app import run as run_words
from robodyn_cli.integrators.runtime.integrator import Integrator
from robodyn_cli.over.findings import findings
from tests.fuzz.cases import _signature, datasets_not_finite
from tests.pairs.reasons import reason_of

BEFORE_STEPS = (2, 3, 4, 5)


@dataclasses.dataclass
class Outcome:
    """How a command ended: exit code, what it printed, and whether it ended before its first step."""

    code: int
    out: str
    err: str
    early: bool = True
    finding: str = ""

    @property
    def message(self) -> str:
        """The error that ended it."""
        found = [line for line in self.err.splitlines() if line.startswith("robodyn: error: ")]
        return found[-1].removeprefix("robodyn: error: ") if found else ""


def write(tree: Mapping[str, Any], folder: Path, command: str | None = None) -> Path:
    """Write a scene, with the files that it names, for a command."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    files = {key: text for key, text in tree.items() if "." in key}
    for name, text in files.items():
        (folder / name).write_text(text, encoding="utf-8")
    own = {"command": command} if command else {}
    keys = {key: value for key, value in tree.items() if key not in files}
    path = folder / "scene.yaml"
    path.write_text(yaml.safe_dump({**keys, **own}, sort_keys=False), encoding="utf-8")
    return path


def call(words: list[str], folder: Path) -> Outcome:
    """Run a command line in a folder."""
    out, err, before = io.StringIO(), io.StringIO(), os.getcwd()
    steps: list[bool] = []
    with _told_of_steps(steps), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        os.chdir(folder)
        try:
            code = run_words(words)
        except SystemExit as end:
            code = int(end.code or 0)
        except Exception as error:
            code, finding = 70, f"{type(error).__name__} leaves the program: {error}"[:200]
            return Outcome(code, out.getvalue(), err.getvalue(), finding=finding)
        finally:
            os.chdir(before)
    said = err.getvalue()
    outcome = Outcome(code, out.getvalue(), said, early=not steps and "results until then" not in said)
    if code == 70 or "Traceback" in said:
        outcome.finding = _signature(said) if "Traceback" in said else outcome.message[:120]
    elif warning := re.search(r"^.*\w+Warning: .*$", said, re.MULTILINE):
        outcome.finding = f"a raw warning: {warning.group()[-120:]}"
    return outcome


@contextlib.contextmanager
def _told_of_steps(steps: list[bool]) -> Iterator[None]:
    """Note in a list that an integration has begun."""
    own: Callable[..., Any] = Integrator.run

    def run(*values: Any, **keys: Any) -> Any:
        steps.append(True)
        return own(*values, **keys)

    with mock.patch.object(Integrator, "run", run):
        yield


def judge(tree: Mapping[str, Any], command: str, folder: Path) -> list[str]:
    """Run a scene by one of the commands that a scene may name; return what must not be."""
    return judged(tree, command, folder)[1]


def judged(tree: Mapping[str, Any], command: str, folder: Path) -> tuple[Outcome, list[str]]:
    """Return the outcome too."""
    path = write(tree, folder, command)
    quick = ["--quick"] if command == "stability" else []
    done = call([command, "scene.yaml", "--no-plots", "--out", "out", *quick], folder)
    if done.finding:
        return done, [done.finding]
    found = []
    if done.code not in (0, 1, *BEFORE_STEPS):
        found.append(f"exit code {done.code}")
    refused = done.code in BEFORE_STEPS
    if refused and reason_of(done.message) is None:
        found.append(f"refused for no stated reason: {done.code}: {done.message}")
    if done.code in (0, 1):
        found += not_finite(folder / "out")
    found += against_validate(path, command, done)
    return done, found


def built(tree: Mapping[str, Any], command: str, folder: Path) -> list[str]:
    """Do with a scene what a command does before its first step; return what must not be."""
    try:
        errors = [f for f in findings(write(tree, folder, command)) if f.severity == "error"]
    except Exception as error:
        return [f"validate: {type(error).__name__}: {error}"]
    return [f"refused for no stated reason: {f.message}" for f in errors if reason_of(f.message) is None]


def against_validate(path: Path, command: str, done: Outcome) -> list[str]:
    """Return where ``validate`` says something else than the command before its first step."""
    try:
        errors = [(f.exit_code, f.message) for f in findings(path) if f.severity == "error"]
    except Exception as error:
        return [f"validate: {type(error).__name__}: {error}"]
    told = [(done.code, done.message)] if done.code in BEFORE_STEPS and done.early else []
    place = str(path)
    plain = [(code, text.replace(place, path.name)) for code, text in errors]
    if plain == told or (told and plain and told[0] in plain and plain[0][0] == done.code == 2):
        return []
    if told and plain and all(f"{command} needs " in text for _, text in plain) and " needs " in done.message:
        return []  # a message for each link, of which the command's says all
    return [f"validate says {plain or 'ok'}, {command} {told or f'runs (exit code {done.code})'}"]


def not_finite(results: Path) -> list[str]:
    """Return which data of a run that succeeded are not finite, and errors of 0 of figures that are not."""
    bad = [f"not finite: /{name}" for name in datasets_not_finite(results / "result.h5")]
    summary = json.loads((results / "summary.json").read_text(), parse_constant=lambda word: 1 / 0)
    return bad + list(_errors_of_nothing(summary, "summary"))


def _errors_of_nothing(tree: Any, place: str) -> Iterator[str]:
    if not isinstance(tree, dict):
        return
    errors = tree.get("errors")
    for key, value in tree.items():
        yield from _errors_of_nothing(value, f"{place}.{key}")
        if value is None and isinstance(errors, dict) and errors.get(key) == 0.0:
            yield f"an error of 0 for no figure: {place}.{key}"


# robots in other formats, each with the file that it is read from
FORMATS = {"urdf+": "scene.urdf", "extended-urdf": "scene.urdf", "mjcf": "scene.xml", "sdf": "scene.sdf"}
# other commands, with what tells calls of one apart behind the name: on the scene, and on the result that it has given
ON_SCENES: dict[str, tuple[str, ...]] = {
    "info": ("--no-plots",),
    "plan": (),
    "equations": ("--sympy",),
    "size": ("--no-plots",),
    "stability": ("--no-plots", "--quick"),
    "work-precision": ("--no-plots", "--methods", "gauss,dop853", "--tolerances", "1e-6", "--repeats", "1"),
    "crosscheck": ("--with", "pinocchio"),
    "crosscheck own": ("--with", "mujoco", "--own-settings", "--no-plots", "--out", "own"),
    **{f"export {kind}": ("--to", kind, "--out", kind) for kind in FORMATS},
    "sensitivity": ("--no-plots", "-j", "1", "--to", "gravity.1", "--of", "final.q.b"),
    "run": ("--no-plots", "-j", "1", "--out", "run"),
}
ON_RESULTS: dict[str, tuple[str, ...]] = {
    "check": ("out",),
    "compare": ("out", "out"),
    "export": ("out", "--to", "csv", "--out", "export"),
    "plot": ("out", "--out", "plots"),
    "report": ("out", "--file", "page.html"),
    "animate": ("out", "--file", "strip.png"),
}


def by_other_commands(tree: Mapping[str, Any], folder: Path, names: Sequence[str] | None = None) -> list[str]:
    """Run a scene, and its result, by commands that no scene names; return what must not be."""
    write(tree, folder, "simulate")
    found = []
    if call(["simulate", "scene.yaml", "--no-plots", "--out", "out"], folder).code in (0, 1):
        found += [(name, ON_RESULTS[name]) for name in ON_RESULTS if names is None or name in names]
    found += [
        (name, ("scene.yaml", *ON_SCENES[name])) for name in ON_SCENES if names is None or name in names
    ]
    wrong = []
    for name, words in found:
        command, _, kind = name.partition(" ")
        done = call([command, *words], folder)
        if kind in FORMATS and done.code == 0:  # what was written can be read
            done = call(["import", str(Path(kind) / FORMATS[kind]), f"{kind}.robot"], folder)
            done.finding = done.finding or done.message
        if done.finding or done.code not in (0, 1, *BEFORE_STEPS):
            wrong.append(f"{name}: {done.finding or done.code}")
    return wrong


SAME = (
    1e-9  # of a figure; stated errors, which are differences of runs near rounding, agree to a factor of two
)


def disagreements(tree: Mapping[str, Any], command: str, folder: Path) -> list[str]:
    """Return which figures and errors of a run differ from those of the same run among many, and in a sweep."""
    from robodyn_cli import Mechanism

    path = write(tree, folder, command)
    done = call([command, "scene.yaml", "--no-plots", "--out", "one"], folder)
    if done.code not in (0, 1):
        return []
    summary = json.loads((folder / "one" / "summary.json").read_text())
    figures = dict(_figures(summary, command))
    vary = [
        "--vary",
        "simulate.rtol=[1e-10, 1e-10]" if command == "simulate" else f"{command}.samples=[5, 5]",
    ]
    rows = call(["sweep", "scene.yaml", *vary, "-j", "1", "--no-plots", "--out", "many",
                 *(word for key in figures for word in ("--of", key))], folder)  # fmt: skip
    if rows.finding or rows.code not in (0, 1):
        return [f"sweep: {rows.finding or rows.message}"]
    mechanism = Mechanism(path)
    runs = mechanism.simulate_many if command == "simulate" else mechanism.inverse_many
    many = runs(of=list(figures))  # type: ignore[operator]
    if many.code[0] != done.code and done.code != 1:
        return [f"of many the run ends with {many.code[0]} ({many.reason[0]}), alone with {done.code}"]
    found = []
    for key, value in figures.items():
        other = float(many.outputs[key][0])
        allowed = (
            max(SAME * abs(value), 1e-12) if "error" not in key else max(abs(value), abs(other)) / 2 + 1e-15
        )
        if many.series[0]:  # runs by another method: that of its own error, and apart by both
            group = key.split(".")[1]
            both = float(many.errors[key][0]) + figures.get(f"error_estimate.{group}_end", np.inf)
            allowed = np.inf if "error" in key else max(allowed, both)
        if not abs(other - value) <= allowed:
            found.append(f"{key}: {value} alone, {other} of many")
    return found


def _figures(summary: Mapping[str, Any], command: str) -> Iterator[tuple[str, float]]:
    """Return keys of the summary, and their values, that one run and many have."""
    if command == "simulate":
        groups: list[tuple[str, Mapping[str, Any]]] = [
            (f"final.{name}", summary["final"][name]) for name in ("q", "qd")
        ]
        estimate = summary.get("error_estimate") or {}
        groups.append(("error_estimate", {k: estimate[k] for k in ("q_end", "qd_end") if k in estimate}))
    else:
        groups = [
            (f"joints.{name}", {k: joint[k] for k in ("peak_torque", "rms_torque") if k in joint})
            for name, joint in summary["joints"].items()
        ]
    for place, values in groups:
        for name, value in values.items():
            if isinstance(value, float):
                yield f"{place}.{name}", value
