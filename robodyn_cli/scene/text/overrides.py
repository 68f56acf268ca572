"""``--set key.path=value``: replace or remove values in the tree before it is read; ``+=`` appends to a list.

``KEY#n=value`` replaces the n-th number that is written at or below a key (see ``numbers``).
"""

from __future__ import annotations

from typing import Any

from robodyn_cli.errors import SceneError, did_you_mean, shown
from robodyn_cli.scene.text import nodes
from robodyn_cli.scene.text.includes import Includer, child_kind, concrete
from robodyn_cli.scene.text.numbers import below, counted, number_at, why_none, with_leaf
from robodyn_cli.scene.text.yaml_text import compose
from robodyn_cli.schema.fields import Kind, ListOf, Section


class AskedSetting(str):
    """A text ``key.path=value`` of an option other than ``--set``: errors about it name ``asked``.

    names_key, above : as of ``Source``.
    """

    asked: str
    names_key: bool
    above: str

    def __new__(cls, text: str, asked: str, names_key: bool = True, above: str = "") -> AskedSetting:
        setting = super().__new__(cls, text)
        setting.asked, setting.names_key, setting.above = asked, names_key, above
        return setting

    def __reduce__(self) -> tuple[Any, ...]:
        return AskedSetting, (str(self), self.asked, self.names_key, self.above)


HELP = (
    "allowed: key.path=value, list items by index or by name, as in robot.joints.theta1.a=0.5, key.path#n=value for "
    "the n-th number that is written there, or list+=item"
)


def apply(root: nodes.Node, kind: Kind, override: str, directory: str, includer: Includer) -> nodes.Node:
    """Return the tree with one value set, removed where the value is null, or appended to a list.

    Parameters
    ----------
    root, kind : the tree and what it is.
    override : ``key.path=value``, ``key.path#n=value``, or ``key.path+=value`` for lists; the value is YAML 1.2.
    directory : where relative paths in the value start.
    includer : loads the files that the path leads through.
    """
    source = nodes.Source(_label(override), directory, positions=False)
    if isinstance(override, AskedSetting):
        source = nodes.Source(
            override.asked, directory, positions=False, names_key=override.names_key, above=override.above
        )
    place = nodes.Scalar(source, 1, 1, "", None)
    key, sign, text = override.partition("=")
    appends, key = key.endswith("+"), key.removesuffix("+")
    key, n = counted(key.strip())
    steps = key.split(".")
    if not sign:
        raise nodes.located(place, "", f"has no '='; {HELP}")
    if not all(step.strip() == step and step for step in steps):
        raise nodes.located(place, "", f"{shown(key)} is not a path of keys; {HELP}")
    if not text.strip():
        raise nodes.located(place, key, "has no value; write null to remove a key, '\"\"' for an empty text")
    value = compose(text.strip(), source, includer.faults, tuple(steps), empty=True)
    if n and (appends or not _is_number(value)):
        raise nodes.located(
            place,
            f"{key}#{n}",
            f"is a number of the scene (value {nodes.describe_node(value)}); allowed: a number",
        )
    return _Setter(place, value, includer, appends, n).set(root, kind, steps, ())


def _label(override: str) -> str:
    quoted = " ".join(override.split()) or "''"
    return "--set " + (quoted if len(quoted) <= 100 else quoted[:97] + "...")


def _is_number(value: nodes.Node) -> bool:
    """Tell whether a value may stand in the place of a number: it is one, or a text such as ``pi/2``."""
    return isinstance(value, nodes.Scalar) and not isinstance(value.value, (bool, type(None)))


