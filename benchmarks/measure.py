"""What the benchmarks share: alternating timings, the machine's description, tables and JSON."""

from __future__ import annotations

import argparse
import importlib.util
import json
import math
import os
import platform
import statistics
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

ROOT = Path(__file__).resolve().parent.parent
LIBRARIES = (
    "numpy", "scipy", "llvmlite", "h5py", "typer", "matplotlib", "pin", "mujoco", "heyoka", "casadi", "exudyn", "drake",
    "toppra",
)  # fmt: skip
PATIENCE = 60.0  # seconds by the clock, in which what takes long is repeated
REPEATS = 3  # of what is a run of its own each time

Result = TypeVar("Result")


def single_thread() -> None:
    """Keep numerical libraries to one thread; call before they are imported."""
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[name] = "1"


SPREADS: list[tuple[float, str]] = []  # of all timings so far, with their names


def noted(name: Any, seconds: Sequence[float]) -> None:
    """Keep for the report by what part of their median the middle half of the repeats of a timing differs."""
    name = name if isinstance(name, str) else " ".join(map(str, name))
    values = sorted(seconds)
    if len(values) > 1 and values[0] > 0.0:
        low, middle, high = statistics.quantiles(values, n=4, method="inclusive")
        SPREADS.append(((high - low) / middle, name))


def spread() -> dict[str, Any]:
    """Return the usual and the widest spread of the timings so far, which may be none."""
    if not SPREADS:
        return {}
    most, name = max(SPREADS)
    return {"timings": len(SPREADS), "median": median([x for x, _ in SPREADS]), "most": most, "of": name}


class Spread(NamedTuple):
    """The median of a figure over runs, the least and the largest, and how many runs there were."""

    middle: float
    least: float
    most: float
    runs: int

    @staticmethod
    def of(values: Sequence[float]) -> Spread:
        return Spread(statistics.median(values), min(values), max(values), len(values))

    def told(self, form: str) -> str:
        """Return the median in a format, with the range behind it if there were several runs."""
        if self.runs < 2:
            return f"{self.middle:{form}}"
        return f"{self.middle:{form}} ({self.least:{form}} to {self.most:{form}})"


def repeated(
    name: Any, call: Callable[[], Result], seconds: Callable[[Result], float], repeats: int
) -> list[Result]:
    """Return what a call gives each time: it is made so often, but not once more where all would take longer than
    ``PATIENCE``. The spread of the seconds that each says counts for the report."""
    found: list[Result] = []
    begun = time.perf_counter()
    for k in range(max(1, repeats)):
        if k and (time.perf_counter() - begun) * (k + 1) > PATIENCE * k:
            break
        found.append(call())
    noted(name, [seconds(x) for x in found])
    return found


