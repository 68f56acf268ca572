"""The double pendulum as a unit of FMI, driven from C: communication steps a second, outputs read at each.

    python benchmarks/fmu.py [--quick] [--json FILE]

The unit is compiled as it is exported; the importer of the tests loads it, makes steps and reads all outputs. Each step
makes two integrations, from which the errors come.
"""

from __future__ import annotations

import shutil
import subprocess
import tempfile
import zipfile
from pathlib import Path
from xml.etree import ElementTree

import measure

measure.single_thread()

from robodyn_cli.over.fmu.export import export_fmu  # noqa: E402
from robodyn_cli.scene.load import Family  # noqa: E402

ROOT = Path(__file__).parents[1]
SCENE = ROOT / "configs" / "double_pendulum.yaml"
IMPORTER = ROOT / "tests" / "fmu_importer.c"
STEPS = {"1 ms": 1e-3, "10 ms": 1e-2}


def bench(report: measure.Report, count: int, repeats: int) -> None:
    """Time all; add a row for each communication step."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if export_fmu(Family(SCENE), folder / "own.fmu", []):
            report.absent.append("cc")
            return
        with zipfile.ZipFile(folder / "own.fmu") as unit:
            unit.extractall(folder)
        root = ElementTree.parse(folder / "modelDescription.xml").getroot()
        real = [
            int(v.attrib["valueReference"]) for v in root.iter("Float64") if v.attrib["causality"] == "output"
        ]
        (library,) = (folder / "binaries").glob("*/own.*")
        importer = folder / "importer"
        compiler = str(shutil.which("cc"))
        subprocess.run([compiler, "-std=c99", "-O2", str(IMPORTER), "-o", str(importer), "-ldl"], check=True)
        first, last = real[0], real[-1]
        words = [str(importer), str(library), root.attrib["instantiationToken"]]
        for label, step in STEPS.items():
            times = []
            for _ in range(repeats):
                more = [repr(step), str(count), str(first), str(last - first + 1)]
                done = subprocess.run([*words, *more], check=True, capture_output=True, text=True)
                times.append(float(done.stdout.split()[0]))
            measure.noted(label, times)
            row = {
                "step": label,
                "steps": count,
                "outputs": last - first + 1,
                "steps_a_second": count / measure.median(times),
            }
            report.rows.append(row)


def main() -> None:
    """Measure and print."""
    chosen = measure.command_line(__doc__).parse_args()
    with measure.reporting(chosen.json) as report:
        measure.print_machine()
        if shutil.which("cc") is None:
            report.absent.append("cc")
            return
        with report.part("communication steps"):
            bench(report, *((2000, 3) if chosen.quick else (100_000, 7)))
        head = ["communication step", "steps", "outputs", "steps a second"]
        rows = [
            [r["step"], str(r["steps"]), str(r["outputs"]), f"{r['steps_a_second']:.3g}"] for r in report.rows
        ]
        print("\n" + measure.table([head, *rows]))


if __name__ == "__main__":
    main()
