"""Exact derivatives of ``statics`` by the implicit function theorem at the balance, or at what is held.

A balance satisfies r(q, k) - J^T lambda = 0 and F(q, k) = 0. With N^T J^T = 0 and K = d(r - J^T lambda)/dq,

    J dq = -F_k,   N^T (K dq + r_k - J_k^T lambda) = 0,   J^T dlambda = dr - dJ^T lambda

What is held has the configuration that closes the loops, and actuators and loops share its load as in ``inverse``.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from robodyn_cli.equations.contact_joints import moving_freely
from robodyn_cli.errors import CapabilityError
from robodyn_cli.expr.graph import Scalar
from robodyn_cli.given.loop_conditions import LoopConditions, nothing_led, velocity_places
from robodyn_cli.kernels.program import Program
from robodyn_cli.observe.reactions import ReactionSamples
from robodyn_cli.observe.reactions import figures as largest_loads
from robodyn_cli.over.sensitivity.asked import AskedSlopes
from robodyn_cli.over.sensitivity.differences import Slope
from robodyn_cli.over.sensitivity.gradients import KEYS, Along, MotionGradients, slopes_along
from robodyn_cli.over.sensitivity.led import velocity_map
from robodyn_cli.over.sensitivity.motion.start import Closing, given_slopes
from robodyn_cli.record import record
from robodyn_cli.scene.types import Scene
from robodyn_cli.solve.closure import rank_tolerances
from robodyn_cli.solve.load_sharing import Unbalanced, allowed_motions, least_norm_change, share, share_change
from robodyn_cli.spatial.algebra import Array
from robodyn_cli.summaries.facts import ABSENT, Absent, PeakLoads
from robodyn_cli.torques.closed import unbalanced_by_a_key
from robodyn_cli.works.equilibria import balanced, gap_at, load_at_rest, staying
from robodyn_cli.works.statics import assembled_at_rest, holding_joints, problem_of, terms_at_rest

INDIFFERENT = 1e-9  # part of the largest stiffness below which a configuration may be any


@record
class StaticsFigures:
    """The keys of the summary of ``statics`` that follow from the configuration."""

    configuration: dict[str, float]
    torques_of_joints: dict[str, float]
    multipliers: dict[str, float] | Absent = ABSENT
    reactions: PeakLoads | Absent = ABSENT


@record
class Rest:
    """A configuration at rest and its derivatives by keys, of one sample: q, torques, multipliers of all rows, wrenches
    by path, each (n,) and (n, K).
    """

    values: dict[str, Array]
    changes: dict[str, Array]


class StaticsSlopes:
    """The derivatives of a configuration at rest by some keys, which are named by their numbers.

    Raises
    ------
    CapabilityError : they cannot be computed exactly.
    """

    def __init__(self, asked: AskedSlopes, scene: Scene, numbers: Sequence[int]) -> None:
        self.asked, self.numbers = asked, numbers
        self.problem = problem = problem_of(scene)
        self.balances = scene.statics.find == "balance"
        self.start = assembled_at_rest(problem).q
        self.lead = staying(problem, self.start) if self.balances else nothing_led()
        if not set(self.lead.joints) <= set(self.lead.positions):
            raise CapabilityError("attitudes of joints are held")
        self.loads = ReactionSamples(problem, 1) if scene.outputs.reactions else None
        values, _, _, J = LoopConditions(problem, self.lead, np.zeros(1)).levels()
        outputs: dict[str, Sequence[Scalar]] = {
            "values": values, "J": J, "N": velocity_map(problem), "load": self._load(),
            "tau": list(problem.actuator_torques),
        }  # fmt: skip
        if self.loads is not None:
            outputs |= self.loads.function.outputs
        self.gradients = MotionGradients(problem, outputs, asked.places(numbers))

    @property
    def programs(self) -> list[Program]:
        """The code of values and derivatives."""
        return [self.gradients.program]

    def _load(self) -> list[Scalar]:
        if self.balances:
            return load_at_rest(self.problem)
        terms = terms_at_rest(self.problem).values()
        return [sum(parts) for parts in zip(*terms)] or [0.0] * self.problem.model.nv

    def slopes(self) -> dict[str, list[Slope]]:
        """Return the derivatives of those outputs that follow from the configuration."""
        rest = self.rest
        arrays = [(rest.values[path], change) for path, change in rest.changes.items()]
        return slopes_along(self.asked, self.numbers, self._figures, arrays)

    @cached_property
    def rest(self) -> Rest:
        """The configuration, its torques, multipliers and wrenches, and their derivatives."""
        if self.problem.model.switched:
            raise CapabilityError("payloads are gripped or released on the way")
        model = self.problem.model
        q = balanced(self.problem, self.start).q if self.balances else self.start
        still, p = np.zeros((1, model.nv)), moving_freely(self.problem.contact_joints)
        groups = {"t": np.zeros((1, 1)), "q": q[None], "v": still, "a": still}
        lam = np.zeros((1, len(self.problem.constraints.rows)))
        along = self.gradients({**groups, "lam": lam}, p)
        rest = self._balanced(along, q) if self.balances else self._held(along, q)
        rest.values["q"] = q
        if self.loads is not None:
            along = self.gradients({**groups, "lam": rest.values["lam"][None]}, p)
            moved = {name: rest.changes[name][None] for name in ("q", "lam")}
            for path in self.loads.names:
                rest.values[path], rest.changes[path] = along[path][0], along.change(path, moved)[0]
        return rest

    def _tolerance(self, q: Array) -> float:
        """Return the ratio of singular values below which rows depend on each other."""
        return float(rank_tolerances(self.problem.model, gap_at(self.problem, q)))

    def _balanced(self, along: Along, q: Array) -> Rest:
        nv, rows = self.problem.model.nv, len(self.problem.constraints.rows)
        N, J = along["N"].reshape(-1, nv), along["J"].reshape(-1, nv)
        tolerance = self._tolerance(q)
        lam = np.linalg.pinv(J.T, rcond=tolerance) @ along["load"][0] if len(J) else np.zeros(0)
        slopes = {
            name: (along.by(name, "q")[0] @ N, along.by(name, KEYS)[0]) for name in ("load", "J", "values")
        }
        J_q, J_k = (x.reshape(len(J), nv, x.shape[1]) for x in slopes["J"])
        K, load_k = (x - np.tensordot(lam, y, 1) for x, y in zip(slopes["load"], (J_q, J_k)))
        change = np.concatenate([slopes["values"][1], -self._given(self.lead.joints)])
        step = -np.linalg.pinv(J, rcond=tolerance) @ change
        free = allowed_motions(J[None], tolerance)[0][0]
        reduced = free.T @ K @ free
        if reduced.size and np.linalg.cond(reduced) > 1.0 / INDIFFERENT:
            raise CapabilityError("the balance is indifferent: no force decides the configuration")
        step = step - free @ np.linalg.solve(reduced, free.T @ (K @ step + load_k))
        dJ, dload = J_q @ step + J_k, slopes["load"][0] @ step + slopes["load"][1]
        back = dload - np.tensordot(lam, dJ, 1)
        dlam = np.stack([
            least_norm_change(J.T[None], lam[None], dJ[:, :, k].T[None], back[:, k][None], tolerance)[0]
            for k in range(len(self.numbers))
        ], axis=1)  # fmt: skip
        dq = N @ step
        holding = [i for i in range(len(J)) if i not in self.problem.constraints.of_loops]
        tau = along["tau"][0] + J[holding].T @ lam[holding]
        dtau = along.change("tau", {"q": dq[None]})[0] + J[holding].T @ dlam[holding]
        dtau += np.tensordot(lam[holding], dJ[holding], 1)
        return Rest({"tau": tau, "lam": lam[:rows]}, {"q": dq, "tau": dtau, "lam": dlam[:rows]})

    def _given(self, columns: Sequence[str]) -> Array:
        """Return how given positions change with keys (n, K)."""
        return given_slopes(columns, "q", [self.asked.keys[k] for k in self.numbers])

    def _held(self, along: Along, q: Array) -> Rest:
        problem, constraints = self.problem, self.problem.constraints
        model = problem.model
        dq, keys = self._given(model.q_names), range(len(self.numbers))
        if model.nq != model.nv and (constraints.rows or np.any(dq)):
            raise CapabilityError("positions of joints with quaternions are made of unit length")
        if constraints.rows:
            dq = Closing(problem, q, np.zeros(model.nv)).positions(dq, along.by("values", KEYS)[0])
        loops = constraints.of_loops
        psi = along["J"].reshape(1, -1, model.nv)[:, loops]
        columns = velocity_places(model, holding_joints(problem))
        shared = share(psi, columns, {"load": along["load"]}, self._tolerance(q))
        dJ = along.change("J", {"q": dq[None]}).reshape(-1, model.nv, len(self.numbers))[loops]
        dload = along.change("load", {"q": dq[None]})
        try:
            pairs = [share_change(psi, columns, shared, dJ[None, :, :, k], dload[:, :, k]) for k in keys]
        except Unbalanced as lacking:
            raise unbalanced_by_a_key(problem, lacking, columns) from None
        lam, dlam = np.zeros(len(constraints.rows)), np.zeros((len(constraints.rows), len(self.numbers)))
        lam[loops], dlam[loops] = shared.multipliers[0], np.stack([change[0] for _, change in pairs], axis=1)
        dtau = np.stack([change[0] for change, _ in pairs], axis=1)
        return Rest({"tau": shared.tau[0], "lam": lam}, {"q": dq, "tau": dtau, "lam": dlam})

    def _figures(self, k: int, step: float, every: int) -> StaticsFigures:
        """Return the figures for a key changed by so much, to first order."""
        problem, rest = self.problem, self.rest
        there = {name: x + step * rest.changes[name][:, k] for name, x in rest.values.items()}
        loops = problem.constraints.of_loops
        multipliers = dict(
            zip([row.name for row in problem.constraints.loop_rows], there["lam"][loops].tolist())
        )
        reactions: PeakLoads | Absent = ABSENT
        if self.loads is not None:
            data = {path: there[path][None] for path in self.loads.names}
            reactions = PeakLoads(ABSENT, ABSENT, largest_loads(np.zeros(1), data, self.loads.names))
        return StaticsFigures(
            dict(zip(problem.model.q_names, there["q"].tolist())),
            dict(zip(problem.model.v_names, there["tau"].tolist())),
            multipliers or ABSENT,
            reactions,
        )
