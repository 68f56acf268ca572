"""Threads of the linear algebra that numpy brings along."""

from __future__ import annotations

from collections.abc import MutableMapping

VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def single_thread(environment: MutableMapping[str, str]) -> None:
    """Set one thread, unless the environment says otherwise. Has an effect only before numpy is imported.

    Matrices of mechanisms are small: more threads make nothing faster, and starting them takes longer than a small run.
    """
    for name in VARIABLES:
        environment.setdefault(name, "1")
