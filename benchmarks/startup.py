"""Whole-process times of the command line beside the imports that it cannot do without.

    python benchmarks/startup.py [--quick] [--json FILE] [--as-is]

Every figure is a process from start to end, files written. The processes take turns; figures are medians, but
for the last ratio, that of the shortest processor's times. Two times are given: by the clock, and of the processor
(all threads), which a busy machine disturbs less. A run before has cached compiled code, and Python's bytecode too,
as in any installed package, in a folder of the benchmark's own; ``--as-is`` leaves bytecode to the environment.
"""

from __future__ import annotations

import os
import shutil
import struct
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import measure

CONFIGS = measure.ROOT / "configs"
SCENE = CONFIGS / "2r_circle.yaml"
IMPORTS = "import numpy, h5py, typer, yaml"
UNWANTED = ("matplotlib", "scipy", "pydantic", "numpy.ma", "numpy.random", "numpy.polynomial")

# what reading a command line takes beside them
EMPTY = f"""
{IMPORTS}
app = typer.Typer(add_completion=False)
@app.command()
def nothing() -> None: pass
app()
"""

CANVAS = """
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
FigureCanvasAgg(Figure()).draw()
"""

# the same imports, and as many figures of the same size with two lines of as many samples
PLAIN = """
import sys
import numpy as np, h5py, typer, yaml
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
folder, dpi = sys.argv[1], float(sys.argv[2])
t = np.linspace(0.0, 10.0, 1001)
for k, size in enumerate(sys.argv[3:]):
    width, height = (int(n) / dpi for n in size.split("x"))
    figure = Figure(figsize=(width, height), dpi=dpi)
    ax = figure.add_axes((0.12, 0.12, 0.84, 0.78))
    ax.plot(t, np.sin(t), label="sine")
    ax.plot(t, np.cos(t), label="cosine")
    ax.set_xlabel("time [s]")
    ax.set_ylabel("value")
    ax.set_title("A plain figure")
    ax.legend()
    FigureCanvasAgg(figure).print_png(f"{folder}/{k}.png")
"""

# what a run has imported when it ends
MODULES = """
import sys
from robodyn_cli.cli.app import run
code = run(sys.argv[1:])
assert code == 0, code
print(" ".join(sorted(sys.modules)))
"""


def run(command: list[str], environment: dict[str, str]) -> tuple[float, float]:
    """Run a process; return its seconds by the clock and of the processor."""
    start = time.perf_counter()
    process = subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL)
    if hasattr(os, "wait4"):
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        busy = usage.ru_utime + usage.ru_stime
    else:
        process.wait()
        busy = float("nan")
    elapsed = time.perf_counter() - start
    if process.returncode:
        raise SystemExit(f"exit code {process.returncode} of {' '.join(command)}")
    return elapsed, busy


def modules_of(arguments: list[str], environment: dict[str, str] | None = None) -> set[str]:
    """Return the names of all modules that a run of robodyn has imported when it ends."""
    command = [sys.executable, "-c", MODULES, *arguments, "--quiet"]
    text = subprocess.run(command, env=environment, check=True, stdout=subprocess.PIPE, text=True).stdout
    return set(text.split())


def png_size(path: Path) -> str:
    """Return the width and height of a PNG in dots, as ``840x576``."""
    width, height = struct.unpack(">II", path.read_bytes()[16:24])
    return f"{width}x{height}"


def robodyn() -> list[str]:
    """Return the command: the installed script, or the module where there is none."""
    script = shutil.which("robodyn", path=str(Path(sys.executable).parent))
    return [script] if script else [sys.executable, "-m", "robodyn_cli"]


