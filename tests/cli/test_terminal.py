"""What stands on a terminal: no line wider than it, colours where they are wanted, nothing of both elsewhere."""

from __future__ import annotations

import io
import os
import re
import struct
import sys
import time
from pathlib import Path

import pytest

from robodyn_cli.cli import console
from robodyn_cli.cli.console import fitted
from robodyn_cli.cli.words import table
from tests.cli.batch_scenes import arm
from tests.cli.tool import COMMAND, CONFIGS, ROOT

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


def test_a_wide_table_goes_on_below() -> None:
    rows = [["joint", "torque", "speed", "power"], ["theta1", "168.285", "0.16", "20.6"]]
    assert table(rows).splitlines() == ["  joint    torque  speed  power", "  theta1  168.285   0.16   20.6"]
    assert table(rows, 25).splitlines() == [
        "  joint    torque  speed", "  theta1  168.285   0.16", "  joint   power", "  theta1   20.6",
    ]  # fmt: skip
    assert len(table(rows, 5).splitlines()) == 6, "a column each, however narrow"


def on_terminal(width: int, *words: str | Path) -> str:
    """Return what a command of its own prints on a terminal of so many columns."""
    pty, fcntl, termios = (pytest.importorskip(name) for name in ("pty", "fcntl", "termios"))
    process, screen = pty.fork()
    if process == 0:
        fcntl.ioctl(1, termios.TIOCSWINSZ, struct.pack("HHHH", 24, width, 0, 0))
        environment = {**os.environ, "PYTHONPATH": str(ROOT), "TERM": "xterm"}
        environment = {key: value for key, value in environment.items() if key not in ("COLUMNS", "NO_COLOR")}
        os.execvpe(sys.executable, [*COMMAND, *map(str, words)], environment)
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


def test_what_a_terminal_would_obey_is_shown(capsys: pytest.CaptureFixture[str]) -> None:
    shown = console.Console(as_json=True)
    shown.data({"title": "\x1b[2J\u202e"})
    shown.note("\x1b]0;a\x07")
    shown.error("\x9b31m")
    console.Console().say("a\u202eb\nc")
    out, err = capsys.readouterr()
    assert out == '{\n  "title": "\\u001b[2J\\u202e"\n}\na\\u202eb\nc\n'
    assert err == "\\u001b]0;a\\u0007\nrobodyn: error: \\u009b31m\n"
