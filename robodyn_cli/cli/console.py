"""What people see: messages and progress on standard error, results on standard output, exit codes."""

from __future__ import annotations

import contextlib
import json
import os
import sys
import time
import traceback
from collections.abc import Callable
from typing import NoReturn

from robodyn_cli.errors import OutputError, RobodynError

INTERNAL = 70
INTERRUPTED = 130


class Console:
    """One command's output, as ``--json`` and ``--quiet`` ask for it."""

    def __init__(self, as_json: bool = False, quiet: bool = False) -> None:
        self.as_json = as_json
        self.quiet = quiet
        self._shown = 0.0
        self._width = 0
        self._on_terminal = sys.stderr is not None and sys.stderr.isatty()

    def say(self, text: str) -> None:
        """Print results for people."""
        if not self.quiet and not self.as_json:
            self._print(text)

    def note(self, text: str) -> None:
        """Print a message that is not a result."""
        if not self.quiet:
            self.clear()
            self._print(text, err=True)

    def error(self, text: str) -> None:
        """Print an error that does not end the command, ``--quiet`` or not."""
        self.clear()
        self._print(f"robodyn: error: {text}", err=True)

    def data(self, text: str) -> None:
        """Print JSON, where it was asked for."""
        if self.as_json:
            self._print(text)

    @staticmethod
    def _print(text: str, err: bool = False) -> None:
        """Print to a standard stream; a reader that went away (``robodyn ... | head``) is no error of ours."""
        stream = sys.stderr if err else sys.stdout
        if stream is None:  # a program without a terminal
            return
        try:
            stream.write(f"{text}\n")
            stream.flush()
        except BrokenPipeError:
            # whatever still waits in the buffer goes nowhere, now and when Python ends
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
        except OSError as error:
            if not err:
                raise OutputError(f"cannot write to standard output: {error.strerror}") from error

    def progress(self, done: float, total: float) -> None:
        """Show how far a long run has come, when standard error is a terminal."""
        now = time.monotonic()
        if self.quiet or now - self._shown < 0.1 or not self._on_terminal:
            return
        self._shown = now
        part = min(1.0, done / total) if total else 1.0
        bar = "#" * round(30 * part)
        text = f"\r[{bar:<30}] {100 * part:5.1f} %  t = {done:.4g} of {total:.4g} s"
        self._width = max(self._width, len(text))
        sys.stderr.write(text.ljust(self._width))
        sys.stderr.flush()

    def clear(self) -> None:
        """Remove the progress line."""
        if self._width:
            sys.stderr.write("\r" + " " * self._width + "\r")
            sys.stderr.flush()
            self._width = 0

    def fail(self, error: BaseException, code: int, message: str, summary: str | None = None) -> NoReturn:
        """Report an error and leave with its exit code."""
        self.clear()
        if self.as_json:
            details = getattr(error, "details", {})
            payload = {
                "status": "failed",
                "error": {
                    "kind": type(error).__name__,
                    "message": message,
                    "exit_code": code,
                    **_plain(details),
                },
            }
            with contextlib.suppress(OutputError):  # that is what is being reported
                self._print(
                    summary if summary is not None else json.dumps(payload, ensure_ascii=False, indent=2)
                )
        self._print(f"robodyn: error: {message}", err=True)
        raise SystemExit(code)


def _plain(details: dict[str, object]) -> dict[str, object]:
    from robodyn_cli.results.summary import jsonable

    found = {k: v for k, v in details.items() if k not in ("kind", "message", "exit_code")}
    if "kind" in details:
        found["singularity"] = details["kind"]
    plain = jsonable(found)
    assert isinstance(plain, dict)
    return plain


def guarded(console: Console, action: Callable[[], int]) -> NoReturn:
    """Run a command's action and turn every outcome into an exit code."""
    try:
        code = action()
    except RobodynError as error:
        console.fail(error, error.exit_code, error.message)
    except KeyboardInterrupt as error:
        console.fail(error, INTERRUPTED, "interrupted")
    except MemoryError as error:
        console.fail(error, INTERNAL, "out of memory: ask for fewer samples")
    except Exception as error:
        if os.environ.get("ROBODYN_DEBUG"):
            traceback.print_exc()
        console.fail(
            error, INTERNAL,
            f"internal error: {type(error).__name__}: {error} (set ROBODYN_DEBUG=1 for the traceback, and please "
            "report it with the scene)",
        )  # fmt: skip
    raise SystemExit(code)
