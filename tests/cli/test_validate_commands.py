"""``validate`` tells of each command what the command itself tells before its first step, and nothing else."""

from __future__ import annotations

from pathlib import Path

import pytest

from robodyn_cli.commands import SCENE_COMMANDS
from robodyn_cli.errors import RobodynError
from robodyn_cli.integrators.runtime.integrator import Integrator
from robodyn_cli.over.commands import execute, place
from robodyn_cli.over.findings import Finding, findings
from robodyn_cli.scene.load import examine, load_scene
from robodyn_cli.tools.progress import Stopwatch, no_progress

ARM = """\
schema: 1
gravity: [0, -9.81, 0]
robot:
  convention: standard
  joints:
    - {name: j1, type: revolute, a: 1.0, alpha: 0, d: 0§j1}
    - {name: j2, type: revolute, a: 0.8, alpha: 0, d: 0§j2}
  links:
    - {name: l1, mass: 2, com: [-0.5, 0, 0], com_frame: link, inertia: {xx: 0.1, yy: 0.1, zz: 0.1}}
    - {name: l2§mass, com: [-0.4, 0, 0], com_frame: link, inertia: {§inertia}}
  points: {tip: {link: l2, at: end}}
initial: {q: {j1: 0.3, §q2}}
simulate: {duration: 1, §simulate}
trajectory: {type: quintic, points: [{t: 0, q: {j1: 0, j2: 0.2}}, {t: 1, q: {j1: 0.5, j2: 1}}]}
inverse: {samples: 21}
kinematics: {samples: 21}
reach: {frame: tip, position: [§x, 0.5, 0]}
statics: {find: §find}
"""
# little to choose from where ``size`` is not the point; the whole scenes choose from what the program has
PARTS = """\
catalogue:
  motors: {m: {type: dc, mass: 1, cost: 1, torque_constant: 0.1, resistance: 1, voltage: 48, max_current: 30, rated_current: 6}}
  gears: {g: {type: gear, ratio: 40, efficiency: 0.8, mass: 1, cost: 1, peak_torque: 90}}
"""
STILL = "trajectory: {type: joint, q: {j1: 0, j2: 0.8}, duration: 1}"
WHOLE = {
    "j1": "",
    "j2": "",
    "mass": ", mass: 1",
    "inertia": "xx: 0.05, yy: 0.05, zz: 0.05",
    "q2": "j2: 0.4",
    "simulate": "samples: 11",
    "x": "0.9",
    "find": "hold",
}
ARMS: dict[str, tuple[dict[str, str], str]] = {
    "whole": ({}, ""),
    "data are missing": ({"mass": ""}, ""),
    "a start is missing": ({"q2": ""}, ""),
    "the pose is out of reach": ({"x": "2.5"}, ""),
    "nothing feels a joint": ({"mass": ", mass: 0", "inertia": "zz: 0"}, ""),
    "bodies that cannot exist": ({"inertia": "xx: 0.05, yy: 0.05, zz: -3"}, ""),
    "beyond a stop": ({"j2": ", limits: {lower: 0.5, stop: {restitution: 0.5}}"}, STILL),
    "friction that sticks": ({"j2": ", friction: {coulomb: 1, law: set_valued}"}, ""),
    "a method that cannot": (
        {"j2": ", friction: {viscous: 1}", "simulate": "integrator: verlet, step: 0.01"},
        "",
    ),
    "gears": ({"j2": ", gear_ratio: 50"}, ""),
    "a passive joint": ({}, "actuated: [j1]"),
    "a controller": ({"find": "balance"}, "control: {type: pid, gains: {kp: 50, kd: 10, ki: 5}}"),
    "a payload that is dropped": (
        {},
        "payloads: [{name: load, at: tip, mass: 1, inertia: {zz: 0.01}, until: {time: 0.5}}]",
    ),
    "a stored start": ({}, "initial: {from: nowhere.h5}"),
    "a formula without a value": ({}, 'torques: {j1: "1/(j2 - 0.4)"}'),
}

FOUR_BAR = """\
schema: 1
gravity: [0, -9.81, 0]
robot:
  convention: standard
  joints:
    - {name: crank, type: revolute, a: 0.3, alpha: 0, d: 0}
    - {name: knee, type: revolute, a: §coupler, alpha: 0, d: 0§knee}
    - {name: rocker, type: revolute, parent: base, a: 0.6, alpha: 0, d: 0, origin: {xyz: [1, 0, 0]}}
  links:
    - {name: l1, mass: 1, com: [-0.15, 0, 0], com_frame: link, inertia: {zz: 0.01}}
    - {name: l2§mass, com: [-0.4, 0, 0], com_frame: link, inertia: {zz: 0.05}}
    - {name: l3, mass: 1, com: [-0.3, 0, 0], com_frame: link, inertia: {zz: 0.03}}
loops: [{name: pin, type: revolute, between: [l2.end, l3.end]}]
initial: {q: {crank: §crank, knee: -0.5, rocker: 1.7}, hold: [crank]}
actuated: [§actuated]
torques: {crank: 1}
trajectory: {type: quintic, points: [{t: 0, q: {crank: 1}}, {t: 1, q: {crank: 1.5}}]}
simulate: {duration: 1, samples: 11, §simulate}
inverse: {samples: 21}
kinematics: {samples: 21}
statics: {find: hold}
assemble: {branches: §branches}
"""
CLOSED = {
    "coupler": "0.8",
    "mass": ", mass: 1",
    "knee": "",
    "crank": "1",
    "actuated": "crank",
    "simulate": "rtol: 1e-6",
    "branches": "false",
}
MECHANISMS: dict[str, tuple[dict[str, str], str]] = {
    "whole": ({}, ""),
    "data are missing": ({"mass": ""}, ""),
    "a loop that cannot close": ({"coupler": "0.1"}, ""),
    "too few actuators": ({"actuated": ""}, "torques: {}"),
    "two inputs": ({"actuated": "crank, knee"}, ""),
    "studied gains and a joint that sticks": (
        {"knee": ", friction: {coulomb: 1, law: set_valued}", "simulate": "stabilisation: baumgarte"},
        "",
    ),
    "branches": ({"branches": "true"}, ""),
    "a controller": ({}, "control: {type: pid, joints: [crank], gains: {kp: 50, kd: 10, ki: 5}}"),
    "a path out of reach": (
        {},
        "trajectory: {type: circle, point: l1.end, center: [0.9, 0.9], radius: 0.1, duration: 1}",
    ),
}


