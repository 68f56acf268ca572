"""What each command does with a scene before its first step: equations, start, motion, and which data they need.

A check is named by the row of its command, and calls the functions with which the command itself begins, so that it
refuses what the command refuses, in the same words. It returns the names of data that the equations need and the scene
does not give.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import TypeVar

from robodyn_cli.errors import RobodynError
from robodyn_cli.formulations.rolled import Rolled
from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.registry import methods
from robodyn_cli.model.model import unknown_among
from robodyn_cli.motion.build import leaves_gains, projected_motion, with_stabilisation
from robodyn_cli.motion.motion import Beginning, Motion
from robodyn_cli.ready.integrable import integrable
from robodyn_cli.scene.types import Baumgarte, Scene
from robodyn_cli.tools.progress import Stopwatch

# at most so many samples of a motion are tried; where it fails there, all are, up to a limit, as the command has them
TRIED, MOST_TRIED = 1001, 100_000
Tried = TypeVar("Tried")
# gains that are not studied: no size of them is refused
ANY_GAINS = Baumgarte(alpha=1.0, beta=1.0)

Missing = Sequence[str]


def _tried(plan: Callable[[int], Tried], samples: int) -> Tried:
    """Return a motion at some of its samples; where it fails, its error is that of all of them."""
    few = min(TRIED, samples)
    try:
        return plan(few)
    except RobodynError:
        if not few < samples <= MOST_TRIED:
            raise
    return plan(samples)


def inverse(scene: Scene) -> Missing:
    """Plan the motion, and compute the torques of its first sample."""
    from robodyn_cli.observe.rounding import few
    from robodyn_cli.ready.mass_matrix import refuse_indefinite
    from robodyn_cli.trajectories.motion import JointMotion
    from robodyn_cli.works.inverse import program_of

    program = program_of(scene)
    planned = _tried(lambda samples: program.plan(program.times(samples)), scene.inverse.samples)
    motion, times = planned.motion, planned.times
    refuse_indefinite(program.problem.scene, motion.q[few(len(times))])
    if scene.inverse.flywheel is not None:
        from robodyn_cli.works.balance import refuse_flywheel

        refuse_flywheel(program.problem, motion)
    missing = unknown_among([x for term in program.terms.values() for x in term])
    if not missing:
        first = JointMotion(*(x[:1] for x in (motion.q, motion.qd, motion.qdd)))
        program.evaluate(dataclasses.replace(planned, times=times[:1], motion=first), program.compile(1))
    return missing


def size(scene: Scene) -> Missing:
    """Do what ``inverse`` does first, with drives of one unit each, and look for motors and gears."""
    from robodyn_cli.works.size.candidates import with_unit_drives
    from robodyn_cli.works.size.search import candidates_of
    from robodyn_cli.works.size.size import to_size

    scene, drives = to_size(scene)
    missing = inverse(with_unit_drives(scene, drives))
    candidates_of(scene, drives, scene.catalogue)
    return missing


def simulate(scene: Scene) -> Missing:
    """Build the motion, and let those who watch it see the start."""
    from robodyn_cli.works.simulate import motion_of

    return _begun(*motion_of(_without_study(scene), Stopwatch()))


def deploy(scene: Scene) -> Missing:
    """Build the motion of the mechanism, and let those who watch it see the start."""
    from robodyn_cli.works.deploy.deploy import deployment_of

    return _begun(*deployment_of(_without_study(scene), Stopwatch()))


def stability(scene: Scene) -> Missing:
    """Build the equations, and close the loops."""
    from robodyn_cli.formulations.build import build_system
    from robodyn_cli.over.stability.stability import started

    return _lacking(build_system(started(scene, Stopwatch())[1].problem, "none", work=False))


def kinematics(scene: Scene) -> Missing:
    """Find the motion, as far as it goes."""
    from robodyn_cli.works.kinematics import evaluated, plan, problem_of, refuse_transmission

    def planned(samples: int) -> object:
        options = dataclasses.replace(scene.kinematics, samples=samples)
        problem = problem_of(dataclasses.replace(scene, kinematics=options))
        found, _ = plan(problem)
        if options.design is not None and len(found.times) > 1:
            from robodyn_cli.works.design import refuse_design

            refuse_design(problem, found)
        if options.transmission is not None:
            refuse_transmission(scene, evaluated(problem, found))
        return found

    _tried(planned, scene.kinematics.samples)
    return ()


def assemble(scene: Scene) -> Missing:
    """Close the loops."""
    from robodyn_cli.works.assemble import closed_loops

    closed_loops(scene, Stopwatch())
    return ()


def reach(scene: Scene) -> Missing:
    """Bring the frame to the pose."""
    from robodyn_cli.works.reach import reached

    reached(scene, Stopwatch())
    return ()


def statics(scene: Scene) -> Missing:
    """Find the balance, or the torques that hold the configuration."""
    from robodyn_cli.works.statics import rest_of

    rest_of(scene, Stopwatch())
    return ()


def linearise(scene: Scene) -> Missing:
    """Find the state about which the scene is linearised."""
    from robodyn_cli.works.linearise.linearise import prepared
    from robodyn_cli.works.linearise.nominal import Question

    prepared(scene, Question(), Stopwatch())
    return ()


# -- what is integrated ------------------------------------------------------------------------------------
def _without_study(scene: Scene) -> Scene:
    """Return the scene with some gains where the command would choose Baumgarte's by trial runs."""
    if not leaves_gains(scene):
        return scene
    from robodyn_cli.motion.baumgarte import refuse_study

    ready = integrable(scene)
    refuse_study(projected_motion(ready).problem)
    return with_stabilisation(ready, ANY_GAINS)


def _begun(motion: Motion, beginning: Beginning) -> Missing:
    """Do what a driver does with a motion before it steps, but for what is compiled."""
    if missing := _lacking(motion.system):
        return missing
    methods[motion.choice.method].check(motion.system)
    state = beginning.state
    for watcher in motion.watchers:
        state = watcher.begin(beginning.time, state, motion.options)
    _ = motion.observer
    return ()


def _lacking(system: System) -> Missing:
    # loops over bodies have asked for what they need when they were made
    return () if isinstance(system.dynamics, Rolled) else unknown_among(system.rates)
