"""``robodyn new``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from robodyn_cli.cli.offers import begun_by
from robodyn_cli.cli.options import Told, utf8

if TYPE_CHECKING:
    from robodyn_cli.cli.console import Console
    from robodyn_cli.robots.collection import StarterRobot
    from robodyn_cli.scene.starters import Starter


def _kinds(incomplete: str) -> list[str]:
    from robodyn_cli.scene.starters import STARTERS

    return begun_by(STARTERS)(incomplete)


def _robots(incomplete: str) -> list[str]:
    from robodyn_cli.robots.collection import ROBOTS

    return begun_by(ROBOTS)(incomplete)


def _examples(incomplete: str) -> list[str]:
    from robodyn_cli.robots.examples import example_names, examples_folder

    return begun_by(example_names(examples_folder()))(incomplete)


EXAMPLES = (
    "new simulate pendulum.yaml",
    "new --from puma560 arm.yaml",
    "new --example four_bar_deploy",
)


def command(
    kind: Annotated[
        str | None,
        typer.Argument(
            metavar="KIND",
            autocompletion=_kinds,
            show_default=False,
            help="inverse, joint, waypoints, stops, lines, table, path, simulate, body, loop, mechanism, kinematics, "
            "statics, assemble or deploy; none with --from.",
        ),
    ] = None,
    file: Annotated[
        Path | None,
        typer.Argument(
            metavar="FILE",
            help="File to write; default: KIND.yaml. With --example the folder to write into; default: configs.",
            show_default=False,
        ),
    ] = None,
    robot: Annotated[
        str | None,
        typer.Option(
            "--from",
            metavar="ROBOT",
            parser=utf8,
            autocompletion=_robots,
            help="A robot with the sources of its constants in place of KIND: planar_2r, planar_3r, scara, puma560, "
            "seven_joint_arm, cart_pole, furuta_pendulum, delta, five_bar, slider_crank, watt_six_bar, scissor_mast "
            "or stewart_platform.",
        ),
    ] = None,
    example: Annotated[
        str | None,
        typer.Option(
            "--example",
            metavar="NAME",
            parser=utf8,
            autocompletion=_examples,
            help="An example scene in place of KIND, with the files that it reads: 2r_circle, double_pendulum, "
            "four_bar_deploy, mechanisms/solar_array, ...; an unknown NAME lists all.",
        ),
    ] = None,
    *,
    told: Told,
) -> int:
    """Write a starter or an example, never over another file; return the exit code."""
    from robodyn_cli.errors import CapabilityError

    beside = [option for option in (robot, example) if option is not None]
    if beside and file is None and kind is not None:
        file, kind = Path(kind), None
    if len(beside) + (kind is not None) != 1:
        raise CapabilityError(
            "needs the kind of a scene, or --from with a robot, or --example with a scene; see 'robodyn new --help'"
        )
    console = told.console
    if example is not None:
        return _example(example, file or Path("configs"), console)
    return _template(
        _robot(robot) if robot is not None else _starter(str(kind)), file, robot or kind, console
    )


def _template(template: StarterRobot | Starter, file: Path | None, name: str | None, console: Console) -> int:
    from robodyn_cli.results.atomic import write_new

    path = file or Path(f"{name}.yaml")
    write_new(path, template.text(str(path)))
    console.data({"status": "ok", "file": str(path), "command": template.command})
    console.say(f"{path}: {template.title}. Run it: robodyn {template.command} {path}")
    return 0


def _example(name: str, target: Path, console: Console) -> int:
    from robodyn_cli.results.atomic import write_alike
    from robodyn_cli.robots.examples import examples_folder, find_example, texts_of
    from robodyn_cli.scene.load import load_scene

    folder = examples_folder()
    path = find_example(name, folder)
    scene = load_scene(path)
    texts = {target / place: text for place, text in texts_of(path, scene.sources, folder).items()}
    write_alike(texts)
    first, *others = texts
    console.data(
        {"status": "ok", "file": str(first), "command": scene.command, "with": list(map(str, others))}
    )
    console.say(f"{first}: {scene.title}. Run it: robodyn {scene.command} {first}")
    if others:
        console.say(f"  with {', '.join(map(str, others))}")
    return 0


def _robot(name: str) -> StarterRobot | Starter:
    from robodyn_cli.robots.collection import find_robot

    return find_robot(name)


def _starter(kind: str) -> StarterRobot | Starter:
    from robodyn_cli.scene.starters import find_starter

    return find_starter(kind)
