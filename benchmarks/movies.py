"""Whole-process times of a movie: the deploying four-bar as a GIF, beside matplotlib's FuncAnimation.

    python benchmarks/movies.py [--repeats N] [--alone] [--quick] [--json FILE]

Every figure is a process from start to end, the file written. The processes take turns; times are medians, by the
clock and of the processor (all threads). FuncAnimation draws as many frames of the same size with nothing but the
lines of the links, in the same colours, by Pillow too.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import measure
from startup import robodyn, run

SCENE = measure.ROOT / "configs" / "four_bar_deploy.yaml"
WANTED = 4.0  # seconds at most

FUNC_ANIMATION = """
import sys
import h5py, numpy as np
from matplotlib.animation import FuncAnimation, PillowWriter
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
result, target, width, height, frames, fps = sys.argv[1], sys.argv[2], *(float(x) for x in sys.argv[3:])
with h5py.File(result) as file:
    links = [data[:] for data in file["skeleton"].values()]
figure = Figure(figsize=(width / 100, height / 100), dpi=100)
FigureCanvasAgg(figure)
ax = figure.add_axes((0.1, 0.1, 0.85, 0.85))
every = np.concatenate([link.reshape(-1, 3) for link in links])
low, high = every.min(axis=0), every.max(axis=0)
ax.set_xlim(low[0] - 0.1, high[0] + 0.1)
ax.set_ylim(low[1] - 0.1, high[1] + 0.1)
ax.set_aspect("equal")
lines = [ax.plot([], [])[0] for _ in links]
chosen = np.linspace(0, len(links[0]) - 1, int(frames)).round().astype(int)
def show(frame):
    for line, link in zip(lines, links):
        line.set_data(link[chosen[frame], :, 0], link[chosen[frame], :, 1])
    return lines
FuncAnimation(figure, show, frames=len(chosen), blit=True).save(target, PillowWriter(fps=int(fps)))
"""


def main() -> None:
    parser = measure.command_line(__doc__)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--alone", action="store_true", help="leave FuncAnimation out")
    options = parser.parse_args()
    options.repeats = 1 if options.quick else options.repeats
    more = ["--fps", "5"] if options.quick else []
    environment = {**os.environ, "PYTHONPATH": measure.search_path(), "MPLBACKEND": "Agg"}
    measure.print_machine()
    with measure.reporting(options.json) as report, tempfile.TemporaryDirectory() as folder:
        rows, made = bench(Path(folder), environment, options.repeats, options.alone, more)
        report.rows += rows
        report.more |= {"repeats": options.repeats, "wanted": WANTED, "frames": made["frames"]}
        print(
            f"medians of {options.repeats} alternating processes; {made['frames']} frames, "
            f"{made['size'] / 1024:.0f} KiB"
        )
        print(f"wanted: robodyn animate in less than {WANTED:g} s\n")
        cells = [[row["process"], f"{row['s']:.2f}", f"{row['cpu_s']:.2f}"] for row in rows]
        print(measure.table([["process", "s", "CPU s"], *cells]))


def bench(
    folder: Path, environment: dict[str, str], repeats: int, alone: bool, more: list[str]
) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Time the processes in turn; return their rows, and what ``animate`` says of its movie. more : its options."""
    from PIL import Image

    run([*robodyn(), "deploy", str(SCENE), "--no-plots", "--out", str(folder / "result")], environment)
    gif = folder / "movie.gif"
    animate = [*robodyn(), "animate", str(folder / "result"), "--file", str(gif), "--json", *more]
    made = json.loads(subprocess.run(animate, env=environment, check=True, stdout=subprocess.PIPE).stdout)
    with Image.open(gif) as image:
        size = image.size
    processes = {"robodyn animate": animate}
    if not alone:
        words = [folder / "result" / "result.h5", folder / "plain.gif", *size, made["frames"], made["fps"]]
        processes["FuncAnimation"] = [sys.executable, "-c", FUNC_ANIMATION, *map(str, words)]
    times: dict[str, list[tuple[float, float]]] = {name: [] for name in processes}
    for _ in range(repeats):
        for name, process in processes.items():
            times[name].append(run(process, environment))
    rows = []
    for name, pairs in times.items():
        clock, busy = zip(*pairs)
        measure.noted(name, clock)
        rows.append({"process": name, "s": measure.median(clock), "cpu_s": measure.median(busy)})
    return rows, made


if __name__ == "__main__":
    main()
