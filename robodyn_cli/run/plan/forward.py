"""The plan of ``simulate`` and ``deploy``: the accelerations, and the other programs of a step."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator
from functools import cached_property
from typing import Any

from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.graph import Expr, Scalar, count_operations, free_symbols, is_nonzero
from robodyn_cli.formulations.build import build_system
from robodyn_cli.formulations.events import EventFunction
from robodyn_cli.formulations.residual import Residual
from robodyn_cli.formulations.rolled import Rolled
from robodyn_cli.formulations.system import System
from robodyn_cli.integrators.registry import methods
from robodyn_cli.integrators.stepping.stepper import Method
from robodyn_cli.integrators.stepping.writer import LANES
from robodyn_cli.kernels.lower import INLINE_LIMIT
from robodyn_cli.kernels.samples import SampleKernel
from robodyn_cli.run.deploy.deploy import build_deployment
from robodyn_cli.run.driver.build import build_motion
from robodyn_cli.run.observation.evaluation import SampleFunction
from robodyn_cli.run.observation.observe import observed
from robodyn_cli.run.plan.programs import Entry, rolled, rolled_step, sampled, stepped
from robodyn_cli.run.plan.terms import Equations, Ledger, Term
from robodyn_cli.run.plan.variant import Symbols
from robodyn_cli.run.plan.variants import general_drives, one_pin, one_prescribed, serial_chain, without_loops
from robodyn_cli.run.plan.words import listed
from robodyn_cli.run.stopwatch import Stopwatch
from robodyn_cli.scene import types as sc

PROJECTION = "projection"


class Forward:
    """A simulation of one scene as ``build_motion`` builds it."""

    def __init__(self, scene: sc.Scene, command: str) -> None:
        if command == "deploy":
            self.motion = build_deployment(scene, Stopwatch(), plan=True)
        else:
            self.motion = build_motion(scene, plan=True)
        self.problem, self.system = self.motion.problem, self.motion.system
        self.redundant = tuple(self.motion.assembled.redundant)
        self.stabilisation = self.motion.scene.simulate.stabilisation

    @cached_property
    def method(self) -> Method:
        return methods[self.motion.choice.method]

    @cached_property
    def residual(self) -> Residual | None:
        """The accelerations as corrections of a guess, where the method works with those."""
        return self.method.residual_of(self.system)

    def outputs(self, problem: Problem, work: bool = True) -> list[Scalar]:
        """Return the right-hand side that is integrated: accelerations and the work's rate."""
        wanted = problem.scene.simulate.stabilisation
        # projection is a program of its own; the accelerations are the same without it
        system = build_system(problem, "none" if wanted == PROJECTION else wanted, work=work, expanded=True)
        return system.rates

    # -- kernels --------------------------------------------------------------------------------------
    def kernels(self) -> list[Entry]:
        """Describe the compiled programs: those of the stepping loop, then those of samples and events."""
        motion = self.motion
        for watcher in motion.watchers:
            watcher.follow(motion)
        # before the programs of the method, as a run has it, so that they are numbered alike
        kernels: dict[str, SampleKernel | SampleFunction] = dict(motion.observer.kernels)
        found = self._rates()
        s = self.system
        for name, program in (
            ("positions back on the joints' manifolds", s.normal_form),
            ("projection of positions", s.positions),
            ("projection of velocities", s.velocities),
        ):
            if program is not None:
                found.append(stepped(name, program))
        if s.switching is not None:
            found.append(stepped("events", s.switching, "times", LANES))
        if isinstance(s.dynamics, Rolled):
            found.append(rolled("accelerations at the samples", s.dynamics.plan, s.dynamics.operations))
        for watcher in motion.watchers:
            kernels |= watcher.kernels
        for name, kernel in kernels.items():
            entry = sampled(name, kernel.program, kernel.compiled)
            if entry["digest"] not in {other["digest"] for other in found}:  # the same code in another loop
                found.append(entry)
        return found

    def _rates(self) -> list[Entry]:
        """Describe the programs that the method evaluates in its steps."""
        if isinstance(self.system.dynamics, Rolled):
            return [rolled_step("accelerations", self.system.dynamics, self.method.lanes)]
        programs = self.method.programs(self.system)
        return [stepped(p.name, p.program, "state" if p.lanes == 1 else "stages", p.lanes) for p in programs]

    # -- terms ----------------------------------------------------------------------------------------
    def terms(self, equations: Equations) -> Iterator[Term]:
        """Yield the solution for the accelerations, drives, stabilisation, work, events and samples."""
        yield self._solution()
        if not self.problem.model.loops:
            yield equations.left_out(
                "closed loops and their multipliers",
                "the joints form an open chain or tree; counted: what a single pin from "
                f"{self.problem.model.bodies[-1].name} to the base would add",
                one_pin(equations.here, equations.plane),
            )
        yield from self._drives(equations)
        yield from self._stabilisation(equations)
        yield from self._redundant_rows(equations)
        yield self._manifolds()
        yield self._work(equations)
        yield from self._events()
        yield self._samples()
        wanted = self.problem.scene.simulate.error_estimate
        again = "a second, tighter integration by the same code"
        yield Term("error estimate", wanted, again if wanted else "simulate.error_estimate is false")

    def _solution(self) -> Term:
        problem = self.problem
        given: list[Scalar] = [
            *(problem.applied - problem.bias),
            *problem.psi.flat,
            *problem.constraints.gamma,
        ]
        return Term(
            "mass matrix and the solution for the accelerations",
            True,
            "accelerations are what is integrated",
            count_operations(self.outputs(problem)) - count_operations(given),
        )

    def _drives(self, e: Equations) -> Iterator[Term]:
        here, driven, given = e.here, self.problem.scene.torques, self.problem.scene.prescribed
        yield e.either(
            "actuator torques", driven, f"given for {listed(driven)}", "no joint has one",
            here.with_scene(torques={}), general_drives(here),
        )  # fmt: skip
        yield e.either(
            "prescribed motion", given, f"given for {listed(given)}, by a row each", "no joint's motion is prescribed",
            here.with_scene(prescribed={}), one_prescribed(here),
        )  # fmt: skip
        timed = any(s.value[1] == "t" for s in free_symbols(self.outputs(self.problem)))
        yield Term(
            "time as an input", timed, "the rates depend on t" if timed else "nothing depends on t explicitly"
        )

    def _redundant_rows(self, e: Equations) -> Iterator[Term]:
        if not self.redundant:
            return
        reason = f"{listed(self.redundant)} follow from the other rows in every pose"
        if not self.problem.dependent:
            yield e.left_out("redundant rows", reason, dataclasses.replace(e.here, rows=None))
            return
        working, given = self.problem.independent_rows, self.problem.constraints
        combined = [*working.psi(self.problem.model.nv).flat, *working.gamma]
        work = count_operations(combined) - count_operations([*self.problem.psi.flat, *given.gamma])
        reason += ": all rows are solved together, with multipliers of least norm"
        yield Term("combination of dependent rows", True, reason, work)

    def _stabilisation(self, e: Equations) -> Iterator[Term]:
        """Yield projection, or what takes its place, and Baumgarte's terms."""
        if not self.problem.constraints.rows:
            yield Term("stabilisation of constraints", False, "there are none, so nothing can drift")
            return
        s, gains = self.system, self.stabilisation
        damped = isinstance(gains, sc.Baumgarte)
        name = "projection of positions and velocities"
        if s.positions is not None:
            reason = "keeps the loops closed to rounding; in programs of its own, once a step"
            yield Term(name, True, reason, _operations(s))
        else:
            asked = "Baumgarte's terms" if damped else gains
            reason = f"simulate.stabilisation asks for {asked}"
            yield Term(name, False, reason, _operations(build_system(self.problem, PROJECTION)))
        symbols = Symbols(e.model.graph)
        other = "none" if damped else sc.Baumgarte(alpha=symbols.one(), beta=symbols.one())
        simulate = dataclasses.replace(self.problem.scene.simulate, stabilisation=other)
        variant = e.here.with_scene(simulate=simulate)
        if damped:
            yield e.kept("Baumgarte's terms", "asked for in simulate.stabilisation", variant)
        else:
            reason = "projection leaves no drift to damp" if gains == PROJECTION else "not asked for"
            yield e.left_out("Baumgarte's terms", reason, variant)

    def _manifolds(self) -> Term:
        program, name = self.system.normal_form, "positions back on the joints' manifolds"
        if program is None:
            return Term(name, False, "every value of the positions is a position of the joints")
        joints = [b.joint_name for b in self.problem.model.bodies if b.joint.quasi]
        return Term(name, True, f"of {listed(joints)}, once a step", program.operations)

    def _work(self, e: Equations) -> Term:
        """Return the work integral, with the forces that do work."""
        p, name = self.problem, "work integral"
        if not self.system.further:
            driven = general_drives(e.here).problem()
            more, less = (count_operations(self.outputs(driven, work)) for work in (True, False))
            return Term(
                name,
                False,
                "no force but gravity and springs does work: energy itself is conserved",
                more - less,
            )
        doing = {
            "actuators": any(is_nonzero(x) for x in p.actuator_torques),
            "friction, dampers or stops": bool(p.dissipated),
            "forces on points and between bodies": isinstance(p.elements.power, Expr),
            "prescribed motion": bool(p.constraints.rheonomic),
            "impacts on rigid stops": any(joint.stops for joint in p.contact_joints),
        }
        who = listed(name for name, works in doing.items() if works)
        less = count_operations(self.outputs(p, work=False))
        reason = f"what the energy is balanced against: work of {who}"
        return Term(name, True, reason, count_operations(self.outputs(p)) - less)

    def _events(self) -> Iterator[Term]:
        """Yield the event functions of the system, by name; ``kind`` gives the reason."""
        events = self.system.events
        watched: dict[str, list[EventFunction]] = {}
        for event in events:
            watched.setdefault(title_of(event), []).append(event)
        for title, same in watched.items():
            reason = f"watched, in a program of its own: {same[0].kind.value}"
            yield Term(title, True, reason, count_operations([event.value for event in same]))
        if not events:
            nothing = "no formula switches with the state and no joint sticks or meets a rigid stop"
            if not self.problem.model.closures:
                nothing += "; an open chain has no singular poses"
            yield Term("events", False, nothing)

    def _samples(self) -> Term:
        problem = self.problem
        everything = [x for entries in observed(problem).values() for x in entries]
        return Term(
            "energies, points and multipliers at the samples",
            True,
            "in the result; evaluated at the samples only, not in the stepping loop",
            count_operations(everything) - count_operations(list(problem.forward.qdd)),
        )

    # -- choices --------------------------------------------------------------------------------------
    def choices(self) -> list[Entry]:
        """Describe the choices of the engine, and the alternatives."""
        choice = self.motion.choice
        found = [self._solver(), {"choice": "integrator", "taken": choice.method, "reason": choice.reason}]
        dynamics = self.system.dynamics
        if isinstance(dynamics, Rolled):
            nv = self.problem.model.nv
            return [*found, {
                "choice": "right-hand side in the stepping loop", "taken": "loops over the bodies",
                "reason": f"{nv} joints: straight-line code would take longer to compile than to run",
                "operations": {"loops over the bodies": dynamics.operations},
            }]  # fmt: skip
        size = dynamics.program.operations
        if self.residual is not None:
            corrected = self.residual.correction.operations
            found.append({
                "choice": "accelerations in the stages", "taken": "corrections by inverse dynamics",
                "reason": "fewer operations over the rounds of a step",
                "operations": {
                    "corrections by inverse dynamics": corrected,
                    "forward dynamics": size,
                    "factors of the mass matrix, once": self.residual.factors.operations,
                },
            })  # fmt: skip
            size = corrected
        inline = size <= INLINE_LIMIT
        found.append({
            "choice": "right-hand side in the stepping loop", "taken": "inlined" if inline else "function",
            "reason": f"{size} operations, {'not more' if inline else 'more'} than {INLINE_LIMIT}",
        })  # fmt: skip
        return found

    def _solver(self) -> Entry:
        """Describe how the equations are solved for the accelerations."""
        problem, what = self.problem, "accelerations"
        if problem.has_multipliers:
            taken, reason = "factored mass matrix", "the multipliers need the factor of M"
            return {"choice": what, "taken": taken, "reason": reason}
        ways = problem.ways_to_accelerations(problem.applied - problem.bias)
        counts = {name: count_operations(list(qdd)) for name, qdd in ways.items()}
        reason = "fewer operations"
        if len(counts) == 1:
            reason = f"{problem.model.nv} joints: the factored mass matrix grows with their cube"
        return {
            "choice": what,
            "taken": min(counts, key=counts.__getitem__),
            "reason": reason,
            "operations": counts,
        }

    def equation_36(self, ledger: Ledger) -> dict[str, Any] | None:
        """Return the operations of the loops: of the open tree, the open chain of as many joints, loops,
        projection."""
        if not self.problem.model.loops:
            return None
        tree = ledger.operations(without_loops(ledger.here))
        chain = ledger.operations(serial_chain(ledger.here))
        s = self.system
        return {
            "operations": ledger.total,
            "rows": list(self.problem.constraints.names),
            "open_tree": tree,
            "loop_terms": None if tree is None else ledger.total - tree,
            "open_chain_of_as_many_joints": chain,
            "ratio": round(ledger.total / chain, 3) if chain else None,
            "projection_of_positions": s.positions.operations if s.positions else 0,
            "projection_of_velocities": s.velocities.operations if s.velocities else 0,
            "events": s.switching.operations if s.switching else 0,
        }


def title_of(event: EventFunction) -> str:
    """Return the name of an event function in the plan; those that differ by a number share an entry."""
    return f"event: {re.sub(r'[.][0-9]+$', '', event.name).replace('_', ' ')}"


def _operations(system: System) -> int:
    """Of the projection of positions and velocities."""
    return sum(program.operations for program in (system.positions, system.velocities) if program is not None)
