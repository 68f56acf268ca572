"""Solvers side by side: each runs in a thread of its own and asks for points, which are made together."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from queue import SimpleQueue
from typing import Any, Generic, TypeVar

Question = TypeVar("Question")
Reply = TypeVar("Reply")
Outcome = TypeVar("Outcome")


class StoppedLane(BaseException):
    """The search has ended: a solver goes no further."""


class Lanes(Generic[Question, Reply, Outcome]):
    """Runs solvers until all have ended.

    As each waits until the questions of all are answered, what is asked does not depend on which thread is quick.

    Parameters
    ----------
    answer : gives the replies to the questions of those solvers that have one, in the order of the solvers. It is
    called in the thread that calls ``run``, like all that makes runs. tell : is told there how many solvers have
    ended, each time that questions are answered.
    """

    def __init__(
        self,
        answer: Callable[[Sequence[Question]], Sequence[Reply]],
        tell: Callable[[int], None] = lambda ended: None,
    ) -> None:
        self._answer, self._tell = answer, tell
        self._inbox: SimpleQueue[tuple[int, Any]] = SimpleQueue()

    def run(self, solvers: Sequence[Callable[[Callable[[Question], Reply]], Outcome]]) -> list[Outcome]:
        """Return what each solver returns; it is given a function that answers its questions.

        Raises
        ------
        Whatever a solver, or ``answer``, raises.
        """
        replies: list[SimpleQueue[Any]] = [SimpleQueue() for _ in solvers]
        outcomes: list[Any] = [None] * len(solvers)
        faults: list[BaseException] = []

        def lane(k: int) -> None:
            def ask(question: Question) -> Reply:
                self._inbox.put((k, question))
                reply = replies[k].get()
                if isinstance(reply, StoppedLane):
                    raise reply
                given: Reply = reply
                return given

            try:
                outcomes[k] = solvers[k](ask)
            except StoppedLane:
                pass
            except BaseException as fault:
                faults.append(fault)
            finally:
                self._inbox.put((k, END))

        for k in range(len(solvers)):
            threading.Thread(target=lane, args=(k,), daemon=True).start()
        live = set(range(len(solvers)))
        try:
            while live:
                for k, reply in self._round(live):
                    replies[k].put(reply)
                self._tell(len(solvers) - len(live))
        except BaseException:
            for k in live:
                replies[k].put(StoppedLane())
            raise
        if faults:
            raise faults[0]
        return outcomes

    def _round(self, live: set[int]) -> list[tuple[int, Reply]]:
        """Wait until each live solver has a question or has ended; return the replies."""
        waiting: dict[int, Question] = {}
        while len(waiting) < len(live):
            k, question = self._inbox.get()
            if question is END:
                live.discard(k)
            else:
                waiting[k] = question
        lanes = sorted(waiting)
        return list(zip(lanes, self._answer([waiting[k] for k in lanes]))) if lanes else []


END = object()
