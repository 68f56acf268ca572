"""Checks of the options of ``deploy``, ``kinematics`` and ``reach``, of what ``optimise`` looks for, and of margins of
motorisation."""

from __future__ import annotations

from collections.abc import Iterator

from robodyn_cli.errors import unknown_name
from robodyn_cli.expr.statements import Expectation
from robodyn_cli.scene.checks.check import Check
from robodyn_cli.scene.checks.orientation import check_orientation
from robodyn_cli.scene.checks.robot import check_joints, columns, moving
from robodyn_cli.scene.nested_options import (
    CONDITIONS,
    DeployLatch,
    KinematicDesign,
    Motorisation,
    ReachOptions,
    SearchOptions,
)
from robodyn_cli.scene.points import BASE, point_link, point_problem
from robodyn_cli.scene.robot_types import Robot
from robodyn_cli.scene.text.nodes import Path
from robodyn_cli.scene.types import Scene
from robodyn_cli.schema.fields import DRIVE, ROLES
from robodyn_cli.trajectories.led import led_joints


def check_deploy(scene: Scene, check: Check) -> None:
    """Check the options of ``deploy``."""
    options = scene.deploy
    if options.latches or check.has(("deploy", "until")):
        _check_latches(scene, check)
    with check:
        if options.after == "continue" and options.latch is None:
            check.fail(
                ("deploy", "after"), "needs a latch that holds the structure together: key 'latch' beside it"
            )
    _check_latch(scene, check)
    latch = () if options.latches else ("latch",)
    known = [*moving(scene.robot), *(loop.name for loop in scene.loops), *latch]
    for name in options.loads:
        with check:
            check.known(name, known, "joint or closure", ("deploy", "loads", name), at_key=True)
    if scene.deploy.latch is not None:
        between = scene.deploy.latch.between
        links = [link.name for link in scene.robot.links]
        for k, name in enumerate(between):
            with check:
                check.known(name, [*links, BASE], "link", ("deploy", "latch", "between", k))
        with check:
            if between[0] == between[1]:
                check.fail(
                    ("deploy", "latch", "between"), f"both are {between[0]!r}; a latch joins two links"
                )


def check_motorisation(scene: Scene, options: Motorisation, check: Check) -> None:
    """Factors are of roles, each inside or outside; joints have coordinates."""
    roles = (*(role for role in ROLES if role != DRIVE), "drive_inertia")
    for key in ("factors", "outside"):
        for name in getattr(options, key):
            with check:
                check.known(name, roles, "role", ("motorisation", key, name), at_key=True)
    for name in options.outside:
        with check:
            if name in options.factors:
                message = f"{name!r} stands in 'factors' too; allowed: in one of them"
                check.fail(("motorisation", "outside", name), message, at_key=True)
    known = columns(scene.robot, velocities=True)
    for k, name in enumerate(options.joints):
        with check:
            check.known(name, known, "joint or coordinate", ("motorisation", "joints", k))


def _check_latch(scene: Scene, check: Check) -> None:
    """A latch at a position names one coordinate, and goes with `criterion: latch`."""
    latch, chosen = scene.deploy.latch, scene.deploy.criterion == "latch"
    path: Path = ("deploy", "latch")
    given = (
        {}
        if latch is None
        else {key: getattr(latch, key) for key in ("at", "at_limit") if getattr(latch, key)}
    )
    with check:
        if chosen and not given:
            place = path if check.has(path) else ("deploy", "criterion")
            check.fail(place, "criterion 'latch' needs a position: key 'at' or 'at_limit' of 'latch'")
        if given and not chosen:
            check.fail((*path, next(iter(given))), "goes with 'criterion: latch'")
        if sum(len(names) for names in given.values()) > 1:
            check.fail(
                (*path, list(given)[-1]), "names more than one joint; allowed: one, in 'at' or 'at_limit'"
            )
        single = columns(scene.robot, quasi=False)
        for key, names in given.items():
            for name in names:
                place = (*path, key, *name.split("."))
                check.known(name, single, "joint with a coordinate", place, at_key=True)
                if key == "at_limit" and getattr(scene.robot.limits_of(name), names[name], None) is None:
                    check.fail(place, f"joint {name!r} has no such limit: key 'limits.{names[name]}'")


LATCHES: Path = ("deploy", "latches")
WITHOUT = (
    "criterion",
    "growth",
    "limit",
    "latch",
    "after",
)  # keys of one latch, which do not go with several
UNTIL = ("all", "end")


