"""Write a tree as canonical YAML 1.2: the text that is stored with results and can be loaded again."""

from __future__ import annotations

import json
import math
import re

from robodyn_cli.scene.text.nodes import Mapping, Node, Scalar, Sequence, Value, resolve

WIDTH = 110

# text that YAML reads back as itself without quotes, in block and in flow style
_PLAIN = re.compile(r"[A-Za-z_][A-Za-z0-9_./-]*( [A-Za-z0-9_./(*+=-]+)*\)?")
# characters that YAML wants escaped; compiled on first use, because that takes milliseconds
_ESCAPED = "[^\x20-\x7e\xa0-\u2027\u202a-\ud7ff\ue000-\ufefe\uff00-\ufffd\U00010000-\U0010ffff]"


def emit(node: Node) -> str:
    """Return the YAML text of a tree: keys in the order of the file, numbers with all their digits."""
    return "\n".join(block(node)) + "\n"


def block(node: Node) -> list[str]:
    """Return the lines of a node in block style; what is simple and short stays on one line."""
    if isinstance(node, Mapping) and node.entries:
        lines = []
        for key, value in node.entries:
            name = _text(key.text)
            line = _short(value, len(name) + 2)
            if line is not None:
                lines.append(f"{name}: {line}")
            else:
                lines.append(f"{name}:")
                lines.extend("  " + line for line in block(value))
        return lines
    if isinstance(node, Sequence) and node.items:
        lines = []
        for item in node.items:
            line = _short(item, 2)
            inner = [line] if line is not None else block(item)
            lines.append(f"- {inner[0]}")
            lines.extend("  " + line for line in inner[1:])
        return lines
    return [flow(node)]


def _short(node: Node, used: int) -> str | None:
    """Return flow style where it fits beside ``used`` characters and holds at most two levels, else None."""
    if isinstance(node, (Mapping, Sequence)):
        if node.size > WIDTH or _depth(node) > 2:
            return None
        line = flow(node)
        return line if used + len(line) <= WIDTH else None
    return flow(node)


def _depth(node: Node) -> int:
    if isinstance(node, Mapping):
        return 1 + max((_depth(value) for _, value in node.entries), default=0)
    if isinstance(node, Sequence):
        return 1 + max((_depth(item) for item in node.items), default=0)
    return 0


def flow(node: Node) -> str:
    """Return a value as YAML on one line."""
    if isinstance(node, Mapping):
        return "{" + ", ".join(f"{_text(k.text)}: {flow(v)}" for k, v in node.entries) + "}"
    if isinstance(node, Sequence):
        return "[" + ", ".join(flow(item) for item in node.items) + "]"
    assert isinstance(node, Scalar)
    return _scalar(node.value)


def _scalar(value: Value) -> str:
    if value is None:
        return "null"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        if math.isfinite(value):
            return repr(value)
        return ".nan" if math.isnan(value) else (".inf" if value > 0 else "-.inf")
    return _text(value)


def _text(value: str) -> str:
    if _PLAIN.fullmatch(value) and isinstance(resolve(value), str):
        return value
    # JSON strings are YAML strings, except for characters that YAML wants escaped and JSON does not
    quoted = json.dumps(value, ensure_ascii=False)
    if quoted.isascii() and quoted.isprintable():
        return quoted
    return re.sub(_ESCAPED, lambda match: f"\\u{ord(match.group()):04x}", quoted)
