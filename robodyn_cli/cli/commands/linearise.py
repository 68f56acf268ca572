"""``robodyn linearise``."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from robodyn_cli.cli.offers import any_of, begun_by, listed_of, names_in
from robodyn_cli.cli.options import SceneFile, SharedOptions, Strict, quantity, utf8
from robodyn_cli.cli.runner import run_scene
from robodyn_cli.cli.words import error_text, holding_lines, number, stated, table
from robodyn_cli.errors import SceneError, of_option

BALANCE, START = "balance", "start"
MOVING = 1e-3  # amplitude of a coordinate below which a mode's line leaves it out
MOST = 4  # coordinates of a mode that are listed
HEADS = ["pole [1/s]", "error [1/s]", "mode", "in [s]", "frequency [Hz]", "damping", "moves"]
MAIN = 3  # of these columns that are told first
ABOUT = {
    "state": "about the state",
    "balance": "about a balance",
    "hold": "about the pose, held by constant torques",
    "motion": "along the motion",
    "controller": "about the pose that the controller is to keep",
}


EXAMPLES = (
    "linearise configs/double_pendulum.yaml --at balance",
    "linearise configs/double_pendulum.yaml --at 'theta1=20 deg, theta2=10 deg' --hold --input theta1,theta2",
    "linearise configs/double_pendulum.yaml --along --instants 0,0.5,2",
)


def command(
    scene: SceneFile,
    at: Annotated[
        list[str] | None,
        typer.Option(
            "--at",
            metavar="q.NAME=...|balance",
            autocompletion=any_of(
                begun_by((BALANCE, START)), names_in("robot.joints", before=("q.", "qd."), after="=")
            ),
            parser=utf8,
            help="State, as `q.theta1=60 deg` for each joint, or `balance` or `start`. "
            "[default: the pose that the controller is to keep, else the start]",
        ),
    ] = None,
    hold: Annotated[
        bool, typer.Option("--hold", help="At rest in that pose, held by constant torques of the inputs.")
    ] = False,
    along: Annotated[
        bool, typer.Option("--along", help="Along the scene's motion, by `simulate` or `inverse`.")
    ] = False,
    inputs: Annotated[
        list[str] | None,
        typer.Option(
            "--input",
            metavar="NAME,...",
            parser=utf8,
            autocompletion=listed_of(names_in("robot.joints")),
            help="Joints whose torques are inputs.",
        ),
    ] = None,
    outputs: Annotated[
        list[str] | None,
        typer.Option(
            "--output",
            metavar="NAME,...",
            parser=utf8,
            autocompletion=listed_of(
                any_of(
                    names_in("robot.joints", before=("", "qd.")),
                    names_in("robot.points", "outputs.signals"),
                )
            ),
            help="What is measured: joints, qd.JOINT, points, outputs.signals.",
        ),
    ] = None,
    instants: Annotated[
        list[str] | None,
        typer.Option(
            "--instants",
            metavar="T,...",
            help="With --along: times [s] at which modes and frequency response are wanted.",
        ),
    ] = None,
    period: Annotated[
        float | None,
        typer.Option(
            "--period",
            metavar="T",
            parser=quantity("s"),
            help="Of the model under a hold [s]: `2 ms`. [default: that of the controller]",
            show_default=False,
        ),
    ] = None,
    delay: Annotated[
        float | None,
        typer.Option(
            "--delay",
            metavar="T",
            parser=quantity("s"),
            help="Until an input of that model acts [s]. [default: that of the controller]",
            show_default=False,
        ),
    ] = None,
    *,
    shared: SharedOptions,
    strict: Strict = False,
) -> int:
    """Linearise a scene; return the exit code."""
    state = [text for text in at or () if text not in (BALANCE, START)]
    about = _about(at or (), state, hold, along)
    of = {"inputs": _names(inputs), "outputs": _names(outputs)}
    times = _times(_names(instants))
    if times and about != "motion":
        raise of_option("--instants", "they are those of a motion; allowed: with --along")
    if about != "motion":
        shared = dataclasses.replace(shared, overrides=_changes(scene, shared.overrides or (), state))
    job = shared.job(
        "linearise", scene, strict, options={"about": times or about, "period": period, "delay": delay, **of}
    )
    return run_scene(job, shared.console, describe)


def _about(at: Sequence[str], state: Sequence[str], hold: bool, along: bool) -> str | None:
    """Return what is linearised about; None where nothing says it.

    Raises
    ------
    SceneError : options that exclude each other, a word that is no state.
    """
    if words := [text for text in state if "=" not in text]:
        raise of_option(
            f"--at {words[0]!r}",
            f"is no state; allowed: {BALANCE}, {START}, or a state such as 'theta1=60 deg', with "
            "--hold where constant torques hold it",
        )
    balance, start = BALANCE in at, START in at
    if "hold" in state:
        raise of_option(
            "--at 'hold'", f"is no state; allowed: --hold, states as q=[0.1, 0.2], or --at {BALANCE}"
        )
    chosen = [
        name
        for name, given in (
            ("--at balance", balance), ("--at start", start and not hold), ("--hold", hold), ("--along", along)
        )
        if given
    ]  # fmt: skip
    if len(chosen) > 1 or (state and (balance or along or start)):
        listed = " and ".join([*(["--at STATE"] if state else []), *chosen])
        raise SceneError(f"{listed} exclude each other; allowed: one of them, or --at STATE with --hold")
    if not chosen and not state:
        return None
    return BALANCE if balance else "hold" if hold else "motion" if along else "state"


def _names(given: Sequence[str] | None) -> tuple[str, ...]:
    return tuple(name.strip() for text in given or () for name in text.split(",") if name.strip())


def _times(given: Sequence[str]) -> tuple[float, ...]:
    """Return times [s].

    Raises
    ------
    SceneError : one is no number, or no time.
    """
    try:
        return tuple(map(quantity("s"), given))
    except SceneError as error:
        message = (
            f"--instants {','.join(given)}: {error.message}; allowed: numbers [s], as 0,0.5,2 or 0,500 ms"
        )
        raise SceneError(message) from None


def _changes(path: Path, overrides: Sequence[str], state: Sequence[str]) -> list[str]:
    """Return all overrides of a scene that is to be in a state."""
    from robodyn_cli.scene.load import load_scene
    from robodyn_cli.works.info import changes_at

    return changes_at(load_scene(path, list(overrides)), overrides, state)


def describe(summary: Mapping[str, Any], verbose: bool = True) -> str:
    """Return the summary for the terminal."""
    freedoms = summary["freedoms"]
    inputs, outputs = (", ".join(x["name"] for x in summary[key]) or "none" for key in ("inputs", "measured"))
    about = ABOUT[summary["about"]]
    if summary["about"] == BALANCE and "holding_torques" in summary:
        about = "about a pose that is a balance with the holding torques alone"
    lines = [
        f"{summary['title']}",
        f"  linear model       {about}; {freedoms} degree{'s' if freedoms != 1 else ''} of freedom",
    ]
    if verbose:
        lines += [
            f"  states             {', '.join(x['name'] for x in summary['states'])}",
            f"  inputs             {inputs}",
            f"  outputs            {outputs}",
        ]
    torques, off = (summary.get(key, {}) for key in ("holding_torques", "holding_torques_error"))
    lines += holding_lines(torques, off, summary.get("units", {}))
    if "growth" in summary:
        growth = summary["growth"]
        lines.append(
            f"  samples            {summary['samples']}; pole farthest to the right "
            f"{stated(growth['largest'], growth['error'])} 1/s at t = {number(growth['time'])} s"
        )
        for instant in summary.get("instants", ()):
            lines += _modes(instant, verbose, f" at {number(instant['time'])} s")
        return "\n".join(lines)
    return "\n".join([*lines, *_modes(summary, verbose), *_discrete(summary), *_loop(summary)])


def _discrete(summary: Mapping[str, Any]) -> list[str]:
    """Return the line of the model under a hold, where there is one."""
    if "discrete" not in summary:
        return []
    model = summary["discrete"]
    late = f", {number(model['delay'])} s late" if model["delay"] else ""
    waiting = len(model["states"]) - len(summary["states"])
    kept = f"; {waiting} of its {len(model['states'])} states are inputs on their way" if waiting else ""
    return [
        f"  discrete model     inputs held for {number(model['period'])} s{late}: /discrete of the result{kept}"
    ]


def _loop(summary: Mapping[str, Any]) -> list[str]:
    """Return the lines of the loop of a controller, where there is one."""
    if "closed_loop" not in summary:
        return []
    from robodyn_cli.cli.loop_words import loop_lines

    return loop_lines(summary)


def _modes(of: Mapping[str, Any], verbose: bool, when: str = "") -> list[str]:
    """Return the lines of a system's modes: of each its pole with the error, with -v all else."""
    rows = [HEADS, *map(_row, of["modes"])]
    lines = [table(rows if verbose else [row[:MAIN] for row in rows])]
    # with a controller these are poles of what it drives
    name = "without control" if "closed_loop" in of else f"stability{when}"
    return [f"  {name:<18} {_stability(of)}", "  modes, slowest first:", *lines]


