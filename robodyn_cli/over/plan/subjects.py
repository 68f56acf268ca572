"""The plans of ``simulate``, ``deploy`` and ``inverse``: accelerations or torques, and the other programs."""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
import re
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from typing import Any

from robodyn_cli.decision import Decision
from robodyn_cli.equations.problem import DENSE_LIMIT, Problem
from robodyn_cli.errors import CapabilityError
from robodyn_cli.expr.graph import Scalar, count_operations, free_symbols
from robodyn_cli.formulations.build import build_system, expanded_rates
from robodyn_cli.formulations.events import EventFunction
from robodyn_cli.formulations.rolled import Rolled
from robodyn_cli.formulations.system import System
from robodyn_cli.given.motion import point_task
from robodyn_cli.integrators.registry import methods
from robodyn_cli.kernels.crossover import CROSSOVER
from robodyn_cli.kernels.lower import LANES
from robodyn_cli.kernels.program import make_program
from robodyn_cli.motion.build import build_motion
from robodyn_cli.motion.motion import Motion
from robodyn_cli.observe.evaluation import SampleFunction
from robodyn_cli.observe.observe import observed
from robodyn_cli.over.plan.plane import at_samples, in_steps
from robodyn_cli.over.plan.terms import Ledger, PlanEquations, Term
from robodyn_cli.over.plan.text import listed, plural
from robodyn_cli.over.plan.variants import (
    Variant,
    general_drives,
    one_pin,
    one_prescribed,
    serial_chain,
    without_loops,
)
from robodyn_cli.ready.integrable import integrable
from robodyn_cli.scene import types as sc
from robodyn_cli.summaries.checks import Kernel, LoopCosts
from robodyn_cli.tools.progress import Stopwatch
from robodyn_cli.torques.dynamics import InverseDynamics
from robodyn_cli.trajectories.base import TaskSpaceTrajectory
from robodyn_cli.works.inverse import program_of


def solver(problem: Problem) -> Decision:
    """Return the way that ``Problem.forward`` takes, and why."""
    quantity = "accelerations"
    if problem.constraints.rows or problem.is_held:
        reason = "the multipliers need the factor of M"
        if problem.braces:
            reason += "; inertias along the rows of the loops, since the opened tree's M has no inverse or a bad one"
        return Decision(quantity, "factored mass matrix", reason)
    if problem.model.nv > DENSE_LIMIT:
        reason = f"{problem.model.nv} joints: the factored mass matrix grows with their cube"
        name = "articulated bodies"
        return Decision(quantity, name, reason, {name: count_operations(list(problem.forward.qdd))})
    ways = problem.ways_to_accelerations(problem.applied - problem.bias)
    counts = {name: count_operations(list(a)) for name, a in ways.items()}
    return Decision(quantity, min(counts, key=counts.__getitem__), "fewer operations", counts)


PROJECTION = "projection"
WORK = "work integral"


