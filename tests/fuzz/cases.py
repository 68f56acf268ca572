"""One case: words of a command line with their files, run in this process, and what is wrong with the outcome."""

from __future__ import annotations

import contextlib
import dataclasses
import io
import json
import os
import re
import shutil
import signal
import sys
import traceback
from pathlib import Path
from typing import Any

from robodyn_cli.cli.app import run as run_words
from robodyn_cli.errors import INTERNAL, RobodynError
from robodyn_cli.results.catalogue import lookup
from tests.fuzz.readers import ROOT, read_files

CONFIGS = ROOT / "configs"
READ = "read"  # in the place of a command: a reader alone
RUNS = ("inverse", "simulate", "deploy", "kinematics", "statics", "assemble", "reach", "linearise", "size")
KNOWN_CODES = (0, 1, 2, 3, 4, 5, 74)
SLOW = 130  # interrupted by the clock of a case, and heeded


@dataclasses.dataclass
class Case:
    """What is run: a command with its scene and other files (name to bytes) and options."""

    command: str
    files: dict[str, bytes]
    words: list[str]


@dataclasses.dataclass
class Outcome:
    """How a case ended; ``finding`` says in one line what must not be, empty where all is well."""

    code: int
    said: str
    finding: str = ""


def try_case(case: Case, folder: Path, seconds: float = 10.0) -> Outcome:
    """Run a case in an empty folder; after ``seconds`` it gets an interrupt, which it should heed."""
    if case.command != READ:  # readers leave nothing
        shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in case.files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    said, shown = io.StringIO(), io.StringIO()
    before = os.getcwd()
    os.chdir(folder)
    try:
        with _clock(seconds), contextlib.redirect_stdout(shown), contextlib.redirect_stderr(said):
            code = _read(case.words[0]) if case.command == READ else run_words([case.command, *case.words])
    except SystemExit as end:
        code = int(end.code or 0)
    except KeyboardInterrupt:
        code = SLOW
    except BaseException as error:
        return Outcome(70, said.getvalue(), f"{type(error).__name__} leaves the program: {error}"[:200])
    finally:
        os.chdir(before)
    outcome = Outcome(code, said.getvalue())
    outcome.finding = _wrong(case, outcome, shown.getvalue(), folder)
    return outcome


def _read(kind: str) -> int:
    """Read files as the program does; say what is wrong with them, and return the exit code."""
    try:
        read_files(kind)
    except RobodynError as error:
        sys.stderr.write(error.message)
        return error.exit_code
    except (MemoryError, OverflowError, ZeroDivisionError):  # as every command does
        sys.stderr.write("out of range")
        return 3
    except Exception:
        traceback.print_exc()
        return INTERNAL
    return 0


@contextlib.contextmanager
def _clock(seconds: float) -> Any:
    def interrupt(*_: Any) -> None:
        raise KeyboardInterrupt

    if not hasattr(signal, "setitimer") or seconds <= 0:
        yield
        return
    old = signal.signal(signal.SIGALRM, interrupt)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, old)


def _wrong(case: Case, outcome: Outcome, shown: str, folder: Path) -> str:
    """Return what must not be."""
    if "Exception ignored" in outcome.said and "in interrupt\n" in outcome.said:
        return ""  # the clock of the case, in a callback that Python lets no exception leave
    if outcome.code == 70 or "Traceback" in outcome.said:
        return _signature(outcome.said)
    if outcome.code not in KNOWN_CODES and outcome.code != SLOW:
        return f"exit code {outcome.code}"
    if case.command == READ and outcome.code == 2 and not any(name in outcome.said for name in case.files):
        return f"a message that names no file: {outcome.said.strip()[:100]}"
    if re.search(r"\w*Warning:", outcome.said):
        return "a raw warning: " + outcome.said.strip().splitlines()[0][-120:]
    if (
        not shown
        and outcome.code not in (0, SLOW)
        and not (outcome.said + shown).strip()
        and case.command not in ("validate", "check", "compare", READ)
    ):
        return f"exit code {outcome.code} without a word"
    if "--json" in case.words and outcome.code != SLOW:
        try:
            json.loads(shown, parse_constant=lambda word: 1 / 0)
        except (ValueError, ZeroDivisionError):
            return "standard output is not one JSON document"
    if outcome.code == 0 and case.command in RUNS:
        return _not_finite(folder)
    return ""


def _signature(said: str) -> str:
    """Return the error and the last line of our own that it went through."""
    ours = re.findall(r'File "[^"]*robodyn_cli/([^"]+)", line (\d+), in (\S+)', said)
    lines = [
        line for line in said.splitlines() if re.match(r"[\w.]+(Error|Exception|Warning|Interrupt)\b", line)
    ]
    where = " ".join(ours[-1]) if ours else "?"
    return f"{(lines or ['?'])[-1][:120]} @ {where}"


def _not_finite(folder: Path) -> str:
    """Return which dataset of a run that succeeded holds a number that is not finite."""
    bad = [name for path in folder.glob("outputs/*/*/result.h5") for name in datasets_not_finite(path)]
    return (
        f"not finite, status ok: {', '.join(re.sub('[0-9]+', '', name) for name in sorted(bad)[:3])}"
        if bad
        else ""
    )


def datasets_not_finite(file: Path) -> list[str]:
    """Return the datasets of a result with numbers that are not finite, where the format does not say nan of gaps."""
    import h5py
    import numpy as np

    bad: list[str] = []

    def look(name: str, item: Any) -> None:
        if name.startswith("stability/"):  # steps without a bound, methods that did not come to an end
            return
        if isinstance(item, h5py.Dataset) and item.dtype.kind == "f":
            entry, values = lookup(name), item[()]
            allowed = np.isnan(values) if entry is not None and entry.has_gaps else False
            if not (np.isfinite(values) | allowed).all():
                bad.append(name)

    if file.exists():
        with h5py.File(file) as opened:
            opened.visititems(look)
    return bad


def store_results(folder: Path) -> None:
    """Write whole results for ``check`` and ``compare``."""
    for name, command in (("double_pendulum", "simulate"), ("2r_circle", "inverse")):
        words = [command, str(CONFIGS / f"{name}.yaml"), "--no-plots", "--quiet", "--out", str(folder / name)]
        code = run_words([*words, "--set", f"{command}.samples=5"])
        if code:
            sys.exit(f"{name} ends with {code}")
