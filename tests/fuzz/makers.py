"""What is tried: the case of a seed, a mutated file for its reader or a command with its scene and options."""

from __future__ import annotations

import functools
import random
from pathlib import Path
from typing import Any

import yaml

from robodyn_cli.scene import load_scene
from robodyn_cli.scene.starters import STARTERS
from tests.fuzz.cases import CONFIGS, READ, RUNS, Case
from tests.fuzz.mutate import Mutator, dump, get, places, spoil
from tests.fuzz.readers import make_files, make_reading
from tests.pairs import apart
from tests.pairs.covering import covering
from tests.pairs.motions import MOST, ROWS, families, scene

# the commands by how often they are tried; runs that compile code are the dear ones
WEIGHTS = {
    "validate": 12, "plan": 6, "info": 12, "inverse": 16, "kinematics": 12, "statics": 8, "assemble": 8, "reach": 5,
    "linearise": 4, "simulate": 6, "deploy": 3, "size": 1.5, "check": 3, "compare": 3, "export": 3, "import": 3, "new": 1,
    "schema": 0.2, "cache": 0.3, "plot": 0.4, "report": 0.6, "view": 0.4, "animate": 0.2, "run": 1, "sensitivity": 1.2,
    "sweep": 1.2, "optimise": 0.4, "crosscheck": 1.5, "work-precision": 0.15, "stability": 0.15, "equations": 1,
}  # fmt: skip
READ_SHARE = 10.0 / 11.0  # of cases of both parts
OUTPUTS = {
    "simulate": "final.q.{}", "inverse": "peak_torque.{}", "kinematics": "joints.{}.peak_speed",
    "statics": "configuration.{}",
}  # fmt: skip
STUDIES = ("sweep", "sensitivity", "optimise")
OTHERS = ("validate", "plan", "info", "crosscheck", "run", "work-precision", "stability", "equations")
# on stored results: their options
ON_RESULTS = {
    "check": (), "compare": (), "plot": ("--out", "plots"), "report": ("--file", "page.html"), "view": (),
    "export": ("--out", "export"), "animate": ("--file", "strip.png"),
}  # fmt: skip


@functools.cache
def bases() -> list[dict[str, Any]]:
    """Return good scenes to begin with, short and with few samples."""
    texts = [load_scene(path).text for path in sorted(CONFIGS.rglob("*.yaml")) if path.parent.name not in
             ("robots", "trajectories")]  # fmt: skip
    trees = [yaml.load(text, getattr(yaml, "CSafeLoader", yaml.SafeLoader)) for text in texts]
    trees += [yaml.safe_load(starter.text("x")) for starter in STARTERS.values()]
    # the largest take minutes to build, which finds nothing that the others do not
    small = [t for t in trees if "include" not in t and len(dump(t)) < 5000]
    for tree in small:
        for key in ("simulate", "inverse", "kinematics"):
            if key in tree or key == "simulate":
                tree[key] = {**(tree.get(key) or {}), "samples": 5}
        tree["simulate"]["duration"] = min(0.1, float(tree["simulate"].get("duration", 1)))
        tree.pop("expect", None)
    return small


@functools.cache
def of_features() -> list[dict[str, Any]]:
    """Return scenes of ``tests/pairs``, which hold every feature with every other."""
    trees = [
        scene(case) for row in ROWS for case in covering(families(row), list(apart.read(row)), MOST[row])
    ]
    return [tree for tree in yaml.safe_load(dump(trees)) if len(dump(tree)) < 5000]


def make(seed: int, stored: Path, part: str = "run") -> Case:
    """Return the case of a seed.

    stored : a directory with whole results. part : "read" for a file and its reader, "run" for a command, or "both".
    """
    rng = random.Random(seed)
    mutator = _mutator(rng)
    if part == "read" or (part == "both" and rng.random() < READ_SHARE):
        kind, files = make_reading(rng, mutator, bases(), stored)
        return Case(READ, files, [kind])
    command = rng.choices(list(WEIGHTS), list(WEIGHTS.values()))[0]
    if command in ON_RESULTS:
        return _of_results(command, stored, rng)
    if command not in (*RUNS, *STUDIES, *OTHERS):
        return _of_files(command, stored, rng, mutator)
    trees = of_features() if rng.random() < 0.3 else bases()
    if command in RUNS and rng.random() < 0.95:
        trees = [t for t in trees if t.get("command") == command] or trees
    return _of_scene(command, rng.choice(trees), rng, mutator)


def _of_scene(command: str, tree: dict[str, Any], rng: random.Random, mutator: Mutator) -> Case:
    words = (
        ["--no-plots"] if command in (*RUNS, *STUDIES, "info", "run", "work-precision", "stability") else []
    )
    files = {name: text.encode() for name, text in tree.items() if "." in name}
    tree = {key: value for key, value in tree.items() if key not in files}
    kind = rng.random()
    if kind < 0.75:
        text = dump(mutator.within(tree))
    elif kind < 0.85:
        text = dump(mutator.scene(tree))
    elif kind < 0.88:
        text = mutator.text(tree)
    else:
        text = dump(tree)
        if command != "validate":
            words += [w for _ in range(rng.choice((1, 1, 2))) for w in ("--set", mutator.override(tree))]
    if rng.random() < 0.02:
        name, content = _table(rng)
        files[name] = content
        text = dump({**tree, "trajectory": {"type": "table", "file": name}})
    files["scene.yaml"] = text.encode(errors="surrogatepass")
    return Case(command, files, ["scene.yaml", *words, *_options(command, rng, mutator, tree)])


