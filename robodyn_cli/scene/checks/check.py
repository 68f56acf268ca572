"""Errors at a path of the tree, for checks that look at a scene after it was read."""

from __future__ import annotations

from collections.abc import Iterable
from collections.abc import Sequence as SequenceOf
from types import TracebackType
from typing import NoReturn

from robodyn_cli.errors import SceneError, did_you_mean
from robodyn_cli.scene.text.nodes import Mapping, Node, Path, Scalar, Sequence, dotted, located


class Check:
    """Finds the node of a path, to say where something is wrong.

    Checks that do not build on each other stand in ``with check:`` blocks: where errors are ``collected``, such a
    block ends at its first error and what follows it goes on.
    """

    def __init__(self, root: Node, collected: list[SceneError] | None = None) -> None:
        self.root = root
        self.collected = collected

    def __enter__(self) -> None:
        pass

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> bool:
        if self.collected is None or not isinstance(error, SceneError):
            return False
        self.collected.append(error)
        return True

    @property
    def failures(self) -> int:
        """Number of errors collected."""
        return len(self.collected or ())

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
            with self:
                if name in names[:k]:
                    self.fail(paths[k], f"{what} {name!r} stands twice; names of {what}s must differ")
