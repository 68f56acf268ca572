"""``simulate.stabilisation: baumgarte`` without numbers: the gains chosen, and the scene that has them."""

from __future__ import annotations

import dataclasses
from typing import Any

from robodyn_cli.errors import CapabilityError
from robodyn_cli.formulations.index1 import index1
from robodyn_cli.run.driver.baumgarte import GainStudy
from robodyn_cli.run.driver.method import choose
from robodyn_cli.run.driver.prepare import Setup, options_for, prepare
from robodyn_cli.run.stopwatch import Stopwatch
from robodyn_cli.scene.types import Baumgarte, Scene

AUTOMATIC = "baumgarte"


def study(scene: Scene, setup: Setup, method: str | None = None) -> GainStudy:
    """Return a study of the gains of a scene with loops, for the method and tolerances that it asks for.

    Raises
    ------
    CapabilityError : rows of the loops depend on each other (``problem.dependent``): which of them are fed back
        changes on the way, and gains studied for some say nothing of the others.
    """
    if setup.problem.dependent:
        raise CapabilityError(
            "simulate.stabilisation: Baumgarte's gains are not chosen where rows of the loops depend on each other; "
            "allowed: projection, none, Baumgarte's {alpha, beta}"
        )
    options = options_for(scene)
    system = index1(setup.problem, "projection", work=False)
    start = system.join(setup.assembled.q, setup.assembled.v)
    if method is None:
        method = choose(scene, setup.problem, system, start, options).method
    return GainStudy(setup.problem, system, start, scene.simulate.duration, options, method)


def with_gains(scene: Scene, watch: Stopwatch) -> tuple[Scene, dict[str, Any] | None]:
    """Return the scene with Baumgarte's gains chosen where it leaves that to us, and what was found on the way."""
    if scene.simulate.stabilisation != AUTOMATIC or not (scene.loops or scene.couplers):
        return scene, None
    with watch.stage("gains"):
        setup = prepare(scene, modes=True)
        if setup.problem.gates:
            raise CapabilityError(
                "simulate.stabilisation: the runs that choose Baumgarte's gains do not follow joints that stick or "
                "meet rigid stops; allowed: projection, none, Baumgarte's {alpha, beta}"
            )
        found = study(scene, setup).choose()
    gains = Baumgarte(alpha=found.alpha, beta=found.beta)
    changed = dataclasses.replace(scene.simulate, stabilisation=gains)
    return dataclasses.replace(scene, simulate=changed), found.as_dict()
