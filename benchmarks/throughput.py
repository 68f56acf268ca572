"""Inverse and forward dynamics of many samples, beside Pinocchio: microseconds a sample on one thread.

    python benchmarks/throughput.py [--quick] [--json FILE]

robodyn runs through its public API (``InverseDynamics`` and ``ForwardDynamics`` on column-ordered arrays),
Pinocchio through ``rneaInParallel`` and ``abaInParallel``, its fastest way from Python, with one thread. The
two take turns; figures are medians. Errors are against an evaluation in extended precision (``arms.py``).
Compiling is not part of the time a sample and is listed apart.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any

import measure

measure.single_thread()

import arms  # noqa: E402
import numpy as np  # noqa: E402

from robodyn_cli import ForwardDynamics, InverseDynamics, load_scene_text  # noqa: E402

KINDS: dict[str, Any] = {"inverse": InverseDynamics, "forward": ForwardDynamics}
# how many of the samples the reference checks
CHECKED = 250

READY = """
import sys, time
from robodyn_cli import ForwardDynamics, InverseDynamics, load_scene_text
import llvmlite.binding, robodyn_cli.kernels.rolled.kernels, robodyn_cli.kernels.samples
scene = load_scene_text(sys.stdin.read())
start = time.process_time()
{kind}(scene)
print(time.process_time() - start)
"""

FIRST = """
import sys, time
import numpy as np
from robodyn_cli import ForwardDynamics, InverseDynamics, load_scene_text
function = {kind}(load_scene_text(sys.stdin.read()))
rng = np.random.default_rng(0)
given = [np.asfortranarray(rng.normal(size=({samples}, {joints}))) for _ in range(3)]
start = time.process_time()
for _ in range({calls}):
    function(*given)
print(1e6 * (time.process_time() - start) / ({calls} * {samples}))
"""
CALLS, PROCESSES = 20, 5


def first_time(arm: arms.Arm, kind: str, samples: int) -> float:
    """Return the microseconds a sample of the first calls of a process, all code cached: the median of several."""
    code = FIRST.format(kind=KINDS[kind].__name__, samples=samples, joints=arm.n, calls=CALLS)
    return measure.median([measure.cold_and_cached(code, arms.scene_text(arm))[1] for _ in range(PROCESSES)])


def compile_times(scene: str, kind: str) -> tuple[float, float]:
    """Return the seconds from a scene to a function ready to call: nothing cached, and all code cached."""
    return measure.cold_and_cached(READY.format(kind=KINDS[kind].__name__), scene)


def pinocchio_call(pin: Any, arm: arms.Arm, kind: str, q: Any, qd: Any, x: Any) -> Callable[[], Any]:
    """Return a call of Pinocchio's batch function; it writes into the same array again and again."""
    pool = pin.ModelPool(arms.pinocchio_model(arm), 1)
    function = pin.rneaInParallel if kind == "inverse" else pin.abaInParallel
    columns = [np.asfortranarray(a.T) for a in (q, qd, x)]
    out = np.zeros_like(columns[0], order="F")

    def call() -> Any:
        function(1, pool, *columns, out)
        return out.T

    return call


def bench(arm: arms.Arm, kind: str, samples: int, repeats: int, pin: Any) -> list[dict[str, Any]]:
    """Time one function of one arm with both engines; return their rows."""
    q, qd, qdd = arms.motion(arm.n, samples)
    scene = load_scene_text(arms.scene_text(arm))
    given = qdd if kind == "inverse" else InverseDynamics(scene)(q, qd, qdd)
    function = KINDS[kind](scene)
    calls: dict[str, Callable[[], Any]] = {"robodyn": lambda: function(q, qd, given)}
    if pin is not None:
        calls["pinocchio"] = pinocchio_call(pin, arm, kind, q, qd, given)
    some = slice(None, None, max(1, samples // CHECKED))
    rows = []
    for engine, call in calls.items():
        result = call()
        check = arms.inverse_error if kind == "inverse" else arms.forward_error
        error = check(arm, q[some], qd[some], given[some], np.array(result[some]))
        rows.append({"work": f"{kind} dynamics, {arm.name}", "engine": engine, "error": error,
                     "result": result.copy()})  # fmt: skip
    measure.warmed(calls["robodyn"], samples)
    times = measure.alternate(calls, repeats)
    for row in rows:
        seconds = times[row["engine"]]
        row["us_per_sample"] = 1e6 * measure.median(seconds) / samples
        row["us_quartiles"] = [1e6 * float(x) / samples for x in np.quantile(seconds, (0.25, 0.75))]
    if pin is not None:
        ours, theirs = rows
        ours["faster"] = measure.median_ratio(times["pinocchio"], times["robodyn"])
        scale = np.abs(ours["result"]).max()
        ours["engines_differ"] = float(np.abs(ours["result"] - theirs["result"]).max() / scale)
    for row in rows:
        del row["result"]
    return rows


def main() -> None:
    options = measure.command_line(__doc__).parse_args()
    samples, repeats = 10_000, 3 if options.quick else 25
    measure.print_machine()
    print(f"{samples} samples a call, one thread, medians of {repeats} alternating repeats\n")
    with measure.reporting(options.json) as report:
        report.more |= {"samples": samples, "repeats": repeats}
        pin = importlib.import_module("pinocchio") if report.has("pinocchio") else None
        for arm in (arms.planar_2r(), arms.seven_joint_arm(), arms.random_chain(30)):
            for kind in KINDS:
                with report.part(f"{kind} dynamics, {arm.name}"):
                    rows = bench(arm, kind, samples, repeats, pin)
                    if not options.quick:
                        rows[0]["cold_s"], rows[0]["cached_s"] = compile_times(arms.scene_text(arm), kind)
                        rows[0]["first_us_per_sample"] = first_time(arm, kind, samples)
                    report.rows += rows
        print(measure.table(list(lines(report.rows))))


def lines(rows: list[dict[str, Any]]) -> Any:
    """Yield the lines of the table, a line a kind of work."""
    yield ["work", "robodyn us", "Pinocchio us", "times faster", "error", "Pinocchio's error", "between them",
           "ready, cold s", "cached s", "first us"]  # fmt: skip
    peers = {row["work"]: row for row in rows if row["engine"] == "pinocchio"}

    def text(row: dict[str, Any] | None, key: str, form: str) -> str:
        return format(row[key], form) if row and key in row else "-"

    for row in rows:
        if row["engine"] == "robodyn":
            peer = peers.get(row["work"])
            yield [row["work"], text(row, "us_per_sample", ".4f"), text(peer, "us_per_sample", ".3f"),
                   text(row, "faster", ".1f"), text(row, "error", ".1e"), text(peer, "error", ".1e"),
                   text(row, "engines_differ", ".1e"), text(row, "cold_s", ".3f"),
                   text(row, "cached_s", ".3f"), text(row, "first_us_per_sample", ".4f")]  # fmt: skip


if __name__ == "__main__":
    main()
