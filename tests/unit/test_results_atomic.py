"""Files are whole under their final name or not there, whatever happens while they are written."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from robodyn_cli.errors import OutputError
from robodyn_cli.results.hdf5 import ResultWriter, read, write
from robodyn_cli.results.json_text import indented
from robodyn_cli.results.result import Result
from robodyn_cli.results.summary import dumps, write_summary

posix_only = pytest.mark.skipif(sys.platform == "win32", reason="needs POSIX signals or limits")


def small_result() -> Result:
    result = Result("simulate", "small", "ok", "")
    result.add("time", [0.0, 1.0])
    return result


def test_an_exception_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    target = write(small_result(), tmp_path / "r.h5")
    before = target.read_bytes()
    with pytest.raises(KeyboardInterrupt), ResultWriter(target, command="simulate") as writer:
        writer.append("time", np.arange(1e6))
        raise KeyboardInterrupt
    assert target.read_bytes() == before
    assert [path.name for path in tmp_path.iterdir()] == ["r.h5"]


def test_leaving_without_finish_is_noticed(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match="without finish"), ResultWriter(tmp_path / "r.h5", command="x"):
        pass
    assert not list(tmp_path.iterdir())


KILLED = """
import os, signal, sys
import numpy as np
from robodyn_cli.results.hdf5 import ResultWriter
writer = ResultWriter(sys.argv[1], command="simulate")
writer.append("time", np.arange(1e6))
os.kill(os.getpid(), signal.SIGKILL)
"""


@posix_only
def test_a_kill_leaves_the_old_file_whole(tmp_path: Path) -> None:
    target = write(small_result(), tmp_path / "r.h5")
    done = subprocess.run([sys.executable, "-c", KILLED, str(target)], check=False)
    assert done.returncode == -signal.SIGKILL
    assert len(read(target).time) == 2


FULL_DISK = """
import resource, signal, sys
import numpy as np
from robodyn_cli.errors import OutputError
from robodyn_cli.results.hdf5 import ResultWriter, write
resource.setrlimit(resource.RLIMIT_FSIZE, (300_000, 300_000))
for flushed in (False, True):
    try:
        with ResultWriter(sys.argv[1], command="simulate") as writer:
            if flushed:
                for _ in range(10):
                    writer.append("time", np.arange(1e5))
            else:
                writer.put("time", np.arange(1e5))
            writer.finish()
    except OutputError as error:
        assert error.exit_code == 74 and sys.argv[1] in error.message, error.message
    else:
        raise SystemExit("no error")
"""


@posix_only
def test_a_full_disk_is_an_output_error_and_no_crash(tmp_path: Path) -> None:
    target = tmp_path / "r.h5"
    done = subprocess.run([sys.executable, "-c", FULL_DISK, str(target)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert not list(tmp_path.iterdir())


def test_summary_is_strict_json_in_a_fixed_order(tmp_path: Path) -> None:
    summary = {
        "outputs": ["result.h5"],
        "peak": {"theta1": np.float64(0.1) + 0.2, "theta2": float("nan")},
        "counters": {"steps": np.int64(12)},
        "array": np.array([1.0, np.inf]),
        "flag": np.bool_(True),
        "path": Path("a") / "b",
        "status": "ok",
        "termination": {"reason": "end", "time": -np.inf},
    }
    write_summary(summary, tmp_path / "summary.json")
    text = (tmp_path / "summary.json").read_text()

    def refuse(constant: str) -> None:
        raise AssertionError(constant)

    back = json.loads(text, parse_constant=refuse)
    assert list(back) == ["status", "termination", "peak", "array", "flag", "path", "counters", "outputs"]
    assert back["peak"] == {"theta1": 0.1 + 0.2, "theta2": None}
    assert back["array"] == [1.0, None] and back["flag"] is True and back["path"] == "a/b"
    assert back["termination"]["time"] is None
    assert [path.name for path in tmp_path.iterdir()] == ["summary.json"]
    assert dumps(dict(reversed(summary.items()))).startswith('{"status": "ok", "termination"')


def test_summaries_are_read_by_people() -> None:
    """A key a line, numbers of a list on one, as large matrices have a million; the same data as Python reads it."""
    data = {
        "none": {},
        "empty": [],
        "row": [1, 2.5, None, True],
        "words": ["x", 'é"\n'],
        "in": {"matrix": [[1.0, 2.0], [3.0]], "mixed": [{"h": 1}, [], ["a", 1]]},
    }
    for ascii_only in (False, True):
        assert json.loads(indented(data, ascii_only)) == data
        assert indented(data, ascii_only).isascii() == ascii_only
    lines = indented(data).splitlines()
    assert lines[3] == '  "row": [1, 2.5, null, true],' and lines[10:12] == [
        "      [1.0, 2.0],",
        "      [3.0]",
    ]
    assert indented({}) == "{}"


def test_summary_errors_name_the_path_or_the_value(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="nowhere"):
        write_summary({}, tmp_path / "nowhere" / "summary.json")
    with pytest.raises(TypeError, match="object"):
        write_summary({"x": object()}, tmp_path / "summary.json")
    assert not list(tmp_path.iterdir())
