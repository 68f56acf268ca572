"""The documentation says what the program does: keys, options, exit codes, examples, figures, links."""

from __future__ import annotations

import importlib
import importlib.util
import inspect
import re
import shlex
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import typer.main

import robodyn
import robodyn_cli
from robodyn_cli import deploy, errors, inverse, load_scene, load_scene_text, simulate
from robodyn_cli.cli.app import app
from robodyn_cli.commands import COMMANDS as ROWS
from robodyn_cli.errors import ALL
from robodyn_cli.expr.formula_tree import CONSTANTS, FUNCTIONS
from robodyn_cli.over.work_precision.work_precision import work_precision
from robodyn_cli.report.registry import PLOTS
from robodyn_cli.results.catalogue import GROUPS
from robodyn_cli.results.result import Result
from robodyn_cli.robots.examples import find_example
from robodyn_cli.scene.starters import STARTERS
from robodyn_cli.summaries.keys import EVERY_RUN
from tests.leaves import undeclared

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = sorted([*ROOT.glob("*.md"), *DOCS.glob("*.md"), *DOCS.glob("tutorials/*.md")])
GROUP: Any = typer.main.get_command(app)
COMMANDS = {name: GROUP.get_command(None, name) for name in GROUP.list_commands(None)}
RUNS = {
    "inverse": (inverse, "2r_circle"),
    "simulate": (simulate, "double_pendulum"),
    "deploy": (deploy, "four_bar_deploy"),
}

# what a fragment of a scene is completed with; keys that it gives itself are left out
ARM = {
    "schema": "schema: 1",
    "gravity": "gravity: [0, -9.81, 0]",
    "robot": "robot: robots/planar_2r.yaml",
}
PUMA = {**ARM, "robot": "robot: robots/puma560.yaml"}
FOUR_BAR = {
    "schema": "schema: 1",
    "gravity": "gravity: [0, 0, 0]",
    "robot": "robot: robots/four_bar.yaml",
    "loops": "loops: [{name: pin, type: revolute, between: [coupler.end, follower.end]}]",
    "initial": "initial: {q: {theta1: 0.01, phi1: 0.0102}, hold: [theta1]}",
}


