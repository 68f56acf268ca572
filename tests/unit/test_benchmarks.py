"""The benchmarks run, their errors are small, and start-up imports only what it needs. Nothing is timed.

``-m benchmarks`` runs every script in its quick form beside its peers (`pip install robodyn[peers]`): a script without
one of them is skipped with its name after it has run, and fails where ROBODYN_PEERS=required. ROBODYN_BENCHMARKS names
a folder that keeps what they write.
"""

from __future__ import annotations

import importlib
import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
BENCHMARKS = ROOT / "benchmarks"
SCRIPTS = sorted(
    path.name for path in BENCHMARKS.glob("*.py") if "\nif __name__ ==" in path.read_text("utf-8")
)


def run(script: str, *arguments: str) -> str:
    """Return what a benchmark prints."""
    command = [sys.executable, str(BENCHMARKS / script), *arguments]
    return subprocess.run(command, check=True, cwd=ROOT, stdout=subprocess.PIPE, text=True).stdout


def rows_of(file: Path) -> list[dict[str, Any]]:
    found = json.loads(file.read_text(encoding="utf-8"))
    assert found["machine"]["cpu"] and found["machine"]["robodyn"]
    rows: list[dict[str, Any]] = found["rows"]
    return rows


@pytest.mark.benchmarks
@pytest.mark.parametrize("script", SCRIPTS)
def test_every_script_beside_its_peers(script: str, tmp_path: Path) -> None:
    folder = Path(os.environ.get("ROBODYN_BENCHMARKS", tmp_path))
    folder.mkdir(exist_ok=True)
    file = folder / f"{Path(script).stem}.json"
    command = [sys.executable, str(BENCHMARKS / script), "--quick", "--json", str(file)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    written = json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}
    absent = written.get("absent", [])
    assert done.returncode == 0 and written["failed"] == {}, done.stdout + done.stderr
    assert written["rows"] or absent
    if absent and os.environ.get("ROBODYN_PEERS") == "required":
        pytest.fail(f"without {', '.join(absent)}")
    if absent:
        pytest.skip(f"ran without {', '.join(absent)}, not installed")


@pytest.mark.parametrize("script", SCRIPTS)
def test_every_script_reports(script: str) -> None:
    """All have ``--quick`` and ``--json`` and one way of keeping what was measured."""
    text = (BENCHMARKS / script).read_text(encoding="utf-8")
    assert "measure.command_line(__doc__)" in text and "measure.reporting(" in text


