"""What stands on a terminal: no line wider than it, colours where they are wanted, nothing of both elsewhere."""

from __future__ import annotations

import io
import os
import re
import struct
import sys
import time
import types
from pathlib import Path

import pytest

from robodyn_cli.cli import console, progress_line
from robodyn_cli.cli.console import fitted
from robodyn_cli.cli.figure_words import figure_lines
from robodyn_cli.cli.runner import say_where
from robodyn_cli.cli.words import table
from robodyn_cli.commands import places
from robodyn_cli.registry import Registry
from robodyn_cli.report.cells import Figure
from robodyn_cli.report.figures import declared, headlines
from robodyn_cli.report.page.tables import main_figures, typeset
from robodyn_cli.results.result import Result
from robodyn_cli.scene.load import load_scene
from tests.cli.batch_scenes import arm
from tests.cli.tool import COMMAND, CONFIGS, ROOT, invoke

CODES = re.compile("\x1b\\[[0-9;]*m")


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.fixture
def columns(monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    monkeypatch.setenv("COLUMNS", "44")
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.delenv("NO_COLOR", raising=False)
    return monkeypatch


def test_long_lines_go_on_below_their_text(columns: pytest.MonkeyPatch) -> None:
    text = "  energy drift       8.4e-09 J (kinetic + potential), which is little\nshort"
    assert fitted(text, Terminal()).splitlines() == [
        "  energy drift       8.4e-09 J (kinetic +",
        "                     potential), which is",
        "                     little",
        "short",
    ]  # fmt: skip
    assert fitted(text, io.StringIO()) == text == fitted(text, None)


def test_a_label_that_is_too_wide_does_not_squeeze_the_text(columns: pytest.MonkeyPatch) -> None:
    found = fitted(f"differs  {'very/' * 6}long  worst of all by far and much more", Terminal())
    assert max(len(CODES.sub("", line)) for line in found.splitlines()) <= 44
    assert "".join(found.split()).endswith("worstofallbyfarandmuchmore")


@pytest.mark.parametrize(
    ("line", "shown"),
    [
        ("ok      scene", "\x1b[32mok\x1b[0m      scene"),
        ("failed  scene", "\x1b[31mfailed\x1b[0m  scene"),
        ("robodyn: error: no", "\x1b[31mrobodyn: error:\x1b[0m no"),
        ("okay, scene", "okay, scene"),
        ("  ok", "  ok"),
    ],
)
def test_colours(line: str, shown: str, columns: pytest.MonkeyPatch) -> None:
    assert fitted(line, Terminal()) == shown
    columns.setenv("NO_COLOR", "1")
    assert fitted(line, Terminal()) == line
    columns.setenv("NO_COLOR", "")
    assert fitted(line, Terminal()) == shown, "an empty variable says nothing"
    columns.setenv("TERM", "dumb")
    assert fitted(line, Terminal()) == line


def test_an_old_console_of_windows_gets_no_codes(columns: pytest.MonkeyPatch) -> None:
    """It would print them; Windows Terminal tells by a variable that it paints."""
    line = "ok      scene"
    columns.setattr(sys, "platform", "win32")
    for name in console.PAINTING:
        columns.delenv(name, raising=False)
    assert fitted(line, Terminal()) == line
    columns.setenv("WT_SESSION", "1")
    assert fitted(line, Terminal()) != line


def test_a_wide_table_goes_on_below() -> None:
    rows = [["joint", "torque", "speed", "power"], ["theta1", "168.285", "0.16", "20.6"]]
    assert table(rows).splitlines() == ["  joint    torque  speed  power", "  theta1  168.285   0.16   20.6"]
    assert table(rows, 25).splitlines() == [
        "  joint    torque  speed", "  theta1  168.285   0.16", "  joint   power", "  theta1   20.6",
    ]  # fmt: skip
    assert len(table(rows, 5).splitlines()) == 6, "a column each, however narrow"


def on_terminal(width: int, *words: str | Path) -> str:
    """Return what a command of its own prints on a terminal of so many columns."""
    return of_process(width, [*COMMAND, *map(str, words)])


def of_process(width: int, program: list[str]) -> str:
    """Return what a program prints on a terminal of so many columns."""
    pty, fcntl, termios = (pytest.importorskip(name) for name in ("pty", "fcntl", "termios"))
    process, screen = pty.fork()
    if process == 0:
        fcntl.ioctl(1, termios.TIOCSWINSZ, struct.pack("HHHH", 24, width, 0, 0))
        environment = {**os.environ, "PYTHONPATH": str(ROOT), "TERM": "xterm"}
        environment = {key: value for key, value in environment.items() if key not in ("COLUMNS", "NO_COLOR")}
        os.execvpe(sys.executable, program, environment)
    found = b""
    while True:
        try:
            more = os.read(screen, 65536)
        except OSError:  # the other end is closed
            more = b""
        if not more:
            break
        found += more
    os.waitpid(process, 0)
    return found.decode()


INTERRUPTED = """
import os, signal, sys
from robodyn_cli.cli import interrupts
from robodyn_cli.cli.console import Console, guarded
signal.signal(signal.SIGINT, signal.default_int_handler)
interrupts.leave_at_once()

def command():
    console = Console()
    with console.waiting(lambda: "a study"):
        console._line.wait("a study of some length", 12.0)
        if sys.argv[1] == "begun":
            interrupts.tidy_up_first()
        if sys.argv[1] == "cython":
            interrupts.tidy_up_first()
            sys.excepthook(KeyboardInterrupt, KeyboardInterrupt(), None)  # as its functions that can raise nothing do
        os.kill(os.getpid(), signal.SIGINT)

interrupts.end(guarded(command)())
"""


@pytest.mark.parametrize("when", ["early", "begun", "cython"])
@pytest.mark.parametrize("width", [80, 20])
def test_an_interrupt_leaves_nothing_of_the_line_of_progress(when: str, width: int) -> None:
    shown = of_process(width, [sys.executable, "-c", INTERRUPTED, when])
    assert "a study" in shown
    left = [rewritten(line) for line in CODES.sub("", shown).replace("\r\n", "\n").split("\n")]
    assert " ".join("".join(left).split()) == "robodyn: error: interrupted", shown


def rewritten(line: str) -> str:
    """Return what a terminal shows of a line whose parts are written over one another."""
    cells: list[str] = []
    for part in line.split("\r"):
        cells[: len(part)] = part
    return "".join(cells)


@pytest.mark.parametrize("width", [80, 60])
@pytest.mark.parametrize("command", ["inverse", "plan", "info", "run"])
def test_no_line_is_wider_than_the_terminal(command: str, width: int, tmp_path: Path) -> None:
    scene, more = CONFIGS / "2r_circle.yaml", ["--no-plots", "--out", tmp_path / "out"]
    if command == "run":
        scene = arm(tmp_path / "arm.yaml", "expect: {peak_torque.swing: < 0.001}")
    shown = on_terminal(width, command, scene, *(more if command != "plan" else ()))
    lines = [line.split("\r")[-1] for line in CODES.sub("", shown).replace("\r\n", "\n").split("\n")]
    words = [line for line in lines if " " in line.strip()]  # a path alone may be longer
    assert len(words) >= 2 and max(map(len, words)) <= width
    assert ("\x1b[31mfailed\x1b[0m" in shown) == (command == "run")


SHORT = {
    "simulate": ("double_pendulum", "errors", "cost"),
    "inverse": ("2r_circle", "errors", "peak power"),
    "deploy": ("four_bar_deploy", "locked", "criteria"),
    "statics": ("mechanisms/balanced_four_bar", "balanced", "mobility"),
    "kinematics": ("mechanisms/four_bar_kinematics", "singular ratio", "mobility"),
}


@pytest.mark.parametrize("command", SHORT)
def test_by_default_the_main_figures_are_told_and_with_v_all(command: str, tmp_path: Path) -> None:
    name, main, more = SHORT[command]
    words = (command, CONFIGS / f"{name}.yaml", "--no-plots", "--out", tmp_path)
    short, whole = invoke(*words).out, invoke(*words, "-v").out
    assert f"  {main} " in short and f"  {more} " not in short
    assert re.search(
        rf"^results: {re.escape(str(tmp_path))}  \(2 files in [0-9.]+ s; -v tells more\)$", short, re.M
    )
    assert f"  {main} " in whole and f"  {more} " in whole and "(result.h5, summary.json)" in whole
    assert len(short.splitlines()) < len(whole.splitlines())


def test_times_have_two_digits_up_to_ten_seconds() -> None:
    from robodyn_cli.cli.progress_line import spent

    seconds = (0.0, 0.0034, 0.0149, 0.8, 1.04, 9.94, 9.96, 75.0, 100.0, 130.0, 3000.0, 7200.0)
    assert [spent(x) for x in seconds] == [
        "0.01 s", "0.01 s", "0.01 s", "0.80 s", "1.0 s", "9.9 s", "10 s", "75 s", "1.7 min", "2.2 min", "50 min", "2.0 h"]  # fmt: skip


@pytest.mark.parametrize(
    ("times", "told"),
    [
        ({"compile": 0.4, "total": 0.6}, "2 files in 0.60 s"),
        ({"compile": 3.0, "plots": 1.0, "total": 5.0}, "in 5.0 s, 3.0 s of it for compiling, which is kept"),
        ({"compile": 1.0, "plots": 3.0, "total": 5.0}, "in 5.0 s, 3.0 s of it for plots: --no-plots"),
        ({"compile": 2.0, "plots": 2.0, "total": 5.0}, "in 5.0 s; -v tells more"),
        ({}, "2 files; -v tells more"),
    ],
)
def test_where_most_of_the_time_went_is_told(
    times: dict[str, float], told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    kept = types.SimpleNamespace(path=Path("out"), outputs=["result.h5", "summary.json"])
    say_where(kept, console.Console(), {"wall_time_s": times})  # type: ignore[arg-type]
    assert told in capsys.readouterr().out


STUDIED = {
    "sweep": ("2r_circle.yaml", "--vary", "robot.links.link2.mass=[10, 20]", "--of", "peak_torque.theta1"),
    "sensitivity": ("2r_circle.yaml", "--to", "robot.links.link2.mass", "--of", "peak_torque.theta1"),
    "optimise": ("search/spring_balance.yaml",),
}


@pytest.mark.parametrize("command", STUDIED)
def test_studies_tell_what_they_took_and_figures_with_errors(command: str, tmp_path: Path) -> None:
    scene, *words = STUDIED[command]
    told = (command, CONFIGS / scene, *words, "--no-plots", "--out", tmp_path)
    short, whole = invoke(*told), invoke(*told, "-v")
    assert short.code == 0 and re.search(
        r"^results: .*\(\d files in [0-9.]+ s; -v tells more\)$", short.out, re.M
    )
    assert "+-" in short.out and len(whole.out) > len(short.out)
    assert ("method" in whole.out) == (command == "sensitivity") and "method" not in short.out
    assert "price" not in short.out, "of a search without active bounds"


def test_modes_are_told_by_their_poles_and_errors(tmp_path: Path) -> None:
    told = ("linearise", CONFIGS / "double_pendulum.yaml", "--at", "balance", "--no-plots", "--out", tmp_path)
    short, whole = invoke(*told).out, invoke(*told, "-v").out
    for out, heads in ((short, ["mode"]), (whole, ["mode", "in [s]", "frequency [Hz]", "damping", "moves"])):
        (head,) = [line for line in out.splitlines() if "pole [1/s]" in line]
        assert re.split(r"\s{2,}", head.strip()) == ["pole [1/s]", "error [1/s]", *heads]


def test_an_assembly_at_rest_is_told_by_its_positions(tmp_path: Path) -> None:
    told = ("assemble", CONFIGS / "four_bar_deploy.yaml", "--no-plots", "--out", tmp_path)
    assert "acceleration" not in invoke(*told).out and "acceleration [rad/s^2]" in invoke(*told, "-v").out
    assert "rate [rad/s]" in invoke(*told, "--set", "initial.qd={theta1: 1}").out


def test_joints_that_are_left_out_are_counted() -> None:
    units = {"torque": "N m", "speed": "rad/s", "power": "W", "energy": "J"}
    figures = dict.fromkeys(("peak_torque_time", "rms_torque", "peak_speed", "peak_power", "energy"), 1.0)
    joints = {f"j{k}": {**figures, "peak_torque": float(k % 7), "units": units} for k in range(30)}
    result = Result("inverse", "", "ok", "", summary={"joints": joints})
    short, whole = ("\n".join(figure_lines(result, verbose)) for verbose in (False, True))
    assert "... and 18 more with smaller peak torque" in short and "j6 " in short and "j7 " not in short
    assert "j7 " in whole and "peak power" in whole and "peak power" not in short


@pytest.mark.parametrize("scene", ["inverse 2r_drives", "simulate controlled_arm", "deploy four_bar_deploy"])
def test_the_terminal_and_the_page_have_the_same_figures(scene: str) -> None:
    """Short ones are headlines alone; each figure is rounded in one place."""
    command, name = scene.split()
    result = Registry("robodyn_cli", places("run"))[command](load_scene(CONFIGS / f"{name}.yaml"))
    short, whole = ("\n".join(figure_lines(result, verbose)) for verbose in (False, True))
    page = str(main_figures(result))
    leads, listed = headlines(result), declared(result)
    assert leads and sum(len(one.rows[0]) for one in leads) < sum(len(one.rows[0]) for one in listed)
    for one, words in [(one, short) for one in leads] + [(one, whole) for one in listed]:
        for cell in (cell for row in one.rows for cell in row if isinstance(cell, Figure)):
            assert cell.number.replace("±", "+-") in words and typeset(str(cell)) in page
    assert "+-" in short


def test_where_there_is_no_terminal_a_line_a_minute_tells_how_far_it_is(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(console, "LONG_SECONDS", 0.05)
    monkeypatch.setattr(console, "LONGEST_SECONDS", 0.05)
    shown = console.Console()
    shown.note("robodyn: warning: something")
    with shown.waiting(lambda: "integrate"):
        for k in range(3):
            shown.progress(k, 8)
            time.sleep(0.12)
    said = capsys.readouterr().err.splitlines()
    # a slow machine may speak before the first step, and later
    told = [line.partition(": integrate, ")[2] for line in said if ": integrate, " in line]
    assert len(told) >= 2 and told[0].endswith("of 8 s") and told[-1] == "25.0 %  t = 2 of 8 s"
    assert all(line.startswith("robodyn: after ") for line in said[1:])


def test_how_far_an_integration_was_is_not_told_of_what_follows_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(console, "LONG_SECONDS", 0.05)
    monkeypatch.setattr(console, "LONGEST_SECONDS", 0.05)
    shown, doing = console.Console(), ["integrate"]
    with shown.waiting(lambda: doing[0]):
        shown.progress(3, 8)
        doing[0] = "write"
        time.sleep(0.3)
    told = [line for line in capsys.readouterr().err.splitlines() if ": write" in line]
    assert told and all(line.endswith(": write") for line in told)


class Screen:
    """A terminal on standard error, and a clock that this test moves on."""

    def __init__(self, patch: pytest.MonkeyPatch, width: int, **variables: str) -> None:
        for name, value in {"COLUMNS": str(width), **variables}.items():
            patch.setenv(name, value)
        self.now, self.stream = 100.0, Terminal()
        patch.setattr(progress_line, "time", types.SimpleNamespace(monotonic=lambda: self.now))
        patch.setattr(sys, "stderr", self.stream)
        self.console = console.Console()

    @property
    def written(self) -> str:
        return self.stream.getvalue()

    def steps(self, *ways: tuple[float, float, str]) -> list[str]:
        """Return the lines after steps of 10 s each."""
        lines = []
        for way in ways:
            self.console.progress(*way)
            self.now += 10.0
            lines.append(self.written.split("\r")[-1].rstrip())
        return lines


def test_each_pass_is_named_and_has_a_time_left_of_its_own(columns: pytest.MonkeyPatch) -> None:
    screen, doing = Screen(columns, 80), ["integrate"]
    with screen.console.waiting(lambda: doing[0]):
        first = screen.steps((0.0, 8.0, "s"), (2.0, 8.0, "s"), (6.0, 8.0, "s"))
        doing[0] = "error estimate"
        second = screen.steps((2.0, 8.0, "s"), (4.0, 8.0, "s"))
    assert first[0].endswith("] 0.0 %  t = 0 of 8 s") and first[1].endswith(
        "] 25.0 %  t = 2 of 8 s, 30 s left"
    )
    assert first[2].startswith("integrate  [###") and first[2].endswith("75.0 %  t = 6 of 8 s, 7 s left")
    assert second[0].startswith("error estimate  [#") and second[0].endswith("t = 2 of 8 s"), (
        "a pace of its own"
    )
    assert second[1].endswith("50.0 %  t = 4 of 8 s, 10 s left")
    assert screen.written.endswith(f"\r{' ' * max(map(len, first + second))}\r"), "the line is cleared"


@pytest.mark.parametrize("width", [20, 40, 80])
def test_a_line_that_is_written_over_has_room_on_the_terminal(
    width: int, columns: pytest.MonkeyPatch
) -> None:
    """One that went on below would stay there."""
    screen = Screen(columns, width)
    with screen.console.waiting(lambda: "error estimate"):
        screen.steps(*((k, 7, "methods") for k in range(7)))
        screen.console.count(5, 700, 99.0)
        screen.console._line.wait("a stage of a long name", 4.0)
    longest = max(map(len, screen.written.split("\r")))
    assert "\n" not in screen.written and (longest == width - 1 if width < 60 else 60 < longest < width)


@pytest.mark.parametrize(
    ("seconds", "told"), [(3.2, "3 s"), (99.0, "99 s"), (600.0, "10 min"), (9000.0, "2.5 h")]
)
def test_a_time_that_is_left(seconds: float, told: str) -> None:
    assert progress_line.duration(seconds) == told


def test_a_terminal_that_writes_nothing_over_gets_lines(columns: pytest.MonkeyPatch) -> None:
    screen = Screen(columns, 80, TERM="dumb")
    assert (
        screen.steps((1.0, 2.0, "s")) == [""] and screen.console._line.reached("") == "50.0 %  t = 1 of 2 s"
    )


def test_what_a_terminal_would_obey_is_shown(capsys: pytest.CaptureFixture[str]) -> None:
    shown = console.Console(as_json=True)
    shown.data({"title": "\x1b[2J\u202e"})
    shown.note("\x1b]0;a\x07")
    shown.error("\x9b31m")
    console.Console().say("a\u202eb\nc")
    out, err = capsys.readouterr()
    assert out == '{\n  "title": "\\u001b[2J\\u202e"\n}\na\\u202eb\nc\n'
    assert err == "\\u001b]0;a\\u0007\nrobodyn: error: \\u009b31m\n"


@pytest.mark.parametrize("width", [40, 80])
def test_help_is_as_wide_as_the_terminal_and_names_no_types(
    width: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", str(width))
    for command in ("new", "check", "report", "validate", "statics"):
        told = invoke(command, "--help").out
        usage, examples = told.partition("\n\n")[0], told.find("Examples:")
        assert max(map(len, told[:examples].splitlines())) <= width
        assert (
            "[[" not in usage
            and "..." not in usage.replace("}...", "")
            and "<" not in told[:examples].split("Options:")[0]
        )


def test_all_that_is_wrong_with_a_scene_is_told(tmp_path: Path) -> None:
    scene = arm(tmp_path / "arm.yaml")
    wrong = ["inverse.samples=-1", "gravity=[0, -9.81]", "colour=red"]
    done = invoke("inverse", scene, *(word for one in wrong for word in ("--set", one)))
    assert done.code == 2 and done.err.count("robodyn: error: ") == 3
    assert "value [0, -9.81]" in done.err and "colour" in done.err
    joints = ", ".join(f"{{name: j{k}, type: nonsense}}" for k in range(14))
    scene.write_text(f"schema: 1\nrobot: {{joints: [{joints}]}}\n")
    done = invoke("simulate", scene)
    assert done.err.count("robodyn: error: ") == 11 and "more: `robodyn validate` lists them" in done.err


@pytest.mark.parametrize("command", ["sweep", "optimise", "sensitivity", "info", "work-precision"])
def test_plots_that_a_command_never_draws_are_refused_before_it_runs(command: str, tmp_path: Path) -> None:
    scene = arm(tmp_path / "arm.yaml")
    done = invoke(command, scene, "--plots", "four_bars", "--out", tmp_path / "out")
    assert done.code == 2 and f"--plots four_bars: `{command}` does not draw that; allowed: " in done.err
    assert not (tmp_path / "out").exists()


def test_plots_without_data_are_told_of_studies_too(tmp_path: Path) -> None:
    asked = ("--vary", "robot.links.0.mass=[1, 2]", "--of", "peak_torque.swing", "--plots", "study_map")
    done = invoke("sweep", arm(tmp_path / "arm.yaml"), *asked, "--out", tmp_path / "out")
    assert done.code == 0 and "no data for the plot study_map" in done.err, done.err
