"""The kinds of loop closure: one file a kind, one line here."""

from __future__ import annotations

from robodyn_cli.loops.revolute import RevoluteLoop

loop_types: dict[str, type] = {
    "revolute": RevoluteLoop,
}