@pytest.mark.parametrize("error", [ValueError("no such thing"), KeyboardInterrupt()])
def test_what_was_measured_is_kept(
    error: BaseException, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A part that fails is a line, and the parts behind it go on; an interrupt ends, with all before it written."""
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    measure = importlib.import_module("measure")
    file = tmp_path / "rows.json"
    ends = SystemExit if isinstance(error, Exception) else KeyboardInterrupt
    with pytest.raises(ends), measure.reporting(str(file)) as report:
        report.rows.append({"engine": "first"})
        with report.part("second"):
            raise error
        report.rows.append({"engine": "third"})
    kept = json.loads(file.read_text(encoding="utf-8"))
    if ends is SystemExit:
        assert [row["engine"] for row in kept["rows"]] == ["first", "third"]
        assert kept["failed"] == {"second": "ValueError: no such thing"}
        assert "| second | ValueError: no such thing |" in capsys.readouterr().out
    else:
        assert kept["rows"] == [{"engine": "first"}] and kept["failed"] == {}


def test_revisions_are_compared_figure_by_figure(monkeypatch: pytest.MonkeyPatch) -> None:
    """Times alone, those of rows with the same words and tolerance by their order; the least of each counts."""
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    revisions = importlib.import_module("revisions")
    rows = [
        {"work": "fall", "tolerance": 1e-3, "error": 1e-4, "ms": 2.0, "us_per_sample": 5.0, "runs": 7},
        {"work": "fall", "tolerance": 1e-3, "error": 1e-7, "ms": 4.0, "us_per_sample": None, "runs": 7},
    ]
    found = revisions.figures("a.py", rows)
    assert not any(map(revisions.PEERS.match, ("robodyn gauss", "robodyn_us", "us")))
    assert all(map(revisions.PEERS.match, ("Pinocchio, scipy DOP853", "toppra_ms", "heyoka, batches of 8")))
    assert revisions.all_rows({"rows": rows, "machine": {}, "list": [1.0], "more": rows[:1]}) == [
        *rows,
        rows[0],
    ]
    assert found == {
        ("a.py", "fall", "0.001", "0", "ms"): 2.0,
        ("a.py", "fall", "0.001", "0", "us_per_sample"): 5.0,
        ("a.py", "fall", "0.001", "1", "ms"): 4.0,
    }
    first, second = (("a.py", "fall", "0.001", order, "ms") for order in "01")
    old = [{first: 2.0, second: 4.0}, {first: 2.4, second: 4.1}]
    new = [{first: 2.3, second: 9.0}, {first: 3.0, second: 5.0}]
    slower, within = revisions.compared(old, new)
    assert slower["figure"] == "a.py, fall, 0.001, 1, ms" and slower["ratio"] == 1.25
    assert within["ratio"] == pytest.approx(1.15) and within["spread"] == pytest.approx(1.2)


def test_the_old_engine_runs_the_scripts_and_scenes_of_the_new_revision(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    revisions = importlib.import_module("revisions")
    report = "import json, sys; json.dump({{'rows': {}}}, open(sys.argv[2], 'w')); sys.exit(1)"
    engine = "[{{'work': open('robodyn_cli/name').read(), 'ms': len(open('configs/a.yaml').read())}}]"
    for name in ("old", "new"):
        for folder in ("benchmarks", "configs", "robodyn_cli"):
            (tmp_path / name / folder).mkdir(parents=True)
        (tmp_path / name / "robodyn_cli" / "name").write_text(name, encoding="utf-8")
    old, new = tmp_path / "old", tmp_path / "new"
    (old / "benchmarks" / "gone.py").touch()
    (new / "benchmarks" / "a.py").write_text(report.format(engine.format()), encoding="utf-8")
    (new / "benchmarks" / "b.py").write_text(report.format([]), encoding="utf-8")
    (new / "configs" / "a.yaml").write_text("abc", encoding="utf-8")
    revisions.give(new, old)
    assert not (old / "benchmarks" / "gone.py").exists()
    # a script of which a part fails has measured the others
    assert revisions.run(old, "a.py", "", quick=False) == {("a.py", "old", "0", "ms"): 3.0}
    with pytest.raises(RuntimeError, match="--own"):
        revisions.run(old, "b.py", "", quick=False)


def test_whole_runs_are_repeated_and_told_with_their_range(monkeypatch: pytest.MonkeyPatch) -> None:
    """But for those that take long: what would take longer than is waited for is not made again."""
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    measure = importlib.import_module("measure")
    clock = iter(range(100))
    monkeypatch.setattr(measure, "SPREADS", [])
    monkeypatch.setattr(measure.time, "perf_counter", lambda: 10.0 * next(clock))
    seconds = iter([3.0, 1.0, 2.0, 9.0])
    assert measure.repeated("a", lambda: (next(seconds),), lambda x: x[0], 3) == [(3.0,), (1.0,), (2.0,)]
    spread = measure.Spread.of([3.0, 1.0, 2.0])
    assert spread == (2.0, 1.0, 3.0, 3) and spread.told(".1f") == "2.0 (1.0 to 3.0)"
    assert measure.Spread.of([4.0]).told(".2f") == "4.00"
    assert measure.SPREADS == [(0.5, "a")]
    monkeypatch.setattr(measure, "PATIENCE", 15.0)
    assert measure.repeated("b", lambda: (next(seconds),), lambda x: x[0], 3) == [(9.0,)]


def test_reports_have_their_revision(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    revision = importlib.import_module("measure").revision()
    git = ["git", "-C", str(ROOT), "rev-parse", "HEAD"]
    try:
        head = subprocess.run(git, capture_output=True, text=True).stdout.strip()
    except OSError:
        head = ""
    assert head.startswith(revision.rstrip("+")) and bool(revision) == bool(head)


def test_formulas_of_peers_are_those_of_the_graph() -> None:
    """Accelerations operation by operation, by what an engine of formulas is given, beside Newton and Euler's."""
    code = """
import math, sys
sys.path.insert(0, ".")
import arms, numpy as np
from cases import CASES
from peers.formulas import graph_rates
case = CASES["arm"]()
q, v, _ = arms.motion(case.n, 3)
for x, y in zip(q, v):
    got = np.array(graph_rates(case, [*x, *y], math.sin, math.cos), dtype=float)[case.n:]
    tau = arms.newton_euler(case.arm, x[None], y[None], got[None])
    assert abs(tau).max() < 1e-11, tau
"""
    subprocess.run([sys.executable, "-c", code], check=True, cwd=BENCHMARKS)


def test_throughput(tmp_path: Path) -> None:
    file = tmp_path / "throughput.json"
    printed = run("throughput.py", "--quick", "--json", str(file))
    rows = rows_of(file)
    for row in rows:
        assert {"work", "engine", "us_per_sample", "error"} <= set(row)
        assert row["us_per_sample"] > 0.0
        assert 0.0 <= row["error"] < 1e-10
        assert row["work"] in printed
    arms = ("planar 2R", "7-joint arm", "30-joint chain")
    wanted = {f"{kind} dynamics, {arm}" for kind in ("inverse", "forward") for arm in arms}
    assert {row["work"] for row in rows if row["engine"] == "robodyn"} == wanted


def test_model_functions(tmp_path: Path) -> None:
    file = tmp_path / "functions.json"
    printed = run("model_functions.py", "--quick", "--json", str(file))
    rows = rows_of(file)
    assert [row["function"] for row in rows] == ["M", "C", "G", "Jacobian", "d tau", "d qdd"]
    for row in rows:
        assert row["robodyn_us"] > 0.0 and row["function"] in printed
        assert row.get("differ", 0.0) < 1e-11


def test_sensitivities(tmp_path: Path) -> None:
    file = tmp_path / "sensitivities.json"
    printed = run("sensitivities.py", "--quick", "--json", str(file))
    ways = {row["way"]: row for row in rows_of(file)}
    assert set(ways) == {"derivatives", "with their errors", "20 runs by deploy_many", "20 runs one by one"}
    assert all(row["ms"] > 0.0 and way in printed for way, row in ways.items())
    assert ways["derivatives"]["error"] < 1e-8
    assert ways["with their errors"]["error"] < 1e-10


def test_movies(tmp_path: Path) -> None:
    file = tmp_path / "movies.json"
    printed = run("movies.py", "--alone", "--quick", "--json", str(file))
    (row,) = rows_of(file)
    frames = json.loads(file.read_text(encoding="utf-8"))["frames"]
    assert f"{frames} frames" in printed and frames > 12.2 * 5, (
        "five a second, until the lock and somewhat longer"
    )
    assert row["process"] == "robodyn animate" and row["cpu_s"] > 0.0


def test_throughput_finds_wrong_results() -> None:
    """The reference is no echo of the engine: a wrong mass, or a sample that is off, shows in both errors."""
    sys.path.insert(0, str(BENCHMARKS))
    try:
        import arms
    finally:
        sys.path.remove(str(BENCHMARKS))
    from robodyn_cli import ForwardDynamics, InverseDynamics, load_scene_text

    arm = arms.seven_joint_arm()
    scene = load_scene_text(arms.scene_text(arm))
    q, qd, qdd = arms.motion(7, 40)
    tau = InverseDynamics(scene)(q, qd, qdd)
    found = ForwardDynamics(scene)(q, qd, tau)
    assert arms.inverse_error(arm, q, qd, qdd, tau) < 1e-14
    assert arms.forward_error(arm, q, qd, tau, found) < 1e-12
    off = found.copy()
    off[3, 2] += 1e-6
    size = abs(found).max()
    assert arms.forward_error(arm, q, qd, tau, off) == pytest.approx(1e-6 / size, rel=1e-4)
    tau[5, 1] += 1e-6
    assert arms.inverse_error(arm, q, qd, qdd, tau) == pytest.approx(1e-6 / abs(tau).max(), rel=1e-6)


def test_work_precision(tmp_path: Path) -> None:
    file = tmp_path / "work_precision.json"
    printed = run("double_pendulum.py", "--quick", "--json", str(file))
    rows = rows_of(file)
    for row in rows:
        assert row["us"] > 0.0 and row["engine"] in printed
    for work, limit in (("double pendulum, 10 s", 1e-11), ("four-bar to lock", 1e-11)):
        mine = [row for row in rows if row["work"] == work]
        assert min(row["error"] for row in mine if row["engine"] == "robodyn gauss") < limit
        assert all(row["error"] < 1e-2 for row in mine)


def test_many_loops_cost_in_proportion(tmp_path: Path) -> None:
    """Each further loop of the N-four-bar takes the same operations, and the motion stays right."""
    file = tmp_path / "loops.json"
    run("n_four_bar.py", "--loops", "2", "4", "6", "--json", str(file))
    rows = rows_of(file)
    for key in ("operations", "operations_of_a_step"):
        first, second, third = (row[key] for row in rows)
        assert second - first == third - second
    assert all(row["error"] < 1e-10 for row in rows)


@pytest.mark.further
def test_ensembles(tmp_path: Path) -> None:
    """robodyn's part: errors of many runs, against references of their own."""
    file = tmp_path / "ensembles.json"
    run("ensembles.py", "--quick", "--json", str(file))
    rows = {(row["work"], row["way"]): row for row in rows_of(file)}
    assert rows["double pendulums", "robodyn dop853"]["error"] < 1e-7
    assert rows["double pendulums", "robodyn gauss"]["error"] < 1e-9
    assert rows["stiff double pendulums", "robodyn radau13"]["error"] < 1e-8
    assert rows["four-bars to their lock", "robodyn gauss, with error estimate"]["error"] < 1e-9
    assert rows["arrays of ten panels, ten latches", "robodyn gauss, with error estimate"]["error"] < 1e-9


def test_memory_of_studies(tmp_path: Path) -> None:
    file = tmp_path / "memory.json"
    run("study_memory.py", "--quick", "--json", str(file))
    few, many = rows_of(file)
    assert (few["runs"], many["runs"]) == (100, 1000) and many["peak_MB"] < 1.1 * few["peak_MB"]


def test_operations_of_a_hundred_loops() -> None:
    """Counted on graphs alone: proportional still, and rows in any order of the loops cost the same."""
    code = """
import random
from n_four_bar import scene
from robodyn_cli import load_scene_text
from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.graph import count_operations
def operations(text): return count_operations(list(Problem(load_scene_text(text)).forward.qdd))
found = [operations(scene(n)) for n in (20, 60, 100)]
assert found[1] - found[0] == found[2] - found[1], found
lines = scene(60).splitlines()
first = lines.index("loops:") + 1
loops = lines[first : first + 60]
random.Random(1).shuffle(loops)
lines[first : first + 60] = loops
shuffled = operations("\\n".join(lines) + "\\n")
assert shuffled < 1.6 * found[1], (shuffled, found[1])
"""
    command = [sys.executable, "-c", f"import sys; sys.path.insert(0, {str(ROOT)!r}); {code}"]
    subprocess.run(command, check=True, cwd=BENCHMARKS)


def test_against_peers(tmp_path: Path) -> None:
    """robodyn's part: errors against references that share nothing with it, stiff transients included."""
    file = tmp_path / "peers.json"
    run("against_peers.py", "--quick", "--engines", "robodyn", "--json", str(file))
    rows = rows_of(file)
    best = {row["case"]: 1.0 for row in rows}
    for row in rows:
        best[row["case"]] = min(best[row["case"]], row["error"])
    assert set(best) == {"plain", "stiff", "light", "heavy", "four_bar", "arm"}
    for case, error in best.items():
        assert error < {"arm": 1e-10, "heavy": 1e-11, "light": 1e-11}.get(case, 1e-12), case


def test_reference_of_the_swinging_arms() -> None:
    """Collocation in extended precision agrees with itself, and with a Taylor series in quadruple precision."""
    found = json.loads((BENCHMARKS / "reference.json").read_text(encoding="utf-8"))
    taylor = [-1.62889639534036989, 0.477493006480734381, -1.42990244445507279, 2.56888649044476188]
    assert found["plain"]["states"][-1] == pytest.approx(taylor, rel=0, abs=5e-16)
    assert found["times"][0] == 1e-4 and found["times"][-1] == 10.0
    for variant in ("plain", "stiff", "light", "heavy"):
        assert found[variant]["angles_agree"] < 1e-15 and found[variant]["rates_agree"] < 1e-12
    assert found["arm"]["agree"] < 1e-13


def test_mechanisms_with_loops(tmp_path: Path) -> None:
    file = tmp_path / "loops.json"
    run("loops.py", "--quick", "--scenes", "rbd_four_bar", "--json", str(file))
    rows = [row for row in rows_of(file) if not row["engine"].startswith("Exudyn")]
    assert {row["engine"].split(",")[0] for row in rows} >= {"projection", "baumgarte", "none"}
    assert all(row["error"] < 1e-8 for row in rows if row["setting"] == "rtol 1e-10")


def test_time_of_the_lock() -> None:
    """The reference of the four-bar is its energy integral, to all the digits of a double."""
    code = "from lock_time import LOCK, lock_time; assert abs(lock_time() - LOCK) < 1e-14"
    subprocess.run([sys.executable, "-c", code], check=True, cwd=BENCHMARKS)


@pytest.mark.parametrize(
    ("arguments", "absent"),
    [
        (["inverse", "configs/2r_circle.yaml", "--no-plots"], {"matplotlib", "llvmlite"}),
        (["simulate", "configs/double_pendulum.yaml", "--no-plots"], {"matplotlib"}),
        (["deploy", "configs/four_bar_deploy.yaml", "--no-plots"], {"matplotlib"}),
        (["inverse", "configs/2r_circle.yaml"], {"matplotlib.pyplot"}),
    ],
)
def test_start_up_imports(arguments: list[str], absent: set[str], tmp_path: Path) -> None:
    """What takes long to import is not imported where it is not needed."""
    code = "import startup, sys; print(*startup.modules_of(sys.argv[1:]))"
    command = [sys.executable, "-c", f"import sys; sys.path.insert(0, {str(BENCHMARKS)!r}); {code}"]
    command += [*arguments, "--out", str(tmp_path)]
    printed = subprocess.run(command, check=True, cwd=ROOT, stdout=subprocess.PIPE, text=True).stdout
    loaded = set(printed.split())
    assert "robodyn_cli.cli.runner" in loaded
    assert not (absent | {"scipy", "rich"}) & loaded


@pytest.fixture
def pages(monkeypatch: pytest.MonkeyPatch) -> Any:
    """The script that fills the pages and keeps records."""
    monkeypatch.setattr(sys, "path", sys.path[:])
    spec = importlib.util.spec_from_file_location("make_benchmarks", ROOT / "docs" / "make_benchmarks.py")
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_releases_have_their_record(pages: Any) -> None:
    """Each version of the changelog that is released, and no other; of the commit and the version that it says."""
    assert pages.released("# A\n\n## 0.3.0 (unreleased)\n\n## 0.2.0 (2026-01-02)\n\n### 9 (x)\n") == ["0.2.0"]
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    records = pages.records()
    assert set(pages.released(changelog)) <= set(records)
    for version, record in records.items():
        assert record["version"] == version and f"\n## {version} (" in changelog
        assert {"throughput", "ensembles", "against_peers"} <= set(record["scripts"])
        for script in record["scripts"].values():
            assert script["revision"] and not script["revision"].endswith("+") and not script["failed"]


def test_records_keep_what_scripts_wrote(pages: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """To four digits, and only of one machine without a part that failed; releases stand side by side."""
    monkeypatch.setattr(pages, "HISTORY", tmp_path / "history")
    runs = tmp_path / "runs"
    runs.mkdir()

    def write(name: str, ratio: float, **more: Any) -> None:
        swings: list[dict[str, Any]] = [
            {"engine": "robodyn gauss", "error": 1e-8, "us": 4.0},
            {"engine": "robodyn dop853", "error": 1e-4, "us": 2.0},
            {"engine": "heyoka, once", "error": 1e-9, "us": 12.0},
            {"engine": "scipy", "error": None, "us": 1.0},
        ]
        machine = {"cpu": "C", "robodyn": "0.9.0", "revision": "abc", "load": ratio, "pin": "4"}
        rows = [{"work": "fall", "faster": ratio, "us": 3.0}, {"work": "swing", "error": 1e-9}]
        found = {
            "machine": machine | more.pop("machine", {}),
            "quick": False,
            "rows": rows,
            "failed": {},
        } | more
        found["more"] = [{"work": "swing"} | row for row in swings] if name == "against_peers" else []
        (runs / f"{name}.json").write_text(json.dumps(found), encoding="utf-8")

    def keep() -> dict[str, Any]:
        monkeypatch.setattr(sys, "argv", ["make_benchmarks.py", str(runs), "--record"])
        pages.main()
        return pages.records(tmp_path / "history")  # type: ignore[no-any-return]

    with pytest.raises(SystemExit, match="no NAME.json"):
        keep()
    write("revisions", 1.0, machine={"cpu": "other"})
    write("throughput", 2.345678)
    write("against_peers", 5.0)
    kept = keep()["0.9.0"]
    assert kept["machine"] == {"cpu": "C", "pin": "4"} and set(kept["scripts"]) == {
        "throughput",
        "against_peers",
    }
    assert (
        kept["scripts"]["throughput"]["revision"] == "abc" and kept["scripts"]["throughput"]["load"] == 2.346
    )
    assert kept["scripts"]["throughput"]["rows"][0] == {"work": "fall", "faster": 2.346, "us": 3.0}
    write("throughput", 3.0, machine={"robodyn": "0.10.0"}, quick=True)
    write("against_peers", 6.0, machine={"robodyn": "0.10.0"}, quick=True)
    both = keep()
    lines = [
        [cell.strip() for cell in x.split("|")[1:-1]] for x in pages.over_releases(both, []).splitlines()
    ]
    assert lines[0] == ["figure", "0.9.0", "0.10.0 (quick)"]
    assert lines[2:] == [
        ["against_peers, swing, heyoka to 1e-03", "6", "6"],
        ["against_peers, swing, heyoka to 1e-07", "3", "3"],
        ["throughput, fall, 0, faster", "2.346", "3"],
    ]
    assert "throughput, swing, 0, error" in pages.over_releases(both, ["swing", "throughput"])
    for more, told in (
        (
            {"machine": {"pin": "5", "robodyn": "0.10.0"}},
            r"throughput\.json: pin 5, the others 4",
        ),
        ({"failed": {"part": "why"}}, r"throughput\.json: part failed"),
    ):
        write("throughput", 6.0, **more)
        with pytest.raises(SystemExit, match=told):
            keep()


def test_all_scripts_are_run_once_for_a_record(
    pages: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What failed is told and made again, what is whole stays; words of robots of others are not kept for the pages."""
    scripts, runs = tmp_path / "benchmarks", tmp_path / "runs"
    scripts.mkdir()
    text = """import json, sys
if __name__ == "__main__":
    print("run", *sys.argv[3:])
    failed = {"part": "why"} if NAME else {}
    machine = {"revision": REVISION}
    json.dump({"machine": machine, "failed": failed, "rows": []}, open(sys.argv[2], "w"))
    sys.exit(bool(failed))
""".replace("REVISION", repr(pages.measure.revision()))
    for name in ("time_optimal", "urdf_corpus", "broken", "revisions"):
        (scripts / f"{name}.py").write_text(text.replace("NAME", str(name == "broken")), encoding="utf-8")
    (scripts / "shared.py").write_text("", encoding="utf-8")
    assert pages.measured(runs, scripts, ["--quick"]) == ["broken"]
    assert {x.name for x in runs.iterdir()} == {
        "time_optimal.json", "time_optimal.txt", "urdf_corpus.json", "broken.json", "broken.txt"
    }  # fmt: skip
    assert (runs / "time_optimal.txt").read_text(encoding="utf-8") == "run --random 50 --quick\n"
    assert json.loads((runs / "time_optimal.json").read_text(encoding="utf-8"))["took_s"] == 0
    (scripts / "broken.py").write_text(text.replace("NAME", "0"), encoding="utf-8")
    (scripts / "time_optimal.py").write_text(
        "\nif __name__ == '__main__':\n    raise SystemExit(1)", encoding="utf-8"
    )
    assert pages.measured(runs, scripts, []) == []


def test_spread_is_that_of_the_middle_half(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Printed and written with the report, which has no numbers that JSON cannot hold."""
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    measure = importlib.import_module("measure")
    monkeypatch.setattr(measure, "SPREADS", [])
    measure.noted("once", [1.0])
    assert measure.spread() == {}
    measure.noted("same", [2.0] * 5)
    measure.noted(("apart", 1e-3), [5.0, 1.0, 4.0, 2.0, 3.0])
    with measure.reporting(str(tmp_path / "a.json")) as report:
        report.rows.append({"error": float("nan"), "list": [1.0, float("inf")]})
    found = json.loads((tmp_path / "a.json").read_text(encoding="utf-8"))
    assert found["rows"] == [{"error": None, "list": [1.0, None]}] and found["quick"] is False
    assert found["spread"] == {"timings": 2, "median": 1 / 3, "most": 2 / 3, "of": "apart 0.001"}
    assert "within 33% (median of 2), at most 67% (apart 0.001)" in capsys.readouterr().out


def test_pages_show_tables_of_scripts_that_exist(pages: Any, tmp_path: Path) -> None:
    """And a table that a run prints anew comes into its place, and nothing else changes."""
    for name in pages.PAGES:
        page = (pages.DOCS / name).read_text(encoding="utf-8")
        marks = list(pages.MARK.finditer(page))
        assert marks
        for mark in marks:
            assert (BENCHMARKS / f"{mark[1]}.py").exists(), mark[0]
            assert mark[2] == "all" or page[mark.end()] == "|", f"no table behind {mark[0]}"
        assert pages.filled(page, tmp_path) == page
    page = "# A\n\n<!-- one 2 -->\n\n| old |\n|---|\n\nwords\n\n<!-- two all -->\n\nold words\n\n## B\n"
    (tmp_path / "one.txt").write_text(
        "machine\n\n| first |\n|---|\n\n| new |\n|---|\n| 1 |\n", encoding="utf-8"
    )
    (tmp_path / "two.txt").write_text("machine\n\nnew words\n\n| t |\n", encoding="utf-8")
    new = "# A\n\n<!-- one 2 -->\n\n| new |\n|---|\n| 1 |\n\nwords\n\n<!-- two all -->\n\nnew words\n\n| t |\n\n## B\n"
    assert pages.filled(page, tmp_path) == new
    with pytest.raises(SystemExit, match=r"one\.txt has 2 tables"):
        pages.filled(page.replace("one 2", "one 3"), tmp_path)


def test_robots_in_urdf(tmp_path: Path) -> None:
    pytest.importorskip("pinocchio")
    file = tmp_path / "corpus.json"
    (tmp_path / "other").mkdir()
    broken = "<robot name='x'><link name='a'/><link name='b'/></robot>"
    (tmp_path / "other" / "lift_arm.urdf").write_text(broken, encoding="utf-8")
    (tmp_path / "lift_arm.urdf").write_bytes((ROOT / "configs" / "robots" / "lift_arm.urdf").read_bytes())
    printed = run("urdf_corpus.py", str(tmp_path), "--json", str(file))
    good, refused = rows_of(file)
    assert good["joints"] == 4 and good["mimics"] == 1 and good["coupled"] < 1e-13 and good["torques"] < 1e-13
    assert "allowed: one root" in refused["refused"] and "1 of 2 robots within 1e-10, 1 refused" in printed
