"""Printed errors where motions amplify: ``python -m tests.proof.amplified --seeds 0 20 [--family NAME]``.

Chains that are chaotic, loops, N-four-bars through their flat poses, and bodies that tumble about their middle axis, each
at several tolerances, against motions in extended precision; ``--many`` compares the errors of many runs, too.
"""

from __future__ import annotations

import argparse
import collections
import dataclasses
import statistics
import sys
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from robodyn_cli import Mechanism, load_scene_text, simulate
from robodyn_cli.errors import RobodynError
from tests.proof.extended import LONG, Array, Chain, Truth, n_four_bar, truth, tumbling

TOLERANCES = (1e-6, 1e-8, 1e-10, 1e-12)
KEYS = ("q_max", "qd_max", "q_end", "qd_end")
DOUBT = 10.0  # times the doubt of the reference: an error below it cannot be told
LOST = 0.01  # of the range of a motion, beyond which errors only have to be told as such
BATCH = 6  # scenes of one seed


@dataclasses.dataclass
class Scenes:
    """Scenes of one structure, and what they are in extended precision.

    reference : takes starts q, qd (B, n) as the runs have them, and sample times (T,) [s].
    """

    texts: list[str]
    reference: Callable[[Array, Array, Array], Truth]
    split: Callable[
        [Array], tuple[Array, Array]
    ]  # states (T, B, n) to q and qd (T, B, n) in the program's order


@dataclasses.dataclass
class Judged:
    """A figure of a run: its true and its printed error."""

    family: str
    seed: int
    scene: int
    how: str
    rtol: float | None
    key: str
    true: float
    printed: float
    floor: float

    @property
    def ratio(self) -> float:
        return self.printed / self.true

    def __str__(self) -> str:
        tolerance = "default" if self.rtol is None else f"{self.rtol:.0e}"
        return (
            f"{self.family:14} {self.seed:3} {self.scene} {self.how:8} {tolerance:8} {self.key:10} "
            f"true {self.true:.1e} printed {self.printed:.1e} floor {self.floor:.1e} ratio {self.ratio:.2g}"
        )


# -- scenes ---------------------------------------------------------------------------------------------------------
def _flow(items: dict[str, Any]) -> str:
    return "{" + ", ".join(f"{k}: {v}" for k, v in items.items()) + "}"