class _Setter:
    """Puts a value into a tree; ``n`` : it replaces the n-th number there, 0: all that is there."""

    def __init__(
        self, place: nodes.Scalar, value: nodes.Node, includer: Includer, appends: bool, n: int
    ) -> None:
        self.place = place
        self.n = n
        self.value = value
        self.includer = includer
        self.appends = appends
        self.removes = isinstance(value, nodes.Scalar) and value.value is None and not appends

    def set(self, node: nodes.Node, kind: Kind | None, steps: list[str], done: nodes.Path) -> nodes.Node:
        """Return ``node`` with the value at ``steps`` below it replaced."""
        if not steps:
            if self.n:
                return self.counted(node, kind, done)
            return self.appended(node, kind, done) if self.appends else self.value
        if kind is not None:
            node = self.includer.here(kind, node, done)
            kind = concrete(kind, node)
        step, rest = steps[0], steps[1:]
        if isinstance(node, nodes.Sequence):
            index = self.index(node, step, done)
            items = list(node.items)
            if self.removes and not rest:
                return nodes.sequence(node, items[:index] + items[index + 1 :])
            items[index] = self.set(items[index], below(kind, step), rest, (*done, index))
            return nodes.sequence(node, items)
        if isinstance(node, nodes.Mapping):
            key = node.key(step) or nodes.Scalar(self.place.source, 1, 1, step, step)
            inner = child_kind(kind, step)
            old = node.get(step)
            if old is None and self.n:
                raise self.missing(node, kind, step, done)
            # the reader refuses a key that the schema does not know
            known = old is not None or inner is not None or not isinstance(kind, Section)
            if self.removes and not rest and known:
                return self.without(node, kind, step, done)
            if old is None or (isinstance(old, nodes.Scalar) and old.value is None and rest):
                if rest and isinstance(inner, ListOf):
                    raise self.error((*done, step), "is empty, so it has no items; set the whole list")
                # the reader refuses unknown keys and names this option
                old = nodes.mapping(self.place, [])
            new = self.set(old, inner, rest, (*done, step))
            # an absent key needs no removal
            return node if new is old else node.replaced(key, new)
        fault = f"is {nodes.describe_node(node)}" if done else f"the scene is {nodes.describe_node(node)}"
        raise self.error(done, f"{fault}, so it has no key {shown(step)}")

    def missing(self, node: nodes.Mapping, kind: Kind | None, step: str, done: nodes.Path) -> SceneError:
        """Return the error of a key whose numbers are counted, and which the scene does not write."""
        if isinstance(kind, Section) and child_kind(kind, step) is not None:
            return self.error((*done, step), f"is not written in the scene, so there is no #{self.n}")
        names = [key.text for key, _ in node.entries]
        return self.error(
            done, f"has no key {shown(step)}{did_you_mean(step, names)}; allowed: {', '.join(names)}"
        )

    def counted(self, node: nodes.Node, kind: Kind | None, done: nodes.Path) -> nodes.Node:
        """Return a value with its n-th number replaced."""
        if kind is not None:
            node = self.includer.whole(kind, node, done)
        written = number_at(node, kind, self.n)
        if written is None:
            raise self.error(done, why_none(node, kind, self.n))
        assert isinstance(self.value, nodes.Scalar)
        if unit := written.doubled(self.value.text):
            raise self.error(
                done,
                f"#{self.n} is the number in {written.text!r}, with its unit behind it (value {self.value.text!r}); "
                f"allowed: a number, in {unit}, or the key without #{self.n} and a value with a unit",
            )
        if not written.inside:
            return with_leaf(node, written.path, self.value)
        text = written.replaced(self.value.text)
        return with_leaf(node, written.path, nodes.Scalar(self.place.source, 1, 1, text, text))

    def appended(self, node: nodes.Node, kind: Kind | None, done: nodes.Path) -> nodes.Node:
        """Return a list with the value behind its items; a list that is not there has none."""
        if kind is not None:
            node = self.includer.here(kind, node, done)
        empty = (isinstance(node, nodes.Scalar) and node.value is None) or (
            isinstance(node, nodes.Mapping) and not node.entries
        )
        if isinstance(node, nodes.Sequence) or (empty and isinstance(kind, ListOf)):
            items = node.items if isinstance(node, nodes.Sequence) else ()
            return nodes.sequence(self.place, [*items, self.value])
        raise self.error(done, f"is {nodes.describe_node(node)}, so nothing can be appended; allowed: a list")

    def without(self, node: nodes.Mapping, kind: Kind | None, step: str, done: nodes.Path) -> nodes.Node:
        """Return a map without a key; a known key that is absent needs no removal."""
        if node.get(step) is not None:
            return node.without(step)
        if not isinstance(kind, Section):
            names = [key.text for key, _ in node.entries]
            allowed = f"allowed: {', '.join(names)}" if names else "it is empty"
            raise self.error(
                done, f"has no key {shown(step)} to remove{did_you_mean(step, names)}; {allowed}"
            )
        return node

    def index(self, node: nodes.Sequence, step: str, done: nodes.Path) -> int:
        """Return the index of a list item, given by index or by its ``name``."""
        index = nodes.index_of(node, step)
        if index is not None:
            return index
        if step.isdecimal():
            last = f"allowed: 0 to {len(node.items) - 1}" if node.items else "the list is empty"
            raise self.error(done, f"has no item {step}; {last}")
        names = [name for item in node.items if (name := nodes.name_of(item))]
        allowed = f"; allowed: {', '.join(names)} or an index" if names else "; allowed: an index"
        raise self.error(done, f"has no item named {shown(step)}{did_you_mean(step, names)}{allowed}")

    def error(self, path: nodes.Path, message: str) -> SceneError:
        return nodes.located(self.place, nodes.dotted(path), message)
