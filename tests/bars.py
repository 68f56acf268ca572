"""Random four-bars and five-bars that start from rough values, or from none."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from robodyn_cli.scene.load import Family

JOINTS = ("first", "second", "third", "last")


@dataclasses.dataclass
class Bars:
    """A scene: a chain of n bars from the origin, and one from another pivot, that meet; with ranges of keys."""

    text: str
    ranges: dict[str, tuple[float, float]]

    def family(self, folder: Path) -> Family:
        path = folder / "bars.yaml"
        path.write_text(self.text)
        return Family(path, [])


def random_bars(rng: np.random.Generator, count: int) -> Bars:
    """Return a four-bar (count 3) or a five-bar (4): all joints with rough values, the last chain's end without, or only
    those that are held; a quarter of them hold none."""
    lengths, pivot = rng.uniform(0.4, 1.6, count), rng.uniform(0.5, 1.5)
    names = JOINTS[:count]
    guess = dict(zip(names, rng.uniform(-np.pi, np.pi, count).tolist()))
    held = [names[0], *names[2:-1]]
    given = ({}, {names[1]}, set(names) - set(held))[rng.integers(3)]
    start = ", ".join(f"{name}: {x}" for name, x in guess.items() if name not in given)
    hold = ", ".join(held if rng.uniform() < 0.75 else [])
    joints, links, parent = [], [], "base"
    for k, name in enumerate(names):
        last = k == count - 1
        place = f"parent: base, origin: {{xyz: [{pivot}, 0, 0]}}" if last else f"parent: {parent}"
        joints.append(
            f"{{name: {name}, type: revolute, link: bar{k}, {place}, a: {lengths[k]}, alpha: 0, d: 0}}"
        )
        body = f"com: [{lengths[k] / 2}, 0.01, 0], com_frame: joint, inertia: {{zz: {0.1 * lengths[k]}}}"
        links.append(f"{{name: bar{k}, mass: {1 + 0.3 * k}, {body}}}")
        parent = f"bar{k}"
    text = (
        "schema: 1\ntitle: bars\ncommand: simulate\ngravity: [0, -9.81, 0]\nrobot:\n  convention: standard\n"
        f"  joints: [{', '.join(joints)}]\n  links: [{', '.join(links)}]\n"
        f"loops: [{{name: pin, type: revolute, between: [bar{count - 2}.end, bar{count - 1}.end]}}]\n"
        f"initial: {{q: {{{start}}}, hold: [{hold}]}}\ntorques: {{first: '0.5 - 0.1*qd.first'}}\n"
        "simulate: {duration: 0.1, samples: 5}\n"
    )
    ranges = {f"robot.joints.{name}.a": (0.7 * x, 1.3 * x) for name, x in zip(names[:2], lengths.tolist())}
    first = guess[names[0]]
    return Bars(text, {**ranges, f"initial.q.{names[0]}": (first - 1.2, first + 1.2)})