def _check_latches(scene: Scene, check: Check) -> None:
    """Check a list of latches, and what the run goes on until."""
    latches = scene.deploy.latches
    names = [latch.name for latch in latches]
    check.unique(names, "latch", [(*LATCHES, k, "name") for k in range(len(names))])
    for name in WITHOUT:
        with check:
            if latches and check.has(("deploy", name)):
                other = "; allowed: until: end" if name == "after" else ""
                check.fail(("deploy", name), f"does not go with 'latches'{other}", at_key=True)
    with check:
        if not latches:
            check.fail(("deploy", "until"), "goes with 'latches'", at_key=True)
        check.known(scene.deploy.until, [*UNTIL, *names], "latch", ("deploy", "until"))
    for k, latch in enumerate(latches):
        with check:
            if latch.name in UNTIL:
                check.fail((*LATCHES, k, "name"), f"{latch.name!r} has a meaning under 'until'")
        with check:
            _check_one_of_several(scene, latch, check, (*LATCHES, k))


def _check_one_of_several(scene: Scene, latch: DeployLatch, check: Check, path: Path) -> None:
    """Check what one latch holds, and when it closes."""
    single = columns(scene.robot, quasi=False)
    if (latch.joint is None) == (latch.between is None):
        check.fail(path, "needs one of 'joint' and 'between': what it holds")
    if latch.joint is not None:
        check.known(latch.joint, single, "joint with a coordinate", (*path, "joint"))
    links = [*(link.name for link in scene.robot.links), BASE]
    for n, link in enumerate(latch.between or ()):
        check.known(link, links, "link", (*path, "between", n))
    if latch.between is not None and latch.between[0] == latch.between[1]:
        check.fail((*path, "between"), f"both are {latch.between[0]!r}; a latch joins two links")
    given = latch.conditions
    if len(given) != 1:
        last = (*path, given[-1]) if given else path
        check.fail(
            last,
            f"says when it closes {'twice' if given else 'nowhere'}; needed: one of {', '.join(CONDITIONS)}",
        )
    for name in ("when", "release"):
        check.varies(getattr(latch, name), scene.parameters, (*path, name))
    if latch.at_dead_point and latch.side != "either":
        check.fail((*path, "side"), "does not go with 'at_dead_point'", at_key=True)
    where = getattr(latch, given[0])
    if isinstance(where, float) and latch.joint is None:
        check.fail(
            (*path, "at"), "a number is the position of the latch's own 'joint'; allowed: {JOINT: POSITION}"
        )
    if not isinstance(where, dict):
        return
    if len(where) != 1:
        check.fail((*path, given[0]), "names more than one joint; allowed: one")
    for name in where:
        place = (*path, given[0], *name.split("."))
        check.known(name, single, "joint with a coordinate", place, at_key=True)
        if given[0] == "at_limit" and getattr(scene.robot.limits_of(name), where[name], None) is None:
            check.fail(place, f"joint {name!r} has no such limit: key 'limits.{where[name]}'")


def check_kinematics(scene: Scene, check: Check) -> None:
    """Check the options of ``kinematics``."""
    options = scene.kinematics
    if options.sweep is not None:
        joint: Path = ("kinematics", "sweep", "joint")
        check_joints(scene, [(options.sweep.joint, joint)], check, at_key=False)
        with check:
            if options.sweep.start == options.sweep.stop:
                check.fail(
                    ("kinematics", "sweep", "stop"), "is where the sweep begins; allowed: another position"
                )
        with check:
            if options.sweep.joint in led_joints(scene.prescribed):
                check.fail(joint, f"the motion of {options.sweep.joint!r} is prescribed; sweep another joint")
    for k, reference in enumerate(options.transmission or ()):
        with check:
            problem = point_problem(scene.robot, reference)
            if problem is not None:
                check.fail(("kinematics", "transmission", k), problem)

    if options.design is not None:
        _check_design(scene, options.design, check)


DESIGN: Path = ("kinematics", "design")


def _check_design(scene: Scene, design: KinematicDesign, check: Check) -> None:
    """Pairs are of links, joints and points that there are, and differ."""
    robot, links = scene.robot, [*(link.name for link in scene.robot.links), BASE]
    rates = columns(robot, velocities=True)
    for key, pairs in (("poles", design.poles), ("ratios", design.ratios), ("pressure", design.pressure)):
        for name, pair in pairs.items():
            path = (*DESIGN, key, name)
            with check:
                if pair[0] == pair[1]:
                    check.fail(path, f"both are {pair[0]!r}; allowed: two that differ")
                if key == "ratios" and not (set(pair) <= set(rates) or set(pair) <= set(links)):
                    wrong = next((x for x in pair if x not in rates and x not in links), None)
                    if wrong is not None:
                        check.known(wrong, [*rates, *links], "joint or link", path)
                    check.fail(
                        path, f"{pair[0]!r} and {pair[1]!r} are a joint and a link; allowed: two alike"
                    )
                if key == "ratios" and pair[1] == BASE and BASE not in rates:
                    check.fail(path, "'base' does not turn; allowed as the second: a link that turns")
                for k, one in enumerate(pair):
                    if key == "poles":
                        check.known(one, links, "link", (*path, k))
                    elif key == "pressure" and (problem := point_problem(robot, one)) is not None:
                        check.fail((*path, k), problem)
                if key == "pressure" and point_link(robot, pair[1]) == BASE:
                    check.fail((*path, 1), f"{pair[1]!r} is fixed to the base; allowed: a point that moves")
    for k, point in enumerate(design.curves):
        with check:
            if (problem := point_problem(robot, point)) is not None:
                check.fail((*DESIGN, "curves", k), problem)
            if point_link(robot, point) == BASE:
                check.fail(
                    (*DESIGN, "curves", k), f"{point!r} is fixed to the base; allowed: a point that moves"
                )
    with check:
        if design.grashof and not scene.loops:
            check.fail((*DESIGN, "grashof"), "there is no closed chain: key 'loops' is missing")


