"""The stability suite's cases in MuJoCo, Exudyn and scipy, each at settings that a user would start with.

    python benchmarks/stability_peers.py [--cases A,B] [--repeats N] [--quick] [--json FILE]

Errors are the largest of any position or rate over its range, against the suite's own reference, whose two methods
agree. Springs, dampers and dry friction of joints, loops and rigid stops are the engines' own as far as they have them
(``suite_peers``); other torques are functions of ours, applied once a step in MuJoCo. A case that has to stop is told
in words. Engines that are not installed are left out. The seconds of a run are medians of several, with their range.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "benchmarks")]

import measure  # noqa: E402

measure.single_thread()

import numpy as np  # noqa: E402
from suite_peers import exudyn, mujoco, scipy  # noqa: E402
from suite_peers.case import SECONDS, Mechanism, Refused, Run, TooSlow  # noqa: E402

from robodyn_cli.over.references import TrialReference  # noqa: E402
from robodyn_cli.over.stability.cases import CASES, Case  # noqa: E402
from robodyn_cli.over.stability.suite import _spectrum  # noqa: E402
from robodyn_cli.over.stability.trial import INACCURATE, Budget, attempt, reference  # noqa: E402

ENGINES = {"mujoco": mujoco.runs, "exudyn": exudyn.runs, "scipy": scipy.runs}
NEEDED = {"scipy": ("pinocchio",)}  # for the accelerations
BUDGET = Budget(2_000_000, 20.0)
QUICK = ("gravity_alone", "start_near_singular", "double_pendulum")  # cases of ``--quick``
INSTANTS = 257  # of a case that has no reference
TORN = 1e-2  # m: ends of a loop that are further apart are no loop
SAME = 0.02  # rad between crank and follower of a parallelogram; on its other branch 0.25 at the end


def outcome(run: Run, times: np.ndarray) -> tuple[dict[str, Any], np.ndarray | None]:
    """Return what is known of a peer's run without a reference, and its states (T, n) if there are any."""
    began = time.process_time()
    states = None
    try:
        with np.errstate(all="ignore"):
            states = run(times)
        status = "stable" if np.all(np.isfinite(states)) else "not finite"
    except TooSlow:
        return {"status": "too_slow", "relative": None, "seconds": SECONDS}, None
    except Refused as error:
        return {"status": str(error), "relative": None, "seconds": 0.0}, None
    except Exception as error:  # a peer may fail in ways of its own
        status = "model refused" if "inertia" in str(error) else "gives up"
        found = {"status": status, "relative": None, "seconds": time.process_time() - began}
        return {**found, "message": str(error)}, None
    found = {"status": status, "relative": None, "seconds": time.process_time() - began}
    return found, states if status == "stable" else None


def judged(found: dict[str, Any], states: np.ndarray | None, ref: TrialReference) -> dict[str, Any]:
    """Return a run with its error over the range of each quantity."""
    if states is None:
        return found
    relative = float((np.abs(states - ref.states) / ref.scale).max())
    return {**found, "status": "stable" if relative <= INACCURATE else "inaccurate", "relative": relative}


def passage(found: dict[str, Any], states: np.ndarray | None, mechanism: Mechanism) -> dict[str, Any]:
    """Return a run through the flat pose of the parallelogram with the branch that it leaves on, in words."""
    if states is None:
        return found
    gap = float(mechanism.gaps(states).max())
    names = mechanism.model.q_names
    crank, follower = (states[-1, names.index(name)] for name in ("theta1", "phi1"))
    apart = abs(np.angle(np.exp(1j * (crank - follower))))
    branch = "parallelogram" if apart < SAME else "antiparallelogram"
    if gap > TORN:
        branch = "torn"
    return {**found, "words": f"{branch}, gap {gap:.0e} m", "gap": gap, "apart": float(apart)}


def timed(seconds: Sequence[float]) -> dict[str, Any]:
    """Return the median of the seconds of several runs, and their range."""
    middle, *ends, repeats = measure.Spread.of(seconds)
    return {"seconds": middle, "range": ends, "repeats": repeats}


def compare(
    report: measure.Report, case: Case, text: str | None = None, repeats: int = 1
) -> dict[str, Any] | None:
    """Return what robodyn and its peers do with a case (``text``: with another scene); None without a reference."""
    if not case.peers:
        return None
    mechanism = Mechanism(case, text)
    scene = mechanism.scene
    ref = None
    if case.stops is None:
        ref = reference(scene, BUDGET, _spectrum(scene)[1])
        if ref is None:
            return None
    own, *more = measure.repeated(
        f"{case.name} robodyn", lambda: attempt(scene, "auto", ref, BUDGET), lambda x: x.seconds, repeats
    )
    mine: dict[str, Any] = {"status": own.status, "relative": own.relative}
    mine |= timed([x.seconds for x in (own, *more)])
    if ref is None:
        mine["words"] = "stops" if own.failure == case.stops else own.status
    found = {"robodyn auto": mine}
    times = np.linspace(0.0, scene.simulate.duration, INSTANTS) if ref is None else ref.times
    for module, runs in ENGINES.items():
        if not all(report.has(name) for name in (module, *NEEDED.get(module, ()))):
            continue
        for name, run in runs(mechanism):
            runs_of_it = measure.repeated(
                f"{case.name} {name}",
                lambda run=run: outcome(run, times),
                lambda x: x[0]["seconds"],
                repeats,
            )
            told, states = runs_of_it[0]
            told |= timed([x["seconds"] for x, _ in runs_of_it])
            found[name] = passage(told, states, mechanism) if ref is None else judged(told, states, ref)
    row: dict[str, Any] = {"case": case.name, "runs": found}
    return row if ref is None else {**row, "until": ref.until, "digits": ref.digits}


def shown(run: dict[str, Any] | None) -> str:
    if run is None:
        return ""
    if "words" in run:
        return str(run["words"])
    if run["relative"] is None:
        return str(run["status"]).replace("_", " ")
    return f"{run['relative']:.0e}" + (" !" if run["status"] == "inaccurate" else "")


def main() -> None:
    parser = measure.command_line(__doc__)
    parser.add_argument(
        "--cases", default="", help="names of the suite's cases; default: all, three by --quick"
    )
    options = measure.with_repeats(parser)
    names = options.cases.split(",") if options.cases else [c.name for c in CASES]
    if options.quick and not options.cases:
        names = QUICK
    with measure.reporting(options.json) as report:
        for case in (c for c in CASES if c.name in names):
            with report.part(case.name):
                row = compare(report, case, repeats=options.repeats)
                if row is not None:
                    report.rows.append(row)
                    told = {k: shown(v) for k, v in row["runs"].items()}
                    print(case.name, told, file=sys.stderr, flush=True)
        columns = list(dict.fromkeys(name for row in report.rows for name in row["runs"]))
        print("| case | " + " | ".join(columns) + " |")
        print("|---" * (len(columns) + 1) + "|")
        for row in report.rows:
            print(f"| {row['case']} | " + " | ".join(shown(row["runs"].get(c)) for c in columns) + " |")


if __name__ == "__main__":
    main()