class Forward:
    """A simulation of one scene as the command builds it."""

    inner = "accelerations"

    def __init__(self, scene: sc.Scene) -> None:
        self.motion = self.built(scene)
        self.problem, self.system = self.motion.problem, self.motion.system
        self.redundant = tuple(self.motion.assembled.redundant)

    def built(self, scene: sc.Scene) -> Motion:
        """Return what the command integrates."""
        return build_motion(integrable(scene), plan=True)

    def outputs(self, problem: Problem) -> list[Scalar]:
        """Return the right-hand side that is integrated: accelerations and the work's rate."""
        return [*itertools.chain(*self._rates(problem))]

    def _rates(self, problem: Problem) -> tuple[list[Scalar], list[Scalar]]:
        """Return the rates of all states but the work, and that of the work where there is any."""
        wanted = problem.scene.simulate.stabilisation
        # projection is a program of its own; the accelerations are the same without it
        return expanded_rates(problem, "none" if wanted == PROJECTION else wanted)

    def apart(self, here: Variant) -> dict[str, int]:
        """Return the operations of the work integral, where nothing does work here: with a torque in each joint."""
        if self.system.work_done_by:
            return {}
        with here.apart() as own:
            return {WORK: self._of_work(general_drives(own).problem())}

    def kernels(self) -> list[Kernel]:
        """Return the compiled programs: those of the stepping loop, then those of samples and events."""
        motion, s = self.motion, self.system
        for watcher in motion.watchers:
            watcher.follow(motion)
        # before the programs of the method, as a run has it, so that they are numbered alike
        observed_by = dict(motion.observer.kernels)
        method = methods[motion.choice.method]
        if isinstance(s.dynamics, Rolled):
            programs = [in_steps("accelerations", s.dynamics, method.lanes)]
        else:
            programs = [in_steps(p.name, p.program, p.lanes, p.hold) for p in method.programs(s)]
        for name, program in s.programs.items():
            lanes = LANES if program is s.switching else 1
            programs.append(in_steps(name, program, lanes, "times"))
        if isinstance(s.dynamics, Rolled):
            beside = s.dynamics.program.operations
            programs.append(at_samples("accelerations at the samples", s.dynamics.plan, beside=beside))
        kernels = itertools.chain(
            observed_by.items(), *(watcher.kernels.items() for watcher in motion.watchers)
        )
        programs += [at_samples(name, kernel.program, kernel.compiled) for name, kernel in kernels]
        once: dict[str, Kernel] = {}
        for kernel in programs:  # some have the same code, in another loop
            once.setdefault(kernel.digest, kernel)
        return list(once.values())

    def choices(self) -> list[Decision]:
        """Return the decisions of the builders."""
        taken = self.motion.choice
        integrator = Decision("integrator", taken.method, taken.reason)
        return [solver(self.problem), integrator, *methods[taken.method].choices(self.system)]

    # -- terms ----------------------------------------------------------------------------------------
    def terms(self, e: PlanEquations) -> Iterator[Term]:
        """Yield the solution for the accelerations, drives, stabilisation, work, events and samples."""
        p = self.problem
        given = [*(p.applied - p.bias), *p.psi.flat, *p.constraints.gamma]
        work = count_operations(self.outputs(p)) - count_operations(given)
        name = "mass matrix and the solution for the accelerations"
        yield Term(name, True, "accelerations are integrated", work)
        if not p.model.loops:
            reason = "the joints form an open chain or tree; counted: operations of a single pin from "
            reason += f"{p.model.bodies[-1].name} to the base"
            yield e.left_out("closed loops and their multipliers", reason, one_pin(e.here, e.plane))
        yield from self._drives(e)
        yield from self._stabilisation(e)
        yield from self._redundant_rows(e)
        yield self._manifolds()
        yield self._work(e)
        yield from self._events()
        everything = count_operations([x for entries in observed(p).values() for x in entries])
        yield Term(
            "energies, points and multipliers at the samples",
            True,
            "in the result; evaluated at the samples only, not in the stepping loop",
            everything - count_operations(list(p.forward.qdd)),
        )
        wanted = p.scene.simulate.error_estimate
        again = "a second, tighter integration by the same code"
        yield Term("error estimate", wanted, again if wanted else "simulate.error_estimate is false")

    def _drives(self, e: PlanEquations) -> Iterator[Term]:
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
        reason = "the rates depend on t" if timed else "nothing depends on t explicitly"
        yield Term("time as an input", timed, reason)

    def _stabilisation(self, e: PlanEquations) -> Iterator[Term]:
        """Yield projection, or what takes its place, and Baumgarte's terms."""
        if not self.problem.constraints.rows:
            yield Term("stabilisation of constraints", False, "there are none, so nothing can drift")
            return
        gains = self.motion.scene.simulate.stabilisation
        damped = isinstance(gains, sc.Baumgarte)
        name, kept = "projection of positions and velocities", self.system.positions is not None
        reason = f"simulate.stabilisation asks for {'Baumgarte terms' if damped else gains}"
        if kept:
            reason = "keeps the loops closed to rounding; in programs of its own, once a step"
        work = _projection(self.system if kept else build_system(self.problem, PROJECTION))
        yield Term(name, kept, reason, work)
        s = e.here.symbols
        other = "none" if damped else sc.Baumgarte(alpha=s.one(), beta=s.one())
        simulate = dataclasses.replace(self.problem.scene.simulate, stabilisation=other)
        why_not = "projection leaves no drift to damp" if gains == PROJECTION else "not asked for"
        variant = e.here.with_scene(simulate=simulate)
        yield e.either(
            "Baumgarte's terms", damped, "asked for in simulate.stabilisation", why_not, variant, variant
        )

    def _redundant_rows(self, e: PlanEquations) -> Iterator[Term]:
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

    def _manifolds(self) -> Term:
        program, name = self.system.normal_form, "positions back on the joints' manifolds"
        if program is None:
            return Term(name, False, "every value of the positions is a position of the joints")
        joints = [b.joint_name for b in self.problem.model.bodies if b.joint.quasi]
        return Term(name, True, f"of {listed(joints)}, once a step", program.operations)

    def _work(self, e: PlanEquations) -> Term:
        doers = self.system.work_done_by
        work = self._of_work(self.problem) if doers else e.apart[WORK]
        reason = "no force but gravity and springs does work: energy itself is conserved"
        if doers:
            reason = f"balance of the energy: work of {listed(doers)}"
        return Term(WORK, bool(doers), reason, work)

    def _of_work(self, problem: Problem) -> int:
        rates, power = self._rates(problem)
        return count_operations([*rates, *power]) - count_operations(rates)

    def _events(self) -> Iterator[Term]:
        """Yield the event functions of the system; those that differ by a number share an entry."""
        titles = {event: title_of(event) for event in self.system.events}
        for title in dict.fromkeys(titles.values()):
            same = [event for event in titles if titles[event] == title]
            reason = f"watched, in a program of its own: {same[0].kind.value}"
            yield Term(title, True, reason, count_operations([event.value for event in same]))
        if not titles:
            nothing = "no formula switches with the state and no joint sticks or meets a rigid stop"
            if not self.problem.model.closures:
                nothing += "; an open chain has no singular poses"
            yield Term("events", False, nothing)

    def equation_36(self, ledger: Ledger) -> LoopCosts | None:
        """Return what the loops cost, None where there are none."""
        if not self.problem.model.loops:
            return None
        tree = ledger.operations(without_loops(ledger.here))
        chain = ledger.operations(serial_chain(ledger.here))
        s = self.system
        return LoopCosts(
            ledger.total,
            list(self.problem.constraints.names),
            tree,
            None if tree is None else ledger.total - tree,
            chain,
            round(ledger.total / chain, 3) if chain else None,
            *(
                0 if program is None else program.operations
                for program in (s.positions, s.velocities, s.switching)
            ),
        )