def _chain(rng: np.random.Generator, n: int, pinned: bool, duration: float) -> Scenes:
    """Return chains of n links; pinned ones hang between two points."""
    B = BATCH
    length = rng.uniform(0.5, 1.5, (B, n))
    mass, inertia = rng.uniform(0.3, 3.0, (B, n)), rng.uniform(0.005, 0.2, (B, n))
    com = rng.uniform(0.2, 0.8, (B, n)) * length + 1j * rng.uniform(-0.1, 0.1, (B, n))
    gravity = rng.choice((0.0, 9.81, 9.81), B)
    q, qd = rng.uniform(-3.0, 3.0, (B, n)), rng.uniform(-2.0, 2.0, (B, n))
    pin = None
    if pinned:
        q = np.concatenate([rng.uniform(0.3, 1.2, (B, 1)), rng.uniform(-1.6, -0.4, (B, n - 1))], axis=1)
        angle = np.cumsum(q, axis=1)
        tip = (length * np.exp(1j * angle)).sum(axis=1)
        pin = tip.round(6)
    texts = []
    for b in range(B):
        joints = [f"    - {{name: j{k}, type: revolute, parent: {'base' if k == 0 else f'l{k - 1}'}, link: l{k}, "
                  f"origin: {{xyz: [{length[b, k - 1]!r}, 0, 0]}}, axis: [0, 0, 1]}}" if k else
                  "    - {name: j0, type: revolute, parent: base, link: l0, axis: [0, 0, 1]}" for k in range(n)]  # fmt: skip
        links = [f"    - {{name: l{k}, mass: {mass[b, k]!r}, com: [{com[b, k].real!r}, {com[b, k].imag!r}, 0], inertia: {{zz: {inertia[b, k]!r}}}}}"
                 for k in range(n)]  # fmt: skip
        text = [
            "schema: 1",
            "title: chain",
            "command: simulate",
            f"gravity: [0, {-gravity[b]!r}, 0]",
            "robot:",
            "  joints:",
        ]
        text += [*joints, "  links:", *links]
        if pin is not None:
            text += ["  points:", f"    tip: {{link: l{n - 1}, at: [{length[b, -1]!r}, 0, 0]}}",
                     f"    pin: {{link: base, at: [{pin[b].real!r}, {pin[b].imag!r}, 0]}}",
                     "loops: [{name: pin, type: revolute, between: [tip, pin]}]"]  # fmt: skip
        held = [f"j{k}" for k in range(n - 2)] if pinned else []
        free = range(n - 2) if pinned else range(n)
        start = {
            "q": _flow({f"j{k}": repr(q[b, k]) for k in range(n)}),
            "qd": _flow({f"j{k}": repr(qd[b, k]) for k in free}),
        }
        if held:
            start["hold"] = f"[{', '.join(held)}]"
        text += [f"initial: {_flow(start)}", f"simulate: {{duration: {duration!r}, samples: 41}}"]
        texts.append("\n".join(text).replace("np.float64(", "").replace(")", ""))
    chain = Chain(LONG(length), LONG(mass), np.clongdouble(com), LONG(inertia), LONG(gravity),
                  None if pin is None else np.clongdouble(pin))  # fmt: skip

    def reference(q: Array, qd: Array, times: Array) -> Truth:
        return truth(chain.rate, chain.start(q, qd), times, 4)

    return Scenes(texts, reference, Chain.joints)


def chains(rng: np.random.Generator) -> Scenes:
    return _chain(rng, int(rng.integers(1, 5)), False, float(rng.choice((2.0, 5.0, 10.0))))


def loops(rng: np.random.Generator) -> Scenes:
    return _chain(rng, int(rng.integers(3, 5)), True, float(rng.choice((2.0, 5.0))))


def tumblers(rng: np.random.Generator) -> Scenes:
    """Bodies that spin about their middle axis and a little off it."""
    moments = np.sort(rng.uniform(0.002, 0.01, (BATCH, 3)), axis=1)
    moments[:, 2] = np.minimum(moments[:, 2], 0.95 * (moments[:, 0] + moments[:, 1]))
    moments = np.sort(moments, axis=1)
    omega = np.stack(
        [10.0 ** rng.uniform(-6, -1, BATCH), rng.uniform(2, 8, BATCH), 10.0 ** rng.uniform(-6, -1, BATCH)],
        axis=1,
    )
    v = rng.uniform(-0.1, 0.1, (BATCH, 3))
    duration = float(rng.choice((6.0, 12.0)))
    texts = [
        "schema: 1\ntitle: tumbling\ncommand: simulate\ngravity: [0, 0, 0]\nrobot:\n"
        "  joints: [{name: body, type: floating}]\n"
        f"  links: [{{name: handle, mass: 0.8, com: [0, 0, 0], inertia: {{xx: {float(a)!r}, yy: {float(b)!r}, zz: {float(c)!r}}}}}]\n"
        f"initial: {{q: {{body: {{xyz: [0, 0, 0], rpy: [0, 0, 0]}}}}, qd: {{body: {[*map(float, v[k]), *map(float, omega[k])]}}}}}\nsimulate: {{duration: {duration}, samples: 41}}"
        for k, (a, b, c) in enumerate(moments)
    ]

    def reference(q: Array, qd: Array, times: Array) -> Truth:
        y = np.concatenate([LONG(q), LONG(qd[:, 3:]), LONG(qd[:, :3])], axis=1)
        return truth(tumbling(LONG(moments)), y, times, 3)

    def split(y: Array) -> tuple[Array, Array]:
        return y[..., :7], np.concatenate([y[..., 10:], y[..., 7:10]], axis=-1)

    return Scenes(texts, reference, split)


