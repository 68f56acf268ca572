"""Exported C of the four-bar's whole motion to its lock, beside the program's own compiled loop.

    python benchmarks/c_loop.py [--quick] [--json FILE]

The time of the compiler, by what it is asked for, and the time of one motion: numbers, start, all steps up to the lock.
Both run the same number of steps and end at the same time.
"""

from __future__ import annotations

import resource
import shutil
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

import measure

measure.single_thread()

import numpy as np  # noqa: E402

from robodyn_cli.integrators.runtime.fleet import FleetLimits, Sampling  # noqa: E402
from robodyn_cli.over.c99.folder import export_c  # noqa: E402
from robodyn_cli.over.loop_c.structure import CStructure  # noqa: E402
from robodyn_cli.scene.load import Family  # noqa: E402

SCENE = Path(__file__).parents[1] / "configs" / "four_bar_deploy.yaml"
NAME = "four_bar_deploy"
CHOICES = {
    "-O2, vectors": ("-O2", "-DFOUR_BAR_DEPLOY_VECTORS"),
    "-O2 -march=native, vectors": ("-O2", "-march=native", "-DFOUR_BAR_DEPLOY_VECTORS"),
    "-O2, scalars": ("-O2",),
}
TIMER = f"""#include "{NAME}_loop.h"
#include <stdio.h>
#include <stdlib.h>
#include <time.h>
static {NAME}_loop loop;
int main(int count, char **words)
{{
    double values[{NAME.upper()}_LOOP_KEYS + 1], x[{NAME.upper()}_LOOP_NX];
    const int rounds = atoi(words[count - 1]);
    clock_t begin;
    {NAME}_loop_values(values);
    begin = clock();
    for (int k = 0; k < rounds; ++k)
        if ({NAME}_loop_begin(&loop, values, 0) || {NAME}_loop_to(&loop, 1e3, x) != {NAME.upper()}_LOOP_ENDED)
            return 1;
    printf("%.17g %.17g\\n", (double)(clock() - begin) / CLOCKS_PER_SEC / rounds * 1e6, {NAME}_loop_time(&loop));
    return 0;
}}
"""


def compiled(folder: Path, flags: tuple[str, ...]) -> tuple[Path, float]:
    """Return a program, and the processor time of the compiler [s]."""
    target = folder / f"timer{len(list(folder.glob('timer*')))}"
    sources = [folder / "timer.c", folder / "c" / f"{NAME}_loop.c"]
    command = [str(shutil.which("gcc")), "-std=c99", *flags, "-I", str(folder / "c"), *map(str, sources)]
    before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    subprocess.run([*command, "-lm", "-o", str(target)], check=True)
    return target, resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before


class OwnLoop:
    """The program's own loop on the same scene."""

    def __init__(self, family: Family) -> None:
        structure = CStructure(family, {})
        judging = structure.judging
        self.fleet, self.batch, self.steps = structure.fleet, structure.batch, judging.most

    def seconds(self, rounds: int) -> tuple[float, float]:
        """Return processor time of one run [s], and where it ends [s]."""
        batch = self.batch
        numbers = np.tile(self.fleet.tables.numbers, (rounds, 1))
        states, ends = np.tile(batch.states, (rounds, 1)), np.tile(batch.ends, rounds)
        limits = FleetLimits(steps=np.full(rounds, self.steps))
        runs = self.fleet.begin(states, numbers, ends, batch.options, limits, Sampling())
        begin = time.process_time()
        self.fleet.drive_one_by_one(runs)
        return (time.process_time() - begin) / rounds, float(runs.time[0])


def bench(report: measure.Report, rounds: int, repeats: int) -> None:
    """Time all; add a row for each choice of the compiler."""
    family = Family(SCENE)
    own = OwnLoop(family)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        export_c(family, [], folder / "c", loop=True)
        (folder / "timer.c").write_text(TIMER, encoding="utf-8")
        programs = {label: compiled(folder, flags) for label, flags in CHOICES.items()}
        times: dict[str, list[float]] = {label: [] for label in (*programs, "own")}
        end = 0.0
        for _ in range(repeats):
            took, end = own.seconds(rounds)
            times["own"].append(took * 1e6)
            for label, (program, _) in programs.items():
                out = subprocess.run([str(program), str(rounds)], check=True, capture_output=True, text=True)
                took, last = map(float, out.stdout.split())
                assert abs(last - end) <= 1e-10, (last, end)
                times[label].append(took)
    for label, taken in times.items():
        measure.noted(label, taken)
    for label, (_, compiling) in programs.items():
        row: dict[str, Any] = {
            "compiler": f"gcc {label}", "compile_s": compiling, "motion_us": measure.median(times[label]),
            "own_us": measure.median(times["own"]), "ratio": measure.median_ratio(times[label], times["own"]),
        }  # fmt: skip
        report.rows.append(row)


def main() -> None:
    """Measure and print."""
    chosen = measure.command_line(__doc__).parse_args()
    with measure.reporting(chosen.json) as report:
        measure.print_machine()
        if shutil.which("gcc") is None:
            report.absent.append("gcc")
            return
        with report.part("the four-bar to its lock"):
            bench(report, *((50, 3) if chosen.quick else (500, 11)))
        head = ["compiler", "compile s", "C us", "own us", "times as long"]
        rows = [
            [
                r["compiler"],
                f"{r['compile_s']:.1f}",
                f"{r['motion_us']:.0f}",
                f"{r['own_us']:.0f}",
                f"{r['ratio']:.2f}",
            ]
            for r in report.rows
        ]
        print("\n" + measure.table([head, *rows]))


if __name__ == "__main__":
    main()