class ForwardUntilLock(Forward):
    """A deployment of one scene as the command builds it."""

    def built(self, scene: sc.Scene) -> Motion:
        from robodyn_cli.works.deploy.deploy import build_deployment

        return build_deployment(scene, Stopwatch(), plan=True)


def title_of(event: EventFunction) -> str:
    """Return the name of an event function in the plan, without a number at its end."""
    return f"event: {re.sub(r'[.][0-9]+$', '', event.name).replace('_', ' ')}"


def _projection(system: System) -> int:
    """Return the operations of the projection of positions and velocities."""
    return sum(p.operations for p in (system.positions, system.velocities) if p is not None)


class InversePlan:
    """The programs of inverse dynamics of one scene."""

    inner = "torques"
    redundant: tuple[str, ...] = ()

    def __init__(self, scene: sc.Scene) -> None:
        self.fastest = scene.trajectory is not None and scene.trajectory.least_time
        self.program = program_of(scene)
        scene = self.program.problem.scene
        # equations of their own, for counts that the run does not need
        self.problem = Problem(scene)
        leads = isinstance(scene.trajectory, TaskSpaceTrajectory) and not self.problem.model.closures
        self.task = point_task(self.program.problem) if leads else None

    @cached_property
    def function(self) -> SampleFunction:
        """All that is evaluated at the samples."""
        return self.program.compile(self.problem.scene.inverse.samples)

    @cached_property
    def torques(self) -> InverseDynamics | None:
        """The torques as a function of samples, None where there is no such function."""
        with contextlib.suppress(CapabilityError):  # loops, loads in time
            return InverseDynamics(self.problem, eager=False)
        return None

    def outputs(self, problem: Problem) -> list[Scalar]:
        """Return the load on actuators and loops, and the rows of the loops, which share it."""
        tau: Any = problem.inverse_dynamics
        for term in problem.passive_forces(smooth=False).values():
            tau = tau - term
        rows = problem.constraints.loop_rows
        return [*tau, *(x for row in rows for x in row.psi)]

    def apart(self, here: Variant) -> dict[str, int]:
        """Return nothing: all that is counted are variants."""
        return {}

    def kernels(self) -> list[Kernel]:
        """Return the compiled programs."""
        programs, title = [], "torque terms, energies, places"
        if self.problem.model.closures:
            title = "torque terms, rows of the loops, energies, places"
        if self.torques is not None:
            code = self.torques.code
            beside = self.torques.operations - code.operations
            programs.append(at_samples("torques (InverseDynamics)", code, beside=beside))
        programs.append(at_samples(title, self.function.program, self.function.compiled))
        if self.task is not None and self.task.method == "newton":
            point = make_program(dict(self.task.kinematics().outputs()), ("q", "v"))
            programs.append(at_samples(f"kinematics of {self.task.trajectory.point}", point))
        return programs

    def choices(self) -> list[Decision]:
        """Return the decisions of the builders."""
        decisions = [self.function.decision]
        if self.torques is not None:
            joints = plural(self.problem.model.nv, "joint")
            reason = f"{joints}; a loop over the bodies pays from {CROSSOVER} on"
            decisions.append(Decision("shape of the torque kernel", self.torques.shape, reason))
        return decisions

    def terms(self, e: PlanEquations) -> Iterator[Term]:
        """Yield the stages around the torques."""
        program, model = self.program, self.program.problem.model
        less = dataclasses.replace(e.here, accelerations=False)
        yield e.kept("inertia forces", "the masses are accelerated", less)
        if not model.closures:
            reason = "the joints form an open chain or tree: every torque follows from the motion alone"
            yield Term("closed loops and their multipliers", False, reason)
        if program.problem.scene.torques:
            yield Term("actuator torques of the scene", False, "inverse dynamics finds them")
        split = _operations(program.terms)
        together = count_operations(self.outputs(self.problem)[: model.nv])
        reason = f"the result has them apart: {listed(program.terms)}"
        yield Term("torques split into terms", True, reason, max(0, split - together))
        places = [(len(model.points), "named point"), (len(model.frames), "frame")]
        what = ["energies", *(plural(n, what) for n, what in places if n), "outlines of the links"]
        reason = f"in the result: {', '.join(what)}"
        yield Term("energies, points and outlines", True, reason, _operations(program.outputs) - split)
        yield self._motion()
        if self.fastest:
            yield Term(
                "time law", True, "as fast as the limits allow: two passes over a grid, before the samples"
            )
        if self.task is not None and self.task.chosen:
            yield Term(
                "search for the first pose", True, "of those that reach the path's start, before the samples"
            )
        yield Term("integration, events, projection", False, "the motion is given: nothing is integrated")

    def _motion(self) -> Term:
        """Return how the motion of all joints is found."""
        problem = self.program.problem
        name, rows = "inverse kinematics", problem.constraints.rows
        if problem.model.closures:
            work = count_operations([x for row in rows for x in (row.eta, *row.psi, row.gamma, row.eta_t)])
            reason = "the loops decide about the joints that are not led: by Newton's method"
            return Term(name, True, reason, work)
        if self.task is None:
            gives = "the trajectory gives" if problem.scene.trajectory is not None else "formulas give"
            return Term(name, False, f"{gives} the joints' motion itself")
        leads = f"the trajectory leads {self.task.trajectory.point}"
        if self.task.method == "analytic":
            return Term(name, True, f"{leads}: in closed form, a planar 2R arm")
        return Term(name, True, f"{leads}: by Newton's method", _operations(self.task.kinematics().outputs()))

    def equation_36(self, ledger: Ledger) -> LoopCosts | None:
        """Return nothing: inverse dynamics does not solve equation (36)."""
        return None


def _operations(outputs: Mapping[str, Sequence[Scalar]]) -> int:
    return count_operations([x for entries in outputs.values() for x in entries])
