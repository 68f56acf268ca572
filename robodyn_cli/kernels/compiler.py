"""LLVM IR text to machine code in memory, with an object cache on disk."""

from __future__ import annotations

import contextlib
import ctypes
import hashlib
import re
import time
from collections.abc import Callable, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

from robodyn_cli.errors import CapabilityError
from robodyn_cli.kernels.cache import REPORT, ObjectFile, cache_directory
from robodyn_cli.record import record

# Levels of the generator of code. What is made quickly takes a fifth of the time to make and runs two to four times as
# long. More than 1 takes longer to make, and its code runs no faster on these graphs.
QUICK, LASTING = 0, 1
OTHER_TARGETS = (0, 50)  # version of llvmlite from which on it brings all processors, with LLVM 22


@record
class Target:
    """What code is made for: a processor, its lanes of doubles, and whether it fuses multiply-add.

    Writers of code take ``lanes`` and ``fused`` of it; the rest is the compiler's.
    """

    triple: str
    cpu: str
    features: str
    lanes: int
    fused: bool


@lru_cache(maxsize=1)
def machine() -> Target:
    """Return this processor."""
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
    return Target(
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


def compile_module(
    key: str, write: Callable[[], str], level: int = LASTING, target: Target | None = None
) -> CompiledModule:
    """Return the machine code of a module, from the cache or compiled now.

    Parameters
    ----------
    key : digest of everything that decides the code, other than the target and robodyn's own version.
    write : writes the IR text; called only when there is no cached object.
    level : ``LASTING``, or ``QUICK`` for code that is used little.
    target : that this processor runs as well; default: this processor.
    """
    start = time.perf_counter()
    m = target or machine()
    digest = _digest(key, level, m)
    compiled = _loaded.get(digest)
    if compiled is not None:
        return compiled
    llvm = _llvm()
    generator = _generator(llvm, m, level)
    folder = cache_directory()
    kept = ObjectFile(folder, digest) if folder else None
    code = kept.read() if kept else None
    if code is None:
        REPORT.now = "compiling"
        text = aligned(write())
        REPORT.begin(text.count("\n"), quick=level == QUICK)
        try:
            code = _compile(llvm, generator, llvm.parse_assembly(text), level)
        finally:
            REPORT.now = ""
        if kept:
            kept.write(code)
        REPORT.compiled += 1
    else:
        REPORT.cached += 1
    empty = llvm.parse_assembly("")
    empty.triple = m.triple
    engine = llvm.create_mcjit_compiler(empty, generator)
    engine.add_object_file(llvm.ObjectFileRef.from_data(code))
    engine.finalize_object()
    REPORT.spend(time.perf_counter() - start)
    # of two threads that compile the same, both take what was there first: addresses point into it
    return _loaded.setdefault(digest, CompiledModule(engine))


def is_at_hand(key: str, level: int = LASTING, target: Target | None = None) -> bool:
    """Tell whether ``compile_module`` has a module in memory or in the cache, which it need not compile."""
    digest = _digest(key, level, target or machine())
    folder = cache_directory()
    return digest in _loaded or (folder is not None and ObjectFile(folder, digest).path.is_file())


def _digest(key: str, level: int, m: Target) -> str:
    text = "\n".join(
        [key, str(level), m.triple, m.cpu, m.features, str(m.lanes), str(m.fused), code_version()]
    )
    return hashlib.sha256(text.encode()).hexdigest()


def aligned(text: str) -> str:
    """Return IR whose functions begin with a stack that is aligned for the widest vectors.

    LLVM aligns it only where a function reserves room of its own for vectors, and else spills them across lines of the
    cache: up to a quarter of the run time then depended on where the stack happened to be.
    """
    # a pattern with letters in front is looked for four times as fast as one that begins at lines
    head = re.compile(r'\n(define .*?)( section "[^"]*")? \{$', re.MULTILINE)
    return head.sub(r"\n\1 alignstack(64)\2 {", "\n" + text)[1:]


def compile_object(texts: Sequence[str], target: Target, level: int = 2) -> bytes:
    """Return one object file of modules that call each other, for a target that need not be this processor.

    Raises
    ------
    CapabilityError : llvmlite is too old for other targets.
    """
    import llvmlite

    version = tuple(int(x) for x in llvmlite.__version__.split(".")[:2])
    if version < OTHER_TARGETS:
        raise CapabilityError(
            f"code for {target.triple} takes llvmlite {'.'.join(map(str, OTHER_TARGETS))} or newer; here it is "
            f"{llvmlite.__version__}"
        )
    llvm = _llvm()
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    generator = _generator(llvm, target, level)
    whole, *others = (llvm.parse_assembly(text) for text in texts)
    for part in (whole, *others):
        part.triple, part.data_layout = target.triple, str(generator.target_data)
    for part in others:
        whole.link_in(part)
    return _compile(llvm, generator, whole, level)


def _generator(llvm: Any, target: Target, level: int) -> Any:
    """Return LLVM's generator of code for a target."""
    chosen = llvm.Target.from_triple(target.triple)
    return chosen.create_target_machine(cpu=target.cpu, features=target.features, opt=level)


def _compile(llvm: Any, generator: Any, parsed: Any, level: int) -> bytes:
    """Return an object file.

    LLVM's own pipelines take as long as parsing and code generation together, and their code runs no faster: constants
    are folded and common expressions found before the text is written. Three things are left to do: a better order of
    sums (the flags allow it, and it saves a tenth of the run time), identities of single instructions, and jumps. Code
    that is made quickly does without these: they take as long as the rest of it.
    """
    parsed.verify()
    builder = llvm.create_pass_builder(generator, llvm.create_pipeline_tuning_options())
    passes = llvm.create_new_module_pass_manager()
    passes.add_sroa_pass()
    if level != QUICK:
        passes.add_reassociate_pass()
        passes.add_instruction_combine_pass()
        passes.add_simplify_cfg_pass()
    passes.run(parsed, builder)
    return bytes(generator.emit_object(parsed))
