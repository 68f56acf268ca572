"""Exported C of a seven-joint arm beside CasADi's: nanoseconds a call, one state at a time.

    python benchmarks/c_functions.py [--quick] [--json FILE]

RNEA, ABA and M of the same equations: CasADi gets the expressions that robodyn exports, and writes its C of them. The
same compiler makes both, with the same options, into one program, in which they take turns. robodyn's numbers lie in
a table that may change, CasADi's are in its code.
"""

from __future__ import annotations

import importlib
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import measure

measure.single_thread()

import arms  # noqa: E402
import numpy as np  # noqa: E402

from robodyn_cli.expr.rebuild import evaluate  # noqa: E402
from robodyn_cli.over.c99.folder import export_c  # noqa: E402
from robodyn_cli.over.c99.functions import GROUPS, functions_of  # noqa: E402
from robodyn_cli.scene.load import Family, load_scene_text  # noqa: E402

FUNCTIONS = {"RNEA": "inverse_dynamics", "ABA": "forward_dynamics", "M": "mass_matrix"}
FLAGS = ("-O2",)
STATES = 200
TIMER = """#include "arm.h"
#include <stdio.h>
#include <stdlib.h>
#include <time.h>
%(declared)s
static const double in[%(states)d][3][7] = %(given)s;
static double sum;
static double seconds(void) { return (double)clock() / CLOCKS_PER_SEC; }
%(timers)s
int main(int count, char **words)
{
    arm_numbers numbers;
    const int rounds = atoi(words[count - 1]);
    arm_nominal(&numbers);
    for (int k = 0; k < %(repeats)d; ++k) {
%(calls)s
    }
    return sum == 0.123;
}
"""


def timer(name: str, call: str, size: int) -> str:
    """Return a function that times calls, and adds up what they give."""
    return f"""static void time_{name}(const arm_numbers *numbers, int rounds)
{{
    double out[{size}];
    const double begin = seconds();
    (void)numbers;
    for (int r = 0; r < rounds; ++r)
        for (int s = 0; s < {STATES}; ++s) {{
            const double *q = in[s][0], *qd = in[s][1], *x = in[s][2];
            (void)qd; (void)x;
            {call}
            sum += out[0];
        }}
    printf("{name} %.17g %.17g\\n", (seconds() - begin) / rounds / {STATES} * 1e9, out[{size} - 1]);
}}
"""


def casadi_code(folder: Path, arm: arms.Arm) -> None:
    """Write CasADi's C of the expressions that robodyn exports."""
    ca = importlib.import_module("casadi")
    if hasattr(ca.GlobalOptions, "setNumpyMode"):
        ca.GlobalOptions.setNumpyMode(-1)  # functions of numpy give expressions, without a warning
    own = functions_of(load_scene_text(arms.scene_text(arm)))
    generator = ca.CodeGenerator("peer.c", {"with_header": False})
    for function in own.functions:
        if function.name in FUNCTIONS.values():
            symbols = {name: ca.SX.sym(name, arm.n) for name in function.takes}
            inputs = {GROUPS[name]: [x[k] for k in range(arm.n)] for name, x in symbols.items()}
            (entries,) = function.entries.values()
            outputs = ca.vertcat(*evaluate(entries, inputs))
            generator.add(ca.Function(f"peer_{function.name}", list(symbols.values()), [outputs]))
    generator.generate(f"{folder}/")


def program(folder: Path, arm: arms.Arm, peer: bool, repeats: int) -> Path:
    """Return the program that times both, compiled."""
    scene = folder / "arm.yaml"
    scene.write_text(arms.scene_text(arm), encoding="utf-8")
    export_c(Family(scene), [], folder / "c")
    timers, declared, calls = [], [], []
    takes = {
        "inverse_dynamics": ("q", "qd", "x"),
        "forward_dynamics": ("q", "qd", "x"),
        "mass_matrix": ("q",),
    }
    for name in FUNCTIONS.values():
        size = arm.n * arm.n if name == "mass_matrix" else arm.n
        listed = ", ".join(takes[name])
        timers.append(timer(name, f"arm_{name}(numbers, {listed}, out);", size))
        calls.append(f"        time_{name}(&numbers, rounds);")
        if peer:
            declared.append(f"int peer_{name}(const double **, double **, long long *, double *, int);")
            call = f"const double *arg[] = {{{listed}}}; double *res[] = {{out}}; peer_{name}(arg, res, 0, 0, 0);"
            timers.append(timer(f"peer_{name}", call, size))
            calls.append(f"        time_peer_{name}(&numbers, rounds);")
    states = np.stack(arms.motion(arm.n, STATES), axis=1)
    given = (
        "{"
        + ", ".join(
            "{" + ", ".join("{" + ", ".join(map(repr, x)) + "}" for x in s) + "}" for s in states.tolist()
        )
        + "}"
    )
    text = TIMER % {
        "declared": "\n".join(declared), "states": STATES, "given": given, "timers": "\n".join(timers),
        "repeats": repeats, "calls": "\n".join(calls),
    }  # fmt: skip
    (folder / "timer.c").write_text(text, encoding="utf-8")
    sources = [folder / "timer.c", folder / "c" / "arm.c", *([folder / "peer.c"] if peer else [])]
    target = folder / "timer"
    command = [
        str(shutil.which("cc")),
        *FLAGS,
        "-I",
        str(folder / "c"),
        *map(str, sources),
        "-lm",
        "-o",
        str(target),
    ]
    subprocess.run(command, check=True)
    return target


def bench(report: measure.Report, rounds: int, repeats: int) -> None:
    """Time all functions; add a row for each to the report."""
    peer, arm = report.has("casadi"), arms.seven_joint_arm()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if peer:
            casadi_code(folder, arm)
        out = subprocess.run(
            [str(program(folder, arm, peer, repeats)), str(rounds)],
            check=True,
            capture_output=True,
            text=True,
        )
    found: dict[str, list[tuple[float, float]]] = {}
    for line in out.stdout.splitlines():
        label, time, last = line.split()
        found.setdefault(label, []).append((float(time), float(last)))
    for label, name in FUNCTIONS.items():
        times = [x for x, _ in found[name]]
        measure.noted(label, times)
        row: dict[str, Any] = {"function": label, "ns": measure.median(times)}
        if peer:
            theirs = [x for x, _ in found[f"peer_{name}"]]
            own_last, last = found[name][0][1], found[f"peer_{name}"][0][1]
            row |= {
                "casadi_ns": measure.median(theirs), "ratio": measure.median_ratio(theirs, times),
                "difference": abs(own_last - last) / max(abs(last), 1e-300),
            }  # fmt: skip
        report.rows.append(row)


def main() -> None:
    """Measure and print."""
    chosen = measure.command_line(__doc__).parse_args()
    with measure.reporting(chosen.json) as report:
        measure.print_machine()
        if shutil.which("cc") is None:
            report.absent.append("cc")
            return
        with report.part("a seven-joint arm"):
            bench(report, *((20, 3) if chosen.quick else (300, 15)))
        head = ["function", "robodyn ns", "CasADi ns", "times as fast", "difference"]
        rows = []
        for row in report.rows:
            beside = ["-"] * 3
            if "ratio" in row:
                beside = [f"{row['casadi_ns']:.0f}", f"{row['ratio']:.2f}", f"{row['difference']:.0e}"]
            rows.append([row["function"], f"{row['ns']:.0f}", *beside])
        print("\n" + measure.table([head, *rows]))


if __name__ == "__main__":
    main()
