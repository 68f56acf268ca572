"""Tables in files: header and rows as nodes that know their place.

Include other files where the schema allows it: YAML files and CSV tables.
"""

from __future__ import annotations

import contextlib
import dataclasses
import os
from collections.abc import Iterator
from collections.abc import Mapping as MappingOf
from typing import TYPE_CHECKING, Any

from robodyn_cli.errors import ResultFileError, SceneError, shown, unknown_name
from robodyn_cli.registry import Registry
from robodyn_cli.scene.text import nodes
from robodyn_cli.scene.text.yaml_text import compose, read_text
from robodyn_cli.schema import fields as kinds

if TYPE_CHECKING:
    from robodyn_cli.scene.dialects import Description

HDF5 = (".h5", ".hdf5")
# only the results know the HDF5 library, which is loaded where a scene names such a file
_readers: Registry[Any] = Registry("robodyn_cli.results.hdf5", {"table": "reader:read_table"})


def is_hdf5(name: str) -> bool:
    """Tell whether a file is HDF5, by its name."""
    return name.lower().endswith(HDF5)


def hdf5_table(
    path: str, named: nodes.Scalar, source: nodes.Source, key: str
) -> tuple[nodes.Sequence, nodes.Sequence]:
    """Return columns and rows of an HDF5 file; ``named`` : where the scene names it."""
    try:
        columns, rows = _readers["table"](path)
    except ResultFileError as error:
        raise nodes.located(named, key, error.message) from None
    place = nodes.Scalar(source, 1, 1, "", None)
    lines = [nodes.sequence(place, [nodes.scalar(place, x) for x in row]) for row in rows.tolist()]
    return nodes.sequence(place, [nodes.scalar(place, name) for name in columns]), nodes.sequence(
        place, lines
    )


