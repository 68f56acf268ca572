"""LLVM IR text to machine code in memory, with an object cache on disk."""

from __future__ import annotations

import contextlib
import ctypes
import hashlib
import os
import platform
import tempfile
import time
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any

from robodyn_cli.kernels.report import REPORT
from robodyn_cli.record import record

CACHE_FILES = 400  # about 10 kB each; the oldest go first


@record
class Machine:
    """The processor that code is made for."""

    triple: str
    cpu: str
    features: str
    lanes: int
    fused: bool


@lru_cache(maxsize=1)
def machine() -> Machine:
    """Describe this processor: its lanes of doubles and whether it fuses multiply-add."""
    llvm = _llvm()
    features = llvm.get_host_cpu_features()
    triple = llvm.get_default_triple()
    arm = triple.startswith(("aarch64", "arm64"))
    if features.get("avx512f"):
        lanes = 8
    elif features.get("avx2") or features.get("avx"):
        lanes = 4
    else:
        lanes = 2
    return Machine(
        triple, llvm.get_host_cpu_name(), features.flatten(), lanes, arm or bool(features.get("fma"))
    )


@lru_cache(maxsize=1)
def _llvm() -> Any:
    import llvmlite.binding as llvm

    with contextlib.suppress(RuntimeError):  # recent versions initialise themselves and say so
        llvm.initialize()
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    return llvm


def code_writers() -> list[Path]:
    """Return the sources that write code, those in subfolders included."""
    root = Path(__file__).resolve().parent.parent
    folders = ("kernels", "formulations", "integrators")
    return sorted(path for folder in folders for path in (root / folder).rglob("*.py"))


@lru_cache(maxsize=1)
def code_version() -> str:
    """Return a digest of the sources that write code, so that a cached object never outlives them."""
    hasher = hashlib.sha256()
    for path in code_writers():
        hasher.update(path.read_bytes())
    import llvmlite

    hasher.update(llvmlite.__version__.encode())
    return hasher.hexdigest()


def cache_directory() -> Path | None:
    """Return where compiled code is kept, or None where nothing can be kept (``ROBODYN_CACHE`` = path or ``off``)."""
    setting = os.environ.get("ROBODYN_CACHE")
    if setting == "off":
        return None
    if setting:
        root = Path(setting)
    elif platform.system() == "Windows":
        root = Path(os.environ.get("LOCALAPPDATA", Path.home() / "AppData" / "Local")) / "robodyn"
    elif platform.system() == "Darwin":
        root = Path.home() / "Library" / "Caches" / "robodyn"
    else:
        root = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "robodyn"
    try:
        root.mkdir(parents=True, exist_ok=True, mode=0o700)
    except (OSError, RuntimeError):
        return None
    return root


def _read(path: Path) -> bytes | None:
    """Return a cached object if it is whole: the file starts with the digest of the rest."""
    try:
        data = path.read_bytes()
    except OSError:
        return None
    if len(data) <= 32 or hashlib.sha256(data[32:]).digest() != data[:32]:
        return None
    return data[32:]


def _write(path: Path, code: bytes) -> None:
    """Keep an object; losing a race or having no space is no error."""
    with contextlib.suppress(OSError):
        handle, name = tempfile.mkstemp(dir=path.parent, suffix=".part")
        try:
            with os.fdopen(handle, "wb") as stream:
                stream.write(hashlib.sha256(code).digest() + code)
            os.replace(name, path)
        except BaseException:
            os.unlink(name)
            raise
        files = sorted(path.parent.glob("*.o"), key=lambda p: p.stat().st_mtime)
        for old in files[:-CACHE_FILES]:
            old.unlink()


_loaded: dict[str, CompiledModule] = {}


class CompiledModule:
    """Machine code in memory; ``address(name)`` finds a function. Lives as long as the process."""

    def __init__(self, engine: Any) -> None:
        self._engine = engine

    def address(self, name: str) -> int:
        return int(self._engine.get_function_address(name))

    def function(self, name: str, *types: Any, result: Any = None) -> Callable[..., Any]:
        """Return a function as a ctypes callable."""
        return ctypes.CFUNCTYPE(result, *types)(self.address(name))


def compile_module(key: str, write: Callable[[], str], level: int = 1) -> CompiledModule:
    """Return the machine code of a module, from the cache or compiled now.

    Parameters
    ----------
    key : digest of everything that decides the code, other than the processor and robodyn's own version.
    write : writes the IR text; called only when there is no cached object.
    level : optimisation level of the code generator, 0 to 3. Level 1 runs as fast as 2 and 3 on these graphs.
    """
    start = time.perf_counter()
    m = machine()
    text = "\n".join(
        [key, str(level), m.triple, m.cpu, m.features, str(m.lanes), str(m.fused), code_version()]
    )
    digest = hashlib.sha256(text.encode()).hexdigest()
    found = _loaded.get(digest)
    if found is not None:
        return found
    llvm = _llvm()
    target = llvm.Target.from_triple(m.triple).create_target_machine(
        cpu=m.cpu, features=m.features, opt=level
    )
    folder = cache_directory()
    path = folder / f"{digest[:40]}.o" if folder else None
    code = _read(path) if path else None
    if code is None:
        code = _compile(llvm, target, write())
        if path:
            _write(path, code)
        REPORT.compiled += 1
    else:
        REPORT.cached += 1
    empty = llvm.parse_assembly("")
    empty.triple = m.triple
    engine = llvm.create_mcjit_compiler(empty, target)
    engine.add_object_file(llvm.ObjectFileRef.from_data(code))
    engine.finalize_object()
    module = _loaded[digest] = CompiledModule(engine)
    REPORT.seconds += time.perf_counter() - start
    return module


def _compile(llvm: Any, target: Any, text: str) -> bytes:
    """Return an object file.

    LLVM's own pipelines take as long as parsing and code generation together, and their code runs no faster: constants
    are folded and common expressions found before the text is written. What is left to do are sums in a better order
    (the flags allow that, and it is worth a tenth of the run time), identities of single instructions, and jumps.
    """
    parsed = llvm.parse_assembly(text)
    parsed.verify()
    builder = llvm.create_pass_builder(target, llvm.create_pipeline_tuning_options())
    passes = llvm.create_new_function_pass_manager()
    passes.add_sroa_pass()
    passes.add_reassociate_pass()
    passes.add_instruction_combine_pass()
    passes.add_simplify_cfg_pass()
    for function in parsed.functions:
        if not function.is_declaration:
            passes.run(function, builder)
    return bytes(target.emit_object(parsed))
