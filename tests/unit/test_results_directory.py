"""The output directory: one run at a time, its own old files removed, those of others left alone."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from robodyn_cli.errors import DirectoryInUseError, OutputError
from robodyn_cli.report import draw_all, plot_files
from robodyn_cli.results.hdf5 import write
from robodyn_cli.results.output_dir import OutputDirectory
from tests.unit.synthetic_results import inverse_result

HOLD = """
import sys, time
from robodyn_cli.results.output_dir import OutputDirectory
with OutputDirectory(sys.argv[1]):
    print("held", flush=True)
    time.sleep(60)
"""


def names(directory: Path) -> set[str]:
    return {path.name for path in directory.iterdir()} - {".lock"}


def test_a_run_leaves_what_it_lists(tmp_path: Path) -> None:
    target = tmp_path / "a" / "b"
    with OutputDirectory(target) as out:
        write(inverse_result(), out.result_path)
        out.temporary("notes.png").write_bytes(b"x")
        out.publish("notes.png")
        out.temporary("abandoned.png").write_bytes(b"x")
        out.write_summary({"status": "ok"})
    assert names(target) == {"result.h5", "notes.png", "summary.json"}
    summary = json.loads((target / "summary.json").read_text())
    assert summary["outputs"] == ["result.h5", "notes.png", "summary.json"]


def test_old_outputs_go_and_foreign_files_stay(tmp_path: Path) -> None:
    outside = tmp_path / "outside.png"
    outside.write_bytes(b"mine")
    target = tmp_path / "run"
    with OutputDirectory(target) as out:
        write(inverse_result(), out.result_path)
        out.record(draw_all(inverse_result(), target))
        out.write_summary({"status": "ok"})
    assert "torques.png" in names(target)
    for name in ("mine.png", "data.csv", "energy.png", "listed.png"):
        (target / name).write_bytes(b"mine")
    listing = json.loads((target / "summary.json").read_text())
    listing["outputs"] += ["listed.png", "energy.png", "../outside.png", str(outside), "data.csv", ".", "", 3]
    (target / "summary.json").write_text(json.dumps(listing))
    (target / ".result.h5.1-00.robodyn-tmp").write_bytes(b"left by a kill")
    with OutputDirectory(target, plot_files()):
        assert names(target) == {"mine.png", "data.csv", "energy.png", "listed.png"}
    assert outside.read_bytes() == b"mine"


def test_drawings_of_a_killed_run_are_known_by_their_mark(tmp_path: Path) -> None:
    draw_all(inverse_result(), tmp_path)
    (tmp_path / "summary.json").write_text("not json")
    assert len(names(tmp_path)) == 7
    with OutputDirectory(tmp_path, plot_files()):
        assert names(tmp_path) == set()


def test_the_directory_is_locked_within_a_process(tmp_path: Path) -> None:
    with OutputDirectory(tmp_path):
        with pytest.raises(DirectoryInUseError) as caught, OutputDirectory(tmp_path):
            pass
        assert caught.value.exit_code == 2
        assert str(os.getpid()) in caught.value.message
    with OutputDirectory(tmp_path):
        pass


def test_a_second_process_is_refused_and_a_kill_frees(tmp_path: Path) -> None:
    (tmp_path / "result.h5").write_bytes(b"the first run removes this")
    child = subprocess.Popen([sys.executable, "-c", HOLD, str(tmp_path)], stdout=subprocess.PIPE, text=True)
    try:
        assert child.stdout is not None and child.stdout.readline() == "held\n"
        assert names(tmp_path) == set()
        (tmp_path / "result.h5").write_bytes(b"being written")
        with pytest.raises(DirectoryInUseError, match="in use"), OutputDirectory(tmp_path):
            pass
        assert names(tmp_path) == {"result.h5"}
    finally:
        child.send_signal(getattr(signal, "SIGKILL", signal.SIGTERM))
        child.wait()
        assert child.stdout is not None
        child.stdout.close()
    with OutputDirectory(tmp_path):
        assert names(tmp_path) == set()


def test_an_error_inside_frees_the_directory(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError), OutputDirectory(tmp_path) as out:
        out.temporary("x.png").write_bytes(b"x")
        raise ZeroDivisionError
    assert names(tmp_path) == set()
    with OutputDirectory(tmp_path):
        pass


def test_unusable_paths_are_output_errors(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"")
    for path in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(OutputError, match="file") as caught, OutputDirectory(path):
            pass
        assert caught.value.exit_code == 74
    (tmp_path / "run" / "result.h5").mkdir(parents=True)
    with pytest.raises(OutputError, match=r"result\.h5"), OutputDirectory(tmp_path / "run"):
        pass


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may write anywhere")
def test_a_forbidden_directory_is_an_output_error(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    try:
        with pytest.raises(OutputError, match="ermission"), OutputDirectory(tmp_path / "run"):
            pass
    finally:
        tmp_path.chmod(0o700)
