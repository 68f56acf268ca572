"""What is known to go wrong: words of a finding, and why it is left. The list may only shrink."""

from __future__ import annotations

KNOWN: dict[str, str] = {}