def csv_table(text: str, source: nodes.Source, key: str) -> tuple[nodes.Sequence, nodes.Sequence]:
    """Return header and rows of a CSV text; blank lines and lines that start with ``#`` are skipped."""
    header: list[nodes.Node] = []
    rows: list[nodes.Node] = []
    start = nodes.Scalar(source, 1, 1, "", None)
    for number, line in enumerate(text.splitlines(), start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        cells: list[nodes.Node] = []
        column = 1
        for cell in line.split(","):
            place = nodes.Scalar(source, number, column + len(cell) - len(cell.lstrip()), "", None)
            cells.append(_cell(cell.strip(), place, bool(header), key))
            column += len(cell) + 1
        if header:
            rows.append(nodes.sequence(cells[0], cells))
        else:
            header = cells
    if not header:
        raise nodes.located(
            start, key, "there is no header row; allowed: a row of column names, then rows of numbers"
        )
    return nodes.sequence(header[0], header), nodes.sequence(start, rows)


def _cell(text: str, place: nodes.Scalar, is_number: bool, key: str) -> nodes.Scalar:
    if not is_number:
        return nodes.scalar(place, text)
    try:
        value = nodes.resolve(text)
    except ValueError:
        value = text
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        hint = "; cells are separated by commas, and numbers have a point" if ";" in text else ""
        raise nodes.located(place, key, f"must be a number (value {shown(text)}){hint}")
    return nodes.scalar(place, value)


MAX_CHAIN = 20
BESIDE_ROBOT = ("loops", "couplers", "forces")  # parts of a mechanism that no robot holds


def fits(kind: kinds.Kind, node: nodes.Node) -> bool:
    """Tell whether the shape of a node (scalar, list, map) is that of a kind."""
    if isinstance(kind, kinds.OrFile):
        return fits(kind.item, node) or isinstance(node, nodes.Scalar)
    if isinstance(kind, kinds.Either):
        return any(fits(k, node) for k in kind.kinds)
    if isinstance(kind, (kinds.Section, kinds.Tagged, kinds.MapOf)):
        return isinstance(node, nodes.Mapping)
    if isinstance(kind, (kinds.ListOf, kinds.Vector)):
        return isinstance(node, nodes.Sequence)
    return isinstance(node, nodes.Scalar)


def concrete(kind: kinds.Kind, node: nodes.Node) -> kinds.Kind | None:
    """Return the section, list, map or scalar kind that a node is to be read as, or None if none fits."""
    if isinstance(kind, kinds.OrFile):
        return concrete(kind.item, node)
    if isinstance(kind, kinds.Either):
        fitting = next((k for k in kind.kinds if fits(k, node)), None)
        return concrete(fitting, node) if fitting is not None else None
    if isinstance(kind, kinds.ByPart):
        by_part = isinstance(node, nodes.Mapping) and any(key.text in kind.parts for key, _ in node.entries)
        return kinds.MapOf(kind.item, of="coordinate") if by_part else kind.item
    if isinstance(kind, kinds.Tagged) and isinstance(node, nodes.Mapping):
        tag = node.get(kind.tag)
        cls = kind.registry().get(tag.text) if isinstance(tag, nodes.Scalar) else None
        return kinds.Section(cls) if cls is not None else None
    return kind


def child_kind(kind: kinds.Kind | None, step: str) -> kinds.Kind | None:
    """Return what a section, list or map expects under one step of a path, or None if it does not know it."""
    if isinstance(kind, kinds.Section):
        for field in dataclasses.fields(kind.cls):
            if kinds.key_name(field) == step and not isinstance(field.metadata.get("kind"), kinds.Inline):
                return field.metadata.get("kind")
            if (
                isinstance(field.metadata.get("kind"), kinds.Inline)
                and step in field.metadata["kind"].registry()
            ):
                return field.metadata["kind"].at(step)
    if isinstance(kind, (kinds.MapOf, kinds.ListOf)):
        return kind.item
    return None


def robot_of(tree: nodes.Node, path: nodes.Path) -> nodes.Node:
    """Return the robot of a whole scene, and any other tree as it is.

    Raises
    ------
    SceneError : the scene has parts of its mechanism beside its robot, which would be lost.
    """
    robot = tree.get("robot") if isinstance(tree, nodes.Mapping) else None
    if not isinstance(tree, nodes.Mapping) or robot is None:
        return tree
    for name in BESIDE_ROBOT:
        if tree.get(name) is not None:
            raise nodes.located(
                tree.key(name) or tree,
                nodes.dotted(path),
                f"this scene has {name!r} beside its robot; allowed: the file of a robot, or a scene without "
                f"{', '.join(BESIDE_ROBOT)}",
            )
    return robot


def with_changes(items: nodes.Sequence, changes: nodes.Mapping, path: nodes.Path) -> nodes.Sequence:
    """Return a list in which items have other values of some keys, by the items' names. Raises
    ------
    SceneError : no item has such a name, or its changes are no map.
    """
    new = list(items.items)
    names = [nodes.name_of(item) or "" for item in new]
    for name, keys in changes.entries:
        if name.text not in names:
            kind = str(path[-1]).removesuffix("s")
            raise nodes.located(name, nodes.dotted(path), unknown_name(kind, name.text, names))
        k = names.index(name.text)
        item = new[k]
        if not isinstance(keys, nodes.Mapping) or not isinstance(item, nodes.Mapping):
            raise nodes.located(
                keys, nodes.dotted((*path, name.text)), "must be a map of the keys that change"
            )
        for key, value in keys.entries:
            item = item.replaced(key, value)
        new[k] = item
    return nodes.sequence(changes, new)


class Includer:
    """Includes files and remembers which; a value whose file cannot be included stays as it is.

    packages : folders of the meshes of robots in other formats, by name. undrawn : meshes that could not be read, and
    why. unnamed : keys of motions that are tables whose columns have no names, as arrays of Python.
    """

    def __init__(self, faults: nodes.Faults) -> None:
        self.faults = faults
        self.sources: list[str] = []
        self.descriptions: list[Description] = []
        self.packages: MappingOf[str, str] = {}
        self.undrawn: list[str] = []
        self.unnamed: list[str] = []

    def open_root(self, path: str) -> nodes.Node:
        """Return the tree of the scene file itself."""
        text = read_text(path, None, "", path)
        self.sources.append(path)
        source = nodes.Source(path, os.path.dirname(path) or ".", os.path.realpath(path))
        return compose(text, source, self.faults)

    def whole(self, kind: kinds.Kind, node: nodes.Node, path: nodes.Path = ()) -> nodes.Node:
        """Return the tree with every file included that ``kind`` allows."""
        if isinstance(kind, kinds.OrFile):
            node = self.here(kind, node, path)
        inner = concrete(kind, node)
        if isinstance(node, nodes.Sequence) and isinstance(inner, kinds.ListOf):
            if isinstance(
                inner.item,
                (kinds.Section, kinds.Tagged, kinds.ListOf, kinds.MapOf, kinds.Either, kinds.OrFile),
            ):
                return nodes.sequence(
                    node, [self.whole(inner.item, x, (*path, k)) for k, x in enumerate(node.items)]
                )
            return node
        if not isinstance(node, nodes.Mapping) or not isinstance(inner, (kinds.Section, kinds.MapOf)):
            return node
        entries = []
        for key, value in node.entries:
            below = child_kind(inner, key.text)
            entries.append((key, value if below is None else self.whole(below, value, (*path, key.text))))
        result = nodes.mapping(node, entries)
        if isinstance(inner, kinds.Section):
            for field in dataclasses.fields(inner.cls):
                if isinstance(field.metadata.get("kind"), kinds.CsvFile):
                    with self.collecting((*path, field.name)):
                        result = self.csv(field.metadata["kind"], field.name, result, path)
                elif isinstance(field.metadata.get("kind"), kinds.MeshFile):
                    result = self.mesh(field.metadata["kind"], field.name, result)
        return result

    def here(self, kind: kinds.Kind, node: nodes.Node, path: nodes.Path) -> nodes.Node:
        """Return the node, or the content of the file that it names; the node itself if the file has an error."""
        with self.collecting(path):
            return self.found(kind, node, path)
        return node

    @contextlib.contextmanager
    def collecting(self, path: nodes.Path) -> Iterator[None]:
        """Report an error of the block; that the value at ``path`` is missing follows from it."""
        try:
            yield
        except SceneError as error:
            self.faults.report(error)
            self.faults.lost.append(nodes.dotted(path))

    def found(self, kind: kinds.Kind, node: nodes.Node, path: nodes.Path) -> nodes.Node:
        """Return the node, or the content of the file that it names. Raises
        ------
        SceneError : the file cannot be read, is no YAML, includes itself or does not fit.
        """
        if not isinstance(kind, kinds.OrFile):
            return node
        if isinstance(node, nodes.Scalar) and isinstance(node.value, str):
            return self.found(kind, self.include(kind, node, path), path)
        if isinstance(node, nodes.Mapping) and node.get(kinds.INCLUDE) is not None:
            name = node.get(kinds.INCLUDE)
            if not isinstance(name, nodes.Scalar) or not isinstance(name.value, str):
                raise nodes.located(
                    name or node, nodes.dotted((*path, kinds.INCLUDE)), "must be the path of a YAML file"
                )
            base = self.found(kind, self.include(kind, name, path), path)
            if not isinstance(base, nodes.Mapping):
                raise nodes.located(base, nodes.dotted(path), "an included file must contain a map")
            node = self.with_own_keys(kind, base, node, path)
        if kind.robot and isinstance(node, nodes.Mapping) and node.get(kinds.ATTACH) is not None:
            from robodyn_cli.scene.text.attach import with_attachments

            node = with_attachments(node, path, lambda part, where: self.found(kind, part, where))
        return node

    @staticmethod
    def with_own_keys(
        kind: kinds.OrFile, base: nodes.Mapping, node: nodes.Mapping, path: nodes.Path
    ) -> nodes.Mapping:
        """Return an included map with the keys beside ``include``; points and frames of a robot are added, and a map of
        joints or links by name changes these."""
        own = [(key, value) for key, value in node.entries if key.text != kinds.INCLUDE]
        if kind.robot and node.get(kinds.PREFIX) is not None:
            from robodyn_cli.scene.text.attach import prefix_of, with_prefix

            base = with_prefix(base, prefix_of(node, path))
            own = [(key, value) for key, value in own if key.text != kinds.PREFIX]
        for key, value in own:
            theirs = base.get(key.text) if kind.robot and key.text in ("points", "frames") else None
            if isinstance(theirs, nodes.Mapping) and isinstance(value, nodes.Mapping):
                for name, place in value.entries:  # loops of the file may join its points
                    theirs = theirs.replaced(name, place)
                value = theirs
            items = base.get(key.text) if kind.robot and key.text in ("joints", "links") else None
            if isinstance(items, nodes.Sequence) and isinstance(value, nodes.Mapping):
                value = with_changes(items, value, (*path, key.text))
            base = base.replaced(key, value)
        return base

    def include(self, kind: kinds.OrFile, node: nodes.Scalar, path: nodes.Path) -> nodes.Node:
        """Return the tree of the file that a scalar names: YAML, or another format where ``kind`` allows one."""
        name, real = self.locate(node)
        chain = [source.name for source in node.source.chain()][::-1]
        if any(source.real == real for source in node.source.chain()):
            raise nodes.located(
                node, nodes.dotted(path), f"includes form a cycle: {' -> '.join([*chain, name])}"
            )
        if len(chain) > MAX_CHAIN:
            raise nodes.located(node, nodes.dotted(path), f"includes are nested more than {MAX_CHAIN} deep")
        text = read_text(self.opened(node), node, nodes.dotted(path), name)
        self.sources.append(name)
        source = nodes.Source(name, os.path.dirname(name) or ".", real, node.source)
        if is_xml(text):
            if not kind.robot:
                raise nodes.located(
                    node, nodes.dotted(path), f"{name!r} is XML; allowed: the path of a YAML file"
                )
            return self.described(text, source)
        if kind.catalogue and name.lower().endswith(".csv"):
            from robodyn_cli.scene.text.catalogue import catalogue_tree

            return catalogue_tree(text, source)
        tree = compose(text, source, self.faults, path)
        return robot_of(tree, path) if kind.robot else tree

    def described(self, text: str, source: nodes.Source) -> nodes.Node:
        """Return the tree of a robot in another format."""
        from robodyn_cli.scene.dialects import read_description

        self.descriptions.append(read_description(text, source, self.faults, self.packages))
        self.sources += self.descriptions[-1].files
        return self.descriptions[-1].tree.root

    def locate(self, node: nodes.Scalar) -> tuple[str, str]:
        """Return the path to show and the resolved path of the file that a scalar names."""
        opened = self.opened(node)
        try:
            return os.path.normpath(opened), os.path.realpath(opened)
        except ValueError:  # a zero byte in the name
            return opened, opened

    @staticmethod
    def opened(node: nodes.Scalar) -> str:
        return os.path.join(node.source.directory, node.text)

    def csv(self, kind: kinds.CsvFile, key: str, section: nodes.Mapping, path: nodes.Path) -> nodes.Mapping:
        """Return a section with the table, CSV or HDF5, that it names replaced by the file's columns and rows."""
        node = section.get(key)
        if node is None or (isinstance(node, nodes.Scalar) and node.value is None):
            return section

        here = nodes.dotted((*path, key))
        if not isinstance(node, nodes.Scalar) or not isinstance(node.value, str):
            raise nodes.located(node, here, "must be the path of a CSV or HDF5 file")
        for other in (kind.columns, kind.rows):
            if section.get(other) is not None:
                raise nodes.located(
                    section.key(key) or node, here, f"give either {key!r} or {other!r}, not both"
                )
        name, real = self.locate(node)
        self.sources.append(name)
        source = nodes.Source(name, os.path.dirname(name) or ".", real, node.source)
        if is_hdf5(name):
            columns, rows = hdf5_table(self.opened(node), node, source, here)
        else:
            text = read_text(self.opened(node), node, here, name)
            columns, rows = csv_table(text, source, nodes.dotted((*path, kind.rows)))
        entries = [(k, v) for k, v in section.entries if k.text != key]
        entries += [(nodes.scalar(columns, kind.columns), columns), (nodes.scalar(rows, kind.rows), rows)]
        return nodes.mapping(section, entries)

    def mesh(self, kind: kinds.MeshFile, key: str, section: nodes.Mapping) -> nodes.Mapping:
        """Return a shape with the mesh that it names replaced by what pictures need of it.

        Nothing but pictures depends on a mesh, so one that cannot be read is remembered, and leaves an empty shape.
        """
        node = section.get(key)
        if (
            not isinstance(node, nodes.Scalar)
            or not isinstance(node.value, str)
            or section.get(kind.text) is not None
        ):
            return section
        from robodyn_cli.scene.mesh.files import MeshError, small_mesh

        name, _ = self.locate(node)
        text = ""
        try:
            text = small_mesh(self.opened(node))
            self.sources.append(name)
        except MeshError as error:
            self.undrawn.append(f"{name}: {error}")
        entries = [
            (nodes.scalar(k, kind.text), nodes.scalar(node, text)) if k.text == key else (k, v)
            for k, v in section.entries
        ]
        return nodes.mapping(section, entries)


def is_xml(text: str) -> bool:
    """Tell XML from YAML, in which a merge key may come first."""
    start = text.lstrip()
    return start.startswith("<") and not start.startswith("<<")
