"""Names of a URDF file as names of a scene: letters, digits and _, each once."""

from __future__ import annotations

import re
from collections.abc import Iterable

from robodyn_cli.expr.formula import RESERVED

GROUND = "base"


def scene_names(names: Iterable[str], taken: Iterable[str]) -> dict[str, str]:
    """Return the scene's name for each name of the URDF: itself where it is allowed and not ``taken``.

    Other characters become ``_``; a name that is taken then gets a number.
    """
    found: dict[str, str] = {}
    taken = frozenset(taken)
    used = set(taken)
    wanted = {name: _allowed(name) for name in names}
    # names that stay as they are come first: none of them makes way for a name that changes anyway
    for name in sorted(wanted, key=lambda name: wanted[name] != name or name in taken):
        number, new = 2, wanted[name]
        while new in used:
            new, number = f"{wanted[name]}_{number}", number + 1
        used.add(new)
        found[name] = new
    return found


def joint_names(names: Iterable[str]) -> dict[str, str]:
    """Return names of joints, which formulas use."""
    return scene_names(names, RESERVED)


def link_names(names: Iterable[str]) -> dict[str, str]:
    """Return names of links; ``base`` is the ground in scenes."""
    return scene_names(names, (GROUND,))


def _allowed(name: str) -> str:
    new = re.sub(r"[^A-Za-z0-9_]", "_", name)
    return f"_{new}" if not new or new[0].isdigit() else new
