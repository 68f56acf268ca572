"""The motors and gears of a catalogue that bear a motion: the cheapest or lightest at each joint."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from robodyn_cli.errors import SceneError
from robodyn_cli.joints.registry import joint_types
from robodyn_cli.motors.drive import Catalogue, Drive
from robodyn_cli.record import record
from robodyn_cli.results.result import Result
from robodyn_cli.results.summary import as_keys
from robodyn_cli.scene.load import Family
from robodyn_cli.scene.text.catalogue import EXAMPLE
from robodyn_cli.scene.types import Scene
from robodyn_cli.summaries.inverse import Sized, SizeSummary, Sizing
from robodyn_cli.tools.progress import Progress, Stopwatch, no_progress
from robodyn_cli.works.inverse import inverse
from robodyn_cli.works.size.candidates import Responses
from robodyn_cli.works.size.search import DriveSearch, Together, order_of

# combinations times samples that are evaluated for combinations of all joints together: a blink, some minutes
FEW, MANY = 2e6, 4e9
_DEFAULTS = {"gear_ratio": 1.0, "rotor_inertia": 0.0}


@record
class Wanted:
    """What is asked for.

    by : what is to be small, ``cost`` or ``mass``; the other decides between equals. margin : part of each limit that
    is to be left; default: that of each drive. types : kinds of motor to choose from; default: all. thorough : try
    combinations of all joints together until nothing cheaper (lighter) is left, or for some minutes.
    """

    by: str = "cost"
    margin: float | None = None
    types: Sequence[str] = ()
    thorough: bool = False


def size(
    scene: Scene, *, progress: Progress = no_progress, watch: Stopwatch | None = None, **wanted: Any
) -> Result:
    """Find, for each driven joint, the cheapest or lightest motor and gear of the catalogue that bear the motion.

    Driven are the joints of ``drives``, or all that have an actuator where there is no such key. The masses of the
    drives act on the links that carry them: joints are gone through from the last to the first, each with what the
    others have, until nothing changes. Then combinations of all joints together are tried for one that is cheaper
    (lighter) still, as long as that takes next to no time. Where nothing bears a joint's motion it gets what comes
    nearest.

    Parameters
    ----------
    progress : called when the work is done. watch : adds up wall times by stage. wanted : fields of ``Wanted``.

    Returns
    -------
    The result of ``inverse`` with the drives that were found, and the tables of all combinations.

    Raises
    ------
    RobodynError : see ``inverse``. SceneError : a joint says itself what drives it.
    """
    watch, asked = watch or Stopwatch(), Wanted(**wanted)
    family, settings = Family.of(scene), _settings(scene)
    scene, drives = to_size(scene, asked.margin)
    with watch.stage("responses"):
        responses = Responses.of(scene, drives)
    with watch.stage("size"):
        search, sweeps, proven = _search(responses, drives, scene.catalogue, asked, watch)
    with watch.stage("load"):
        chosen = family.scene([*settings, *_chosen(scene, search)])
    result = inverse(chosen, progress=progress, watch=watch)
    result.command, result.title = "size", scene.title or "size"
    _add_tables(result, search)
    sizing = _sizing(search, sweeps, proven, result.summary["drives"])
    result.summary = {
        **result.summary,
        **result.head,
        **as_keys(SizeSummary(sizing)),
        "wall_time_s": watch.report(),
    }
    return result


def _settings(scene: Scene) -> list[str]:
    """Return what is set in a scene before its drives are sought."""
    return [f"catalogue={json.dumps(str(EXAMPLE))}"] if scene.catalogue is None else []


def to_size(scene: Scene, margin: float | None = None) -> tuple[Scene, dict[str, Drive]]:
    """Return the scene with a catalogue, and the drives that are sought.

    Raises
    ------
    SceneError : there are none, or a joint says itself what drives it.
    """
    if settings := _settings(scene):
        scene = Family.of(scene).scene(settings)
    return scene, _asked(scene, margin)


def _search(
    responses: Responses, drives: Mapping[str, Drive], catalogue: Catalogue, asked: Wanted, watch: Stopwatch
) -> tuple[DriveSearch, int, bool]:
    """Return the search with its choice, how many sweeps it took, and whether nothing else is cheaper (lighter)."""
    catalogue = _of_types(catalogue, asked.types)
    search = DriveSearch.of(responses, drives, catalogue, asked.by)
    sweeps = search.run(watch.reach)
    # what is cheapest further out may be too heavy for what is further in
    if not search.all_pass and asked.by != "mass":
        light = DriveSearch.of(responses, drives, catalogue, "mass")
        sweeps += light.run(watch.reach)
        if light.all_pass:
            search.take(light.chosen)
    order = order_of(responses)
    if order is None:
        return search, sweeps, False
    together = Together(search, order, MANY if asked.thorough else FEW)
    together.run(watch.reach)
    if together.choice is not None and together.choice != search.chosen:
        search.take(together.choice)
    return search, sweeps, together.done and together.choice is not None


def _of_types(catalogue: Catalogue, types: Sequence[str]) -> Catalogue:
    """Return the catalogue with motors of some kinds alone, of all where none is named."""
    kept = {name: motor for name, motor in catalogue.motors.items() if not types or motor.type in types}
    return dataclasses.replace(catalogue, motors=kept)


def _asked(scene: Scene, margin: float | None) -> dict[str, Drive]:
    """Return the drives to be found by joint, with what the scene says of them.

    Raises
    ------
    SceneError : there are none, or a joint says itself what drives it.
    """
    single = [joint for joint in scene.robot.joints if joint_types[joint.type].nv == 1]
    actuated = [j.name for j in single if scene.actuated is None or j.name in scene.actuated]
    if scene.actuated is None and (scene.loops or scene.couplers):
        actuated = [name for name in actuated if name in scene.torques]
    drives = dict(scene.drives) or {name: Drive(motor="") for name in actuated}
    if not drives:
        fault = "no joint is driven; allowed: joints in 'drives', or in 'actuated'"
        raise SceneError(fault, (scene.path,), key="drives")
    for joint in single:
        if joint.name not in drives or joint.name in scene.drives:
            continue
        own = (
            "gear"
            if "gear" in dict(joint.forces)
            else "gear_ratio"
            if joint.gear_ratio != 1.0
            else "rotor_inertia"
        )
        if own == "gear" or getattr(joint, own) != _DEFAULTS[own]:
            raise SceneError(
                f"joint {joint.name!r} says by {own!r} what drives it; allowed: joints without that key, "
                "or 'drives' of other joints",
                (scene.path,),
                key=f"robot.joints.{joint.name}.{own}",
            )
    if margin is not None:
        drives = {name: dataclasses.replace(drive, margin=margin) for name, drive in drives.items()}
    return drives


def _chosen(scene: Scene, search: DriveSearch) -> list[str]:
    """Return the settings of the scene that say what was found."""
    settings = []
    for name in search.candidates:
        drive = search.train(name).drive
        keys = {"motor": drive.motor, "gear": drive.gear, "margin": repr(drive.margin)}
        if name in scene.drives:
            settings += [f"drives.{name}.{key}={'null' if x is None else x}" for key, x in keys.items()]
        else:
            written = ", ".join(f"{key}: {x}" for key, x in keys.items() if x is not None)
            settings.append(f"drives.{name}={{{written}}}")
    return settings


def _sizing(
    search: DriveSearch, sweeps: int, proven: bool, figures: Mapping[str, Mapping[str, Any]]
) -> Sizing:
    """Return what was found; ``figures`` : of the run with it, by joint."""
    joints, differences = {}, []
    for name, one in search.candidates.items():
        margins = search.margins(name)
        differences.append(abs(float(margins.flat[search.chosen[name]]) - figures[name]["margin"]))
        passing = int(np.count_nonzero(margins >= one.drive.margin))
        joints[name] = Sized(
            margins.size, passing, search.best(name), search.front(name), list(one.motors), list(one.gears)
        )
    return Sizing(
        by=search.by,
        proven=proven,
        cost=sum(search.figure(name, "costs") for name in joints),
        mass=sum(search.figure(name, "masses") for name in joints),
        sweeps=sweeps,
        margin_difference=max(differences),
        joints=joints,
    )


def _add_tables(result: Result, search: DriveSearch) -> None:
    """Add the table of combinations of each joint: a row each, in the order of the catalogue."""
    for name, one in search.candidates.items():
        motor, gear = np.indices(one.costs.shape)
        margins = search.margins(name)
        columns = (motor, gear, one.costs, one.masses, np.where(one.usable, margins, np.nan))
        result.add(f"candidates/{name}", np.column_stack([x.ravel() for x in columns]))
