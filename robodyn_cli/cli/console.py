"""Output for people: messages and progress on standard error, results on standard output, exit codes."""

from __future__ import annotations

import contextlib
import functools
import os
import re
import shutil
import sys
import threading
import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any, TextIO

from robodyn_cli.cli import interrupts
from robodyn_cli.errors import (
    INTERNAL,
    INTERRUPTED,
    OutputError,
    RobodynError,
    no_linear_algebra,
    out_of_range,
)
from robodyn_cli.foreign import printable
from robodyn_cli.results.json_text import indented  # an interrupted run must import nothing more

if TYPE_CHECKING:
    from robodyn_cli.cli.progress_line import ProgressLine
    from robodyn_cli.results.result import Result

MOST_ERRORS = 10  # of a scene that are told
QUIET_SECONDS = 2.0  # without a word, on a terminal
LONG_SECONDS, LONGEST_SECONDS = 10.0, 60.0  # without a word, elsewhere: at first, and from then on
# by what a line begins with; all else stays as it is
COLOURS = {
    "ok": "32", "equal": "32",
    "failed": "31", "error": "31", "differs": "31", "missing": "31", "unreadable": "31", "stopped": "33", "extra": "33",
    "robodyn: error:": "31", "robodyn: warning:": "33",
}  # fmt: skip
# by terminals of Windows that paint; its older console prints the codes themselves
PAINTING = ("WT_SESSION", "ANSICON", "ConEmuANSI", "TERM")
_COLOURED = re.compile(rf"(?:{'|'.join(sorted(COLOURS, key=len, reverse=True))})(?= )")
_GAP = re.compile(r"\s{2,}(?=\S)")  # between a label and its text


