"""Springs and bushings whose angle jumps at half a turn: steps end there, and the run says so."""

from __future__ import annotations

import copy
from collections.abc import Mapping

from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.graph import Scalar
from robodyn_cli.expr.rebuild import evaluate
from robodyn_cli.forces.element import half_turn_warning
from robodyn_cli.formulations.events import GO_ON, Event, EventFunction, EventKind, Outcome
from robodyn_cli.motion.motion import Motion, Watcher
from robodyn_cli.record import record


@record
class HalfTurnFunction(EventFunction):
    """Changes its sign where the angle of ``force`` jumps; ``there`` : > 0 only there (see ``forces.element``)."""

    force: str = ""
    there: Scalar = 0.0


class HalfTurns(Watcher):
    """Owns the events at which the angle of a force between bodies jumps, and warns of those that happened."""

    def __init__(self, problem: Problem) -> None:
        self.functions = tuple(
            HalfTurnFunction(
                f"forces.{name}", jump.switch, 0, EventKind.DISCONTINUITY, self, name, jump.there
            )
            for name, jump in problem.elements.half_turns
        )
        self.first: dict[str, float] = {}

    @property
    def warnings(self) -> list[str]:
        return [half_turn_warning(name, time) for name, time in self.first.items()]

    @property
    def noted(self) -> dict[str, float]:
        return dict(self.first)

    def recall(self, noted: Mapping[str, float]) -> None:
        self.first = dict(noted)

    def follow(self, motion: Motion) -> None:
        self.system = motion.system

    def handle(self, event: Event) -> Outcome:
        """Keep the time of the first jump of each force; the run goes on."""
        function = event.function
        assert isinstance(function, HalfTurnFunction)
        if function.force not in self.first:
            q, v, _ = self.system.split(event.state)
            values = {"t": [event.time], "q": q.tolist(), "v": v.tolist(), "p": []}
            if evaluate([function.there], values)[0] > 0.0:
                self.first[function.force] = event.time
        return GO_ON

    def again(self) -> HalfTurns:
        """Return the watcher of a second integration, which warns of nothing."""
        other = copy.copy(self)
        other.first = {}
        return other
