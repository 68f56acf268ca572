"""The cache of compiled code: used by the next process, never trusted blindly, never in the way."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import robodyn_cli
from robodyn_cli import ForwardDynamics, InverseDynamics, load_scene
from robodyn_cli.expr import functions as f
from robodyn_cli.expr.graph import Graph
from robodyn_cli.kernels import cache as cache_module
from robodyn_cli.kernels import compiler, samples
from robodyn_cli.kernels.samples import SampleKernel
from robodyn_cli.version import digest_of

ROOT = Path(robodyn_cli.__file__).resolve().parent.parent
SCRIPT = """
import json, sys
import numpy as np
from robodyn_cli.expr import functions as f
from robodyn_cli.expr.graph import Graph
from robodyn_cli.kernels.compiler import REPORT
from robodyn_cli.kernels.samples import SampleKernel

values = []
for k in range(int(sys.argv[1])):
    q = Graph().symbols(["a", "b"], "q")
    kernel = SampleKernel({"r": [f.sin(q[0]) * q[1] + (k + 0.5)]}, ("q",))
    values.append(float(kernel(q=np.array([[0.3, 2.0]]))["r"][0, 0]))
print(json.dumps([REPORT.compiled, REPORT.cached, values]))
"""


def start(cache: Path | str, programs: int = 1, root: Path = ROOT) -> subprocess.Popen[str]:
    environment = {**os.environ, "ROBODYN_CACHE": str(cache), "PYTHONPATH": str(root)}
    return subprocess.Popen(
        [sys.executable, "-c", SCRIPT, str(programs)], env=environment, cwd=root, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip


def finish(process: subprocess.Popen[str]) -> tuple[int, int, list[float]]:
    out, err = process.communicate(timeout=120)
    assert process.returncode == 0, err
    compiled, cached, values = json.loads(out)
    assert values == pytest.approx([np.sin(0.3) * 2.0 + (k + 0.5) for k in range(len(values))], rel=1e-15)
    return compiled, cached, values


COUNTED = """
import sys
from robodyn_cli.cli.app import run
from robodyn_cli.kernels.cache import REPORT
code = run(sys.argv[1:])
assert code == 0, code
print(REPORT.compiled)
"""


def test_a_deployment_compiles_few_modules(tmp_path: Path) -> None:
    """The stepping loop, the multipliers of the scan, and all that is evaluated at the samples: three."""
    words = (
        "deploy",
        "configs/four_bar_deploy.yaml",
        "--no-plots",
        "--quiet",
        "--out",
        str(tmp_path / "out"),
    )
    ended = subprocess.run(
        [sys.executable, "-c", COUNTED, *words], cwd=ROOT, capture_output=True, text=True, timeout=240,
        env={**os.environ, "ROBODYN_CACHE": str(tmp_path / "cache")},
    )  # fmt: skip
    assert ended.returncode == 0, ended.stderr
    assert int(ended.stdout) == 3


def test_every_source_that_writes_code_is_in_the_key_of_the_cache() -> None:
    """Also those in subfolders: else code that an older version has compiled would run on."""
    package = ROOT / "robodyn_cli"
    folders = (package / "kernels", package / "formulations", package / "integrators")
    sources = {Path(folder) / f for top in folders for folder, _, names in os.walk(top) for f in names}
    assert {p for p in sources if p.suffix == ".py"} == set(compiler.code_writers())
    assert package / "integrators" / "stepping" / "loop.py" in sources


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache, and a process that remembers nothing."""
    monkeypatch.setenv("ROBODYN_CACHE", str(tmp_path / "cache"))
    forget(monkeypatch)
    return tmp_path / "cache"


def forget(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiler, "_loaded", {})


def build(constant: float = 0.25) -> tuple[int, int]:
    """Make a kernel and use it; returns how many programs were compiled and loaded for it."""
    before = compiler.REPORT.compiled, compiler.REPORT.cached
    q = Graph().symbols(["a"], "q")
    got = SampleKernel({"r": [f.exp(q[0]) + constant]}, ("q",))(q=np.array([0.0, 1.0, -1.0]))["r"][:, 0]
    np.testing.assert_allclose(got, np.exp([0.0, 1.0, -1.0]) + constant, rtol=1e-15)
    return compiler.REPORT.compiled - before[0], compiler.REPORT.cached - before[1]