def bar_text(N: int, speed: float, duration: float) -> str:
    """Return an N-four-bar, as a scene."""
    legs, bars = range(N + 1), range(N)
    joints = [
        f"    - {{name: th{k}, type: revolute, parent: base, link: leg{k}, origin: {{xyz: [{k}, 0, 0]}}, axis: [0, 0, 1]}}"
        for k in legs
    ]
    joints += [
        f"    - {{name: ph{k}, type: revolute, parent: leg{k}, link: bar{k}, origin: {{xyz: [1, 0, 0]}}, axis: [0, 0, 1]}}"
        for k in bars
    ]
    links = [
        f"    - {{name: {name}{k}, mass: 1, com: [0.5, 0, 0], inertia: {{zz: 1/12}}}}"
        for name, of in (("leg", legs), ("bar", bars))
        for k in of
    ]
    points = [
        f"    {a}{k}: {{link: {link}{j}, at: [1, 0, 0]}}"
        for k in bars
        for a, link, j in (("R", "bar", k), ("T", "leg", k + 1))
    ]
    closures = [f"  - {{name: w{k}, type: revolute, between: [R{k}, T{k}]}}" for k in bars]
    start = {f"th{k}": "90 deg" for k in legs} | {f"ph{k}": "-90 deg" for k in bars}
    return "\n".join([
        "schema: 1", f"title: N-four-bar {N}", "command: simulate", "gravity: [0, -9.81, 0]", "robot:", "  joints:", *joints,
        "  links:", *links, "  points:", *points, "loops:", *closures,
        f"initial: {{q: {_flow(start)}, qd: {{th0: {speed!r}}}, hold: [th0]}}",
        f"simulate: {{duration: {duration!r}, samples: 41, singular: pass}}",
    ])  # fmt: skip


def four_bars(rng: np.random.Generator) -> Scenes:
    """N-four-bars that swing through their flat poses."""
    N = int(rng.integers(1, 7))
    duration = float(rng.choice((1.0, 3.0, 6.0, 10.0, 20.0)))
    speeds = [-1.0, *(float(x) for x in rng.uniform(-4.0, 4.0, BATCH - 1))]
    signs = np.array([*[1.0] * (N + 1), *[-1.0] * N])

    def reference(q: Array, qd: Array, times: Array) -> Truth:
        return truth(n_four_bar(N), LONG(np.stack([q[:, 0], qd[:, 0]], axis=1)), times, 6)

    def split(y: Array) -> tuple[Array, Array]:
        return y[..., :1] * signs, y[..., 1:] * signs

    return Scenes([bar_text(N, speed, duration) for speed in speeds], reference, split)


FAMILIES = {"chains": chains, "loops": loops, "tumblers": tumblers, "four_bars": four_bars}


# -- judging --------------------------------------------------------------------------------------------------------
def judge_seed(
    family: str, seed: int, tolerances: tuple[float | None, ...] = TOLERANCES, many: bool = False
) -> Iterator[Judged]:
    """Yield the figures of the scenes of a seed."""
    scenes = FAMILIES[family](np.random.default_rng([list(FAMILIES).index(family), seed]))
    ref, start = None, None
    for rtol in tolerances:
        overrides = [] if rtol is None else [f"simulate.rtol={rtol}", f"simulate.atol={1e-2 * rtol}"]
        loaded = [load_scene_text(text, overrides=overrides) for text in scenes.texts]
        runs = [_run(scene) for scene in loaded]
        good = [k for k, run in enumerate(runs) if run is not None]
        if not good:
            continue
        q, qd = (
            np.stack([runs[k if k in good else good[0]][name] for k in range(len(runs))], axis=1)
            for name in ("q", "qd")
        )
        if ref is None or np.abs(q[0] - start[0]).max() > 0 or np.abs(qd[0] - start[1]).max() > 0:
            ref, start = scenes.reference(q[0], qd[0], runs[good[0]].time), (q[0], qd[0])
        true_q, true_v = scenes.split(ref.states)
        off = {"q": np.abs(q - true_q).max(axis=-1), "qd": np.abs(qd - true_v).max(axis=-1)}
        spread = {"q": np.ptp(true_q, axis=0).max(axis=-1), "qd": np.ptp(true_v, axis=0).max(axis=-1)}
        for k in good:
            report = runs[k].summary["error_estimate"]
            if report.get("q_max") is None:
                continue
            for key in KEYS:
                name, where = key.split("_")
                error = off[name][:, k]
                true, doubt = (
                    (error.max(), ref.doubt[:, k].max()) if where == "max" else (error[-1], ref.doubt[-1, k])
                )
                if true > DOUBT * doubt and off[name][:, k].max() < LOST * spread[name][k]:
                    yield Judged(
                        family, seed, k, "one", rtol, key, float(true), report[key], report["rounding_floor"]
                    )
        if many:
            yield from _judge_many(family, seed, rtol, loaded, runs)