def text(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


def blocks(page: str, language: str) -> Iterator[tuple[str, str]]:
    """Yield (content, comment above) of the fenced blocks of a page."""
    pattern = rf"(?:<!-- with: (\w+) -->\n)?^```{language}\n(.*?)^```$"
    for match in re.finditer(pattern, page, re.DOTALL | re.MULTILINE):
        yield match.group(2), match.group(1) or ""


def section(page: str, heading: str) -> str:
    """Return the text below a heading, up to the next one of its level or above."""
    level = heading.split()[0]
    _, found, rest = page.partition(f"\n{heading}\n")
    assert found, heading
    return re.split(rf"^#{{1,{len(level)}}} ", rest, maxsplit=1, flags=re.MULTILINE)[0]


@lru_cache
def reference(name: str = "make_scene_reference") -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, DOCS / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@lru_cache
def result(command: str) -> Result:
    run, scene = RUNS[command]
    return run(load_scene(ROOT / "configs" / f"{scene}.yaml"))


# -- the scene -----------------------------------------------------------------------------------------


def test_every_key_of_a_scene_is_in_the_reference() -> None:
    module, page = reference(), text("docs/scene.md")
    described = [match.group(2) for match in module.TABLE.finditer(page)]
    assert sorted(described) == sorted(module.sections())
    assert module.rewritten(page) == page, "run: python docs/make_scene_reference.py"
    for name, cls in module.sections().items():
        table = re.search(rf"<!-- keys: {name} -->\n(.*?)<!-- end -->", page, re.DOTALL)
        assert table is not None
        assert re.findall(r"^\| `(\w+)` \|", table.group(1), re.MULTILINE) == list(module.keys(cls))


def test_every_function_of_formulas_is_in_the_reference() -> None:
    part = section(text("docs/scene.md"), "## Formulas")
    words = set(re.findall(r"`(\w+)[`(]", part))
    assert {*FUNCTIONS, *CONSTANTS, "if", "t"} <= words


YAML_BLOCKS = [(page.name, *block) for page in PAGES for block in blocks(page.read_text("utf-8"), "yaml")]
BEGINNINGS = [f"{page} {' '.join(block.split())[:60]}" for page, block, _ in YAML_BLOCKS]


def completed(block: str, base: str) -> str:
    """Return an example with the lines above it that make it a scene."""
    given = re.findall(r"^(\w+):", block, re.MULTILINE)
    default = {"four_bar": FOUR_BAR, "puma560": PUMA}.get(base, ARM)
    return "\n".join([*(line for key, line in default.items() if key not in given), block])


@pytest.mark.parametrize(("page", "block", "base"), YAML_BLOCKS, ids=BEGINNINGS)
def test_examples_load(page: str, block: str, base: str) -> None:
    scene = load_scene_text(completed(block, base), str(ROOT / "configs" / "example.yaml"))
    assert scene.robot.joints


# -- the command line ----------------------------------------------------------------------------------


def options(command: str) -> set[str]:
    found = {name for p in COMMANDS[command].params if p.param_type_name == "option" for name in p.opts}
    return found | {"-h", "--help"}


def test_every_command_is_documented_with_its_options() -> None:
    page = text("docs/cli.md")
    described: dict[str, set[str]] = {}
    for heading in re.findall(r"^### Options of (.+)$", page, re.MULTILINE):
        table = section(page, f"### Options of {heading}")
        first = [row.split("|")[1] for row in table.splitlines() if row.startswith("| `")]
        names = {word for cell in first for word in re.findall(r"`(--?[\w-]+)", cell)}
        for command in re.split(r", | and ", heading):
            described[command] = names
    assert described == {command: options(command) for command in COMMANDS}
    for name in ("docs/cli.md", "README.md"):
        listed = re.findall(
            r"^\| `(?:robodyn )?([\w-]+)[` ]", section(text(name), "## Commands"), re.MULTILINE
        )
        assert set(listed) >= set(COMMANDS), name


def test_every_command_and_option_has_help() -> None:
    for name, command in COMMANDS.items():
        assert command.help, name
        for p in command.params:
            assert p.param_type_name == "argument" or p.help, f"{name} {p.name}"


def test_exit_codes() -> None:
    classes = [c for _, c in inspect.getmembers(errors, inspect.isclass) if c.__module__ == errors.__name__]
    raised = {c.__name__: c.exit_code for c in classes if c is not errors.RobodynError}
    codes = set(ALL)
    assert set(raised.values()) <= codes
    rows = re.findall(r"^\| (\d+) \|(.*)\|(.*)\|$", text("docs/cli.md"), re.MULTILINE)
    assert {int(code) for code, _, _ in rows} == codes
    named = {name: int(code) for code, _, cell in rows for name in re.findall(r"`(\w+)`", cell)}
    assert named == raised
    short = re.findall(r"^\| (\d+) \|", section(text("README.md"), "## Commands"), re.MULTILINE)
    assert {int(code) for code in short} == codes


def test_python_names() -> None:
    page = re.sub(r"^```.*?^```$", "", text("docs/python.md"), flags=re.DOTALL | re.MULTILINE)
    named = {word for code in re.findall(r"`([^`]+)`", page) for word in re.findall(r"\w+", code)}
    assert {*robodyn_cli.__all__, *robodyn.__all__} - {"__version__"} <= named


def test_environment_variables() -> None:
    sources = "".join(p.read_text("utf-8") for p in (ROOT / "robodyn_cli").rglob("*.py"))
    used = set(re.findall(r"\b(ROBODYN_[A-Z]+)\b", sources))
    documented = set(re.findall(r"^\| `(ROBODYN_[A-Z]+)` \|", text("docs/cli.md"), re.MULTILINE))
    assert used == documented


def shell_lines() -> list[tuple[str, str]]:
    written = [
        (page.name, line.partition("  #")[0].strip())
        for page in PAGES
        for block, _ in blocks(page.read_text("utf-8"), "sh")
        for whole in block.splitlines()
        for line in whole.split(" && ")
        if line.startswith("robodyn ")
    ]
    return written + [("--help", f"robodyn {line}") for name in ROWS for line in examples_of(name)]


def examples_of(name: str) -> tuple[str, ...]:
    return importlib.import_module(f"robodyn_cli.cli.commands.{name.replace('-', '_')}").EXAMPLES


@pytest.mark.parametrize("name", ROWS)
def test_every_command_has_examples(name: str) -> None:
    lines = examples_of(name)
    assert len(lines) >= (3 if COMMANDS[name].params[:-1] else 1) and len(set(lines)) == len(lines)
    assert all(line.split()[0] == name for line in lines)


@pytest.mark.parametrize(("page", "line"), shell_lines())
def test_shell_examples_are_possible(page: str, line: str) -> None:
    command, *rest = shlex.split(line.partition(" > ")[0])[1:]
    flags = {name for p in COMMANDS[command].params if getattr(p, "is_flag", False) for name in p.opts}
    scenes, overrides, value = [], [], ""
    while rest:
        word = rest.pop(0)
        if not word.startswith("-"):
            scenes.append(word)
            continue
        assert word in options(command)
        value = "" if word in flags else rest.pop(0)
        overrides += [value] if word == "--set" else []
    if command == "new":
        assert (scenes and scenes[0] in STARTERS) or find_example(value, ROOT / "configs")
        return
    for scene in scenes:
        if not scene.startswith("configs") or command == "import":
            continue  # what the reader makes, or a robot in another format
        found = list(ROOT.glob(scene))
        assert found, scene
        for path in found:
            for file in sorted(path.glob("*.yaml")) if path.is_dir() else [path]:
                load_scene(file, overrides)


def test_files_named_in_commands_exist() -> None:
    for page in PAGES:
        for block, _ in blocks(page.read_text("utf-8"), "sh"):
            for name in re.findall(r"\b(?:configs|benchmarks|docs|tests)/[\w./-]+", block):
                assert (ROOT / name).exists(), f"{page.name}: {name}"


def test_every_kind_of_new_scene_is_named() -> None:
    part = section(text("docs/cli.md"), "### Options of new").split("|")[0]
    assert set(STARTERS) <= set(re.findall(r"`(\w+)`", part))


def test_every_drawing_is_named() -> None:
    named = set(re.findall(r"`(\w+)`", section(text("docs/cli.md"), "## Output directory")))
    assert set(PLOTS) <= named


# -- summaries -----------------------------------------------------------------------------------------

# maps whose keys are names of joints, rows, factors or stages
BY_NAME = {"angles", "angles_deg", "rates", "rates_before", "rates_after", "impulse", "times", "growth_times"}
BY_NAME |= {"wall_time_s", "q", "qd"}


def test_every_record_of_summaries_has_its_table() -> None:
    module, page = reference("make_summary_reference"), text("docs/cli.md")
    tables = [match.group(2) for match in module.TABLE.finditer(page)]
    places = [*EVERY_RUN, *(place for row in ROWS.values() for place in row.summary)]
    assert sorted(tables) == sorted(set(places))
    assert module.rewritten(page) == page, "run: python docs/make_summary_reference.py"


def summary_keys(summary: dict[str, Any]) -> Iterator[str]:
    for key, value in summary.items():
        if key == "joints":
            yield key
            yield from summary_keys(next(iter(value.values())))
        elif key != "units":
            yield key
            inner = value if isinstance(value, list) else [value]
            if inner and isinstance(inner[0], dict) and key not in BY_NAME:
                yield from summary_keys(inner[0])


@pytest.mark.parametrize("command", [*RUNS, "work-precision"])
def test_every_key_of_a_summary_is_documented(command: str) -> None:
    page = section(text("docs/cli.md"), "## summary.json")
    words = {part for code in re.findall(r"`([^`]+)`", page) for part in re.findall(r"\w+", code)}
    if command in RUNS:
        summary = result(command).summary
    else:
        scene = load_scene(ROOT / "configs" / "double_pendulum.yaml")
        summary = work_precision(scene, ["gauss"], [1e-6], repeats=1).summary
    assert set(summary_keys(summary)) - words == set()
    assert not ROWS[command].summary or undeclared(summary) == []


def test_the_format_is_that_of_the_catalogue() -> None:
    module, page = reference("make_summary_reference"), text("docs/hdf5.md")
    assert [match.group(2) for match in module.DATASETS.finditer(page)] == list(GROUPS)
    assert len(module.ATTRIBUTE_TABLE.findall(page)) == 1
    assert module.rewritten(page) == page, "run: python docs/make_summary_reference.py"


# -- figures -------------------------------------------------------------------------------------------


def figures(command: str) -> list[str]:
    """Return the figures of a run that do not depend on the processor, as printed."""
    summary = result(command).summary
    if command == "inverse":
        joints = summary["joints"].values()
        return [f" {j[key]:.8f}" for j in joints for key in ("peak_torque", "rms_torque")]
    if command == "simulate":
        return []  # nothing but errors; the end of the motion is compared below
    lock, growth = summary["lock"], summary["criteria"]["growth_times"]
    found = [f"{x:.5f} deg" for x in lock["angles_deg"].values()]
    found += [f"{k}x at {t:.3f} s" for k, t in growth.items()]
    found += [f"time               {lock['time']:.10f}", f"{lock['multipliers']['start']:.5g} N"]
    found += [
        f"{lock['multipliers']['at_lock']:.6g} N",
        f"energy lost        {lock['latch']['energy_lost']:.9f}",
    ]
    return [*found, f"angular impulse    {lock['latch']['angular_impulse']:.9f}"]


@pytest.mark.parametrize("command", RUNS)
def test_figures_of_the_readme(command: str) -> None:
    part = section(text("README.md"), "## Results")
    for figure in figures(command):
        assert figure in part, figure


def test_the_simulation_ends_where_the_readme_says() -> None:
    part = section(text("README.md"), "## Results")
    exact = [float(x) for x in re.findall(r"theta[12] = (-?[\d.]+\d)", part)]
    run = result("simulate")
    error = float(np.abs(run["q"][-1] - exact).max())
    assert error < 3.0 * run.summary["error_estimate"]["q_end"] < 1e-10


def test_the_lock_is_where_the_readme_says() -> None:
    exact = float(re.findall(r"puts the lock at ([\d.]+\d) s", text("README.md"))[0])
    lock = result("deploy").summary["lock"]
    assert abs(lock["time"] - exact) < 1e-12


@pytest.mark.parametrize(
    "page, left", [("README.md", ("pendulum.h5", "tip_path.png")), ("docs/python.md", ())]
)
def test_python_examples(
    page: str, left: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "configs").symlink_to(ROOT / "configs")
    monkeypatch.chdir(tmp_path)
    found = [block for block, _ in blocks(text(page), "python")]
    assert found
    for block in found:
        exec(compile(block, page, "exec"), {})
    assert {*left} <= {p.name for p in tmp_path.iterdir()}


# -- links ---------------------------------------------------------------------------------------------


def anchors(page: Path) -> set[str]:
    prose = re.sub(r"^```.*?^```$", "", page.read_text("utf-8"), flags=re.DOTALL | re.MULTILINE)
    return {reference().slug(h) for h in re.findall(r"^#+ (.+)$", prose, re.MULTILINE)}


@pytest.mark.parametrize("page", [*PAGES, *DOCS.glob("*/*.md")], ids=lambda page: page.name)
def test_links_lead_somewhere(page: Path) -> None:
    content = re.sub(r"^```.*?^```$", "", page.read_text("utf-8"), flags=re.DOTALL | re.MULTILINE)
    for target in re.findall(r"\]\(([^)\s]+)\)", content):
        if target.startswith("http"):
            continue
        name, _, anchor = target.partition("#")
        other = (page.parent / name).resolve() if name else page
        assert other.exists(), target
        if anchor:
            assert anchor in anchors(other), target


def test_the_script_of_the_results_fits_the_readme() -> None:
    page, script = text("README.md"), text("docs/make_results.py")
    for _, scene in RUNS.values():
        assert f'"{scene}"' in script and f"configs/{scene}.yaml" in page
        assert f"```text\n{load_scene(ROOT / 'configs' / f'{scene}.yaml').title}\n" in page


def test_images_are_used_and_small() -> None:
    used = {name for page in PAGES for name in re.findall(r"images/([\w.]+)", page.read_text("utf-8"))}
    files = list((DOCS / "images").iterdir())
    assert used == {f.name for f in files}
    assert all(f.stat().st_size < (300_000 if f.suffix == ".gif" else 80_000) for f in files)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_source_files_named_exist(page: Path) -> None:
    for name in re.findall(r"`([\w/*]+\.py)`", page.read_text("utf-8")):
        if "NAME" not in name:
            assert any(list(base.glob(name)) for base in (ROOT / "robodyn_cli", ROOT, page.parent)), name


DESIGN = (DOCS / "design.md").read_text("utf-8")
DEFINED = r"\b(def|class) {0}\b|\b{0} ?[:=(]"  # in Python
OF_OTHERS = {"dataclasses.replace", "dataclasses.fields", "result.h5", "summary.json", "longdouble"}


def line_of(match: re.Match[str]) -> str:
    """Return where in docs/design.md something stands."""
    return f"docs/design.md:{DESIGN.count(chr(10), 0, match.start()) + 1}"


def exists(path: str) -> bool:
    bases = (ROOT / "robodyn_cli", ROOT, ROOT / "configs", DOCS)
    return any(list(base.glob(path.rstrip("/"))) for base in bases)


def test_paths_in_the_design_exist() -> None:
    """Files and folders, with the line of each that does not."""
    found = list(re.finditer(r"`([\w*.]+/[\w/*.]*|[\w*]+\.(?:py|md|yaml|toml))`", DESIGN))
    assert len(found) > 250
    wrong = [f"{line_of(m)}: {m[1]}" for m in found if "NAME" not in m[1] and not exists(m[1])]
    assert wrong == []


def test_names_are_in_the_files_where_the_design_puts_them() -> None:
    """As `Driver.of` (`motion/driver.py`) and `witnessed` in `expr/fixed.py`: there it is defined, or made."""
    placed = re.compile(r"`([\w.]+)`(?:(?:,|\s+and)\s+`([\w.]+)`)?\s+(?:\(|in\s+)`([\w/]+\.py)`")
    found, wrong = list(placed.finditer(DESIGN)), []
    assert len(found) > 120
    for m in found:
        file = ROOT / "robodyn_cli" / m[3]
        code = file.read_text("utf-8") if file.exists() else ""
        names = ".".join(name for name in m.groups()[:2] if name).split(".")
        wrong += [f"{line_of(m)}: {x} in {m[3]}" for x in names if not re.search(DEFINED.format(x), code)]
    assert wrong == []


def test_names_in_the_design_are_in_the_code() -> None:
    """Names of functions, classes, fields, packages and words of the code, wherever they are."""
    named = re.compile(
        r'\b(?:def|class) (\w+)\b|\b(\w+) ?[:=(]|"(\w+)"'
    )  # at once: a search for each takes 20 s
    code = "\n".join(file.read_text("utf-8") for file in (ROOT / "robodyn_cli").rglob("*.py"))
    names = {name for groups in named.findall(code) for name in groups}
    wrong = []
    for m in re.finditer(r"`([A-Za-z_][\w.]*)(?:\(\w*\))?`", DESIGN):
        if exists(m[1]) or m[1] in OF_OTHERS:
            continue
        parts = [part for part in m[1].split(".") if part]
        wrong += [
            f"{line_of(m)}: {part} of {m[1]}"
            for part in parts
            if part not in names and not exists(f"{part}.py")
        ]
    assert wrong == []


@pytest.mark.parametrize("page", [*PAGES, *DOCS.glob("*/*.md")], ids=lambda page: page.name)
def test_pages_are_about_the_tool_alone(page: Path) -> None:
    content = page.read_text("utf-8")
    assert not re.search(r"(?<![\w.])/(work|tmp|home|root)/", content)
    assert content.endswith("\n") and "\t" not in content
