"""Fuzzing for a given time: ``python -m tests.fuzz --seconds 600 --seed 1 --jobs 2 --out DIR``.

A worker that hangs or crashes is replaced. Findings are made smaller and written to ``DIR/NAME``: the files, the
command line and what it said.
"""

from __future__ import annotations

import argparse
import collections
import contextlib
import hashlib
import json
import multiprocessing
import os
import shlex
import shutil
import signal
import sys
import tempfile
import time
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

from tests.fuzz.cases import Case, Outcome, store_results, try_case
from tests.fuzz.makers import make, of_features
from tests.fuzz.smaller import smaller

INTERRUPT_AFTER = 10.0  # seconds, then a case is interrupted as by ctrl-C
HANGS_AFTER = 30.0  # seconds, then the worker is killed
MINIMISED_AFTER = 150.0  # seconds that making a finding smaller may take
SMALLER = "being made smaller"
MEMORY = 6 << 30  # bytes a worker may ask for


def work(seeds: range, stored: Path, out: Path, part: str, pipe: Connection) -> None:
    """Run the cases of some seeds; say before and after each which one and how it ended."""
    import resource

    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    os.environ["ROBODYN_DEBUG"] = "1"
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the pool stops it
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    seen: set[str] = set()
    with tempfile.TemporaryDirectory() as name:
        tempfile.tempdir, os.environ["BROWSER"] = name, "true"  # what commands leave, and open
        for seed in seeds:
            pipe.send((seed, None, ""))
            case = make(seed, stored, part)
            outcome = try_case(case, Path(name) / "case", INTERRUPT_AFTER)
            if outcome.finding and outcome.finding not in seen:
                seen.add(outcome.finding)
                pipe.send((seed, None, SMALLER))
                case = smaller(case, outcome.finding, Path(name) / "case", INTERRUPT_AFTER)
                write(out, case, outcome, seed)
            pipe.send((seed, f"{case.command} {outcome.code}", outcome.finding))


def write(out: Path, case: Case, outcome: Outcome, seed: int) -> None:
    """Store a finding."""
    name = hashlib.sha256(outcome.finding.encode()).hexdigest()[:10]
    for file, content in case.files.items():
        (out / name / file).parent.mkdir(parents=True, exist_ok=True)
        (out / name / file).write_bytes(content)
    line = shlex.join(["robodyn", case.command, *case.words])
    text = f"seed {seed}\n{outcome.finding}\n{line}\nexit code {outcome.code}\n\n{outcome.said}\n"
    (out / name / "finding.txt").write_text(text, errors="backslashreplace")


class Pool:
    """Workers with a share of the seeds each; one that hangs or dies is replaced, and its case is a finding."""

    def __init__(self, arguments: argparse.Namespace, stored: Path) -> None:
        self.arguments, self.stored = arguments, stored
        self.codes: collections.Counter[str] = collections.Counter()
        self.findings: collections.Counter[str] = collections.Counter()
        self.workers: dict[Connection, list[Any]] = {}
        for k in range(arguments.jobs):
            self._begin(arguments.seed + k)

    def _begin(self, first: int) -> None:
        mine, theirs = multiprocessing.Pipe(duplex=False)
        seeds = range(first, sys.maxsize, self.arguments.jobs)
        process = multiprocessing.Process(
            target=work, args=(seeds, self.stored, self.arguments.out, self.arguments.part, theirs)
        )
        process.start()
        theirs.close()
        # importing the program takes its time too
        self.workers[mine] = [process, first, time.monotonic() + 2.0 * HANGS_AFTER]

    def run(self, until: float) -> None:
        """Gather outcomes until the time is over."""
        while time.monotonic() < until and sum(self.codes.values()) < self.arguments.cases:
            for pipe in wait(list(self.workers), 1.0):
                self._hear(pipe)  # type: ignore[arg-type]
            for pipe, (_, seed, until_then) in list(self.workers.items()):
                if time.monotonic() > until_then and not pipe.poll():
                    self._replace(pipe, seed, "hang")

    def end(self) -> None:
        """Stop all workers."""
        for process, _, _ in self.workers.values():
            process.kill()

    def _hear(self, pipe: Connection) -> None:
        try:
            seed, code, finding = pipe.recv()
        except (EOFError, OSError):
            self._replace(pipe, self.workers[pipe][1], "crash")
            return
        patience = MINIMISED_AFTER if finding == SMALLER else HANGS_AFTER
        self.workers[pipe][1:] = [seed, time.monotonic() + patience]
        if code is not None:
            self.codes[code] += 1
            if finding:
                self._tell(seed, finding)

    def _replace(self, pipe: Connection, seed: int, what: str) -> None:
        process = self.workers.pop(pipe)[0]
        process.kill()
        process.join()
        pipe.close()
        case = make(seed, self.stored, self.arguments.part)
        write(self.arguments.out, case, Outcome(-1, "", f"{what} (seed {seed})"), seed)
        self.codes[f"{case.command} {what}"] += 1
        self._tell(seed, f"{what}: {case.command}")
        self._begin(seed + self.arguments.jobs)

    def _tell(self, seed: int, finding: str) -> None:
        self.findings[finding] += 1
        if self.findings[finding] == 1:
            print(f"seed {seed}: {finding}", flush=True)


def main() -> int:
    """Run; return 1 where something was found."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--cases", type=int, default=sys.maxsize)
    parser.add_argument(
        "--part", choices=("read", "run", "both"), default="both", help="readers alone, or commands"
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path(tempfile.gettempdir()) / "robodyn-fuzz")
    arguments = parser.parse_args()
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    arguments.out.mkdir(parents=True, exist_ok=True)
    stored = Path(tempfile.mkdtemp())
    try:
        store_results(stored)
        if arguments.part != "read":
            of_features()  # once for all workers
        pool = Pool(arguments, stored)
        with contextlib.suppress(KeyboardInterrupt):  # what was tried until then is told
            pool.run(time.monotonic() + arguments.seconds)
        pool.end()
    finally:
        shutil.rmtree(stored, ignore_errors=True)
    refused = sum(count for name, count in pool.codes.items() if name.endswith(" 2"))
    report = {"first_seed": arguments.seed, "part": arguments.part, "cases": pool.codes.total(),
              "past_validation": pool.codes.total() - refused, "codes": dict(sorted(pool.codes.items())),
              "findings": dict(pool.findings)}  # fmt: skip
    print(json.dumps(report, indent=1))
    name = f"report-{arguments.part}-{arguments.seed}.json"
    (arguments.out / name).write_text(json.dumps(report, indent=1))
    return 1 if pool.findings else 0


if __name__ == "__main__":
    sys.exit(main())
