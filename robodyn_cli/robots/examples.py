"""The example scenes of ``robodyn new --example``: the repository's ``configs``, which each built package holds."""

from __future__ import annotations

from pathlib import Path

from robodyn_cli.errors import CapabilityError, OutputError, unknown_name

_PACKAGE = Path(__file__).parents[1]
# a built package has them inside; a checkout, installed to be edited or not at all, beside itself
FOLDERS = (_PACKAGE / "examples", _PACKAGE.parent / "configs")
LICENCES = "LICENSES.md"


def examples_folder() -> Path:
    """Return the folder of the example scenes.

    Raises
    ------
    OutputError : this installation has none.
    """
    for folder in FOLDERS:
        if folder.is_dir():
            return folder
    raise OutputError(f"this installation has no example scenes: there is no {FOLDERS[0]}")


def example_names(folder: Path) -> tuple[str, ...]:
    """Return the scenes of a folder by name, ``mechanisms/crane``; parts that scenes include are none."""
    paths = (path.relative_to(folder) for path in sorted(folder.rglob("*.yaml")))
    return tuple(path.with_suffix("").as_posix() for path in paths if path.parts[0] != "robots")


def find_example(name: str, folder: Path) -> Path:
    """Return the file of a scene, which its whole name or the last part of it tells.

    Raises
    ------
    CapabilityError : there is no scene of that name, or there are several.
    """
    names = example_names(folder)
    wanted = name.removesuffix(".yaml")
    found = [one for one in names if one == wanted] or [one for one in names if one.split("/")[-1] == wanted]
    if len(found) > 1:
        raise CapabilityError(f"example {name!r} may be {' or '.join(found)}; give the whole name")
    if not found:
        raise CapabilityError(unknown_name("example", name, names))
    return folder / f"{found[0]}.yaml"


def texts_of(scene: Path, sources: tuple[str, ...], folder: Path) -> dict[str, str]:
    """Return what belongs to a scene by its place below the folder: itself, files that it reads there, licences.

    Parameters
    ----------
    scene : its file. sources : the files that it was read from; those elsewhere are parts of the program.
    """
    root = folder.resolve()
    read = dict.fromkeys(path.resolve() for path in (scene, *map(Path, sources)))
    inside = [path for path in read if path.is_relative_to(root)]
    licences = dict.fromkeys(path.parent / LICENCES for path in inside)
    files = (*inside, *(path for path in licences if path.is_file()))
    return {path.relative_to(root).as_posix(): path.read_text(encoding="utf-8") for path in files}
