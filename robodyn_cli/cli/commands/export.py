"""``robodyn export``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from robodyn_cli.cli.interrupts import tidy_up_first
from robodyn_cli.cli.offers import bare_keys, one_of
from robodyn_cli.cli.options import Overrides, Told, file, utf8

if TYPE_CHECKING:
    from robodyn_cli.over.c99.folder import CFolder
    from robodyn_cli.over.c99.objects import LibraryObject
    from robodyn_cli.scene.load import Family

OF_RESULTS = ("csv", "parquet", "mat", "npz", "json", "mcap")
OF_SCENES = ("urdf+", "extended-urdf", "mjcf", "sdf")
PROCESSORS = ("cortex-m7",)
SCENES = (".yaml", ".yml", ".urdf", ".sdf", ".xml", ".mjcf")


EXAMPLES = (
    "export outputs/double_pendulum/simulate --to csv --out tables",
    "export configs/four_bar_deploy.yaml --to mjcf --out four_bar",
    "export configs/2r_circle.yaml --c arm_in_c",
    "export configs/four_bar_deploy.yaml --fmu four_bar.fmu --key robot.links.crank.mass=5:60",
)


def command(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="RESULT|SCENE.yaml",
            help="Output directory of a run, or its result.h5; or a scene, or the URDF, SDF or MJCF of a robot.",
            callback=file,
            show_default=False,
        ),
    ],
    to: Annotated[
        str | None,
        one_of(
            "--to",
            *OF_RESULTS,
            *OF_SCENES,
            metavar="KIND",
            help="Of a result: csv, parquet, mat (MATLAB), npz, json, mcap (ROS 2). Of a scene: urdf+, "
            "extended-urdf, mjcf, sdf.",
            show_default=False,
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="DIR", help="Where the files of --to go.", show_default=False),
    ] = None,
    c: Annotated[
        Path | None,
        typer.Option(
            "--c",
            metavar="DIR",
            help="Of a scene: the functions of its model and controller as C99, into this folder.",
            show_default=False,
        ),
    ] = None,
    loop: Annotated[
        bool, typer.Option("--loop", help="With --c: the simulation, too, with its events and errors.")
    ] = False,
    target: Annotated[
        str | None,
        one_of(
            "--target",
            *PROCESSORS,
            metavar="PROCESSOR",
            help="With --c: objects of the functions for this controller, too: cortex-m7.",
            show_default=False,
        ),
    ] = None,
    fmu: Annotated[
        Path | None,
        typer.Option(
            "--fmu",
            metavar="FILE",
            help="Of a scene: its simulation as a unit of FMI 3.0 for co-simulation.",
            show_default=False,
        ),
    ] = None,
    overrides: Overrides = None,
    keys: Annotated[
        list[str] | None,
        typer.Option(
            "--key",
            metavar="KEY[=LOW:HIGH]",
            parser=utf8,
            autocompletion=bare_keys,
            help="With --c or --fmu: a key that can be set. [default: masses, inertias, data of forces]",
        ),
    ] = None,
    inputs: Annotated[
        list[str] | None,
        typer.Option(
            "--input",
            metavar="KEY[=LOW:HIGH]",
            parser=utf8,
            autocompletion=bare_keys,
            help="With --fmu: a number that other tools change, or control.reference (set points).",
        ),
    ] = None,
    *,
    told: Told,
) -> int:
    """Write a stored result, or the robot or the functions of a scene, in another form; return the exit code."""
    console = told.console
    tidy_up_first()
    objects: list[LibraryObject] = []
    with console.waiting(lambda: "exporting"):
        chosen = [x for x in (c, fmu, to or out) if x is not None]
        alone = len(chosen) == 1
        if alone and c is not None and not inputs:
            made = _functions(source, c, (overrides or (), keys or ()), loop, target)
            directory, files, notes, objects = c, made.files, made.notes, made.objects
        elif alone and fmu is not None and not (loop or target):
            given = (overrides or (), keys or (), inputs or ())
            directory, (files, notes) = fmu, _unit(source, fmu, given)
        elif alone and to is not None and out is not None and not (keys or loop or target or inputs):
            directory, (files, notes) = out, _files(source, to, out, overrides or ())
        else:
            raise _refusal({"--key": keys, "--loop": loop, "--target": target, "--input": inputs})
    for text in notes:
        console.note(f"robodyn: {text}")
    sizes = {"objects": [one.told for one in objects]} if objects else {}
    console.data({"status": "ok", "files": [str(path) for path in files], "notes": notes, **sizes})
    console.say("\n".join([f"{directory}  ({', '.join(path.name for path in files)})", *map(str, objects)]))
    return 0


BELONGS = {"--key": "--c or --fmu", "--loop": "--c", "--target": "--c", "--input": "--fmu"}


def _refusal(given: Mapping[str, Any]) -> Exception:
    """Return the error of options that do not go together."""
    from robodyn_cli.errors import CapabilityError

    beside = "".join(f"{name} goes with {BELONGS[name]}; " for name, x in given.items() if x)
    return CapabilityError(f"{beside}allowed: either --to KIND with --out DIR, or --c DIR, or --fmu FILE")


def _functions(
    source: Path,
    directory: Path,
    given: tuple[Sequence[str], Sequence[str]],
    loop: bool,
    processor: str | None,
) -> CFolder:
    """Write the functions of a scene as C; given : overrides and keys. loop : its simulation, too. processor : for
    which there are objects.

    Raises
    ------
    CapabilityError : a result has none. Others of what reads and writes them.
    """
    from robodyn_cli.errors import CapabilityError
    from robodyn_cli.over.c99.asked_keys import asked_key
    from robodyn_cli.over.c99.folder import export_c

    if _is_stored(source):
        raise CapabilityError(f"{source} is a result, which has no functions; allowed with --c: a scene")
    overrides, keys = given
    asked = [asked_key(text) for text in keys]
    family = _family(source, overrides)
    return export_c(family, asked, directory, loop, processor)


def _unit(
    source: Path, target: Path, given: tuple[Sequence[str], Sequence[str], Sequence[str]]
) -> tuple[list[Path], list[str]]:
    """Write the simulation of a scene as a unit of FMI; given : overrides, keys and inputs.

    Raises
    ------
    CapabilityError : a result has none. Others of what reads and writes them.
    """
    from robodyn_cli.errors import CapabilityError
    from robodyn_cli.over.c99.asked_keys import asked_key
    from robodyn_cli.over.fmu.export import export_fmu

    if _is_stored(source):
        raise CapabilityError(f"{source} is a result, which does not simulate; allowed with --fmu: a scene")
    overrides, *others = given
    keys, inputs = (
        [asked_key(text, option) for text in texts] for texts, option in zip(others, ("--key", "--input"))
    )
    return [target], export_fmu(_family(source, overrides), target, keys, inputs)


def _family(source: Path, overrides: Sequence[str]) -> Family:
    """Return the scene, that of a robot with its gravity."""
    from robodyn_cli.scene.descriptions import load_robot
    from robodyn_cli.scene.load import Family

    if not isinstance(source, Path) or source.suffix in (".yaml", ".yml"):
        return Family(source, overrides)
    robot = load_robot(source)
    return Family.of(robot).with_values([f"gravity={list(robot.gravity)}", *overrides])


def _is_stored(source: Any) -> bool:
    """Tell a result from a scene."""
    from robodyn_cli.results.result import Result

    return isinstance(source, Result) or (
        isinstance(source, Path) and (source.is_dir() or source.suffix == ".h5")
    )


def _is_scene(source: Any) -> bool:
    return source.suffix in SCENES if isinstance(source, Path) else not _is_stored(source)


def _files(source: Path, to: str, out: Path, overrides: Sequence[str]) -> tuple[list[Path], list[str]]:
    """Write the files of a result or a scene, as the source is one; return them, and what there is to say.

    Raises
    ------
    CapabilityError : results have no robot, and scenes no samples. Others of what reads and writes them.
    """
    from robodyn_cli.errors import CapabilityError

    stored = _is_stored(source)
    if stored if to in OF_SCENES else _is_scene(source):
        of, kinds = ("a result", OF_RESULTS) if stored else ("a scene", OF_SCENES)
        raise CapabilityError(
            f"{source} is {of}, of which --to {to} writes nothing; allowed: {', '.join(kinds)}"
        )
    if overrides and stored:
        raise CapabilityError(f"{source} is a result, in which --set changes nothing; allowed: of scenes")
    if to == "mcap":
        from robodyn_cli.over.batch.stored import read_stored
        from robodyn_cli.over.export.mcap import export_mcap

        return export_mcap(read_stored(source), out), []
    if to in OF_RESULTS:
        from robodyn_cli.over.batch.stored import read_stored
        from robodyn_cli.results.export import export

        return export(read_stored(source), to, out), []
    from robodyn_cli.over.export.scene import export_robot
    from robodyn_cli.scene.descriptions import load_robot

    return export_robot(load_robot(source, overrides), to, out)
