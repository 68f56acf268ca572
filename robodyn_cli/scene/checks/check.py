"""Errors at a path of the tree, for checks that look at a scene after it was read."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from collections.abc import Sequence as SequenceOf
from typing import NoReturn

from robodyn_cli.errors import unknown_name
from robodyn_cli.scene.text.faults import Faults
from robodyn_cli.scene.text.nodes import Mapping, Node, Path, Scalar, Sequence, dotted, find, located, nearest


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

    def known(self, name: str, options: Collection[str], what: str, path: Path, at_key: bool = False) -> None:
        """Refuse a name that is not among ``options``."""
        if name not in options:
            self.fail(path, unknown_name(what, name, options), at_key)

    def unique(self, names: SequenceOf[str], what: str, paths: SequenceOf[Path]) -> None:
        """Refuse a name that appears twice."""
        seen: set[str] = set()
        for k, name in enumerate(names):
            with self:
                if name in seen:
                    self.fail(paths[k], f"{what} {name!r} appears twice; names of {what}s must differ")
                seen.add(name)


def key_place(root: Node, section: str, key: str) -> Path:
    """Return where ``expect`` or ``study.of`` names a key of the summary; in maps dots stand for maps in maps."""
    if section == "expect":
        return ("expect", *next(_ways(find(root, ("expect",)), key.split(".")), ()))
    listed = find(root, ("study", "of"))
    names = (
        [item.text for item in listed.items if isinstance(item, Scalar)]
        if isinstance(listed, Sequence)
        else []
    )
    return ("study", "of", names.index(key))


def _ways(node: Node | None, steps: SequenceOf[str]) -> Iterator[Path]:
    """Yield the paths in maps that are a key with dots."""
    if not steps:
        yield ()
    elif isinstance(node, Mapping):
        for k in range(len(steps), 0, -1):
            name = ".".join(steps[:k])
            if (below := node.get(name)) is not None:
                yield from ((name, *rest) for rest in _ways(below, steps[k:]))
