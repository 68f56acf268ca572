"""Threads: how many, those of the linear algebra that numpy brings along, and programs that share an object."""

from __future__ import annotations

import contextlib
import functools
import os
import sys
import threading
import types
from collections.abc import Callable, Iterator, MutableMapping
from typing import TYPE_CHECKING, Any, TypeVar

VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def single_thread(environment: MutableMapping[str, str]) -> None:
    """Set one thread, unless the environment says otherwise. Has an effect only before numpy is imported.

    Matrices of mechanisms are small: more threads make nothing faster, and starting them takes longer than a small run.
    """
    for name in VARIABLES:
        environment.setdefault(name, "1")


def cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


Function = TypeVar("Function", bound=Callable[..., Any])


class ThreadSafe:
    """An object that several threads may use: what it builds is built by one thread at a time, under ``lock``."""

    def __init__(self) -> None:
        self.lock = threading.RLock()

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "lock"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state, lock=threading.RLock())  # a copy, in another process too, has its own


def one_at_a_time(method: Function) -> Function:
    """Return a method of a ``ThreadSafe`` that one thread runs at a time."""

    @functools.wraps(method)
    def alone(self: ThreadSafe, *args: Any, **options: Any) -> Any:
        with self.lock:
            return method(self, *args, **options)

    return alone  # type: ignore[return-value]


if TYPE_CHECKING:
    once = functools.cached_property
else:

    class once(functools.cached_property):
        """A cached property that one thread computes, once; Python from 3.12 on leaves that open."""

        def __get__(self, instance, owner=None):
            if instance is None:
                return self
            with instance.lock:
                if self.attrname not in vars(instance):
                    vars(instance)[self.attrname] = self.func(instance)
                return vars(instance)[self.attrname]


_main = threading.Lock()


@contextlib.contextmanager
def without_main() -> Iterator[None]:
    """Let processes that begin in the block not run the script of the user again, which needs no guard then."""
    with _main:
        main = sys.modules["__main__"]
        sys.modules["__main__"] = types.ModuleType("__main__")
        try:
            yield
        finally:
            sys.modules["__main__"] = main
