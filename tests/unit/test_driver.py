"""The one driver: owners of events decide how a run goes on; a second run watches what changes the motion."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from robodyn_cli import load_scene
from robodyn_cli.formulations.events import Event, EventFunction, EventKind, Jump, Leap, Outcome
from robodyn_cli.integrators.runtime.options import Grid, Options
from robodyn_cli.motion.build import build_motion
from robodyn_cli.motion.contact.events import Transition
from robodyn_cli.motion.contact.states import ContactStates
from robodyn_cli.motion.driver import Driver
from robodyn_cli.motion.motion import Watcher
from robodyn_cli.motion.second_run import watched_again
from robodyn_cli.tools.progress import Stopwatch
from robodyn_cli.works.deploy.deploy import build_deployment
from tests.mechanisms import CONFIGS
from tests.systems import system

FINE = Options(1e-12, 1e-14)


class At(Watcher):
    """Answers the event at a time with an outcome, and keeps what it sees."""

    def __init__(self, answer: Outcome) -> None:
        self.answer = answer
        self.handled: list[float] = []
        self.seen: list[float] = []

    def see(self, t: np.ndarray, x: np.ndarray) -> None:
        self.seen += t.tolist()

    def handle(self, event: Event) -> Outcome:
        self.handled.append(event.time)
        return self.answer


def driven(watcher: At, direction: int = 0) -> Driver:
    """Return the driver of q = sin t with a watcher whose event is at t = 1."""
    body = system(
        1,
        lambda t, q, v, z, p: [-q[0]],
        events=lambda t, q, v, z, p: [EventFunction("one", t - 1.0, direction, owner=watcher)],
    )
    found = Driver(body, "gauss", FINE, [watcher])
    found.start(0.0, np.array([0.0, 1.0]))
    return found


def test_a_leap_goes_on_behind_with_its_own_samples() -> None:
    def states(t: np.ndarray) -> np.ndarray:
        return np.stack([np.sin(t), np.cos(t)], axis=-1)

    watcher = At(Leap(2.5, states(np.array(2.5)), states))
    driver, grid = driven(watcher), Grid.over(4.0, 41)
    found = driver.samples(4.0, grid)
    assert watcher.handled == [pytest.approx(1.0, abs=1e-13)] and len(watcher.seen) == 41
    assert np.abs(found - states(grid.times(0, 41))).max() < 1e-11
    # what was taken before the leap counts too
    assert driver.counters.steps > driver.integrator.counters.steps > 0 and driver.counters.events == 1
    # a leap beyond the end ends there
    driver = driven(At(Leap(2.5, states(np.array(2.5)), states)))
    found = driver.samples(2.0, Grid.over(2.0, 21))
    assert driver.time == 2.0 and len(found) == 21
    assert np.abs(driver.state - states(np.array(2.0))).max() < 1e-11


def test_a_jump_changes_the_state_and_a_run_can_begin_anew() -> None:
    watcher = At(Jump(np.array([0.0, 0.0])))
    driver = driven(watcher)
    found = driver.samples(2.0, Grid.over(2.0, 3))
    assert np.abs(found[:, 0] - [0.0, np.sin(1.0), 0.0]).max() < 1e-11
    driver.start(0.0, np.array([0.0, 1.0]))
    assert driver.counters.steps == 0 and driver.time == 0.0


def test_a_second_run_watches_what_changes_the_motion_and_no_more() -> None:
    motion = build_deployment(load_scene(CONFIGS / "four_bar_deploy.yaml"), Stopwatch())
    assert {e.kind for e in motion.system.events} == {EventKind.RANK_LOSS, EventKind.DEAD_POINT}
    again, watchers = watched_again(motion)
    assert again.events == () and watchers == []
    bouncing = build_motion(load_scene(CONFIGS / "bouncing_pendulum.yaml"))
    again, watchers = watched_again(bouncing)
    (first,), (second,) = bouncing.watchers, watchers
    assert isinstance(first, ContactStates) and isinstance(second, ContactStates) and second is not first
    assert [e.kind for e in again.events] == [e.kind for e in bouncing.system.events]
    assert all((e.owner is second) == (e.kind is EventKind.CONTACT) for e in again.events)
    # with every event the code is that of the first run, whoever watches
    both = build_motion(load_scene(CONFIGS / "bouncing_pendulum.yaml", ["robot.joints.0.limits={upper: 3}"]))
    kinds = [e.kind for e in both.system.events]
    assert len(watched_again(both)[0].events) < len(kinds)
    every, _ = watched_again(both, every=True)
    assert [e.kind for e in every.events] == kinds and every.digest == both.system.digest
    # a joint rests where its next bounce is below the tolerance: that of the run, not of the first one
    tight = dataclasses.replace(bouncing.options, rtol=1e-13)
    Driver(again, "gauss", tight, watchers).start(0.0, bouncing.start)
    assert second.options.rtol == 1e-13 and first.log == []


def test_functions_of_contact_say_which_joint_and_what_may_follow() -> None:
    motion = build_motion(load_scene(CONFIGS / "bouncing_pendulum.yaml"))
    (contact,) = motion.watchers
    assert isinstance(contact, ContactStates)
    for function in contact.functions:
        name = contact.joints[function.joint].name
        assert function.name == f"{function.transition.value} {name}" and function.direction == -1
    assert {f.transition for f in contact.functions} >= {Transition.BREAK_HIGH, Transition.BREAK_LOW}


def test_a_plan_needs_no_start() -> None:
    scene = load_scene(CONFIGS / "double_pendulum.yaml")
    bare = dataclasses.replace(scene, initial=dataclasses.replace(scene.initial, q={}, qd={}))
    motion = build_motion(bare, plan=True)
    assert motion.start.tolist() == [0.0] * 4 and motion.choice.method == "gauss"
