"""Which methods refuse which kinds of systems, and why: nobody else, and nothing else."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import CapabilityError
from robodyn_cli.formulations.build import build_system
from robodyn_cli.formulations.events import Stopping
from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.runtime.integrator import Integrator
from robodyn_cli.kernels import crossover
from robodyn_cli.motion.contact.events import contact_functions
from robodyn_cli.scene.load import load_scene, load_scene_text
from robodyn_cli.scene.types import Scene
from tests import systems
from tests.mechanisms import CONFIGS
from tests.methods import METHODS, REFUSALS, obstacle

SLIDE = """
schema: 1
gravity: [0, 0, -9.81]
robot:
  convention: standard
  joints: [{name: x, type: prismatic, theta: 0, a: 0, alpha: 0, MORE}]
  links: [{name: mass, mass: 1, com: [0, 0, 0], com_frame: joint}]
initial: {q: {x: 0.1}, qd: {x: 1}}
simulate: {duration: 1, samples: 11}
"""
CHAIN = """
schema: 1
gravity: [0, -9.81, 0]
robot:
  convention: standard
  joints: [JOINTS]
  links: [LINKS]
initial: {q: {START}}
simulate: {duration: 1, samples: 11}
"""


def system_of(scene: Scene) -> System:
    problem = Problem(scene)
    return build_system(problem, events=contact_functions(problem, Stopping()))


def of_scene(text: str) -> System:
    return system_of(load_scene_text(text))


def of_file(name: str) -> System:
    return system_of(load_scene(CONFIGS / f"{name}.yaml"))


def long_chain() -> System:
    names = [f"j{k}" for k in range(crossover.CROSSOVER)]
    joints = ", ".join(f"{{name: {j}, type: revolute, a: 0.1, alpha: 0, d: 0}}" for j in names)
    links = ", ".join(
        f"{{name: l{j}, mass: 1, com: [0.05, 0, 0], com_frame: joint, inertia: {{zz: 0.01}}}}" for j in names
    )
    start = ", ".join(f"{j}: 0" for j in names)
    return of_scene(CHAIN.replace("JOINTS", joints).replace("LINKS", links).replace("START", start))


KINDS: dict[str, Callable[[], System]] = {
    "accelerations from positions and time": lambda: systems.forced().system,
    "accelerations from velocities": lambda: systems.damped().system,
    "accelerations from further states": lambda: systems.system(
        1, lambda t, q, v, z, p: ([-q[0] - z[0]], [q[0]]), nz=1
    ),
    "a closed loop": lambda: of_file("four_bar_deploy"),
    "a ball joint": lambda: of_file("spinning_top"),
    "independent coordinates": lambda: build_system(
        Problem(load_scene(CONFIGS / "four_bar_deploy.yaml")), stabilisation="independent"
    ),
    "set-valued friction": lambda: of_scene(
        SLIDE.replace("MORE", "friction: {law: set_valued, coulomb: 0.3}")
    ),
    "a rigid stop": lambda: of_scene(SLIDE.replace("MORE", "limits: {upper: 1, stop: {restitution: 0.5}}")),
    "a long chain": long_chain,
}


def test_the_kinds_are_those_of_the_table() -> None:
    assert set(KINDS) == set(REFUSALS)


@pytest.mark.parametrize("kind", KINDS)
def test_exactly_these_methods_refuse_a_kind_of_system(kind: str) -> None:
    body = KINDS[kind]()
    told = {m: why for m in METHODS if (why := obstacle(m, body))}
    assert set(told) == set(REFUSALS[kind]), told
    for method, words in REFUSALS[kind].items():
        assert words in told[method]
        with pytest.raises(CapabilityError) as caught:
            Integrator(body, method)
        assert words in caught.value.message
