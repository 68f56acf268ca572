"""One random scene: its runs by the program, its reference, and how the printed errors compare with the true ones."""

from __future__ import annotations

import dataclasses
import math
import time
from typing import Any

import numpy as np

from robodyn_cli import deploy, load_scene_text, simulate
from robodyn_cli.errors import CapabilityError, RobodynError
from robodyn_cli.tools.progress import Progress
from tests.proof.families import make, settings
from tests.proof.locks import LockTruth, compare, lock_truth
from tests.proof.mechanism import Array, Mechanism
from tests.proof.reference import Reference, UndecidedError

TIGHT, LOOSE = 1e-13, 2e-12  # relative tolerances of the two references
SECONDS = 10.0  # of the processor's time for each reference and each run
ROUNDING = 100.0  # times the rounding floor: a true error below it is not told apart from rounding
DOUBT = 10.0  # times the doubt of the reference, likewise
LOST = 1e-2  # part of the range beyond which a run must say that it is not meaningful
FACTOR = 10.0
KEYS = ("q_max", "qd_max", "state_max", "q_end", "qd_end")


@dataclasses.dataclass
class Run:
    """How one run ended. verdict : ok, low, high, silent, rounding, lost, failed, refused, unconfirmed, undecided, crash."""

    seed: int
    family: str
    index: int
    setting: dict[str, Any]
    verdict: str
    key: str = ""
    true: float = 0.0
    estimate: float = 0.0
    ratio: float | None = None
    note: str = ""
    seconds: float = 0.0


def overrides(setting: dict[str, Any]) -> list[str]:
    return [f"simulate.{key}={value}" for key, value in setting.items()] + ["simulate.max_steps=300000"]


class _Clock:
    def __init__(self, seconds: float) -> None:
        self.end = time.process_time() + seconds

    def __call__(self, done: float, total: float) -> None:
        if time.process_time() > self.end:
            raise TimeoutError(f"at t = {done:g} of {total:g} s")


def solve(text: str, setting: dict[str, Any], locks: bool) -> tuple[Any, str]:
    """Return the result of a run, or None and how it failed; locks : whether it is a deployment."""
    clock: Progress = _Clock(SECONDS)
    try:
        command = deploy if locks else simulate
        return command(load_scene_text(text, overrides=overrides(setting)), clock), ""
    except CapabilityError as error:
        return None, f"refused: {error.message}"
    except RobodynError as error:
        return None, f"{type(error).__name__}: {error.message}"
    except TimeoutError as error:
        return None, f"too slow: {error}"


@dataclasses.dataclass
class Truth:
    """Reference samples (T, n) of q and v, and the doubt about them."""

    q: Array
    v: Array
    doubt: Array


def truth(m: Mechanism, q: Array, v: Array, times: Array) -> Truth:
    """Integrate twice from the state that the runs start from."""
    if m.branch is not None:
        q, v = q[m.branch.free], v[m.branch.free]
    found = [Reference(m, tol, 1e-2 * tol, SECONDS).run(q, v, times) for tol in (TIGHT, LOOSE)]
    tight, loose = found
    apart = np.maximum(np.abs(tight.q - loose.q).max(axis=1), np.abs(tight.v - loose.v).max(axis=1))
    size = max(np.abs(tight.q).max(initial=0.0), np.abs(tight.v).max(initial=0.0))
    # the tighter one is an order of magnitude better, but for rounding
    return Truth(tight.q, tight.v, np.maximum.accumulate(0.2 * apart) + 1e-14 * size)