def warmed(call: Callable[[], Any], samples: int) -> None:
    """Call a function of so many samples until its code is what it stays: longer programs are interpreted at first."""
    from robodyn_cli.kernels.samples import MANY

    for _ in range(-(-MANY // samples)):
        call()


def alternate(
    actions: Mapping[str, Callable[[], Any]], repeats: int, least: float = 0.02
) -> dict[str, list[float]]:
    """Time actions in turn, again and again, so that a busy machine slows all of them alike.

    Times are of the processor, not by the clock: the same for one busy thread, but waiting for other people's
    programs does not count.

    Parameters
    ----------
    repeats : how many times each is timed.
    least : seconds one timing should take; a quick action is called several times in it.

    Returns
    -------
    Seconds a call, a list an action.
    """
    calls = {}
    for name, action in actions.items():
        action()  # memory touched, code loaded
        start = time.process_time()
        action()
        calls[name] = max(1, round(least / max(time.process_time() - start, 1e-7)))
    found: dict[str, list[float]] = {name: [] for name in actions}
    for _ in range(repeats):
        for name, action in actions.items():
            start = time.process_time()
            for _ in range(calls[name]):
                action()
            found[name].append((time.process_time() - start) / calls[name])
    for name, seconds in found.items():
        noted(name, seconds)
    return found


def command_line(doc: str | None) -> argparse.ArgumentParser:
    """Return the parser that all benchmarks share, with ``--quick`` and ``--json``; its help is the script's text."""
    parser = argparse.ArgumentParser(
        description=doc, formatter_class=argparse.RawDescriptionHelpFormatter, allow_abbrev=False
    )
    parser.add_argument(
        "--quick", action="store_true", help="smaller, with fewer repeats: a look, not figures"
    )
    parser.add_argument("--json", metavar="FILE", help="write the rows to FILE")
    return parser


def with_repeats(parser: argparse.ArgumentParser) -> argparse.Namespace:
    """Return the options with ``repeats`` of whole runs, which take an option of their own."""
    parser.add_argument(
        "--repeats",
        type=int,
        metavar="N",
        help=f"runs of each, fewer beyond {PATIENCE:.0f} s in all (default: {REPEATS}, 2 by --quick)",
    )
    options = parser.parse_args()
    options.repeats = options.repeats or (2 if options.quick else REPEATS)
    return options


class Report:
    """What a benchmark has measured so far; it is written however the benchmark ends.

    rows : a row each figure or engine. more : what else the file gets. failed : parts that failed, and why.
    absent : peers that are not installed.
    """

    def __init__(self) -> None:
        self.rows: list[dict[str, Any]] = []
        self.more: dict[str, Any] = {}
        self.failed: dict[str, str] = {}
        self.absent: list[str] = []

    def has(self, module: str) -> bool:
        """Tell whether a peer is installed; one that is not is told once, and left out."""
        if importlib.util.find_spec(module) is not None:
            return True
        if module not in self.absent:
            self.absent.append(module)
            print(f"{module} is not installed: left out", file=sys.stderr)
        return False

    @contextmanager
    def part(self, name: str) -> Iterator[None]:
        """Measure a part of a benchmark: if it fails, that is a line of the report, and other parts go on."""
        try:
            yield
        except Exception as error:
            traceback.print_exc()
            self.failed[name] = f"{type(error).__name__}: {error}"


@contextmanager
def reporting(path: str | None) -> Iterator[Report]:
    """Yield an empty report, and write it at the end, after an error or an interrupt too, with the spread of timings.

    Raises
    ------
    SystemExit : with 1, after everything is printed and written, if a part failed.
    """
    report = Report()
    try:
        yield report
    finally:
        if report.failed:
            print("\n" + table([["failed", "why"], *map(list, report.failed.items())], left=2))
        scatter = spread()
        if scatter:
            print(
                f"\nSpread: the middle half of a timing's repeats lies within {scatter['median']:.0%} "
                f"(median of {scatter['timings']}), at most {scatter['most']:.0%} ({scatter['of']})"
            )
        if path:
            kept = {**report.more, "failed": report.failed, "absent": report.absent, "spread": scatter}
            found = {"machine": machine(), "quick": "--quick" in sys.argv, "rows": report.rows, **kept}
            text = json.dumps(finite(found), indent=2, allow_nan=False)
            Path(path).write_text(text + "\n", encoding="utf-8")
    if report.failed:
        raise SystemExit(1)


def finite(value: Any) -> Any:
    """Return data for JSON, which has no word for numbers that are not finite: they are None."""
    if isinstance(value, Mapping):
        return {key: finite(x) for key, x in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(x) for x in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def cold_and_cached(code: str, text: str = "") -> tuple[float, float]:
    """Return the seconds that a Python program prints, with no compiled code cached and with all of it.

    Both are processes of their own that share a cache; ``text`` is their standard input.
    """
    with tempfile.TemporaryDirectory() as cache:
        environment = {**os.environ, "ROBODYN_CACHE": cache, "PYTHONPATH": search_path()}
        command = [sys.executable, "-c", code]
        cold, cached = (
            float(subprocess.run(command, input=text, text=True, env=environment, check=True,
                                 stdout=subprocess.PIPE).stdout.split()[-1])
            for _ in range(2)
        )  # fmt: skip
    return cold, cached


def search_path() -> str:
    """Return PYTHONPATH with this checkout in front."""
    return os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])


def median(values: Sequence[float]) -> float:
    return statistics.median(values)


def median_ratio(slow: Sequence[float], fast: Sequence[float]) -> float:
    """Return the median of the ratios of timings taken next to each other."""
    return statistics.median(a / b for a, b in zip(slow, fast))


def revision() -> str:
    """Return the commit of this checkout, with ``+`` where files differ from it; empty outside of git."""
    git = ["git", "-C", str(ROOT)]
    try:
        found = subprocess.run([*git, "rev-parse", "--short=12", "HEAD"], capture_output=True, text=True)
        changed = subprocess.run([*git, "status", "--porcelain", "-uno"], capture_output=True, text=True)
    except OSError:
        return ""
    return found.stdout.strip() + "+" * bool(changed.stdout.strip()) if found.returncode == 0 else ""


def machine() -> dict[str, Any]:
    """Describe the machine and the versions in use."""
    from robodyn_cli.results.summary import cpu_name
    from robodyn_cli.version import __version__

    found: dict[str, Any] = {
        "cpu": cpu_name(),
        "cores": os.cpu_count(),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "robodyn": __version__,
        "revision": revision(),
    }
    if hasattr(os, "getloadavg"):
        found["load"] = round(os.getloadavg()[0], 2)
    for name in LIBRARIES:
        with suppress(metadata.PackageNotFoundError):
            found[name] = metadata.version(name)
    return found


def table(rows: Sequence[Sequence[str]], left: int = 1) -> str:
    """Return rows as a Markdown table, the first row its head, the first ``left`` columns text."""
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]

    def line(row: Sequence[str]) -> str:
        cells = [c.ljust(w) if k < left else c.rjust(w) for k, (c, w) in enumerate(zip(row, widths))]
        return "| " + " | ".join(cells) + " |"

    rules = ["-" * (w + 2) if k < left else "-" * (w + 1) + ":" for k, w in enumerate(widths)]
    return "\n".join([line(rows[0]), f"|{'|'.join(rules)}|", *map(line, rows[1:])])


def print_machine() -> None:
    print(", ".join(f"{k} {v}" for k, v in machine().items()), flush=True)
