"""The plan of ``inverse``: the torque program, and what is evaluated beside it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from robodyn_cli.equations.plan_facts import listed, plural
from robodyn_cli.equations.plan_terms import Ledger
from robodyn_cli.equations.plan_variants import without_accelerations
from robodyn_cli.equations.problem import GROUPS, Problem
from robodyn_cli.expr.graph import Expr, Scalar, count_operations
from robodyn_cli.kernels.crossover import CROSSOVER, prefer_rolled
from robodyn_cli.kernels.program import make_program
from robodyn_cli.kernels.rolled_tables import RolledPlan
from robodyn_cli.run.inverse.build import open_problem
from robodyn_cli.run.inverse.program import energies, torque_terms
from robodyn_cli.run.mechanism.motion import with_led_point
from robodyn_cli.run.observation import evaluation
from robodyn_cli.run.observation.places import place_outputs
from robodyn_cli.run.plan.kernels import rolled, sampled
from robodyn_cli.scene import types as sc
from robodyn_cli.solve.planar_2r import Planar2R
from robodyn_cli.solve.point_kinematics import PointKinematics
from robodyn_cli.trajectories.motion import TaskSpace


class Inverse:
    """The programs of inverse dynamics of one scene."""

    def __init__(self, scene: sc.Scene) -> None:
        self.problem = open_problem(scene, "inverse dynamics")
        # equations of its own, as the run has them
        self.run = open_problem(with_led_point(scene), "inverse dynamics")
        terms = torque_terms(self.run)
        places = place_outputs(self.run)
        self.terms = list(terms)
        self.evaluated = {**terms, **energies(self.run, terms), **places}
        self.rolled = prefer_rolled(self.problem.model)
        self.redundant: tuple[str, ...] = ()
        self.kept_rows: tuple[str, ...] | None = None

    def outputs(self, problem: Problem) -> list[Scalar]:
        """Return the actuator torques, as ``InverseDynamics`` compiles them."""
        tau: Any = problem.inverse_dynamics
        for term in problem.passive_forces(smooth=False).values():
            tau = tau - term
        return list(tau)

    def _point(self) -> tuple[str, PointKinematics | None] | None:
        """Return the point that the trajectory leads, and its kinematics where Newton's method needs them."""
        trajectory: Any = self.problem.scene.trajectory
        if not isinstance(trajectory, TaskSpace):
            return None
        model = self.run.model
        frame = model.points[trajectory.point]
        if trajectory.ik.method != "newton" and Planar2R.recognise(model, frame) is not None:
            return trajectory.point, None
        components = 3 if not hasattr(trajectory, "position") else len(trajectory.position)
        return trajectory.point, PointKinematics.of(model, self.run.q, self.run.v, frame, components)

    def kernels(self) -> list[dict[str, Any]]:
        """Describe the compiled programs."""
        if self.rolled:
            forces = list(self.problem.passive_forces(smooth=False).values())
            extra = count_operations(list(sum(forces[1:], forces[0]))) if forces else 0
            found = [rolled("torques (InverseDynamics)", RolledPlan(self.problem.model, "inverse"), extra)]
        else:
            torques = make_program({"out": self.outputs(self.problem)}, ("t", "q", "v", "a"))
            found = [sampled("torques (InverseDynamics)", torques)]
        varying = [v for v in self.evaluated.values() if any(isinstance(e, Expr) for e in v)]
        named: dict[str, Sequence[Scalar]] = {f"o{k}": v for k, v in enumerate(varying)}
        program = make_program(named, GROUPS)
        found.append(sampled("torque terms, energies, places", program, self._compiles()))
        point = self._point()
        if point is not None and point[1] is not None:
            outputs: dict[str, Sequence[Scalar]] = dict(point[1].outputs())
            found.append(sampled(f"kinematics of {point[0]}", make_program(outputs, ("q", "v"))))
        return found

    def stages(self, ledger: Ledger) -> None:
        """Enter what only inverse dynamics has."""
        ledger.keep("inertia forces", "the masses are accelerated", without_accelerations(ledger.scene))

    def more_terms(self, ledger: Ledger) -> None:
        """Enter the stages around the torques."""
        problem = self.problem
        scene = problem.scene
        if scene.torques:
            ledger.leave("actuator torques of the scene", "inverse dynamics finds them", saved=0)
        split = count_operations([x for name in self.terms for x in self.evaluated[name]])
        ledger.keep(
            "torques split into terms", f"the result has them apart: {listed(self.terms)}",
            operations=split - ledger.total,
        )  # fmt: skip
        everything = count_operations([x for entries in self.evaluated.values() for x in entries])
        places = [(len(self.run.model.points), "named point"), (len(self.run.model.frames), "frame")]
        ledger.keep(
            "energies, points and outlines",
            "in the result: energies, "
            + "".join(f"{plural(n, what)}, " for n, what in places if n)
            + "outlines of the links",
            operations=everything - split,
        )
        point = self._point()
        if point is None:
            ledger.leave("inverse kinematics", "the trajectory gives the joints' motion itself", saved=0)
        elif point[1] is None:
            ledger.keep(
                "inverse kinematics", f"the trajectory leads {point[0]}: in closed form, a planar 2R arm",
                operations=0,
            )  # fmt: skip
        else:
            work = count_operations([x for entries in point[1].outputs().values() for x in entries])
            ledger.keep(
                "inverse kinematics", f"the trajectory leads {point[0]}: by Newton's method", operations=work
            )
        ledger.leave("integration, events, projection", "the motion is given: nothing is integrated", saved=0)

    def choices(self) -> list[dict[str, Any]]:
        """Describe what the engine chose."""
        samples = self.problem.scene.inverse.samples
        compiles = self._compiles()
        joints = self.problem.model.nv
        return [
            {
                "choice": f"terms and energies at {samples} samples",
                "taken": "compiled" if compiles else "interpreted",
                "reason": "compiling takes less time than interpreting" if compiles
                else "interpreting takes less time than compiling",
            },
            {
                "choice": "shape of the torque kernel",
                "taken": "rolled" if self.rolled else "unrolled",
                "reason": f"{plural(joints, 'joint')}; a loop over the bodies pays from {CROSSOVER} on",
            },
        ]  # fmt: skip

    def _compiles(self) -> bool:
        """Tell whether an inverse run compiles what it evaluates, as ``SampleFunction`` decides."""
        operations = count_operations([x for entries in self.evaluated.values() for x in entries])
        samples = self.problem.scene.inverse.samples
        interpreting = operations * (evaluation._CALL + evaluation._ENTRY * samples)
        return interpreting > evaluation._COMPILER + evaluation._OPERATION * operations

    def equation_36(self, ledger: Ledger) -> dict[str, Any]:
        """Return nothing: inverse dynamics of loops is not done here."""
        return {}
