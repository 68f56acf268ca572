"""Ctrl-C: exit code 130 and one line, at any moment."""

from __future__ import annotations

import _thread
import contextlib
import os
import signal
import sys
import threading
from types import FrameType, TracebackType
from typing import Any, NoReturn

from robodyn_cli.errors import INTERRUPTED

MESSAGE = "interrupted"
AS_JSON = f"""\
{{
  "status": "failed",
  "error": {{
    "kind": "KeyboardInterrupt",
    "message": "{MESSAGE}",
    "exit_code": {INTERRUPTED}
  }}
}}
"""
# what a batch reports that has not come to its first scene
REPORTS = {
    "--junit": f"""\
<?xml version='1.0' encoding='utf-8'?>
<testsuites name="robodyn" tests="1" failures="0" errors="0" time="0.000">
  <testsuite name="robodyn run" tests="1" failures="0" errors="0" time="0.000" skipped="1">
    <testcase name="run" classname="robodyn.run" time="0.000">
      <skipped message="{MESSAGE} before the first scene" />
    </testcase>
  </testsuite>
</testsuites>
""",
    "--markdown": f"# robodyn run\n\nThe batch was {MESSAGE} before its first scene.\n",
}
_seen = False
# columns of the line of progress that stands on standard error, for who leaves at once
line_shown = 0


def leave_at_once() -> None:
    """End the process at once on an interrupt from now on: nothing needs tidying up yet.

    The default, an exception, is lost or turned into another error where it meets the import of a compiled module.
    Nothing changes where the program that started this one had interrupts ignored.
    """
    try:
        if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
            signal.signal(signal.SIGINT, _leave)
    except KeyboardInterrupt:  # just now
        _leave(signal.SIGINT, None)


def tidy_up_first() -> None:
    """Raise KeyboardInterrupt on an interrupt from now on: there are files or processes to tidy up."""
    if signal.getsignal(signal.SIGINT) is _leave:
        sys.unraisablehook = _unraisable
        sys.excepthook = _uncaught
        signal.signal(signal.SIGINT, _raise)


def end(code: int) -> NoReturn:
    """End the process with an exit code, at once: all files are closed, and nothing is left to tidy up.

    Python's own shutdown takes up to a tenth of a small run, and libraries that were interrupted may crash in it. (A
    profiler, which writes its data then, should run ``cli.app.run``.)
    """
    if signal.getsignal(signal.SIGINT) in (_leave, _raise):
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError, AttributeError):  # full, closed, or none at all
            stream.flush()
    os._exit(code)


def seen() -> bool:
    """Tell whether an interrupt has been raised, perhaps to surface as another error."""
    return _seen


def _report_of_batch() -> None:
    """Write the reports that a batch was asked for, while nothing is imported that could write better ones."""
    words = sys.argv[1:]
    if "run" not in words:
        return
    for option, text in REPORTS.items():
        given = [word.partition("=")[2] for word in words if word.startswith(f"{option}=")]
        given += [value for word, value in zip(words, words[1:]) if word == option]
        if not given:
            continue
        with contextlib.suppress(OSError):
            temporary = f"{given[-1]}.{os.getpid()}.tmp"
            with open(temporary, "w", encoding="utf-8") as file:
                file.write(text)
            os.replace(temporary, given[-1])


def over_line(columns: int) -> str:
    """Return what removes a line of progress from a terminal."""
    return "\r" + " " * columns + "\r" if columns else ""


def _leave(number: int, frame: FrameType | None) -> NoReturn:
    _report_of_batch()
    with contextlib.suppress(OSError):
        if "--json" in sys.argv:
            os.write(1, AS_JSON.encode())
    with contextlib.suppress(OSError):
        os.write(2, f"{over_line(line_shown)}robodyn: error: {MESSAGE}\n".encode())
    os._exit(INTERRUPTED)


def _raise(number: int, frame: FrameType | None) -> None:
    global _seen
    _seen = True
    if _importing(frame):
        _again()
    else:
        raise KeyboardInterrupt


def _importing(frame: FrameType | None) -> bool:
    """Tell whether a module is being imported, where an exception may be lost or become another one."""
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back
    return False


def _unraisable(lost: Any) -> None:
    """Raise again an interrupt that came where none can be raised, as in a callback."""
    if lost.exc_type is KeyboardInterrupt:
        _again()
    else:
        sys.__unraisablehook__(lost)


def _uncaught(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """Print the traceback of an error that nobody catches; of an interrupt none: code of Cython that can raise none
    prints it so before it is unraisable."""
    if kind is not KeyboardInterrupt:
        sys.__excepthook__(kind, error, trace)


def _again() -> None:
    """Interrupt the main thread in a moment."""
    later = threading.Timer(0.02, _interrupt)
    later.daemon = True
    later.start()


def _interrupt() -> None:
    if hasattr(signal, "pthread_kill"):
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)
    else:
        _thread.interrupt_main()