def _judge_many(
    family: str, seed: int, rtol: float | None, loaded: list[Any], runs: list[Any]
) -> Iterator[Judged]:
    """Yield runs whose errors in a fleet are not those of a run alone, where both took the same steps."""
    keys = ["error_estimate.q_end", "error_estimate.qd_end", "counters.steps", "error_estimate.steps"]
    for k, (scene, run) in enumerate(zip(loaded, runs)):
        if run is None or k:
            continue
        rows = Mechanism(scene).simulate_many(of=keys)
        report, out = run.summary["error_estimate"], rows.outputs
        same = out["counters.steps"][0] == run.summary["counters"]["steps"] and out["error_estimate.steps"][
            0
        ] == report.get("steps")
        if not same or rows.one_by_one[0]:
            continue
        for key in ("q_end", "qd_end"):
            yield Judged(
                family,
                seed,
                k,
                "many",
                rtol,
                key,
                report[key],
                float(out[f"error_estimate.{key}"][0]),
                report["rounding_floor"],
            )


def _run(scene: Any) -> Any:
    try:
        return simulate(scene)
    except RobodynError as error:
        print("    refused:", str(error)[:150], file=sys.stderr)
        return None


def report(judged: list[Judged]) -> str:
    """Return a table of families and tolerances."""
    groups = collections.defaultdict(list)
    for one in judged:
        groups[one.family, one.how, "default" if one.rtol is None else f"{one.rtol:.0e}"].append(one.ratio)
    lines = [f"{'family':14} {'runs':5} {'rtol':8} figures  least median largest  <0.1  <1  >10"]
    for (family, how, rtol), ratios in groups.items():
        low, under, high = (
            sum(test(r) for r in ratios)
            for test in (lambda r: r < 0.1, lambda r: r < 1.0, lambda r: r > 10.0)
        )
        lines.append(
            f"{family:14} {how:5} {rtol:8} {len(ratios):7} {min(ratios):6.2g} {statistics.median(ratios):6.2g} {max(ratios):7.3g} {low:5} {under:3} {high:4}"
        )
    return "\n".join(lines)


def main() -> int:
    """Run; return 1 where a printed error is below a tenth of the true one."""
    parser = argparse.ArgumentParser(prog="python -m tests.proof.amplified", description=__doc__)
    parser.add_argument("--seeds", type=int, nargs=2, default=(0, 5))
    parser.add_argument("--family", choices=list(FAMILIES), action="append")
    parser.add_argument("--many", action="store_true")
    arguments = parser.parse_args()
    judged = []
    for family in arguments.family or FAMILIES:
        for seed in range(*arguments.seeds):
            one = list(judge_seed(family, seed, many=arguments.many))
            for figure in one:
                if figure.ratio < 0.5 or figure.ratio > 10.0:
                    print(figure, flush=True)
            judged += one
    print(report(judged))
    return 1 if any(one.ratio < 0.1 for one in judged) else 0


if __name__ == "__main__":
    sys.exit(main())
