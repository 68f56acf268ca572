"""Where a result comes from: versions of the libraries in use, and the processor."""

from __future__ import annotations

import functools
import hashlib
import os
import platform
import sys


def versions() -> dict[str, str]:
    """Return the versions of Python and of the libraries loaded so far, without importing any."""
    found = {"python": platform.python_version()}
    for name in ("numpy", "h5py", "llvmlite", "scipy", "casadi"):
        module = sys.modules.get(name)
        if module is not None:
            found[name] = str(getattr(module, "__version__", "unknown"))
    h5py = sys.modules.get("h5py")
    if h5py is not None:
        found["hdf5"] = str(h5py.version.hdf5_version)
    found["platform"] = f"{platform.system()} {platform.release()} {platform.machine()}"
    return found


@functools.cache
def cpu_name() -> str:
    """Return the processor's name, without starting another program to find it."""
    if sys.platform.startswith("linux"):
        try:
            # Each further block makes the kernel query the clock of every core; the first one is enough.
            with open("/proc/cpuinfo", encoding="utf-8", errors="replace") as stream:
                head = stream.read(2048)
        except OSError:
            head = ""
        for line in head.splitlines():
            if line.startswith(("model name", "Model", "cpu model")):
                return line.partition(":")[2].strip()
    return os.environ.get("PROCESSOR_IDENTIFIER") or platform.machine()


def sha256(text: str) -> str:
    """Return the SHA-256 of ``text`` in UTF-8, hexadecimal."""
    return hashlib.sha256(text.encode()).hexdigest()