# commands that refuse the whole scenes of a kind, and so their faults too
NOTHING_FOR = {"arm": ("deploy", "assemble"), "mechanism": ("reach",)}


class SteppedError(Exception):
    """Ends a command where it would take its first step."""


def written(text: str, words: dict[str, str], more: str) -> str:
    """Return a scene with words at their marks, the longest first, and further lines in the place of its own."""
    for name in sorted(words, key=len, reverse=True):
        text = text.replace(f"§{name}", words[name])
    key = more.partition(":")[0]
    lines = [line for line in text.splitlines() if not key or not line.startswith(f"{key}:")]
    return "\n".join([*lines, more, ""])


SCENES = {
    f"{kind}, {name}": written(text, {**words, **own}, more) + PARTS * (name != "whole")
    for kind, text, words, scenes in (("arm", ARM, WHOLE, ARMS), ("mechanism", FOUR_BAR, CLOSED, MECHANISMS))
    for name, (own, more) in scenes.items()
}


def told_by_command(path: Path, command: str, monkeypatch: pytest.MonkeyPatch) -> RobodynError | None:
    """Return the error that ends a command before its first step, with its place."""

    def stop(*_: object, **__: object) -> None:
        raise SteppedError

    with monkeypatch.context() as patch:
        patch.setattr(Integrator, "run", stop)
        try:
            execute(command, load_scene(path), no_progress, Stopwatch())
        except SteppedError:
            return None
        except RobodynError as error:
            if error.result is not None:  # it ran, and ended on the way
                return None
            place(error, lambda: examine(path).root, command)
            return error
    return None


def errors_of(path: Path) -> list[Finding]:
    return [finding for finding in findings(path) if finding.severity == "error"]


@pytest.mark.parametrize("scene", SCENES)
def test_validate_tells_what_each_command_tells(
    scene: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    kind, _, fault = scene.partition(", ")
    refused = []
    for command in SCENE_COMMANDS:
        if fault != "whole" and command in NOTHING_FOR[kind]:
            continue
        path = tmp_path / f"{command}.yaml"
        path.write_text(f"command: {command}\n{SCENES[scene]}", encoding="utf-8")
        told = told_by_command(path, command, monkeypatch)
        found = errors_of(path)
        if told is None:
            assert not found, f"{command} runs"
            continue
        refused.append(command)
        if "missing" in told.details:  # a message for each link, of which the command's says all
            assert {f.exit_code for f in found} == {told.exit_code}
            assert all(f"{command} needs mass of l2" in f.message for f in found)
        else:
            assert [(f.exit_code, f.message) for f in found] == [(told.exit_code, told.message)], command
    assert bool(refused) == (fault != "branches")


def test_missing_data_are_named_all_at_once(tmp_path: Path) -> None:
    """The choice of the method needs one moment of inertia; the torque of the led joint the centre of mass too."""
    path = tmp_path / "led.yaml"
    path.write_text(
        "schema: 1\ncommand: simulate\ngravity: [0, 0, -9.81]\nrobot:\n  joints:\n"
        "    - {name: slew, type: revolute, parent: base, link: tower, axis: [0, 0, 1]}\n"
        "    - {name: trolley, type: prismatic, parent: tower, link: cart, axis: [1, 0, 0]}\n"
        "    - {name: load, type: floating, parent: base, link: ball, origin: {xyz: [10, 0, 8]}}\n"
        "  links:\n    - {name: tower, mass: 5, com: [0, 0, 15], inertia: {xx: 1, yy: 1, zz: 1}}\n"
        "    - {name: cart, mass: 3}\n    - {name: ball, mass: 2, com: [0, 0, 0], inertia: {xx: 3, yy: 3, zz: 3}}\n"
        "  points: {sheave: {link: cart, at: [0, 0, 0]}, hook: {link: ball, at: [0, 0, 0.5]}}\n"
        "forces: [{name: rope, type: nonlinear_spring, between: [sheave, hook], tension: 20*length + rate}]\n"
        'prescribed: {slew: "0.05*t^2", trolley: "10"}\n'
        "initial: {q: {load: {xyz: [0, 0, 0], rpy: [0, 0, 0]}}}\nsimulate: {duration: 0.1}\n"
    )
    (finding,) = findings(path)
    for name in ("com[0]", "com[1]", "inertia.zz"):
        assert name in finding.message
