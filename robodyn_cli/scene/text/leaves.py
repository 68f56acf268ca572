"""The values of a scene's text by their keys, to tell two scenes apart."""

from __future__ import annotations

from collections.abc import Iterator

from robodyn_cli.errors import RobodynError
from robodyn_cli.scene.text import nodes
from robodyn_cli.scene.text.yaml_text import compose

SHORT = 4  # scalars of a list that stand as one value


def leaves_of_text(text: str) -> dict[str, str]:
    """Return the scalars of a scene by key, as written: items of lists by their names, or by number from 0.

    A short list of scalars is one value. What cannot be read has none.
    """
    try:
        root = compose(text, nodes.Source("<text>", "."), nodes.Faults())
    except RobodynError:
        return {}
    return dict(_leaves(root, ""))


def _leaves(node: nodes.Node, key: str) -> Iterator[tuple[str, str]]:
    if isinstance(node, nodes.Scalar):
        yield key, node.text
    elif isinstance(node, nodes.Mapping):
        for name, value in node.entries:
            yield from _leaves(value, f"{key}.{name.text}" if key else name.text)
    elif isinstance(node, nodes.Sequence):
        plain = [item.text for item in node.items if isinstance(item, nodes.Scalar)]
        if len(plain) == len(node.items) <= SHORT:
            yield key, f"[{', '.join(plain)}]"
        else:
            for k, item in enumerate(node.items):
                yield from _leaves(item, f"{key}.{_name_of(item) or k}")


def _name_of(item: nodes.Node) -> str:
    name = item.get("name") if isinstance(item, nodes.Mapping) else None
    return name.text if isinstance(name, nodes.Scalar) else ""
