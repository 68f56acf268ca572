"""Forces and moments among the columns of a wrench."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from robodyn_cli.spatial.algebra import Array


def magnitude(data: Array, names: Sequence[str], letter: str) -> Array:
    """Return the length (T,) of the force (``letter`` f) or of the moment (m) of a wrench (T, n).

    names : of its columns (``fx``, ``mz``), of which some may be missing.
    """
    columns = [k for k, name in enumerate(names) if name.startswith(letter)]
    return np.asarray(np.sqrt((data[:, columns] ** 2).sum(axis=1)))
