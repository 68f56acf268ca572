"""Errors at a path of the tree, for checks that look at a scene after it was read."""

from __future__ import annotations

from collections.abc import Iterable
from collections.abc import Sequence as SequenceOf
from typing import NoReturn

from robodyn_cli.errors import did_you_mean
from robodyn_cli.scene.nodes import Mapping, Node, Path, Scalar, Sequence, dotted, located


class Check:
    """Finds the node of a path, to say where something is wrong."""

    def __init__(self, root: Node) -> None:
        self.root = root

    def find(self, path: Path) -> Node | None:
        """Return the node at ``path``, if there is one."""
        node: Node | None = self.root
        for step in path:
            if isinstance(node, Mapping):
                node = node.get(str(step))
            elif isinstance(node, Sequence) and isinstance(step, int) and step < len(node.items):
                node = node.items[step]
            else:
                return None
        return node

    def has(self, path: Path) -> bool:
        """Tell whether a key is given, and not as null."""
        node = self.find(path)
        return node is not None and not (isinstance(node, Scalar) and node.value is None)

    def fail(self, path: Path, message: str, at_key: bool = False) -> NoReturn:
        """Raise the error of the node at ``path``, or of the nearest one above it.

        With ``at_key`` the place is that of the key itself, for keys that must not be there.
        """
        node: Node | None = None
        if at_key and path:
            above = self.find(path[:-1])
            node = above.key(str(path[-1])) if isinstance(above, Mapping) else None
        reach = path
        node = node or self.find(reach)
        while node is None:
            reach = reach[:-1]
            node = self.find(reach)
        raise located(node, dotted(path), message)

    def known(self, name: str, options: Iterable[str], what: str, path: Path, at_key: bool = False) -> None:
        """Refuse a name that is not among ``options``."""
        names = list(options)
        if name not in names:
            hint = did_you_mean(name, names)
            allowed = ", ".join(names) if names else "none is defined"
            self.fail(path, f"unknown {what} {name!r}{hint}; allowed: {allowed}", at_key)

    def unique(self, names: SequenceOf[str], what: str, paths: SequenceOf[Path]) -> None:
        """Refuse a name that stands twice."""
        for k, name in enumerate(names):
            if name in names[:k]:
                self.fail(paths[k], f"{what} {name!r} stands twice; names of {what}s must differ")
