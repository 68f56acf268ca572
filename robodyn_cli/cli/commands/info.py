"""``robodyn info``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any

import typer

from robodyn_cli.cli.offers import names_in
from robodyn_cli.cli.options import SceneFile, SharedOptions, utf8
from robodyn_cli.cli.runner import begun, output, placed, publish, say_where
from robodyn_cli.summaries.facts import LOAD

EXAMPLES = (
    "info configs/2r_circle.yaml",
    "info configs/2r_circle.yaml --at 'q=[60 deg, -40 deg]'",
    "info configs/four_bar_deploy.yaml --json",
)


def command(
    scene: SceneFile,
    at: Annotated[
        list[str] | None,
        typer.Option(
            "--at",
            metavar="q=[...], qd=[...]",
            autocompletion=names_in("robot.joints", before=("q.", "qd."), after="="),
            parser=utf8,
            help="State, joints in their order or q.NAME=... each.",
        ),
    ] = None,
    *,
    shared: SharedOptions,
) -> int:
    """Print the report of a scene at a state, and draw it; return the exit code."""
    from robodyn_cli.results.summary import jsonable
    from robodyn_cli.works.info import info

    console, overrides, drawings = shared.console, shared.overrides or (), shared.drawings("info")
    target = shared.directory(scene, "info")
    with console.waiting(lambda: "reading and drawing"), output(target, scene, console) as directory:
        with placed(scene, overrides, "info"):
            result = info(scene, overrides, at or ())
        if drawings is not None:
            with begun(directory, console):
                publish(result, directory, drawings, console)
    if console.takes(result):
        return 0
    console.data(jsonable(result.summary))
    console.say(describe(result.summary))
    if drawings is not None:
        say_where(directory, console, result.summary)
    return 0


WIDEST = 24  # columns of a matrix on the terminal


def describe(report: Mapping[str, Any]) -> str:
    """Return the report for the terminal."""
    from robodyn_cli.works.info import tree

    lines = [str(report["title"]), *("  " + line for line in tree(report["joints"], report["links"]))]
    if report["light_links"]:
        lines.append(f"  light links        {', '.join(report['light_links'])}: massless, or nearly so")
    lines.append(f"  state              {state(report['state']['q'], units(report['joints'], 'q'))}")
    lines.append(f"  rates              {state(report['state']['qd'], units(report['joints'], 'v'))}")
    lines += ["  frames in the world (origin [m]; x, y and z axes)"]
    for name, frame in report["frames"].items():
        axes = "  ".join(vector(axis) for axis in zip(*frame["rotation"]))
        lines.append(f"    {name:<12} {vector(frame['position'])}; {axes}")
    lines += matrix("mass matrix M", report["mass_matrix"])
    lines.append(f"    singular values  {values(report['mass_matrix_singular_values'])}")
    if report["mass_matrix_condition"] is not None:
        lines.append(f"    condition        {report['mass_matrix_condition']:.3g}")
    lines += matrix("Coriolis matrix C", report["coriolis_matrix"])
    rates = units(report["joints"], "v")
    gravity = zip(report["gravity_torques"].items(), (LOAD(unit.removesuffix("/s")) for unit in rates))
    lines.append(
        "  gravity torques G  " + ", ".join(f"{name} {cell(x)} {unit}" for (name, x), unit in gravity)
    )
    for name, point in report["points"].items():
        lines.append(
            f"  point {name:<12} at {vector(point['position'])} m, velocity {vector(point['velocity'])} m/s"
        )
        lines += matrix(f"Jacobian of {name}", point["jacobian"])
        lines.append(f"    singular values  {values(point['singular_values'])}")
    if "constraints" in report:
        lines += matrix(
            f"constraint Jacobian Psi ({', '.join(report['constraints']['rows'])})",
            report["constraints"]["psi"],
        )
        lines.append(f"    singular values  {values(report['constraints']['singular_values'])}")
    return "\n".join(lines)


def state(values: Mapping[str, float], units: Sequence[str]) -> str:
    """Return values with their units, which shows that angles are in radians."""
    texts = (f"{name} {x:.6g} {unit}".removesuffix(" 1") for (name, x), unit in zip(values.items(), units))
    return ", ".join(texts)


def units(joints: Sequence[Mapping[str, Any]], of: str) -> list[str]:
    """Return the units of the columns of q or v."""
    from robodyn_cli.joints.registry import joint_types

    kinds = [joint_types[joint["type"]] for joint in joints]
    if of == "q":
        return [unit for kind in kinds for unit in kind.units]
    return [f"{unit}/s" for kind in kinds for unit in kind.v_units]


def cell(x: float) -> str:
    """Return a number for reading; an unknown one as a question mark."""
    return "?" if x != x else f"{x + 0.0:.6g}" if abs(x) > 1e-12 else "0"


def vector(x: Any) -> str:
    """Return a vector in brackets."""
    return "[" + ", ".join(cell(float(v)) for v in x) + "]"


def values(x: list[float] | None) -> str:
    """Return singular values, or the reason why there are none."""
    return "not known: data are missing" if x is None else ", ".join(cell(v) for v in x)


def matrix(name: str, m: Sequence[Sequence[float]]) -> list[str]:
    """Return a matrix as aligned lines below its name."""
    rows, columns = len(m), len(m[0]) if m else 0
    if columns > WIDEST:
        return [f"  {name}  ({rows} x {columns}; in the report of --json and in summary.json)"]
    cells = [[cell(float(x)) for x in row] for row in m]
    width = max((len(x) for row in cells for x in row), default=1)
    return [f"  {name}", *("    " + "  ".join(x.rjust(width) for x in row) for row in cells)]
