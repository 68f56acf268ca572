"""Units of joint quantities in words."""

from __future__ import annotations

from robodyn_cli.model.model import Model


def unit_text(model: Model, suffix: str, table: dict[str, str] | None = None) -> str:
    """Return one text for the units of all joints: ``rad/s``, ``m/s`` or both."""
    kinds = list(dict.fromkeys(model.q_units)) or ["rad"]
    texts = [table[k] if table else k + suffix for k in kinds]
    return " or ".join(texts)
