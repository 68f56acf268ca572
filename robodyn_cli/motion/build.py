"""From a scene to a motion that can be integrated: the one builder of every command that integrates, and of the plan.

gains -> equations and start (``prepare``) -> watchers -> system -> method
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence

from robodyn_cli.equations.problem import Problem
from robodyn_cli.formulations.build import build_system
from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.runtime.options import Options
from robodyn_cli.model.model import unknown_among
from robodyn_cli.motion.method import choose
from robodyn_cli.motion.motion import MethodChoice, Motion, Watcher
from robodyn_cli.observe.observe import all_missing_data
from robodyn_cli.ready.prepare import Setup, passive_coordinates, prepare
from robodyn_cli.scene.types import Baumgarte, Ready, Scene
from robodyn_cli.summaries.motion import Gains
from robodyn_cli.tools.progress import Stopwatch

Follow = Callable[[Problem, Sequence[int]], Sequence[Watcher]]
AUTOMATIC = "baumgarte"
LIGHT = 1e-3  # of the largest mass of a link


def follow_motion(problem: Problem, passive: Sequence[int]) -> list[Watcher]:
    """Return the watchers of a simulation: loss of rank (a stop, or a pose to pass), contact states, limits."""
    watchers = [*rank_watchers(problem), *contact_watchers(problem), *payload_watchers(problem)]
    own = [watcher for watcher in watchers if watcher.functions or watcher.changes_motion]
    return [*own, *limit_watchers(problem)] if problem.scene.robot.limited else own


def follow_latches(problem: Problem, passive: Sequence[int]) -> list[Watcher]:
    """Return the watchers of a motion with latches: loss of rank, payloads, contacts and latches together, limits."""
    from robodyn_cli.motion.contact.latches import Latches

    own = Latches(problem, passive)  # which takes over what payloads have found out at the start
    return [*rank_watchers(problem), *payload_watchers(problem), own, *limit_watchers(problem)]


def follow_changes(problem: Problem, passive: Sequence[int]) -> list[Watcher]:
    """Return the watchers of what changes a motion: poses to pass, and contact states."""
    return [watcher for watcher in follow_motion(problem, passive) if watcher.changes_motion]


def rank_watchers(problem: Problem) -> list[Watcher]:
    """Return the watcher of poses in which loops lose rank, where there are loops."""
    if not problem.model.closures:
        return []
    from robodyn_cli.motion.singular.rank_loss import Passage, RankLoss

    stops = problem.scene.simulate.singular == "stop"
    return [RankLoss(problem) if stops else Passage(problem)]


def contact_watchers(problem: Problem) -> list[Watcher]:
    """Return the watcher of joints that stick, slip and meet rigid stops, where there are such joints."""
    if not problem.contact_joints:
        return []
    from robodyn_cli.motion.contact.states import ContactStates

    return [ContactStates(problem)]


def payload_watchers(problem: Problem) -> list[Watcher]:
    """Return the watcher of masses that are gripped and released, where there are such."""
    if not problem.model.switched:
        return []
    from robodyn_cli.motion.contact.payloads import Payloads

    return [Payloads(problem)]


def limit_watchers(problem: Problem) -> list[Watcher]:
    """Return the watcher of limits that no stop keeps, where joints have any."""
    if not problem.scene.robot.limited:
        return []
    from robodyn_cli.motion.joint_limits import LimitWatcher

    watcher = LimitWatcher(problem)
    return [watcher] if watcher.limits else []


def build_motion(
    scene: Ready,
    watch: Stopwatch | None = None,
    follow: Follow = follow_motion,
    work: bool = True,
    reactions: bool = False,
    plan: bool = False,
) -> Motion:
    """Build everything that a command integrates, once.

    Parameters
    ----------
    follow : gives the watchers for the equations and the passive coordinates.
    work : carry the work of actuators and damping as a further state. reactions : observe joint reactions in any case.
    plan : nothing is going to run, so an open chain may lack initial positions, and the scene data.

    Raises
    ------
    RobodynError : the scene cannot be started; see ``prepare``.
    """
    watch = watch or Stopwatch()
    scene, gains = with_gains(scene, watch)
    setup = prepare(scene, watch, neutral=plan)
    problem = setup.problem
    with watch.stage("equations"):
        passive = passive_coordinates(problem)
        watchers = (*follow(problem, passive), *half_turns(problem))
        system = watched_system(problem, scene.simulate.stabilisation, watchers, work)
    with watch.stage("method"), all_missing_data(problem, system, reactions):
        system, choice = _method(scene, setup, system, plan)
    motion = Motion(
        scene,
        problem,
        setup.assembled,
        passive,
        system,
        watchers,
        options_for(scene),
        choice,
        gains,
        reactions,
    )
    if not plan:
        with watch.stage("equations"):
            for watcher in watchers:
                watcher.follow(motion)
    return motion


def watched_system(
    problem: Problem, stabilisation: str | Baumgarte, watchers: Sequence[Watcher], work: bool = True
) -> System:
    """Return the system with the event functions of its watchers; see ``build_system``."""
    functions = [function for watcher in watchers for function in watcher.functions]
    return build_system(problem, stabilisation, functions, work)


def half_turns(problem: Problem) -> list[Watcher]:
    """Return the watcher of forces between bodies whose angle jumps at half a turn, where there are such forces."""
    if not problem.model.forces or not problem.elements.half_turns:
        return []
    from robodyn_cli.motion.joint_limits import HalfTurns

    return [HalfTurns(problem)]


def options_for(scene: Scene) -> Options:
    """Return the tolerances and limits of a scene's integration."""
    s = scene.simulate
    longest = math.inf if s.max_step is None else s.max_step
    return Options(s.rtol, s.atol, s.step, longest, s.max_steps)


