"""Errors at a path of the tree, for checks that look at a scene after it was read."""

from __future__ import annotations

from collections.abc import Iterable
from collections.abc import Sequence as SequenceOf
from typing import NoReturn

from robodyn_cli.errors import unknown_name
from robodyn_cli.scene.text.faults import Faults
from robodyn_cli.scene.text.nodes import Mapping, Node, Path, Scalar, dotted, find, located, nearest


class Check(Faults):
    """Places errors in the tree.

    Independent checks have ``with check:`` blocks of their own; such a block ends at its first error, and the next one
    runs.
    """

    def __init__(self, root: Node) -> None:
        super().__init__()
        self.root = root

    def has(self, path: Path) -> bool:
        """Tell whether a key is given, and not as null."""
        node = find(self.root, path)
        return node is not None and not (isinstance(node, Scalar) and node.value is None)

    def fail(self, path: Path, message: str, at_key: bool = False) -> NoReturn:
        """Raise the error of the node at ``path``, or of the nearest one above it.

        With ``at_key`` the place is that of the key itself, for keys that must not be there.
        """
        above = find(self.root, path[:-1]) if at_key and path else None
        key = above.key(str(path[-1])) if isinstance(above, Mapping) else None
        node = key or nearest(self.root, path)
        raise located(node, dotted(path), message)

    def known(self, name: str, options: Iterable[str], what: str, path: Path, at_key: bool = False) -> None:
        """Refuse a name that is not among ``options``."""
        names = list(options)
        if name not in names:
            self.fail(path, unknown_name(what, name, names), at_key)

    def unique(self, names: SequenceOf[str], what: str, paths: SequenceOf[Path]) -> None:
        """Refuse a name that appears twice."""
        seen: set[str] = set()
        for k, name in enumerate(names):
            with self:
                if name in seen:
                    self.fail(paths[k], f"{what} {name!r} appears twice; names of {what}s must differ")
                seen.add(name)