@functools.cache
def _vocabulary() -> Mutator:
    return Mutator(bases(), random.Random(0))


def _mutator(rng: random.Random) -> Mutator:
    found = _vocabulary()
    found.rng = rng
    return found


def _options(command: str, rng: random.Random, mutator: Mutator, tree: Any) -> list[str]:
    words = ["--json"] if rng.random() < 0.1 else []
    if command in ("info", "linearise") and rng.random() < 0.2:
        words += ["--at", rng.choice((f"q.{_joint(rng, tree)}={mutator.any_value(tree)}", "balance"))]
    if command == "assemble" and rng.random() < 0.3:
        words.append("--branches")
    if command == "reach" and rng.random() < 0.5:
        words += ["--position", ",".join(f"{rng.gauss(0.0, 0.7):.3g}" for _ in range(3))]
    if command == "work-precision":
        words += ["--methods", "gauss,dop853", "--tolerances", "1e-4,1e-6", "--repeats", "1"]
    if command == "stability":
        words.append("--quick")
    if command == "crosscheck":
        words += ["--with", rng.choice(("pinocchio", "mujoco"))]
    if command == "run":
        words += ["--jobs", "1", "--out", "outputs/run"]
    if command in STUDIES:
        words += [*_study(command, rng, mutator, tree), "--jobs", "1"]
    return words


def _study(command: str, rng: random.Random, mutator: Mutator, tree: Any) -> list[str]:
    """Return what varies and what is looked at: most often what there is."""
    paths = [p for p in places(tree) if type(get(tree, p)) in (int, float) and p[0] != "schema"]
    parts = [p for p in paths if p[0] in ("robot", "gravity") and type(get(tree, p)) is float] or paths
    chosen = rng.sample(parts if rng.random() < 0.85 else paths, k=min(len(parts), 2))
    own = OUTPUTS.get(tree.get("command"), "lock.time").format(_joint(rng, tree))
    of = ["--of", own if rng.random() < 0.85 else rng.choice(mutator.keys)]
    names = {".".join(str(step) for step in p): get(tree, p) for p in chosen}
    if command == "sensitivity":
        return [word for name in names for word in ("--to", name)] + of
    if command == "optimise":
        specs = [f"uniform({x - 0.1}, {x + 0.1})" for x in names.values()]
        goal = rng.choice((["--minimise", of[1]], ["--maximise", of[1]], ["--reach", f"{of[1]}=0.1"]))
        vary = [word for name, spec in zip(names, specs) for word in ("--vary", f"{name}={spec}")]
        return [*vary, *goal, "--starts", "1"]
    specs = [
        rng.choice((f"normal({x}, 0.01)", f"linspace({x}, {x + 0.1}, 2)", f"[{x}, {1.1 * x + 0.01}]"))
        for x in names.values()
    ]
    drawn = ["-n", "3"] if "normal" in str(specs) else []
    return [word for name, spec in zip(names, specs) for word in ("--vary", f"{name}={spec}")] + drawn + of


def _joint(rng: random.Random, tree: Any) -> str:
    robot = tree.get("robot")
    joints = robot.get("joints") if isinstance(robot, dict) else None
    return str(rng.choice([j["name"] for j in joints or [{"name": "x"}]]))


def _table(rng: random.Random) -> tuple[str, bytes]:
    rows = "\n".join(f"{0.1 * k},{0.01 * k * k},{0.02 * k}" for k in range(5))
    good = ("t,theta1,theta2\n" + rows + "\n").encode()
    return "table.csv", spoil(good, rng)


def _of_results(command: str, stored: Path, rng: random.Random) -> Case:
    names = sorted(p.name for p in stored.iterdir())
    source = stored / rng.choice(names)
    files = {f"run/{name}": (source / name).read_bytes() for name in ("result.h5", "summary.json")}
    if rng.random() < 0.5:
        broken = rng.choice(("run/result.h5", "run/result.h5", "run/summary.json"))
        files[broken] = spoil(files[broken], rng)
    words = ["run", *ON_RESULTS[command]]
    if command == "compare" or (command in ("plot", "report") and rng.random() < 0.2):
        words.append(str(stored / rng.choice(names)))
    if command == "export":
        words += ["--to", rng.choice(("csv", "parquet", "mat", "npz", "json", "mcap"))]
    return Case(command, files, words)


def _of_files(command: str, stored: Path, rng: random.Random, mutator: Mutator) -> Case:
    """Return a case of a command that takes neither a scene nor a result."""
    if command == "import":
        kind = rng.choice(("urdf", "mesh"))
        files = make_files(kind, rng, mutator, bases(), stored)
        return Case(
            command,
            files,
            ["robot.urdf", *rng.choice(([], ["--strict"], ["robot.yaml"], ["--package", "x=."]))],
        )
    if command == "new":
        kind = rng.choice((*STARTERS, "x", ""))
        words = rng.choice(
            ([kind], [kind, "a/b.yaml"], ["--from", rng.choice(("delta", "puma560", "x")), "robot.yaml"])
        )
        return Case(command, {}, words)
    return Case(command, {}, ["--json"] if command == "cache" and rng.random() < 0.5 else [])
