"""The output directory: one run at a time, whose files replace those of an earlier run at its end; others stay."""

from __future__ import annotations

import errno
import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from robodyn_cli.errors import DirectoryInUseError, OutputError, ResultFileError
from robodyn_cli.over.batch.stored import read_stored
from robodyn_cli.report import draw_all, plot_files
from robodyn_cli.results import atomic as lock
from robodyn_cli.results.atomic import temporary_path
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
        (out.new / "notes.png").write_bytes(b"x")
        temporary_path(out.new / "abandoned.png").write_bytes(b"x")
        assert names(target) == {out.new.name}
        out.replace_old({"status": "ok"})
    assert names(target) == {"result.h5", "notes.png", "summary.json"}
    summary = json.loads((target / "summary.json").read_text())
    assert summary["outputs"] == ["result.h5", "notes.png", "summary.json"]


def test_old_outputs_go_and_foreign_files_stay(tmp_path: Path) -> None:
    outside = tmp_path / "outside.png"
    outside.write_bytes(b"mine")
    target = tmp_path / "run"
    with OutputDirectory(target) as out:
        write(inverse_result(), out.result_path)
        draw_all(inverse_result(), out.new)
        out.replace_old({"status": "ok"})
    assert "torques.png" in names(target)
    for name in ("mine.png", "data.csv", "energy.png", "listed.png"):
        (target / name).write_bytes(b"mine")
    listing = json.loads((target / "summary.json").read_text())
    listing["outputs"] += ["listed.png", "energy.png", "../outside.png", str(outside), "data.csv", ".", "", 3]
    (target / "summary.json").write_text(json.dumps(listing))
    (target / ".result.h5.1-00.robodyn-tmp").write_bytes(b"left by a kill")
    before = names(target)
    with OutputDirectory(target, plot_files()) as out:
        assert names(target) == before - {".result.h5.1-00.robodyn-tmp"} | {out.new.name}
        out.replace_old({"status": "failed"})
    assert names(target) == {"mine.png", "data.csv", "energy.png", "listed.png", "summary.json"}
    assert outside.read_bytes() == b"mine"


def test_drawings_of_a_killed_run_are_known_by_their_mark(tmp_path: Path) -> None:
    draw_all(inverse_result(), tmp_path)
    (tmp_path / "summary.json").write_text("not json")
    assert len(names(tmp_path)) == 8
    with OutputDirectory(tmp_path, plot_files()) as out:
        out.replace_old({"status": "failed"})
    assert names(tmp_path) == {"summary.json"}


@pytest.mark.parametrize("whole", [True, False])
def test_ended_between_any_two_files_the_mix_is_known(
    whole: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What another process would see if this one were killed after each step of a replacement."""
    seen = []

    def watched(act: Any) -> Any:
        def step(*words: Any, **more: Any) -> Any:
            done = act(*words, **more)
            seen.append(stored_now())
            return done

        return step

    def stored_now() -> dict[str, bytes]:
        found = (path for path in target.iterdir() if path.is_file() and path.name != ".lock")
        return {path.name: path.read_bytes() for path in found}

    target = tmp_path / "out"
    for last in (False, True):
        with OutputDirectory(target, plot_files()) as out:
            if whole or not last:
                result = inverse_result()
                result.attributes["run_id"] = out.run_id
                write(result, out.result_path)
            draw_all(inverse_result(), out.new)
            if last:
                monkeypatch.setattr(os, "replace", watched(os.replace))
                monkeypatch.setattr(Path, "unlink", watched(Path.unlink))
            out.replace_old({"status": "ok"})
    monkeypatch.undo()
    first, end = seen[0], seen[-1]
    verdicts = []
    for k, state in enumerate(seen):
        folder = tmp_path / str(k)
        folder.mkdir()
        for name, content in state.items():
            (folder / name).write_bytes(content)
        try:
            read_stored(folder)
            verdicts.append("whole")
        except ResultFileError as error:
            verdicts.append("mixed" if "not of the same run" in error.message else "none")
            continue
        assert state in (first, end)
    if whole:
        assert verdicts[-1] == "whole" and "mixed" in verdicts
    else:
        assert verdicts[-1] == "none" and "result.h5" not in end


def test_the_directory_knows_the_scene_whose_results_it_holds(tmp_path: Path) -> None:
    mine, other = tmp_path / "a" / "arm.yaml", tmp_path / "b" / "arm.yaml"
    for path in (mine, other):
        path.parent.mkdir()
        path.write_text("")
    out = tmp_path / "out"
    with OutputDirectory(out, scene=mine) as directory:
        directory.replace_old({"status": "ok"})
    assert OutputDirectory(out, scene=mine).other_scene() is None
    assert OutputDirectory(out, scene=other).other_scene() == mine.resolve()
    mine.unlink()  # renamed or moved: the same scene, as far as anybody can tell
    assert OutputDirectory(out, scene=other).other_scene() is None


def test_the_directory_is_locked_within_a_process(tmp_path: Path) -> None:
    with OutputDirectory(tmp_path):
        with pytest.raises(DirectoryInUseError) as caught, OutputDirectory(tmp_path):
            pass
        assert caught.value.exit_code == 2
        assert str(os.getpid()) in caught.value.message
    with OutputDirectory(tmp_path):
        pass


def test_a_second_process_is_refused_and_a_kill_frees(tmp_path: Path) -> None:
    (tmp_path / "result.h5").write_bytes(b"earlier")
    child = subprocess.Popen([sys.executable, "-c", HOLD, str(tmp_path)], stdout=subprocess.PIPE, text=True)
    try:
        assert child.stdout is not None and child.stdout.readline() == "held\n"
        with pytest.raises(DirectoryInUseError, match="in use"), OutputDirectory(tmp_path):
            pass
        assert "result.h5" in names(tmp_path)
    finally:
        child.send_signal(getattr(signal, "SIGKILL", signal.SIGTERM))
        child.wait()
        assert child.stdout is not None
        child.stdout.close()
    with OutputDirectory(tmp_path) as out:
        assert names(tmp_path) == {"result.h5", out.new.name}  # what the killed one was writing is gone
    assert (tmp_path / "result.h5").read_bytes() == b"earlier"


def test_an_error_inside_frees_the_directory(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError), OutputDirectory(tmp_path) as out:
        (out.new / "x.png").write_bytes(b"x")
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


def test_a_file_system_without_locks_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(descriptor: int) -> None:
        raise OSError(errno.ENOLCK, "no locks available")

    with OutputDirectory(tmp_path) as directory:
        assert directory.warning is None
    monkeypatch.setattr(lock, "_take", refuse)
    with OutputDirectory(tmp_path) as directory:
        assert directory.warning is not None and "one robodyn here at a time" in directory.warning