def judge(run: Run, result: Any, ref: Truth) -> Run:
    """Compare the errors that a run prints with its true ones."""
    summary = result.summary
    report = summary["error_estimate"]
    q, v = result["q"], result["qd"]
    errors = {"q": np.abs(q - ref.q), "qd": np.abs(v - ref.v)}
    true = {f"{k}_max": float(e.max(initial=0.0)) for k, e in errors.items()}
    # of the last sample, which is dense output, and of the state itself, which the summary has
    final = {"q": ref.q[-1], "qd": ref.v[-1]}
    if (last := summary.get("final")) is not None and last["time"] == result.time[-1]:
        final = {key: np.array(list(last[key].values())) for key in final}
    ends = {"q": np.abs(final["q"] - ref.q[-1]), "qd": np.abs(final["qd"] - ref.v[-1])}
    true |= {f"{k}_end": float(np.maximum(e[-1], ends[k]).max(initial=0.0)) for k, e in errors.items()}
    true["state_max"] = max(true["q_max"], true["qd_max"])
    ranges = {"q": float(np.ptp(ref.q, axis=0).max()), "qd": float(np.ptp(ref.v, axis=0).max())}
    run.true = true["state_max"]
    if report.get("state_max") is None:
        run.verdict, run.note = "unconfirmed", str(report.get("reason"))
        return run
    run.estimate = report["state_max"]
    least = max(ROUNDING * report["rounding_floor"], DOUBT * float(ref.doubt.max()))
    parts = {k: true[f"{k}_max"] / max(ranges[k], 1e-300) for k in ranges}
    part = max((parts[k] for k in ranges if true[f"{k}_max"] > least), default=0.0)
    if part > LOST:
        said = "meaningful_until" in report
        run.verdict = "lost" if said else "silent" if part > 2.0 * LOST else "rounding"
        run.ratio = run.estimate / run.true
        run.note = f"{part:.2g} of the range"
        return run
    worst = 0.0
    run.verdict = "rounding"
    for key in KEYS:
        if true[key] <= least:
            # an error that rounding explains must not be printed as a large one
            if key == "state_max" and report[key] > FACTOR * max(least, true[key]):
                run.verdict, run.key, run.note = (
                    "high",
                    key,
                    f"printed {report[key]:.2g}, true {true[key]:.2g}",
                )
                run.ratio = report[key] / max(true[key], least)
            continue
        ratio = report[key] / true[key]
        if run.verdict == "rounding":
            run.verdict = "ok"
        off = abs(math.log10(max(ratio, 1e-12)))
        if off > worst:
            worst = off
            run.ratio, run.key = ratio, key
            if off > math.log10(FACTOR):
                run.verdict = "low" if ratio < 1.0 else "high"
                run.true, run.estimate = true[key], report[key]
    return run


def judge_lock(run: Run, result: Any, ref: LockTruth) -> Run:
    """Compare the error that a deployment prints for the time of its lock with the true one."""
    lock = result.summary.get("lock")
    run.verdict, run.true, run.estimate = compare(lock, ref)
    run.key, run.ratio = "lock.time", run.estimate / run.true if run.true > 0.0 else None
    if run.verdict == "silent":
        run.note = f"locks at {lock and lock['time']}, truly at {ref.time}"
    return run


def try_seed(seed: int, runs: int) -> list[Run]:
    """Return the runs of a seed."""
    family, m, rng = make(seed)
    text = m.scene()
    found: list[tuple[Run, Any]] = []
    for index, setting in enumerate(settings(rng, runs)):
        if "parts" in setting:
            setting["step"] = float(f"{m.duration / setting.pop('parts'):.4g}")
        run = Run(seed, family, index, setting, "failed")
        before = time.process_time()
        try:
            result, run.note = solve(text, setting, m.lock is not None)
        except Exception as error:
            run.verdict, result, run.note = "crash", None, repr(error)
        run.seconds = time.process_time() - before
        if run.note.startswith("refused"):
            run.verdict = "refused"
        if result is not None and not all(np.isfinite(result[k]).all() for k in ("q", "qd", "qdd")):
            run.verdict, result, run.note = "crash", None, "a number that is not finite"
        found.append((run, result))
    good = [result for _, result in found if result is not None]
    if not good:
        return [run for run, _ in found]
    first = good[0]
    references: list[tuple[Array, Any, str]] = []
    for run, result in found:
        if result is not None:
            start = np.concatenate([result["q"][0], result["qd"][0]])
            ref, why = _reference(m, references, start, first.time)
            if ref is None:
                run.verdict, run.note = "undecided", why
            elif m.lock is not None:
                judge_lock(run, result, ref)
            else:
                judge(run, result, ref)
    return [run for run, _ in found]


def _reference(
    m: Mechanism, known: list[tuple[Array, Any, str]], start: Array, times: Array
) -> tuple[Truth | LockTruth | None, str]:
    """Return the reference from a start; runs that start alike share one."""
    for state, ref, why in known:
        if np.abs(state - start).max() <= 1e-15 * (1.0 + np.abs(state).max()):
            return ref, why
    nq = int(m.first_q[-1])
    ref: Truth | LockTruth | None = None
    why = ""
    try:
        if m.lock is not None:
            ends = np.array([0.0, m.duration])
            ref = lock_truth(m, start[:nq], start[nq:], ends, (TIGHT, LOOSE))
        else:
            ref = truth(m, start[:nq], start[nq:], times)
    except UndecidedError as error:
        why = str(error)
    except np.linalg.LinAlgError as error:
        why = f"singular: {error}"
    known.append((start, ref, why))
    return ref, why