def check_fluctuation(scene: Scene, check: Check) -> None:
    """Flywheels are on joints of one coordinate, shaking forces about points of the base, abscissas positions."""
    rates, wheel = columns(scene.robot, velocities=True, quasi=False), scene.inverse.flywheel
    named: list[tuple[str, Path]] = [
        (name, ("simulate", "fluctuation", k)) for k, name in enumerate(scene.simulate.fluctuation)
    ]
    if wheel is not None:
        named.append((wheel.joint, ("inverse", "flywheel", "joint")))
    if scene.outputs.abscissa is not None:
        named.append((scene.outputs.abscissa, ("outputs", "abscissa")))
    for name, path in named:
        with check:
            check.known(name, rates, "joint with a coordinate", path)
    about = scene.inverse.shaking
    if about is not None:
        with check:
            if (problem := point_problem(scene.robot, about)) is not None:
                check.fail(("inverse", "shaking"), problem)
            if point_link(scene.robot, about) != BASE:
                check.fail(
                    ("inverse", "shaking"),
                    f"{about!r} moves; allowed: 'base.origin', or a point on the base",
                )


REACH: Path = ("reach",)


def check_reach(robot: Robot, options: ReachOptions, check: Check) -> None:
    """Refuse a frame that does not exist or does not move, and a pose of which nothing is asked."""
    with check:
        _check_frame(robot, options.frame, check)
    if options.orientation is not None:
        check_orientation(options.orientation, check, (*REACH, "orientation"))
    with check:
        if options.position is None and options.orientation is None:
            check.fail(REACH, "asks for nothing; give 'position', 'orientation', or both")
    with check:
        if options.axis is not None and options.orientation is None:
            check.fail((*REACH, "axis"), "needs 'orientation' beside it")


def _check_frame(robot: Robot, name: str, check: Check) -> None:
    links = {link.name: link.name for link in robot.links}
    frames = {key: frame.link for key, frame in robot.frames.items()}
    link = frames.get(name) or links.get(name)
    if link is None:
        problem = point_problem(robot, name)
        if problem is not None:
            names = [*robot.points, *frames, *links, "LINK.end"]
            check.fail((*REACH, "frame"), problem if "." in name else unknown_name("frame", name, names))
        link = point_link(robot, name)
    if link == BASE:
        check.fail(
            (*REACH, "frame"),
            f"{name!r} is fixed to the base; allowed: points, frames and links that a joint moves",
        )


def check_search(options: SearchOptions, check: Check) -> None:
    """Check what ``optimise`` looks for."""
    for path, message in search_problems(options):
        with check:
            check.fail(("search", *path), message)


def search_problems(options: SearchOptions) -> Iterator[tuple[Path, str]]:
    """Yield what is wrong with a search, each with its place below it."""
    goals = [name for name in ("minimise", "maximise", "reach") if getattr(options, name)]
    if len(goals) > 1:
        yield (goals[1],), f"stands beside {goals[0]!r}; allowed: one of minimise, maximise and reach"
    for name, variation in options.vary.items():
        if variation.distribution not in ("", "uniform"):
            yield (
                ("vary", name),
                f"{variation.text!r} has no bounds to search between; allowed: uniform(low, high), or values: "
                "[a, b, ...], linspace(a, b, n), logspace(a, b, n)",
            )
    for name, wanted in options.reach.items():
        if not is_target(wanted):
            yield (
                ("reach", name),
                f"{wanted.text!r} is no value to reach; allowed: a value, 'a +- b', 'a +- b %'",
            )
    for name, kept in options.keep.items():
        if not is_inequality(kept):
            yield (
                ("keep", name),
                f"{kept.text!r} is no inequality; allowed: '<= a', '< a', '>= a', '> a', 'a .. b'; a value that an "
                "output is to have belongs to reach",
            )


def is_inequality(expected: Expectation) -> bool:
    """Tell whether an expectation leaves a number room on one side, or between two bounds."""
    return expected.numeric and "+-" not in expected.text and expected.low < expected.high


def is_target(expected: Expectation) -> bool:
    """Tell whether an expectation is a value, perhaps with a tolerance."""
    return expected.numeric and ("+-" in expected.text or expected.low == expected.high)
