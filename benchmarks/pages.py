"""Pages of results in a headless Chromium: size, time to make them, first drawing, frames a second; what it adds that
scenes run in them, and how long it takes from a slider to the picture.

    python benchmarks/pages.py [--repeats N] [--quick] [--json FILE]

Results: the deploying four-bar, and the seven-joint arm at 100 000 samples. Making a page is a process from start to
end. The first drawing is counted from the start of the page's navigation, frames over seconds in which the motion
plays; the clock and the processor are shared with the browser. From slider to picture: integrations with their errors,
figures and drawing, not what the browser takes to paint. Needs playwright and a Chromium on the PATH.
"""

from __future__ import annotations

import os
import shutil
import statistics
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import measure
from startup import robodyn, run

CONFIGS = measure.ROOT / "configs"
RESULTS = {
    "four-bar": ["deploy", str(CONFIGS / "four_bar_deploy.yaml")],
    "seven joints, 100 001 samples": [
        "inverse", str(CONFIGS / "seven_joint_arm.yaml"), "--set", "inverse.samples=100001",
    ],
}  # fmt: skip
# results of which a scene runs in the page: command, keys with their ranges
LIVE = {
    "four-bar to its lock": (
        RESULTS["four-bar"],
        ["robot.links.crank.mass=5:60", "initial.q.theta1=0.01:0.3"],
    ),
    "double pendulum, 10 s": (
        ["simulate", str(CONFIGS / "double_pendulum.yaml")],
        ["robot.links.link1.mass=8:17", "robot.joints.theta1.a=0.7:1.4"],
    ),
}
CHROMIUM = ("chromium", "chromium-browser", "google-chrome", "chrome")
WANTED = "wanted: four-bar in less than 1 MB and 2 s, drawn within 1 s, 30 frames/s; seven joints in less than 2 MB"
WANTED_LIVE = "wanted: at most 150 kB added to the four-bar's page, slider to picture in less than 5 ms"
MOVES = """async (moves) => {
  const box = document.querySelector('.live'), slider = box.querySelector('input[type=range]'), taken = [];
  const next = () => new Promise((done) => requestAnimationFrame(() => setTimeout(done)));
  for (let k = 0; k < moves; k++) {
    slider.value = Number(slider.min) + (0.1 + 0.8 * k / moves) * (slider.max - slider.min);
    slider.dispatchEvent(new Event('input'));
    await next();
    taken.push(Number(box.dataset.milliseconds));
  }
  return taken;
}"""
FRAMES = """async (seconds) => {
  document.querySelector('.play').click();
  const start = performance.now();
  let count = 0;
  await new Promise((done) => {
    const step = (now) => { count += 1; now - start < 1000 * seconds ? requestAnimationFrame(step) : done(); };
    requestAnimationFrame(step);
  });
  return 1000 * count / (performance.now() - start);
}"""


def main() -> None:
    parser = measure.command_line(__doc__)
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args()
    repeats = 1 if options.quick else options.repeats
    environment = {**os.environ, "PYTHONPATH": measure.search_path(), "MPLBACKEND": "Agg"}
    measure.print_machine()
    print(f"medians of {repeats}; {WANTED}\n")
    with measure.reporting(options.json) as report, tempfile.TemporaryDirectory() as folder:
        report.more["repeats"] = repeats
        path = next((path for name in CHROMIUM if (path := shutil.which(name))), None)
        if path is None:
            report.absent.append("chromium")
            print(f"needs a Chromium on the PATH, by one of the names {', '.join(CHROMIUM)}", file=sys.stderr)
        if path is None or not report.has("playwright"):
            return
        with browser(path) as chromium:
            for name, command in RESULTS.items():
                with report.part(name):
                    report.rows.append(bench(name, command, Path(folder), environment, chromium, repeats))
        head = ["result", "KiB", "made in s", "CPU s", "first drawing s", "frames/s"]
        cells = [
            [
                row["result"], f"{row['bytes'] / 1024:.0f}", f"{row['s']:.2f}", f"{row['cpu_s']:.2f}",
                f"{row['first_drawing_s']:.2f}", f"{row['frames_per_s']:.0f}",
            ]
            for row in report.rows
        ]  # fmt: skip
        print(measure.table([head, *cells]))
        report_live(report, Path(folder), environment, path, 20 if options.quick else 200)


