"""A choice that a builder made, kept beside what it built, for ``robodyn plan``."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

from robodyn_cli.record import record

RATES = "right-hand side in the stepping loop"


@record
class Decision:
    """Of several ways to the same numbers, the one that was ``taken``, and why.

    operations : of the ways that were compared, by name.
    """

    choice: str
    taken: str
    reason: str
    operations: Mapping[str, int] = dataclasses.field(default_factory=dict)
