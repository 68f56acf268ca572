# ruff: noqa: E501
"""Write docs/stability.md from a run of the suite and of its peers.

robodyn stability --suite --out DIR
python benchmarks/stability_peers.py --json PEERS.json
robodyn stability configs/four_bar_deploy.yaml --out FOUR_BAR
python docs/make_stability.py DIR PEERS.json FOUR_BAR
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from PIL import Image

from robodyn_cli.over.references import TrialReference
from robodyn_cli.over.stability.cases import CASES
from robodyn_cli.over.stability.suite import judge
from robodyn_cli.summaries.stability import MethodTrial

DOCS = Path(__file__).resolve().parent
SHOWN = ("auto", "gauss", "implicit_midpoint", "dop853", "dopri5", "rk4", "rodas5p", "radau", "radau13")
HEAD = """\
# Stability

`robodyn stability --suite` runs stiff, badly scaled and singular mechanisms by `auto` and by every method;
[cli.md](cli.md#options-of-stability) has its options, [theory.md](theory.md#numerical-stability) what its figures are.
This page is written by `docs/make_stability.py` from such a run. Figures are the largest error of any position or rate over its
range (or over a thousandth of the largest range of its kind), against a reference on which two methods at tight tolerance
agree, as long as they do. `!` marks an error above a thousandth.
"""


def cell(trial: dict[str, Any] | None) -> str:
    if trial is None:
        return ""
    if "words" in trial:
        return str(trial["words"])
    if trial["relative"] is not None:
        return f"{trial['relative']:.0e}" + (" !" if trial["status"] == "inaccurate" else "")
    if trial["status"] == "stable":
        return "stops" if trial.get("failure") else "ran"
    return str(trial["status"]).replace("_", " ")


def table(head: list[str], rows: list[list[str]]) -> str:
    lines = ["| " + " | ".join(head) + " |", "|---" * len(head) + "|"]
    return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in rows)]) + "\n"


def main(suite: Path, peers: Path, *four_bar: Path) -> None:
    summary = json.loads((suite / "summary.json").read_text(encoding="utf-8"))
    cases = {case["name"]: case for case in summary["cases"]}
    rows, verdicts, missed = [], [], 0
    for case in (c for c in CASES if c.name in cases):
        found = cases[case.name]
        trials = [MethodTrial(**t) for t in found["methods"].values()]
        ref: Any = TrialReference if found["reference"] else None  # whether there is one is all that is asked
        complaints = judge(case, trials, ref)
        missed += bool(complaints)
        told = found["reference"]
        vouched = (
            "-"
            if told is None
            else f"{' and '.join(told['methods'])}: {told['digits']:.0f} digits to {told['until']:.3g} s"
        )
        decay = "-" if found["fastest_decay"] is None else f"{found['fastest_decay']:.1e}"
        verdicts.append(
            [f"`{case.name}`", case.expects, "; ".join(complaints) or "as expected", vouched, decay]
        )
        rows.append([f"`{case.name}`", *(cell(found["methods"].get(n)) for n in SHOWN)])
    parts = [HEAD, "## Cases\n", f"{len(rows) - missed} of {len(rows)} cases end as expected.\n"]
    parts.append(table(["case", "expected", "found", "reference", "fastest decay [1/s]"], verdicts))
    parts.append(
        "## Results of the methods\n\nAt default settings; a fixed-step method takes a thousandth of the duration.\n"
    )
    parts.append(table(["case", *SHOWN], rows))
    parts.append("![the suite by all methods](images/stability_suite.png)\n")
    runs = json.loads(peers.read_text(encoding="utf-8"))["rows"]
    columns = list(dict.fromkeys(name for row in runs for name in row["runs"]))
    parts.append(PEERS)
    parts.append(
        table(
            ["case", *columns], [[f"`{r['case']}`", *(cell(r["runs"].get(c)) for c in columns)] for r in runs]
        )
    )
    parts.append(MODELS)
    parts.append(NOTES)
    parts.append(FUZZING)
    (DOCS / "stability.md").write_text("\n".join(parts), encoding="utf-8")
    for source, name in ((suite, "stability_suite.png"), *((d, "baumgarte.png") for d in four_bar)):
        picture(source / name, DOCS / "images" / (name if source == suite else f"four_bar_{name}"))


def picture(source: Path, target: Path) -> None:
    """Copy a drawing with 64 colours, which takes a third of the room."""
    Image.open(source).convert("RGB").quantize(64, dither=Image.Dither.NONE).save(target, optimize=True)


PEERS = """\
## Peers

All cases (the shorter ones of `--quick`) in MuJoCo, Exudyn and scipy by `benchmarks/stability_peers.py`, at settings that a user
would start with: MuJoCo with its default step or a thousandth of the duration, Exudyn's implicit integrators of index 3
(generalized-alpha) and index 2 (trapezoidal) with steps of 1 ms or 4000 in all, scipy with Pinocchio's accelerations. After 10 s
of computing a run is too slow; where a solver says that it cannot go on, it gives up. The models are below the table.
"""

MODELS = """\
Special terms of a case in each engine:

- Loops: in MuJoCo a `connect` equality, in Exudyn plane bodies in redundant coordinates with a joint for each joint and loop, in
  scipy Pinocchio's `constraintDynamics` without projection. Near a fold its proximal parameter counts: 1e-10 leaves
  `four_bar_folded` visibly wrong, the 1e-14 of this table does not.
- `start_near_singular` has no reference, so the cell tells the branch on which a run leaves the flat pose and the largest distance
  between the ends that the loop joins. The start lies on the parallelogram, 0.2 ms before the flat pose. Soft or regularised
  constraints take the mechanism to have two freedoms there and leave on the other branch, with a loop that is closed to all
  appearance. Exudyn's index 3 does not start, its index 2 stays on the branch. robodyn refuses the start as a singular
  configuration; [`singular: pass`](scene.md) is for poses that are met on the way.
- Dry friction: in MuJoCo `frictionloss`, in Exudyn `CoordinateSpringDamperExt`, with the scene's transition speed as its
  proportional zone, or bristles where the scene has none. scipy has the smoothed law of the scene, or the sign of the rate, about
  which it chatters as soon as a joint sticks.
- Rigid stops: in MuJoCo a joint limit, in Exudyn a limit stop. Neither has a coefficient of restitution: at MuJoCo's default
  parameters a limit rebounds a little, whatever is wanted. Both are given stiffness and damping (in MuJoCo the negative form of
  `solref`) that make the restitution of the scene in an impact of 8 steps. So impacts come late, each later than the one before,
  and between the right instant and theirs the rate has the wrong sign. In scipy a terminal event ends the run at each impact and a
  new one starts; a rebound below 1e-6 rad/s is taken for rest, and an event on the acceleration ends that.
- `stiff_stops`, `spring_opening`: formulas of the joint, taken once a step by MuJoCo, at every iteration by Exudyn. Their steps
  of half a millisecond and more cannot follow a contact of 0.3 ms.
- `governor`: in MuJoCo stiffness and damping of the joint are set anew before each step; Euler and implicitfast take the
  damping implicitly and keep up.
- MuJoCo refuses inertias as small as those of a link of a micrometre.
"""

FUZZING = """\
## Mutated inputs

`python -m tests.fuzz --seconds 600 --seed 1 --jobs 2` changes the scenes of `configs/` and the starters of `robodyn new` (keys, values,
structure, formulas, units, absurd numbers, text that is no YAML), `--set` and `--at` texts, tables and result files, and runs all
commands that take them. Each seed is one case. Faults are an internal error (exit code 70), a traceback, a warning of a
library, a process that hangs or crashes, standard output that is not JSON where that was asked for, an error without a word, and a
number that is not finite in a result whose run succeeded. A finding is made smaller and stored with its command line. The tests run
300 cases.

Seeds 5000001 to 5083755 (83 755 cases, of a version some hours before the last): 0: 15 104, 1: 1 343, 2: 65 884, 3: 151, 4: 451, 5: 801, 70: 2, 130: 19, and
seeds 6000001 to 6006357 (6 357 cases, nearly the last version): 0: 1 065, 1: 88, 2: 5 104, 3: 14, 4: 28, 5: 55, 70: 2, 130: 1. Their two causes are mended and
were run again: paths that lead too far for numbers (also a warning of numpy), and `info` of payloads that come and go. Before that, seeds 4001 to 93867 (89 867 cases): exit codes 0: 16 106, 1: 1 394, 2: 70 780, 3: 206, 4: 504,
5: 839, 70: 15, 130: 23 (130: interrupted after 10 s, which a case gets). The 15 internal errors had six causes, all mended and run again:
links that no joint moves, and a missing key beside them; formulas of data that the scene does not give; inertias whose product no double holds; missing data beside
a prescribed joint; gravity of 1e160 m/s^2. Seeds 3000001 to 3011018 on nearly the last version (11 018 cases): 0: 1934, 1: 212,
2: 8686, 3: 29, 4: 45, 5: 89, 130: 23, no internal error, 100 885 cases in all. Earlier versions: 52 982 cases with two causes, both mended.
No number that is not finite has come out with status ok.

260 runs of six commands were ended at random moments (132 by SIGKILL, 66 by SIGTERM, 62 by SIGINT): 192 left the files of the run before as they
were, 68 had ended and left their own; no mix, no half-written file, nothing left behind.

Faults found, all mended: a mass that the scene does not give and a damped joint (internal error while the method was
chosen), overflow warnings of numpy from `plan`, matrices of numbers such as 1e18 and 1 that cannot be solved with, now exit code 3. By hand and
from other scenes: rows that vanish but for rounding, and joints that throw each other on their rigid stops without end.

## Printed errors and true errors

`python -m tests.proof --seed 1 --seconds 3600 --out DIR` writes random scenes (trees of all joint types with full inertias, springs,
dampers, smooth and set-valued friction, compliant and rigid stops, pulses and tables, prescribed motions, plane and spatial loops, passages of
flat poses; from seed 1 000 000 on gears and bushings, from 2 000 000 on deployments, whose lock's time is compared, from 3 000 000 on controllers, sampled laws and payloads), runs each with methods and tolerances or steps of its own, and compares each printed error (`q_max`, `qd_max`, `state_max`,
`q_end`, `qd_end`) with the true one. The reference is another program: accelerations by Pinocchio with forces, loops, friction and impacts
added by hand, in passages on the known branch with one coordinate, with gears (couplers) in the coordinates that they leave free, integrated by an own order 8 at two tolerances that vouch for each
other. A true error counts where it is above rounding and the reference's doubt, and below 1 % of the range; beyond, the run must say from
when on it is not meaningful. A stopped proof goes on where it was; each seed is one scene. Tests run some twenty scenes.

Last version, seeds from 910101, 1910001, 2910001 and 3910001 on (1 476 runs of 41 scenes, 36 of each): 1 018 with an error that can be told, none below
a tenth of it, four above ten times (0.39 %), median of the ratio 1.29 (estimates have a margin of 1.25 since). The version before had left the
last sample, which is dense output, out of the error at the end wherever the samples that are judged are every n-th and the last one is not among them: what
250358 below showed. Seed 1001020 stays at 0.043: a second integration that is hardly better than the first agrees with it at the last sample by chance.

The version before but for the five runs below, seeds 250001 to 250450 (5 400 runs of 450 scenes, 12 of each): 4 195 runs with an error that can be told, one with one of
the five figures below a tenth of it (250358: 0.083, at the last sample), 14 above ten times (0.33 %), median of the ratio 1.03.
The second integrations of five runs had failed, by bounces that began and ended within one fixed step; they were mended and run again. Seeds 1001001
to 1001050 (400 runs of 50 scenes with gears or bushings): 339 with an error that can be told, one below a tenth (1001020: 0.034, at the last sample),
three above ten times.

`deploy`, seeds 2001001 to 2001120 (480 runs of 120 mechanisms that unfold to a dead point, or to a latch at a position): 135 with an error of
the time of the lock that can be told, none below a tenth of it, none above ten times, median of the ratio 1.08; the others did not lock, as
the reference says too, or were right to rounding.

The version before, seeds 230001 to 230440 (5 280 runs): 4 160 with an error that can be told, two below a tenth, two above ten times (0.05 %).
Those below (230073 and 230399) were errors at the last sample, where the errors of both integrations happen to agree. Such an error is now no less than
what the second integration's own error typically is, at the price of some that are printed too large. Seed 250003 showed pulses shorter than a fixed step
that both integrations took in one and the same step.

A version some hours before, seeds 200001 to 200386 (4 632 runs): 3 792 with an error that can be told, 18 of 4 scenes below a tenth, 89 (2.35 %)
above ten times, 85 of these in passages. The four scenes were run again with the last version: none is left below a tenth. Together the
three versions make 15 312 runs. In no run was an error above 2 % of the range left unsaid, and none crashed.

Seed 220097 showed that the classical method with a fixed step took the last stage of the step that ends at a compliant stop of
`spring_damper` on the far side of it, where the force jumps by the damping, so that the rate was off by a sixth of the step times that jump. Fixed steps
now come close to a jump first: 7e-11 in place of 1e-3 in a scene of one slide. The seed was run again with that.

Faults found, all mended: stages at the end of a step saw the other side of a jump in time (the classical method was wrong by
2e-3, unseen by the estimate where a pulse was shorter than a step); joints that came to rest on a stop while they still bounced
with the root of the tolerance; a pose met again right after an impact beside it, which was stepped over onto another branch; trials beyond
a pose that took all steps a run may take; a joint that could not leave its stop because its load had vanished; a slide at rest in its
dead point, held by mistake.
"""

NOTES = """\
## Baumgarte's gains

The lecture's four-bar over the plane of gains (`robodyn stability configs/four_bar_deploy.yaml`). Above, the default method at
rtol 1e-10: every pair keeps the drift near the integration error, and large gains only cost steps. Below, the classical
method of order 4 with steps of 20 ms: beyond 2 alpha h = 2.79 it is unstable, beyond beta of some 100/s too, and close to that the
added modes spoil the motion itself. The star is the automatic choice, the smallest alpha = beta whose drift stays below the
integration error.

![drift and error over the plane of gains](images/four_bar_baumgarte.png)

## Faults that the suite has found

- Samples of the linearly implicit methods used to come from a Hermite polynomial through the rates at the ends of a step. In a
  stiff component such a rate is rounding noise times the fastest decay: with a tip 1e6 times lighter, samples were wrong by 1e-5
  where steps were good to 1e-12. They come from the methods' own continuous extensions now.
- A mechanism may start 1e-6 rad from a fold: the ratio of singular values that counts as singular is 1e-7.
- A run that breaks down names time, joint and quantity.
- `rigid_stops` and `stiff_stops` used to swing short of their stops, so that nothing was tested and all was well. Now the second
  link falls on its stop, bounces, rests on it and leaves it.
- With impacts to meet, methods of fixed step went on with what the first impact had left of a step, some millions of times, where
  a scene gave no step.
- Springs of 1e8 N m/rad and more met their 1e-6 once the reference came from two families: two orders of Gauss's method had
  agreed with each other and were both wrong by 1e-6.

## Limits of these figures

- Where both methods of a reference are of one family (the table names them), an error that they share would not show.
- `pendulum_1e5_s` is judged at 1e-3 of the range: at first it was held to 1e-5, which its references, good to 5 digits, could not tell.
- `stiff_stops` runs at the default tolerances. Below some 1e-11 a run can end with "keeps switching back and forth": a step that starts exactly
  at the jump of the damping has its first stage on the wrong side of it.
"""


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
