"""``robodyn cache``: what is kept, and what ``--clear`` leaves."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest
from typer.testing import CliRunner

from robodyn_cli.cli.app import app
from robodyn_cli.kernels.cache import MOST_BYTES, REPORT, ObjectFile


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("ROBODYN_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(REPORT, "warnings", [])
    (tmp_path / "cache").mkdir(mode=0o700)
    return tmp_path / "cache"


def call(*words: str) -> str:
    done = CliRunner().invoke(app, ["cache", *words])
    assert done.exit_code == 0, done.output
    return done.output


def test_it_shows_place_and_size(folder: Path) -> None:
    assert "0 objects, 0 MB" in call()
    ObjectFile(folder, "a" * 64).write(bytes(2**20 - 32))
    ObjectFile(folder, "b" * 64).write(bytes(2**19 - 32))
    found = call()
    assert str(folder) in found and "2 objects, 1.50 MB" in found and "64 MB" in found
    report = json.loads(call("--json"))
    assert report == {"status": "ok", "directory": str(folder), "entries": 2, "bytes": 3 * 2**19,
                      "most_bytes": MOST_BYTES, "removed": 0}  # fmt: skip


def test_clear_removes_objects_and_nothing_else(folder: Path) -> None:
    ObjectFile(folder, "a" * 64).write(b"code")
    (folder / "notes.txt").write_text("mine")
    assert "removed  1 object\n" in call("--clear")
    assert [p.name for p in folder.iterdir()] == ["notes.txt"]
    assert json.loads(call("--clear", "--json"))["removed"] == 0


def test_a_cache_that_is_off(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROBODYN_CACHE", "off")
    assert call("--clear") == "compiled code is not kept\n"
    assert json.loads(call("--json"))["directory"] is None


@pytest.mark.skipif(os.name != "posix", reason="permissions of POSIX")
def test_a_cache_that_others_may_write_is_left_alone(folder: Path) -> None:
    ObjectFile(folder, "a" * 64).write(b"code")
    folder.chmod(0o777)
    assert call("--clear").count("other users may write there") == 1
    folder.chmod(0o700)
    assert len(list(folder.iterdir())) == 1
