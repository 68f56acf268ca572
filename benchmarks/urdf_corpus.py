"""Every robot of the package example-robot-data, read by robodyn and by Pinocchio: differences of their equations.

    pip download --no-deps example-robot-data -d DIR && unzip DIR/*.whl '*.urdf' -d DIR
    python benchmarks/urdf_corpus.py DIR [--quick] [--json FILE]

For each URDF below DIR at a random state: torques of inverse dynamics, accelerations of forward dynamics, mass matrix
and the frames of all links, as the largest difference over the largest entry. Damping and friction against
b v + f sign(v). Torques of joints that lead mimics, by the command ``inverse``, against Pinocchio's torques projected
onto the coupling. Read: the least time of several to read the file and check the scene. A dash is nothing to compare.
Without DIR: the robots of ``configs``.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

import measure

measure.single_thread()
sys.path.insert(0, str(measure.ROOT))

from robodyn_cli.errors import RobodynError  # noqa: E402
from robodyn_cli.scene.descriptions import load_description  # noqa: E402
from tests.urdf_robots import compare  # noqa: E402

BOUND = 1e-10
FIGURES = ("torques", "mass", "frames", "acceleration", "residual", "drag", "coupled")


def row_of(name: str, path: Path, repeats: int) -> dict[str, Any]:
    """Return the figures of one robot, or why it is refused."""
    row: dict[str, Any] = {"robot": name}
    try:
        times = []
        for _ in range(repeats):
            start = time.perf_counter()
            load_description(path)
            times.append(time.perf_counter() - start)
        measure.noted(name, times)
        found = compare(path)
    except RobodynError as error:
        return row | {"refused": error.message.replace(str(path), path.name)}
    figures = {name: getattr(found, name) for name in FIGURES}
    return row | {
        "joints": found.joints,
        "mimics": found.mimics,
        **figures,
        "singular": found.singular,
        "read_ms": 1e3 * min(times),
    }


def robots(folder: Path) -> dict[str, Path]:
    """Return the files below a folder by their names, and by their folder too where two have the same."""
    found: dict[str, Path] = {}
    for path in sorted(folder.rglob("*.urdf"), key=lambda path: path.stem.lower()):
        name = path.stem if path.stem not in found else f"{path.stem} ({path.parents[1].name})"
        found[name] = path
    return found


def cell(value: Any) -> str:
    if value is None:
        return "-"
    return f"{value:.1e}" if isinstance(value, float) else str(value)


def within(row: dict[str, Any]) -> bool:
    """Tell whether all figures are within the bound; forward dynamics also where only the residual is.

    Fingers of some grams on arms of many kilograms make mass matrices whose inverse loses digits in any program.
    """
    exact = ("torques", "mass", "frames", "drag", "coupled", "residual")
    return all(row[name] is None or row[name] <= BOUND for name in exact)


def main() -> None:
    parser = measure.command_line(__doc__)
    parser.add_argument("folder", type=Path, nargs="?", default=measure.ROOT / "configs" / "robots",
                        help="folder with the URDF files, at any depth")  # fmt: skip
    options = parser.parse_args()
    measure.print_machine()
    print()
    with measure.reporting(options.json) as report:
        if not report.has("pinocchio"):
            return
        for name, path in robots(options.folder).items():
            with report.part(name):
                report.rows.append(row_of(name, path, 1 if options.quick else 5))
        good, read = print_rows(report.rows)
    sys.exit(0 if good == read else 1)


def print_rows(rows: list[dict[str, Any]]) -> tuple[int, int]:
    """Print the table; return how many robots are within the bound, and how many were read."""
    read = [row for row in rows if "refused" not in row]
    table = [["robot", "joints", "mimics", *FIGURES, "read [ms]"]]
    for row in read:
        figures = (cell(row[f]) for f in FIGURES)
        table.append(
            [row["robot"], cell(row["joints"]), cell(row["mimics"]), *figures, f"{row['read_ms']:.0f}"]
        )
    print(measure.table(table))
    for row in read:
        if row["singular"]:
            print(
                f"\n{row['robot']}: no forward dynamics, because joint {row['singular']!r} moves nothing with inertia"
            )
    for row in rows:
        if "refused" in row:
            print(f"{row['robot']}: refused: {row['refused']}")
    good = sum(within(row) for row in read)
    print(f"{good} of {len(rows)} robots within {BOUND:g}, {len(rows) - len(read)} refused")
    return good, len(read)


if __name__ == "__main__":
    main()
