"""A plugin of pytest that runs the tests of a room once for each mutant, each time in a process forked for it.

Everything is imported and collected once; nothing is written but into a directory of the mutant's own. Its compiled code
is kept there too: it begins with that of the source as it is, whose keys are digests of what it computes, but for a mutant of
what writes code, which begins with none. A mutant is tried by those quick tests of its room that call its function, quickest first,
until one fails. Which ones these are is learnt by running all of them once.
"""

from __future__ import annotations

import dataclasses
import hashlib
import importlib
import json
import os
import pkgutil
import shutil
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import pytest

from robodyn_cli.kernels.compiler import code_writers
from tests.mutants.listed import MODULE, PACKAGE, Mutant
from tests.mutants.rooms import room_of

LONGER = 8.0  # times the seconds of its tests that a mutant may take, for machines with other work
LEAST = 60.0  # seconds, at least
BROKEN = "no mutant: "
ROOT = str(PACKAGE) + os.sep


@dataclasses.dataclass
class Outcome:
    """Of a mutant: ``caught``, ``survived``, ``timeout``, ``gone`` or ``unreached``; by which test, in how many seconds."""

    verdict: str
    test: str = ""
    seconds: float = 0.0


class Runner:
    """Tries mutants in place of the tests that pytest has collected.

    folder : keeps which functions tests call, and compiled code. tell : is given each outcome.
    """

    def __init__(self, mutants: list[Mutant], folder: Path, tell: Callable[[Mutant, Outcome], None]) -> None:
        self.mutants, self.tell = mutants, tell
        self.reach, self.cache = folder.absolute() / "reach.json", folder.absolute() / "cache"
        self.called: set[CodeType] | None = None  # by the test that runs, where that is learnt
        self.seconds, self.failed = 0.0, ""

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        items[:] = [item for item in items if item.get_closest_marker("quick")]

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self.seconds += report.duration
        if report.failed:
            self.failed = report.nodeid

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        """Note what a test calls, its fixtures included."""
        self.seconds = 0.0
        if self.called is None:
            return (yield)
        self.called.clear()
        threading.settrace(self._call)
        sys.settrace(self._call)
        try:
            return (yield)
        finally:
            sys.settrace(None)
            threading.settrace(None)  # type: ignore[arg-type]

    def _call(self, frame: FrameType, event: str, argument: object) -> None:
        """Note a call; as it returns None, lines are not traced."""
        if self.called is not None and (code := frame.f_code).co_filename.startswith(ROOT):
            self.called.add(code)

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        for module in pkgutil.walk_packages([str(PACKAGE)], "robodyn_cli."):
            if module.name != "robodyn_cli.__main__":
                importlib.import_module(module.name)
        reached = self._learnt(session.items)
        by_name = {item.nodeid: item for item in session.items}
        for mutant in self.mutants:
            self.tell(mutant, self._tried(mutant, by_name, reached))
        return True

    def _learnt(self, items: list[pytest.Item]) -> dict[str, Any]:
        """Return seconds and functions of tests; those in files that have not changed are known from earlier runs."""
        known = json.loads(self.reach.read_text()) if self.reach.exists() else {}
        digests = {
            path: hashlib.sha256(path.read_bytes()).hexdigest() for path in {item.path for item in items}
        }
        new = [x for x in items if x.nodeid not in known or known[x.nodeid][2] != digests[x.path]]
        found = Path(f"{self.reach}.new")

        def learn(folder: Path) -> None:
            os.environ["ROBODYN_CACHE"] = str(self.cache)
            self.called = set()
            reached = {}
            for item in new:
                self._run([item])
                names = {f"{code.co_filename[len(ROOT) :]} {code.co_qualname}" for code in self.called}
                functions = sorted({name.partition(".<locals>")[0] for name in names})
                reached[item.nodeid] = self.seconds, functions, digests[item.path]
            found.write_text(json.dumps(reached))

        if new:
            _forked(learn, limit=3600.0)
            known |= json.loads(found.read_text())
            found.unlink()
            self.reach.write_text(json.dumps(known))
        return known

    def _run(self, items: list[pytest.Item]) -> None:
        """Run tests until one fails."""
        for item, following in zip(items, [*items[1:], None]):
            item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
            if self.failed and self.called is None:
                break

    def _tried(self, mutant: Mutant, items: dict[str, pytest.Item], reached: dict[str, Any]) -> Outcome:
        if mutant.is_gone:
            return Outcome("gone")
        room = room_of(mutant.file)
        of_file = mutant.file + " "
        own = sorted(
            (reached[name][0], name)
            for name in items
            if name.partition("::")[0].rpartition("/")[2] in room
            and any(
                x == mutant.place or (mutant.function == MODULE and x.startswith(of_file))
                for x in reached[name][1]
            )
        )
        if not own:
            return Outcome("unreached")
        begun = time.monotonic()

        def child(folder: Path) -> None:
            if self.cache.exists() and mutant.path not in code_writers():
                shutil.copytree(self.cache, folder / "cache")
            mutant.commit()
            self._run([items[name] for _, name in own])
            (folder / "failed").write_text(self.failed)

        failed = _forked(child, max(LEAST, LONGER * sum(x for x, _ in own)))
        verdict = "timeout" if failed is None else "caught" if failed else "survived"
        verdict = "broken" if failed and failed.startswith(BROKEN) else verdict
        return Outcome(verdict, failed or f"{len(own)} tests", time.monotonic() - begun)


def _forked(child: Callable[[Path], None], limit: float) -> str | None:
    """Run a function in a process of its own, with a directory that is removed; return what it wrote to the file
    ``failed`` there, None where it took longer than the limit [s] or ended by itself."""
    folder = Path(tempfile.mkdtemp(prefix="mutant-"))
    sys.stdout.flush()
    process = os.fork()
    if process == 0:
        try:
            os.setsid()
            os.environ.update(ROBODYN_CACHE=str(folder / "cache"), PYTEST_DEBUG_TEMPROOT=str(folder))
            silent = os.open(folder / "output", os.O_WRONLY | os.O_CREAT)
            os.dup2(silent, 1)
            os.dup2(silent, 2)
            child(folder)
        except BaseException as error:
            (folder / "failed").write_text(f"{BROKEN}{type(error).__name__}: {error}")
        finally:
            os._exit(0)
    until = time.monotonic() + limit
    while time.monotonic() < until and os.waitpid(process, os.WNOHANG) == (0, 0):
        time.sleep(0.02)
    try:
        os.killpg(process, signal.SIGKILL)  # what it has started, too
        os.waitpid(process, 0)
    except (ProcessLookupError, ChildProcessError):
        pass
    failed = folder / "failed"
    text = failed.read_text() if failed.exists() else None
    shutil.rmtree(folder, ignore_errors=True)
    return text