class Console:
    """One command's output, as ``--json``, ``--quiet`` and ``--verbose`` ask for it."""

    def __init__(self, as_json: bool = False, quiet: bool = False, verbose: bool = False) -> None:
        self.as_json = as_json
        self.quiet = quiet
        self.verbose = verbose  # whether results are told whole
        self.for_people = not quiet and not as_json  # whether results are printed in words
        self._doing: Callable[[], str] = str

    @functools.cached_property
    def _line(self) -> ProgressLine:
        """The line of progress: quiet commands, and those that fail before they begin, have none."""
        from robodyn_cli.cli.progress_line import ProgressLine

        return ProgressLine(is_terminal(sys.stderr) and os.environ.get("TERM") != "dumb")

    def say(self, text: str) -> None:
        """Print results for people."""
        if self.for_people:
            self.clear()
            _print(fitted(printable(text), sys.stdout), sys.stdout)

    def note(self, text: str) -> None:
        """Print a message that is not a result."""
        if not self.quiet:
            self.clear()
            _print(fitted(printable(text), sys.stderr), sys.stderr)

    def warn(self, text: str) -> None:
        """Print what is doubtful about a scene or a run."""
        self.note(f"robodyn: warning: {text}")

    def error(self, text: str) -> None:
        """Print an error, ``--quiet`` or not."""
        self.clear()
        _print(fitted(printable(f"robodyn: error: {text}"), sys.stderr), sys.stderr)

    def data(self, report: Any) -> None:
        """Print JSON, where it was asked for."""
        if self.as_json:
            _print(printable(indented(report, ensure_ascii=not _encodes(sys.stdout))), sys.stdout)

    def fail(self, error: RobodynError) -> int:
        """Report the error that ended the command, and what else is wrong with its scene; return its exit code."""
        code = self.report(type(error).__name__, error.message, error.exit_code, error.details)
        others = error.details.get("others", ())
        for text in others[: MOST_ERRORS - 1]:
            self.error(text)
        if len(others) >= MOST_ERRORS:
            self.error(f"and {len(others) + 1 - MOST_ERRORS} more: `robodyn validate` lists them")
        return code

    def report(self, kind: str, message: str, code: int, details: dict[str, object] | None = None) -> int:
        """Report the cause that ended the command, as text and, where it was asked for, as JSON; return the exit
        code."""
        facts = {"kind": kind, "message": message, "exit_code": code, **_plain(details or {})}
        with contextlib.suppress(OutputError):  # standard output may be the stream that failed
            self.data({"status": "failed", "error": facts})
        self.error(message)
        return code

    def failed(self, error: RobodynError) -> int:
        """Report the error that ended a run whose results until then are kept; return its exit code."""
        self.error(error.message)
        return error.exit_code

    def takes(self, result: Result) -> bool:
        """Tell whether a result goes to a program in Python, which ``Keeping`` does, and is not shown."""
        return False

    def interrupted(self) -> int:
        """Report an interrupt; return its exit code."""
        return self.report("KeyboardInterrupt", interrupts.MESSAGE, INTERRUPTED)

    @contextlib.contextmanager
    def waiting(self, doing: Callable[[], str]) -> Iterator[None]:
        """Say what is being done where it takes long, beside the progress of an integration.

        On a terminal after 2 s, in a line that is written over; elsewhere after 10 s and then once a minute.
        """
        if self.quiet:
            yield
            return
        ended, line, self._doing = threading.Event(), self._line, doing

        def tell() -> None:
            start = time.monotonic()
            wait = QUIET_SECONDS if line.on_terminal else LONG_SECONDS
            while not ended.wait(wait):
                wait = 0.5 if line.on_terminal else LONGEST_SECONDS
                now, activity = time.monotonic(), doing()
                shown = now - line.shown <= QUIET_SECONDS
                if not line.on_terminal:
                    parts = [text for text in (activity, line.reached(activity) if shown else "") if text]
                    self.note(f"robodyn: after {now - start:.0f} s: {', '.join(parts) or 'still at it'}")
                elif activity and not shown:
                    line.wait(activity, now - start)

        teller = threading.Thread(target=tell, daemon=True)
        teller.start()
        try:
            yield
        finally:
            ended.set()
            teller.join()  # it writes nothing any more
            self._doing = str
            self.clear()

    def progress(self, done: float, total: float, unit: str = "s") -> None:
        """Show how far a pass of a long run is, in seconds of its motion or in a unit of its own, as ``methods``."""
        part = min(1.0, done / total) if total else 1.0
        if unit == "s":
            reached = f"{100 * part:.1f} %" + (f"  t = {done:.4g} of {total:.4g} s" if total else "")
        else:
            reached = f"{done:.0f} of {total:.0f} {unit}"
        if not self.quiet:
            self._line.advance(part, reached, self._doing())

    def count(self, done: int, total: int, left: float | None) -> None:
        """Show how many runs are done, and the seconds left."""
        if not self.quiet:
            self._line.advance(done / total, f"{done} of {total} runs", left=left)

    def clear(self) -> None:
        """Remove the progress line."""
        if "_line" in vars(self):
            self._line.clear()


def guarded(command: Callable[..., int]) -> Callable[..., int]:
    """Return the command with all errors reported and turned into exit codes."""

    @functools.wraps(command)  # the parser reads what a command takes from its signature
    def run(**values: Any) -> int:
        console = Console(values.get("as_json", False), values.get("quiet", False))
        try:
            return command(**values)
        except RobodynError as error:
            return console.fail(error)
        except KeyboardInterrupt:
            return console.interrupted()
        except MemoryError:
            return console.report("MemoryError", "out of memory: ask for fewer samples", INTERNAL)
        except OverflowError as error:
            return console.fail(out_of_range(error))
        except ZeroDivisionError as error:
            return console.fail(no_linear_algebra(error))
        except Exception as error:
            if interrupts.seen():
                return console.interrupted()
            if type(error).__name__ == "LinAlgError":  # numpy may not have been imported
                return console.fail(no_linear_algebra(error))
            return _internal(error, console)
        finally:
            _tell_of_compiled_code(console)

    return run