def _stability(of: Mapping[str, Any]) -> str:
    """Return whether a system is stable, and by which mode if it is not."""
    word: str = of["stability"]
    fastest = max(of["modes"], key=lambda mode: mode["real"])
    if word == "unstable":
        time = stated(fastest["time"], fastest["time_error"])
        return f"unstable: the mode of the pole {_pole(fastest)} 1/s grows e times in {time} s"
    if any(mode["multiplicity"] > 1 for mode in of["modes"]):
        return f"{word}; the mode of a double pole at 0 goes on at the rate that it has"
    return word


def _row(mode: Mapping[str, Any]) -> list[str]:
    note = "" if mode["reached"] and mode["shown"] else " *"
    # only a pair of complex poles oscillates
    oscillation = ["-", "-"]
    if mode["imaginary"]:
        oscillation = [stated(mode[key], mode[f"{key}_error"]) for key in ("frequency", "damping")]
    way = "" if mode["time"] is None else "grows e times" if mode["real"] > 0.0 else "decays to 1/e"
    pole = [_pole(mode) + note, error_text(mode["error"]), way]
    return [*pole, stated(mode["time"], mode["time_error"]), *oscillation, _moves(mode)]


def _pole(mode: Mapping[str, Any]) -> str:
    real, imaginary = mode["real"], mode["imaginary"]
    if imaginary:
        return f"{number(real)} +- {number(imaginary)}i" if real else f"+- {number(imaginary)}i"
    return number(real) + (f" ({mode['multiplicity']} poles)" if mode["multiplicity"] > 1 else "")


def _moves(mode: Mapping[str, Any]) -> str:
    """Return the coordinates that a mode moves most."""
    shape = sorted(mode["shape"].items(), key=lambda item: -item[1][0])
    moves = [
        f"{name} {number(size if abs(phase) < 1.6 else -size, 3)}"
        for name, (size, phase) in shape
        if size > MOVING
    ]
    return ", ".join(moves[:MOST]) + (", ..." if len(moves) > MOST else "")