def _method(scene: Scene, setup: Setup, system: System, plan: bool) -> tuple[System, MethodChoice]:
    """Return the system with what is known of its rounding, and the method with its reason."""
    lacks = plan and not system.dynamics.any_size
    if lacks and unknown_among(system.rates):
        return system, MethodChoice(scene.simulate.integrator, "data are missing that the choice needs")
    start = system.join(setup.assembled.q, setup.assembled.v)
    off = 0.0
    if _may_be_rounded(setup.problem):
        from robodyn_cli.motion.conditioning import rounding_of_rates

        off = rounding_of_rates(system, start)
    if off:
        system = dataclasses.replace(system, is_rounded=True)
    choice = choose(scene, setup.problem, system, start, options_for(scene))
    if off > scene.simulate.atol:
        told = f"rounding puts accelerations off by {off:.0e} rad/s^2 or m/s^2, which is no error of a step"
        choice = dataclasses.replace(choice, reason=f"{choice.reason}; {told}")
    return system, choice


def _may_be_rounded(problem: Problem) -> bool:
    """Tell whether rounding may put rates off by more than is usual: links far lighter than others, or loops."""
    # plain numbers: what they are compared with is no property of the equations
    masses = [0.0 if link.mass is None else float(link.mass) for link in problem.scene.robot.links]
    return bool(problem.model.closures) or min(masses, default=0.0) < LIGHT * max(masses, default=0.0)


# -- Baumgarte's gains that the scene leaves to us ---------------------------------------------------------
def leaves_gains(scene: Scene) -> bool:
    """Tell whether a scene with constraints leaves Baumgarte's gains to the run."""
    constrained = scene.loops or scene.couplers or scene.prescribed
    return bool(constrained) and scene.simulate.stabilisation == AUTOMATIC


def with_gains(scene: Ready, watch: Stopwatch) -> tuple[Ready, Gains | None]:
    """Return the scene with Baumgarte's gains chosen where it leaves that to us, and what was found on the way."""
    if not leaves_gains(scene):
        # without constraints there is nothing to stabilise; nobody behind this meets the word that leaves the choice
        none = scene.simulate.stabilisation == AUTOMATIC
        return (with_stabilisation(scene, "projection") if none else scene), None
    from robodyn_cli.motion.baumgarte import GainStudy

    with watch.stage("gains"):
        chosen = GainStudy(projected_motion(scene)).choose()
    gains = Baumgarte(alpha=chosen.alpha, beta=chosen.beta)
    return with_stabilisation(scene, gains), chosen


def projected_motion(scene: Ready) -> Motion:
    """Return the motion of a scene with its loops kept closed by projection, without the work and without watchers."""
    return build_motion(with_stabilisation(scene, "projection"), follow=lambda p, passive: (), work=False)


def with_stabilisation(scene: Ready, stabilisation: str | Baumgarte) -> Ready:
    """Return the scene with another way to keep its loops closed."""
    return dataclasses.replace(
        scene, simulate=dataclasses.replace(scene.simulate, stabilisation=stabilisation)
    )