def _tell_of_compiled_code(console: Console) -> None:
    """Say what kept compiled code from being kept, where anything was compiled; it does not touch the results."""
    compiler = sys.modules.get("robodyn_cli.kernels.cache")
    for text in compiler.REPORT.warnings if compiler is not None else ():
        console.warn(text)


def _internal(error: Exception, console: Console) -> int:
    if os.environ.get("ROBODYN_DEBUG"):
        import traceback  # only when something is already wrong

        traceback.print_exc()
    kind = type(error).__name__
    advice = "set ROBODYN_DEBUG=1 for the traceback, and please report it with the scene"
    message = f"internal error: {kind}: {error} ({advice})"
    return console.report(kind, message, INTERNAL)


def _print(text: str, stream: TextIO | None) -> None:
    """Print to a standard stream; a reader that has closed its end (``robodyn ... | head``) is no error."""
    if stream is None:  # a program without a terminal
        return
    try:
        stream.write(f"{text}\n")
        stream.flush()
    except OSError as error:
        lost = output_lost(error, stream)
        if lost is not None and stream is not sys.stderr:
            raise lost from error


def output_lost(error: OSError, stream: TextIO) -> OutputError | None:
    """Return the error of a standard stream that takes no more text; None where its reader has closed it."""
    # discard the rest of the buffer, now and when Python ends
    with contextlib.suppress(OSError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
    if isinstance(error, BrokenPipeError):
        return None
    return OutputError(f"cannot write to standard output: {error.strerror}")


def is_terminal(stream: TextIO | None) -> bool:
    """Tell whether somebody reads a stream as it is written."""
    return stream is not None and stream.isatty()


def width(stream: TextIO | None) -> int | None:
    """Return the columns of a stream's terminal; None where it is none, for other programs read lines."""
    return shutil.get_terminal_size().columns if is_terminal(stream) else None


def fitted(text: str, stream: TextIO | None) -> str:
    """Return text for a stream: on a terminal with colours, and lines that are too long go on below their text."""
    columns = width(stream)
    if columns is None:
        return text
    lines = [line if len(line) <= columns else _wrapped(line, columns) for line in text.split("\n")]
    return "\n".join(map(_painted, lines) if _has_colours() else lines)


LABELLED = 21  # columns before the text of a line that begins with a label
LEAST_TEXT = 15


def _wrapped(line: str, columns: int) -> str:
    import textwrap

    most = max(columns // 2, min(LABELLED, columns - LEAST_TEXT))
    starts = [gap.end() for gap in _GAP.finditer(line) if gap.start() > 0 and gap.end() <= most]
    indent = " " * (starts[-1] if starts else 4)
    return textwrap.fill(
        line, columns, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )


def _has_colours() -> bool:
    """Tell whether colours are wanted (https://no-color.org)."""
    if os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb":
        return False
    return sys.platform != "win32" or any(map(os.environ.get, PAINTING))


def _painted(line: str) -> str:
    word = _COLOURED.match(line)
    if word is None:
        return line
    return f"\x1b[{COLOURS[word.group()]}m{word.group()}\x1b[0m{line[word.end() :]}"


def _encodes(stream: TextIO | None) -> bool:
    """Tell whether a stream can encode all letters."""
    return (getattr(stream, "encoding", None) or "utf-8").lower().replace("-", "").startswith("utf")


def _plain(details: dict[str, object]) -> dict[str, object]:
    """Return the facts of an error in terms of JSON; ``kind`` is the error's own, that of a singularity is renamed."""
    if not details:
        return {}
    from robodyn_cli.results.summary import jsonable

    facts = {k: v for k, v in details.items() if k not in ("kind", "message", "exit_code")}
    if "kind" in details:
        facts["singularity"] = details["kind"]
    plain: dict[str, object] = jsonable(facts)
    return plain