def report_live(report: Any, folder: Path, environment: dict[str, str], path: str, moves: int) -> None:
    """Print and keep what running adds to pages."""
    rows = []
    with browser(path) as chromium:
        for name, (command, keys) in LIVE.items():
            with report.part(name):
                rows.append(bench_live(name, command, keys, folder, environment, chromium, moves))
                report.rows.append(rows[-1])
    cells = [
        [
            row["result"],
            f"{row['added_bytes'] / 1000:.0f}",
            f"{row['slider_ms']:.1f}",
            f"{row['slowest_ms']:.1f}",
        ]
        for row in rows
    ]
    head = ["runs in the page", "kB added", "slider to picture ms, median", "of 20 the slowest"]
    print(f"\n{WANTED_LIVE}\n\n{measure.table([head, *cells])}")


def bench_live(
    name: str,
    command: list[str],
    keys: list[str],
    folder: Path,
    environment: dict[str, str],
    chromium: Any,
    moves: int,
) -> dict[str, Any]:
    """Let the scene of a result run in its page, and move its first slider."""
    out, plain, live = folder / "live", folder / "plain.html", folder / "live.html"
    run([*robodyn(), *command, "--no-plots", "--out", str(out)], environment)
    run([*robodyn(), "report", str(out), "--file", str(plain)], environment)
    asked = [word for key in keys for word in ("--live", key)]
    run([*robodyn(), "report", str(out), "--file", str(live), *asked], environment)
    context = chromium.new_context(offline=True, viewport={"width": 1100, "height": 900})
    page = context.new_page()
    page.goto(live.as_uri())
    page.locator("html[data-running]").wait_for(state="attached")
    page.evaluate(MOVES, 20)  # until the browser has compiled what it runs often
    taken = sorted(page.evaluate(MOVES, moves))
    context.close()
    return {
        "result": name,
        "added_bytes": live.stat().st_size - plain.stat().st_size,
        "slider_ms": statistics.median(taken),
        "slowest_ms": taken[int(0.95 * len(taken))],
    }


def bench(
    name: str, command: list[str], folder: Path, environment: dict[str, str], chromium: Any, repeats: int
) -> dict[str, Any]:
    """Make the page of a result and open it, ``repeats`` times each."""
    out, page = folder / command[0], folder / f"{command[0]}.html"
    run([*robodyn(), *command, "--no-plots", "--out", str(out)], environment)
    made = []
    for _ in range(repeats):
        start, before = time.perf_counter(), os.times()
        run([*robodyn(), "report", str(out), "--file", str(page)], environment)
        after = os.times()
        cpu = after.children_user + after.children_system - before.children_user - before.children_system
        made.append((time.perf_counter() - start, cpu))
    seen = [look(chromium, page) for _ in range(repeats)]
    measure.noted(name, [s for s, _ in made])
    return {
        "result": name,
        "bytes": page.stat().st_size,
        "s": statistics.median(s for s, _ in made),
        "cpu_s": statistics.median(cpu for _, cpu in made),
        "first_drawing_s": statistics.median(first for first, _ in seen),
        "frames_per_s": statistics.median(frames for _, frames in seen),
    }


def look(chromium: Any, page: Path) -> tuple[float, float]:
    """Return when the mechanism is first drawn [s] and how many frames a second its motion has."""
    context = chromium.new_context(offline=True, viewport={"width": 1100, "height": 900})
    shown = context.new_page()
    shown.goto(page.as_uri())
    shown.locator(".scene[data-pose]").wait_for()
    first = shown.evaluate("performance.now()") / 1000.0
    frames = shown.evaluate(FRAMES, 3.0)
    context.close()
    return float(first), float(frames)


@contextmanager
def browser(path: str) -> Iterator[Any]:
    """Start a Chromium."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        started = driver.chromium.launch(executable_path=path, args=["--no-sandbox"])
        yield started
        started.close()


if __name__ == "__main__":
    main()
