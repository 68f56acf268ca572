"""The plan of ``simulate`` and ``deploy``: the accelerations, and what stepping needs beside them."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import cached_property
from typing import Any

from robodyn_cli.algorithms.aba import ArticulatedFactor
from robodyn_cli.algorithms.linear import LdlFactor
from robodyn_cli.equations.plan_facts import depends_on_time, listed
from robodyn_cli.equations.plan_terms import Ledger, drive_terms
from robodyn_cli.equations.plan_variants import serial_chain, without_loops
from robodyn_cli.equations.problem import DENSE_LIMIT, Problem
from robodyn_cli.equations.variant import Symbols
from robodyn_cli.expr.graph import Scalar, count_operations
from robodyn_cli.formulations.build import build_system
from robodyn_cli.formulations.dynamics import GROUPS, Expanded
from robodyn_cli.formulations.residual import Residual
from robodyn_cli.formulations.rolled import Rolled
from robodyn_cli.integrators.registry import methods
from robodyn_cli.integrators.stepping.writer import INLINE_LIMIT
from robodyn_cli.kernels.program import make_program
from robodyn_cli.run.deploy.deploy import build_deployment
from robodyn_cli.run.driver.build import build_motion
from robodyn_cli.run.observation.evaluation import worth_compiling
from robodyn_cli.run.observation.least_norm import equations_of
from robodyn_cli.run.observation.observe import observed
from robodyn_cli.run.plan.kernels import rolled, rolled_step, sampled, stepped
from robodyn_cli.run.stopwatch import Stopwatch
from robodyn_cli.scene import types as sc

PROJECTION = "projection"


class Forward:
    """The programs of a simulation of one scene."""

    def __init__(self, scene: sc.Scene, command: str) -> None:
        self.command = command
        self.redundant: tuple[str, ...] = ()
        self.kept_rows: tuple[str, ...] | None = None
        deploys = command == "deploy"
        motion = build_deployment(scene, Stopwatch()) if deploys else build_motion(scene, plan=True)
        self.motion, self.choice = motion, motion.choice
        self.problem, self.system = motion.problem, motion.system
        self.stabilisation = motion.scene.simulate.stabilisation
        self._note_redundant(motion.assembled.redundant)

    def _note_redundant(self, names: Sequence[str]) -> None:
        self.redundant = tuple(names)
        if names and not self.problem.dependent:
            self.kept_rows = self.problem.constraints.names

    # -- operations -----------------------------------------------------------------------------------
    def outputs(self, problem: Problem, work: bool = True) -> list[Scalar]:
        """Return the right-hand side that is integrated: accelerations and the work's rate."""
        wanted = problem.scene.simulate.stabilisation
        # projection is a program of its own; the accelerations are the same without it
        system = build_system(problem, "none" if wanted == PROJECTION else wanted, work=work, expanded=True)
        return [*system.acceleration, *system.z_rate]

    @cached_property
    def _residual(self) -> Residual | None:
        method = methods.get(self.choice.method)
        return None if method is None else method().residual_of(self.system)

    # -- kernels --------------------------------------------------------------------------------------
    def kernels(self) -> list[dict[str, Any]]:
        """Describe the compiled programs."""
        s = self.system
        held = "stages" if self.choice.method.startswith("gauss") else "state"
        if isinstance(s.dynamics, Rolled):
            return self._rolled_kernels(s.dynamics, held)
        assert isinstance(s.dynamics, Expanded)
        residual = self._residual
        if residual is None:
            found = [stepped("accelerations", s.dynamics.program, held)]
        else:
            found = [
                stepped("corrections of accelerations, each round", residual.correction, held),
                stepped("factors of the mass matrix, once a step", residual.factors, held),
            ]
        derivatives = (
            methods[self.choice.method]().linearisation(s) if self.choice.method in methods else None
        )
        if derivatives is not None:
            found.append(stepped("accelerations and their derivatives", derivatives, "state"))
        if s.positions is not None and s.velocities is not None:
            found.append(stepped("projection of positions", s.positions, "state"))
            found.append(stepped("projection of velocities", s.velocities, "state"))
        if s.switching is not None:
            found.append(stepped("events", s.switching, "times"))
        found.append(sampled("observation", make_program(observed(self.problem), GROUPS)))
        if self.command == "deploy":
            lam: dict[str, Sequence[Scalar]] = {"lam": list(self.problem.forward.lam)}
            if self.problem.dependent:
                lam = equations_of(self.problem)
            found.append(sampled("multipliers on the 1 ms grid", make_program(lam, GROUPS)))
        return found

    def _rolled_kernels(self, dynamics: Rolled, held: str) -> list[dict[str, Any]]:
        """Describe the loops over the bodies of a long chain, and what goes with them."""
        found = [rolled_step("accelerations", dynamics, held)]
        if self.system.switching is not None:
            found.append(stepped("events", self.system.switching, "times"))
        found.append(rolled("accelerations at the samples", dynamics.plan, dynamics.program.operations))
        program = make_program(observed(self.problem, accelerations=False), GROUPS)
        compiled = worth_compiling(program.operations, self.problem.scene.simulate.samples)
        found.append(sampled("observation", program, compiled))
        return found

    # -- terms ----------------------------------------------------------------------------------------
    def stages(self, ledger: Ledger) -> None:
        """Enter the solution for the accelerations."""
        problem = self.problem
        given: list[Scalar] = list(problem.applied - problem.bias)
        given += [x for row in problem.psi for x in row] if problem.constraints.rows else []
        given += problem.constraints.gamma
        ledger.keep(
            "mass matrix and the solution for the accelerations",
            "accelerations are what is integrated",
            operations=ledger.total - count_operations(given),
        )

    def more_terms(self, ledger: Ledger) -> None:
        """Enter drives, stabilisation, the work integral, events and what is evaluated at the samples."""
        problem, scene = self.problem, self.problem.scene
        drive_terms(ledger, depends_on_time(self.outputs(problem)))
        self._stabilisation(ledger)
        if problem.dependent:
            ledger.keep(
                "combination of dependent rows",
                f"{listed(self.redundant)} follow from the other rows in every pose: all rows are solved together, "
                "with multipliers of least norm",
                operations=self._combination(),
            )
        elif self.redundant:
            ledger.leave(
                "redundant rows",
                f"{listed(self.redundant)} follow from the other rows in every pose",
                dataclasses.replace(ledger.scene, rows=None),
            )
        without = count_operations(self.outputs(problem, work=False))
        if self.system.nz:
            ledger.keep(
                "work integral", "what the energy is balanced against: something drives or brakes",
                operations=ledger.total - without,
            )  # fmt: skip
        else:
            driven = dataclasses.replace(ledger.scene, drives=True).problem()
            more, less = (count_operations(self.outputs(driven, work=w)) for w in (True, False))
            ledger.leave(
                "work integral", "nothing drives or brakes: energy itself is conserved", saved=more - less
            )
        self._events(ledger)
        sampled_too = count_operations([x for entries in observed(problem).values() for x in entries])
        ledger.keep(
            "energies, points and multipliers at the samples",
            "in the result; evaluated at the samples only, not in the stepping loop",
            operations=sampled_too - count_operations(list(problem.forward.qdd)),
        )
        again = "a second, tighter integration by the same code"
        if scene.simulate.error_estimate:
            ledger.keep("error estimate", again, operations=0)
        else:
            ledger.leave("error estimate", "simulate.error_estimate is false", saved=0)

    def _combination(self) -> int:
        """Return the operations of W Psi and W gamma."""
        independent, given = self.problem.independent_rows, self.problem.constraints
        combined = [*independent.psi(self.problem.model.nv).ravel(), *independent.gamma]
        return count_operations(combined) - count_operations([*self.problem.psi.ravel(), *given.gamma])

    def _stabilisation(self, ledger: Ledger) -> None:
        scene = ledger.scene.scene
        if not self.problem.constraints.rows:
            ledger.leave("stabilisation of constraints", "there are none, so nothing can drift", saved=0)
            return
        s = self.system
        if s.positions is not None and s.velocities is not None:
            ledger.keep(
                "projection of positions and velocities",
                "keeps the loops closed to rounding; in programs of its own, once a step",
                operations=s.positions.operations + s.velocities.operations,
            )
        else:
            projected = build_system(self.problem, PROJECTION)
            both = [p for p in (projected.positions, projected.velocities) if p is not None]
            asked = "none" if self.stabilisation == "none" else "Baumgarte's terms"
            ledger.leave(
                "projection of positions and velocities", f"simulate.stabilisation asks for {asked}",
                saved=sum(p.operations for p in both),
            )  # fmt: skip
        symbols = Symbols(ledger.model.graph)
        if isinstance(self.stabilisation, sc.Baumgarte):
            ledger.keep(
                "Baumgarte's terms", "asked for in simulate.stabilisation",
                ledger.scene.with_scene(simulate=dataclasses.replace(scene.simulate, stabilisation="none")),
            )  # fmt: skip
        else:
            gains = sc.Baumgarte(alpha=symbols.one(), beta=symbols.one())
            ledger.leave(
                "Baumgarte's terms",
                "projection leaves no drift to damp" if self.stabilisation == PROJECTION else "not asked for",
                ledger.scene.with_scene(simulate=dataclasses.replace(scene.simulate, stabilisation=gains)),
            )

    def _events(self, ledger: Ledger) -> None:
        names = {"dead_point": "dead point", "rank": "loss of rank"}
        watched: dict[str, list[Scalar]] = {}
        for event in self.system.events:
            watched.setdefault(event.name, []).append(event.value)
        for name, values in watched.items():
            ledger.keep(
                f"event: {names.get(name, name.replace('_', ' '))}",
                "watched along the motion, in a program of its own",
                operations=count_operations(values),
            )
        if not self.system.events:
            ledger.leave(
                "events",
                "an open chain has no singular poses to stop at"
                if not ledger.model.loops
                else "nothing is asked to be watched",
                saved=0,
            )

    # -- choices --------------------------------------------------------------------------------------
    def choices(self) -> list[dict[str, Any]]:
        """Describe what the engine chose, and the alternatives."""
        problem, model = self.problem, self.problem.model
        found: list[dict[str, Any]] = []
        f = problem.applied - problem.bias
        articulated = count_operations(list(ArticulatedFactor(model, problem.q, problem.X).solve(f)))
        if problem.constraints.rows:
            found.append({
                "choice": "accelerations", "taken": "factored mass matrix",
                "reason": "the multipliers need the factor of M",
            })  # fmt: skip
        elif model.nv > DENSE_LIMIT:
            found.append({
                "choice": "accelerations", "taken": "articulated bodies",
                "reason": f"{model.nv} joints: the factored mass matrix grows with their cube",
                "operations": {"articulated bodies": articulated},
            })  # fmt: skip
        else:
            dense = count_operations(
                list(LdlFactor.of(problem.mass_matrix, problem.elimination_order).solve(f))
            )
            taken = "factored mass matrix" if dense <= articulated else "articulated bodies"
            found.append({
                "choice": "accelerations", "taken": taken, "reason": "fewer operations",
                "operations": {"factored mass matrix": dense, "articulated bodies": articulated},
            })  # fmt: skip
        found.append({"choice": "integrator", "taken": self.choice.method, "reason": self.choice.reason})
        dynamics = self.system.dynamics
        if isinstance(dynamics, Rolled):
            found.append({
                "choice": "right-hand side in the stepping loop", "taken": "loops over the bodies",
                "reason": f"{model.nv} joints: straight-line code would take longer to compile than to run",
                "operations": {"loops over the bodies": dynamics.operations},
            })  # fmt: skip
            return found
        size = dynamics.program.operations
        if self._residual is not None:
            corrected = self._residual.correction.operations
            found.append({
                "choice": "accelerations in the stages", "taken": "corrections by inverse dynamics",
                "reason": "fewer operations over the rounds of a step",
                "operations": {
                    "corrections by inverse dynamics": corrected,
                    "forward dynamics": size,
                    "factors of the mass matrix, once": self._residual.factors.operations,
                },
            })  # fmt: skip
            size = corrected
        inline = size <= INLINE_LIMIT
        found.append({
            "choice": "right-hand side in the stepping loop", "taken": "inlined" if inline else "function",
            "reason": f"{size} operations, {'not more' if inline else 'more'} than {INLINE_LIMIT}",
        })  # fmt: skip
        return found

    def equation_36(self, ledger: Ledger) -> dict[str, Any]:
        """Return what the loops cost: the open tree, the open chain of as many joints, loops, projection."""
        tree = ledger.operations(without_loops(ledger.scene))
        chain = ledger.operations(serial_chain(ledger.scene))
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
