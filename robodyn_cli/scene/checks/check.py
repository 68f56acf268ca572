"""Errors at a path of the tree, for checks that look at a scene after it was read."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from collections.abc import Sequence as SequenceOf
from typing import NoReturn

from robodyn_cli.errors import plural_of, unknown_name
from robodyn_cli.expr.formula import FormulaTree
from robodyn_cli.scene.text import nodes

HELD = ("control.energy.", "control.saturated")  # begin keys of what follows from torques at all times
RESPONSE = "response."  # begins keys that ask for the response of what a controller leads
EXTREMES = "extremes."  # begins keys of summaries that ask for a column over time
LOCKS = "locks."  # those that tell what latches did


class Check(nodes.Faults):
    """Places errors in the tree.

    Independent checks have ``with check:`` blocks of their own; such a block ends at its first error, and the next one
    runs.
    """

    def __init__(self, root: nodes.Node) -> None:
        super().__init__()
        self.root = root

    def has(self, path: nodes.Path) -> bool:
        """Tell whether a key is given, and not as null."""
        node = nodes.find(self.root, path)
        return node is not None and not (isinstance(node, nodes.Scalar) and node.value is None)

    def fail(self, path: nodes.Path, message: str, at_key: bool = False) -> NoReturn:
        """Raise the error of the node at ``path``, or of the nearest one above it.

        With ``at_key`` the place is that of the key itself, for keys that must not be there.
        """
        above = nodes.find(self.root, path[:-1]) if at_key and path else None
        key = above.key(str(path[-1])) if isinstance(above, nodes.Mapping) else None
        node = key or nodes.nearest(self.root, path)
        raise nodes.located(node, nodes.dotted(path), message)

    def known(
        self, name: str, options: Collection[str], kind: str, path: nodes.Path, at_key: bool = False
    ) -> None:
        """Refuse a name that is not among ``options``."""
        if name not in options:
            self.fail(path, unknown_name(kind, name, options), at_key)

    def varies(self, formula: FormulaTree | None, parameters: Collection[str], path: nodes.Path) -> None:
        """Refuse the formula of an event that never passes zero, as it is a number or made of parameters alone."""
        if formula is not None and {name.removeprefix("p.") for name in formula.names} <= set(parameters):
            self.fail(
                path,
                f"never passes zero: it names neither t nor what moves (value {formula.text!r}); allowed: a formula in "
                "t, positions, rates or points",
            )

    def unique(self, names: SequenceOf[str], kind: str, paths: SequenceOf[nodes.Path]) -> None:
        """Refuse a name that appears twice."""
        seen: set[str] = set()
        for k, name in enumerate(names):
            with self:
                if name in seen:
                    self.fail(
                        paths[k], f"{kind} {name!r} appears twice; names of {plural_of(kind)} must differ"
                    )
                seen.add(name)


def key_place(root: nodes.Node, section: nodes.Path, key: str) -> nodes.Path:
    """Return where a section, such as ``expect``, names a key of the summary; in maps dots stand for maps in maps."""
    named = nodes.find(root, section)
    if isinstance(named, nodes.Sequence):
        texts = [item.text if isinstance(item, nodes.Scalar) else "" for item in named.items]
        return (*section, texts.index(key))
    return (*section, *next(_ways(named, key.split(".")), ()))


def _ways(node: nodes.Node | None, steps: SequenceOf[str]) -> Iterator[nodes.Path]:
    """Yield the paths in maps that are a key with dots."""
    if not steps:
        yield ()
    elif isinstance(node, nodes.Mapping):
        for k in range(len(steps), 0, -1):
            name = ".".join(steps[:k])
            if (below := node.get(name)) is not None:
                yield from ((name, *rest) for rest in _ways(below, steps[k:]))