def main() -> None:
    parser = measure.command_line(__doc__)
    parser.add_argument("--as-is", action="store_true", help="leave bytecode to the environment")
    options = parser.parse_args()
    repeats = 3 if options.quick else 21
    environment = {**os.environ, "PYTHONPATH": measure.search_path(), "MPLBACKEND": "Agg"}
    measure.print_machine()
    print(f"medians of {repeats} alternating processes\n")
    with measure.reporting(options.json) as report, tempfile.TemporaryDirectory() as folder:
        if not options.as_is:
            environment.pop("PYTHONDONTWRITEBYTECODE", None)
            environment["PYTHONPYCACHEPREFIX"] = f"{folder}/bytecode"
        report.rows += bench(Path(folder), environment, repeats)
        head = ["work", "process", "ms", "CPU ms", "ratio", "CPU ratio", "of minima", "target"]
        print(measure.table([head, *map(line, report.rows)], left=2))
        loaded = modules_of(["inverse", str(SCENE), "--no-plots", "--out", f"{folder}/modules"], environment)
        unwanted = [name for name in UNWANTED if name in loaded]
        report.more |= {"repeats": repeats, "unwanted_imports": unwanted}
        told = ", ".join(unwanted) or f"none ({', '.join(UNWANTED)})"
        print(f"\nrobodyn inverse --no-plots imports {len(loaded)} modules; unwanted ones: {told}")


def bench(folder: Path, environment: dict[str, str], repeats: int) -> list[dict[str, Any]]:
    """Time all processes in turn; return their rows."""
    from robodyn_cli.report.format import current

    def command(*arguments: str, out: str) -> list[str]:
        return [*robodyn(), *arguments, "--out", str(folder / out)]

    run(command("inverse", str(SCENE), out="plots"), environment)
    sizes = [png_size(path) for path in sorted((folder / "plots").glob("*.png"))]
    (folder / "plain").mkdir()
    python = sys.executable
    plain, plots = f"imports and {len(sizes)} plain figures", "inverse with plots"
    processes = {
        "imports": [python, "-c", IMPORTS],
        "empty": [python, "-c", EMPTY],
        "inverse": command("inverse", str(SCENE), "--no-plots", out="inverse"),
        "simulate": command("simulate", str(CONFIGS / "double_pendulum.yaml"), "--no-plots", out="simulate"),
        "deploy": command("deploy", str(CONFIGS / "four_bar_deploy.yaml"), "--no-plots", out="deploy"),
        "canvas": [python, "-c", CANVAS],
        plain: [python, "-c", PLAIN, str(folder / "plain"), str(current().dpi), *sizes],
        plots: command("inverse", str(SCENE), out="plots"),
    }
    # name, engine, what it is compared with, target of the ratio
    described = {
        "imports": ("numpy, h5py, typer, yaml imported", "python", None, None),
        "empty": ("the same, and an empty command of typer", "python", "imports", None),
        "inverse": ("2r_circle.yaml --no-plots", "robodyn inverse", "imports", 1.1),
        "simulate": ("double_pendulum.yaml --no-plots", "robodyn simulate", "imports", None),
        "deploy": ("four_bar_deploy.yaml --no-plots", "robodyn deploy", "imports", None),
        "canvas": ("matplotlib's Agg canvas imported and drawn empty", "python", None, None),
        plain: (plain, "python", "canvas", None),
        plots: (f"2r_circle.yaml, {len(sizes)} plots", "robodyn inverse", "canvas", 2.0),
    }
    for process in processes.values():
        run(process, environment)
    times: dict[str, list[tuple[float, float]]] = {name: [] for name in processes}
    for _ in range(repeats):
        for name, process in processes.items():
            times[name].append(run(process, environment))
    rows = []
    for name, (work, engine, base, target) in described.items():
        clock, busy = zip(*times[name])
        measure.noted(work, clock)
        row = {"work": work, "engine": engine, "ms": 1e3 * measure.median(clock),
               "cpu_ms": 1e3 * measure.median(busy)}  # fmt: skip
        if base is not None:
            base_clock, base_busy = zip(*times[base])
            row["ratio"] = measure.median_ratio(clock, base_clock)
            row["cpu_ratio"] = measure.median_ratio(busy, base_busy)
            row["cpu_ratio_of_minima"] = min(busy) / min(base_busy)
        if target is not None:
            row["target"] = target
        rows.append(row)
    return rows


def line(row: dict[str, Any]) -> list[str]:
    def text(key: str, form: str) -> str:
        return format(row[key], form) if key in row else ""

    return [row["work"], row["engine"], text("ms", ".0f"), text("cpu_ms", ".0f"), text("ratio", ".2f"),
            text("cpu_ratio", ".2f"), text("cpu_ratio_of_minima", ".2f"), text("target", ".1f")]  # fmt: skip


if __name__ == "__main__":
    main()