def test_a_second_process_loads_what_the_first_compiled(tmp_path: Path) -> None:
    first = finish(start(tmp_path, 3))
    second = finish(start(tmp_path, 3))
    assert first[:2] == (3, 0) and second[:2] == (0, 3)
    assert first[2] == second[2]


def test_within_a_process_code_is_made_once(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert build() == (1, 0)
    assert build() == (0, 0)
    forget(monkeypatch)
    assert build() == (0, 1)
    assert build(0.5) == (1, 0)


DAMAGE = {
    "empty": lambda data: b"",
    "a few bytes": lambda data: data[:10],
    "the digest only": lambda data: data[:32],
    "half": lambda data: data[: len(data) // 2],
    "one byte short": lambda data: data[:-1],
    "one byte more": lambda data: data + b"\0",
    "one bit in the code": lambda data: data[:200] + bytes([data[200] ^ 1]) + data[201:],
    "one bit in the digest": lambda data: bytes([data[0] ^ 1]) + data[1:],
    "something else": lambda data: b"#!/bin/sh\n" * 100,
}


@pytest.mark.parametrize("kind", DAMAGE)
def test_damaged_files_are_compiled_again_and_mended(
    kind: str, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert build() == (1, 0)
    (path,) = cache.glob("*.o")
    whole = path.read_bytes()
    path.write_bytes(DAMAGE[kind](whole))
    forget(monkeypatch)
    assert build() == (1, 0)
    assert len(list(cache.iterdir())) == 1
    forget(monkeypatch)
    assert build() == (0, 1)


def test_a_directory_in_the_place_of_a_file_is_no_obstacle(
    cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    build()
    (path,) = cache.glob("*.o")
    path.unlink()
    path.mkdir()
    forget(monkeypatch)
    assert build() == (1, 0)
    assert not list(cache.glob("*.part")), "nothing half written is left behind"


@pytest.mark.parametrize("place", ["a file", "below a file", "a name that is too long"])
def test_where_nothing_can_be_kept_everything_works(
    place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("in the way")
    target = {
        "a file": blocked,
        "below a file": blocked / "x",
        "a name that is too long": tmp_path / ("x" * 300),
    }[place]
    monkeypatch.setenv("ROBODYN_CACHE", str(target))
    forget(monkeypatch)
    assert compiler.cache_directory() is None
    assert build() == (1, 0)
    assert blocked.read_text() == "in the way"


@pytest.mark.parametrize("function", ["tempfile.mkstemp", "os.replace", "os.fdopen"])
def test_a_full_or_read_only_disk_is_no_error(
    function: str, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(function, fail)
        assert build() == (1, 0)
    assert not list(cache.iterdir())
    forget(monkeypatch)
    assert build() == (1, 0)


def test_the_cache_can_be_switched_off(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROBODYN_CACHE", "off")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    for _ in range(2):
        forget(monkeypatch)
        assert build() == (1, 0)
    assert not list(tmp_path.iterdir())


def test_by_default_it_lies_in_the_users_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("ROBODYN_CACHE", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr("platform.system", lambda: "Linux")
    assert compiler.cache_directory() == tmp_path / "robodyn"
    if os.name == "posix":
        assert (tmp_path / "robodyn").stat().st_mode & 0o077 == 0, "others must not plant code there"


def test_many_processes_at_once_do_not_disturb_each_other(tmp_path: Path) -> None:
    processes = [start(tmp_path, 6) for _ in range(4)]
    results = [finish(p) for p in processes]
    assert all(compiled + cached == 6 for compiled, cached, _ in results)
    assert len({tuple(values) for *_, values in results}) == 1
    files = list(tmp_path.iterdir())
    assert len(files) == 6
    assert finish(start(tmp_path, 6))[:2] == (0, 6)


def test_the_newest_files_are_kept(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cache_module, "SWEEPERS", "0123456789abcdef")
    build(0.0)
    size = next(cache.glob("*.o")).stat().st_size
    monkeypatch.setattr(cache_module, "MOST_BYTES", int(3.5 * size))
    now = time.time()
    names: list[Path] = list(cache.glob("*.o"))
    os.utime(names[0], (now - 200, now - 200))
    for k in range(1, 6):
        build(float(k))
        (new,) = set(cache.glob("*.o")) - set(names)
        names.append(new)
        os.utime(new, (now - 100 + k, now - 100 + k))
    assert set(cache.glob("*.o")) == set(names[-3:])
    forget(monkeypatch)
    assert build(5.0) == (0, 1) and build(0.0) == (1, 0)


def test_one_write_in_sixteen_sweeps(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever the keys, which are digests, a cache does not grow without end."""
    monkeypatch.setattr(cache_module, "MOST_BYTES", 1000)
    for k in range(200):
        cache_module.ObjectFile(tmp_path, hashlib.sha256(bytes([k])).hexdigest()).write(b"x" * 68)
        assert sum(path.stat().st_size for path in tmp_path.iterdir()) <= 1000 + 64 * 100


def test_files_of_processes_that_were_killed_are_swept(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cache_module, "SWEEPERS", "0123456789abcdef")
    cache.mkdir()
    old, fresh = cache / "a.part", cache / "b.part"
    for path in (old, fresh):
        path.write_bytes(b"half")
    os.utime(old, (0, 0))
    build()
    assert not old.exists() and fresh.exists()


def test_code_of_another_key_is_not_run(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two whole files that change places, as a bad copy of a cache would have them."""
    build(1.0)
    (first,) = cache.glob("*.o")
    build(2.0)
    (second,) = set(cache.glob("*.o")) - {first}
    a, b = first.read_bytes(), second.read_bytes()
    first.write_bytes(b)
    second.write_bytes(a)
    forget(monkeypatch)
    assert build(1.0) == (1, 0) and build(2.0) == (1, 0)


@pytest.mark.skipif(os.name != "posix", reason="rights as POSIX has them")
@pytest.mark.parametrize("place", ["directory", "file"])
@pytest.mark.parametrize("mode", [0o020, 0o002])
def test_what_others_may_write_is_not_run(
    place: str, mode: int, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    build()
    (path,) = cache.glob("*.o")
    target = cache if place == "directory" else path
    target.chmod(target.stat().st_mode | mode)
    forget(monkeypatch)
    monkeypatch.setattr(compiler.REPORT, "warnings", [])
    assert build() == (1, 0)
    assert len(compiler.REPORT.warnings) == (place == "directory")


@pytest.mark.skipif(os.name != "posix", reason="links and pipes as POSIX has them")
@pytest.mark.parametrize("kind", ["link", "pipe"])
def test_links_and_pipes_are_not_followed(
    kind: str, cache: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    build()
    (path,) = cache.glob("*.o")
    moved = tmp_path / "elsewhere.o"
    path.rename(moved)
    os.symlink(moved, path) if kind == "link" else os.mkfifo(path)
    forget(monkeypatch)
    assert build() == (1, 0)
    assert moved.exists() and not path.is_symlink() and path.is_file()


def test_another_version_of_the_writer_does_not_use_old_code(tmp_path: Path) -> None:
    finish(start(tmp_path / "cache"))
    other = tmp_path / "other"
    shutil.copytree(ROOT / "robodyn_cli", other / "robodyn_cli", ignore=shutil.ignore_patterns("__pycache__"))
    assert finish(start(tmp_path / "cache", root=other))[:2] == (0, 1), "a copy is the same version"
    for folder in ("kernels", "formulations", "integrators"):
        source = next((other / "robodyn_cli" / folder).glob("*.py"))
        source.write_text(source.read_text() + "\n# changed\n")
        assert finish(start(tmp_path / "cache", root=other))[:2] == (1, 0)


@pytest.mark.parametrize("field", ["cpu", "features", "lanes", "fused"])
def test_another_processor_does_not_use_it_either(
    field: str, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import dataclasses

    keys: list[str] = []
    monkeypatch.setattr(cache_module.ObjectFile, "read", lambda file: keys.append(file.key))
    build()
    host = compiler.machine()
    value = {
        "cpu": "generic",
        "features": host.features + ",-fma",
        "lanes": host.lanes + 1,
        "fused": not host.fused,
    }
    other = dataclasses.replace(host, **{field: value[field]})
    monkeypatch.setattr(compiler, "machine", lambda: other)
    forget(monkeypatch)
    compiler.compile_module("key", lambda: "define void @f() {\n ret void\n}")
    monkeypatch.setattr(compiler, "machine", lambda: host)
    compiler.compile_module("key", lambda: "define void @f() {\n ret void\n}")
    assert len(set(keys)) == 3


def test_what_python_calls_takes_cached_code_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What results hold does not depend on the cache: there the interpreter goes on until enough samples are seen."""
    monkeypatch.setenv("ROBODYN_CACHE", str(tmp_path))
    q = Graph().symbols(["a", "b"], "q")
    long = q[0]
    for _ in range(300):
        long = f.sin(long * q[1])
    kernels = [SampleKernel({"r": [long]}, ("q",), eager=eager) for eager in (False, True, True)]
    samples = np.random.default_rng(1).uniform(0.5, 1.5, (20, 2))
    cold = kernels[1](q=samples)["r"]
    assert kernels[1]._first is not None and "_compiled" not in vars(kernels[1])
    assert kernels[1]._compiled and list(tmp_path.glob("*.o"))
    plain, warm = (kernels[k](q=samples)["r"] for k in (0, 2))
    assert "_compiled" not in vars(kernels[0]) and "_compiled" in vars(kernels[2])
    np.testing.assert_array_equal(plain, cold)
    np.testing.assert_allclose(warm, cold, rtol=1e-12)


def test_functions_of_samples_are_ready_when_they_are_made(monkeypatch: pytest.MonkeyPatch) -> None:
    """Their first call loads nothing; counts of a plan make none of their code."""
    taken: list[str] = []
    load = compiler.compile_module
    monkeypatch.setattr(samples, "compile_module", lambda key, *more: taken.append(key) or load(key, *more))
    scene = load_scene(Path(robodyn_cli.__file__).parents[1] / "configs" / "double_pendulum.yaml")
    for kind in (InverseDynamics, ForwardDynamics):
        function, before = kind(scene), len(taken)
        assert before
        function(*np.zeros((3, 100, 2)))
        assert len(taken) == before
        taken.clear()
    InverseDynamics(scene, eager=False)
    assert not taken


def test_the_stack_of_every_function_is_aligned_for_vectors() -> None:
    from robodyn_cli.integrators.stepping.many import write_many

    text = write_many()
    heads = [line for line in compiler.aligned(text).splitlines() if line.startswith("define")]
    assert len(heads) == text.count("define ") and all("alignstack(64)" in head for head in heads)
    placed = compiler.aligned('define internal double @f(double %a) nounwind section ".text.f" {')
    assert placed == 'define internal double @f(double %a) nounwind alignstack(64) section ".text.f" {'


def test_the_digest_of_code_is_kept_while_files_are_what_they_were(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Files are read again where one has changed, has just changed, or the cache is not one's own."""
    package, read = tmp_path / "package", []
    (package / "inner").mkdir(parents=True)
    for name in ("a.py", "inner/b.py"):
        (package / name).write_text(name)
    monkeypatch.setattr(cache_module, "digest_of", lambda root: read.append(root) or digest_of(root))
    monkeypatch.setenv("ROBODYN_CACHE", str(tmp_path / "cache"))

    def reads() -> int:
        read.clear()
        assert cache_module.code_digest.__wrapped__(str(package)) == digest_of(str(package))
        return len(read)

    assert (reads(), reads()) == (1, 1), "these files are younger than two seconds"
    monkeypatch.setattr(cache_module, "SETTLED", 0)
    assert (reads(), reads()) == (1, 0)
    status = (package / "a.py").stat()
    (package / "a.py").write_text("b.py")
    os.utime(package / "a.py", ns=(status.st_atime_ns, status.st_mtime_ns))
    assert (reads(), reads()) == (1, 0), "the same size and time of change, and other content"
    (package / "inner" / "b.py").rename(package / "inner" / "c.py")
    assert (reads(), reads()) == (1, 0)
    for kept in (tmp_path / "cache").iterdir():
        assert kept.name[0] not in cache_module.SWEEPERS, (
            "else one change of the package in sixteen costs a sweep"
        )
        kept.write_bytes(kept.read_bytes()[:-1])
    assert (reads(), reads()) == (1, 0), "a damaged file is not taken"
    monkeypatch.setenv("ROBODYN_CACHE", "off")
    assert (reads(), reads()) == (1, 1)
