"""What is known of the contact states of joints, and what those at rest do: Coulomb's law, all together.

Each joint at rest is held with a multiplier within its bounds, or moves off in a direction in which it does accelerate
(a linear complementarity problem).
"""

from __future__ import annotations

import itertools
from collections import Counter, deque
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from robodyn_cli.equations.contact_joints import UNBOUNDED, ContactJoint
from robodyn_cli.equations.problem import Problem
from robodyn_cli.errors import NumericalError, listed
from robodyn_cli.kernels.samples import SampleKernel, compile_together
from robodyn_cli.model.model import STATE_GROUPS
from robodyn_cli.motion.contact.checks import check_freedom, refuse_loads
from robodyn_cli.motion.contact.events import HELD, ContactFunction, contact_functions
from robodyn_cli.motion.contact.sticking import (
    DEPENDENT,
    RestingJoints,
    bounded,
    independent_count,
    motions_left,
    replacement,
)
from robodyn_cli.motion.motion import Motion, Watcher
from robodyn_cli.ready.singularity import rank_tolerance
from robodyn_cli.spatial.algebra import Array

AT_REST = 1e-13  # a rate this small, relative to the largest, is zero
FORCE = 1e-9  # a multiplier may pass its bound by this part of the largest one, for rounding
SAME_REST = 1e-9  # of the largest rate: what cannot move without joints at rest is no faster
COMBINATIONS = 6561  # of contact states that are tried where pivoting does not end
CROWD = 1000  # events that are remembered


class JointStates(Watcher):
    """The contact states of the joints of one run; ``p`` holds the parameters of the equations that say which are on.

    state : of each joint, HELD or its direction of motion. rest : joints at rest. contact : direction in which the stop
    pushes, of joints on one. carried : torques of joints at rest that others hold, by their number (see ``sticking``).
    counts : transitions that have happened, by kind.
    """

    functions: tuple[ContactFunction, ...]
    changes_motion = True
    sets_start = True

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self.joints = problem.contact_joints
        self.functions = contact_functions(problem, self)

    def follow(self, motion: Motion) -> None:
        """Make what is evaluated at events; see ``check_freedom`` for what is refused before anything is compiled."""
        self.system, q = motion.system, motion.assembled.q
        psi = self.problem.numbers(self.problem.psi, q).reshape(-1, self.problem.model.nv)
        self._tolerance = rank_tolerance(self.problem, q)
        self.shares = check_freedom(self.joints, psi, self._tolerance)
        if self.shares:
            refuse_loads(self.problem.scene, self.joints)
        own = motions_left(psi, self._tolerance)[[joint.v for joint in self.joints]]
        self._tied = independent_count(own.T) < len(self.joints)
        rates = {"a": list(self.problem.forward.qdd), "lam": self.problem.holding}
        self._rates = SampleKernel(rates, STATE_GROUPS)
        matrices = {"M": list(self.problem.mass_matrix.ravel()), "psi": list(self.problem.psi.ravel())}
        self._matrices = SampleKernel({k: v for k, v in matrices.items() if v}, STATE_GROUPS)
        compile_together(self._rates, self._matrices)
        self._clear()

    @property
    def kernels(self) -> dict[str, SampleKernel]:
        return {"accelerations and holding forces at events": self._rates, "impacts": self._matrices}

    def _clear(self) -> None:
        self.p = np.array(self.system.parameters)
        self.state: list[int] = [0] * len(self.joints)
        self.rest: set[int] = set()
        self.contact: dict[int, float] = {}
        self.carried: dict[int, float] = {}
        self.shared: dict[str, float] = {}
        self._log: list[dict[str, Any]] = []
        self.counts: Counter[str] = Counter()
        self._flight = np.inf
        self._fastest = 0.0
        self._load = 1e-300  # the largest multiplier so far
        self._known_held: set[int] = set()
        self._recent: deque[tuple[float, str]] = deque(maxlen=CROWD)
        self._inertia = np.ones(self.problem.model.nv)

    @property
    def log(self) -> list[dict[str, Any]]:
        return self._log

    def facts(self, end: float) -> dict[str, Any]:
        return {"transitions": dict(self.counts)}

    @property
    def together(self) -> Sequence[str]:
        return tuple(self.shared)

    @property
    def noted(self) -> dict[str, float]:
        return dict(self.shared)

    def recall(self, noted: Mapping[str, float]) -> None:
        self.shared |= {joint.name: noted[joint.name] for joint in self.joints if joint.name in noted}

    @property
    def warnings(self) -> list[str]:
        if not self.shared:
            return []
        names, since = listed(list(self.shared)), min(self.shared.values())
        return [
            f"joints {names} stick together from t = {since:.6g} s on, more of them than there are degrees of freedom: "
            "that they stick, and the motion, are determined; how they share their friction then is not, nor are "
            "multipliers of loops and reactions"
        ]

    # -- places ---------------------------------------------------------------------------------------
    def _q(self, joint: ContactJoint) -> int:
        return self.system.q_places[joint.q]

    def _v(self, joint: ContactJoint) -> int:
        return self.system.v_places[joint.v]

    def rates(self, t: float, x: Array) -> tuple[Array, Array]:
        """Return accelerations (nv,) and multipliers of held joints in the present contact states."""
        values = self._rates.evaluate(1, self._groups(t, x))
        return values["a"][0], values["lam"][0]

    def _groups(self, t: float, x: Array) -> dict[str, Array]:
        """Return the inputs of kernels at a state in the present contact states."""
        return self.system.at(t, x, self.p)

    def _mass_matrix_and_psi(self, t: float, x: Array) -> tuple[Array, Array]:
        """Return the mass matrix (nv, nv) and Psi (m, nv) at a state."""
        values = self._matrices.evaluate(1, self._groups(t, x))
        nv = self.problem.model.nv
        return values["M"].reshape(nv, nv), values.get("psi", np.zeros(0)).reshape(-1, nv)

    def held_rows(self, t: float, x: Array) -> Array:
        """Return rows (k, nv) of what else is held at a state."""
        return np.zeros((0, self.problem.model.nv))

    # -- contact states -------------------------------------------------------------------------------
    def _settle_speeds(self, x: Array) -> None:
        """Sort the joints by their rates: those at rest, and the directions of the others."""
        still = AT_REST * float(np.abs(x[list(self.system.v_places)]).max(initial=0.0))
        for k, joint in enumerate(self.joints):
            place = self._v(joint)
            if abs(x[place]) <= still and (joint.friction is not None or k in self.contact):
                x[place] = 0.0
                self.rest.add(k)
                continue
            self.rest.discard(k)
            self.contact.pop(k, None)
            self.state[k] = int(np.sign(x[place]))

    def _bounds(self, k: int) -> tuple[float, float]:
        """Return the range of the multiplier that can hold a joint."""
        forwards, backwards = self.joints[k].breakaway
        push = self.contact.get(k, 0.0)
        return (-UNBOUNDED if push < 0.0 else -forwards), (UNBOUNDED if push > 0.0 else backwards)

    def _write(self) -> None:
        """Write the contact states into the parameters."""
        for k, joint in enumerate(self.joints):
            at_rest = k in self.rest and self.state[k] == HELD
            direction = 0.0 if at_rest or joint.friction is None else float(self.state[k])
            held, carried = float(at_rest and k not in self.carried), self.carried.get(k, 0.0)
            self.p[joint.place : joint.end] = [held, direction, *self._bounds(k), carried]

    def _settle(self, t: float, x: Array, forced: dict[int, int]) -> None:
        """Find the contact states of the joints at rest; ``forced`` are known to move, in these directions."""
        self._rest_with_them(t, x)
        before = {k: self.state[k] for k in self.rest}
        still = sorted(self.rest)
        self.carried = {}
        for k in still:
            self.state[k] = forced.get(k, HELD)
        if still:
            self._inertia = 1.0 / np.diag(np.linalg.inv(self._mass_matrix_and_psi(t, x)[0]))
            columns, inertia = self._freedoms(t, x, still)
            if independent_count(columns) < len(still):
                self._share(t, x, columns, inertia, forced)
            else:
                self._pivot(t, x, still)
        for k in still:
            if self.state[k] != HELD:
                self.rest.discard(k)
                left = self.contact.pop(k, None) is not None
                self._note(t, "release" if left else "slip", k, direction=self.state[k])
            elif before.get(k) != HELD or k not in self._known_held:
                self._note(t, "contact" if k in self.contact else "stick", k)
        self._known_held = set(self.rest)

    def _rest_with_them(self, t: float, x: Array) -> None:
        """Bring to rest the joints with friction that cannot move without those at rest."""
        if not (self._tied and self.rest):
            return
        resting = np.eye(self.problem.model.nv)[[self.joints[j].v for j in sorted(self.rest)]]
        held = np.concatenate([self._mass_matrix_and_psi(t, x)[1], self.held_rows(t, x)])
        before, after = (
            np.linalg.norm(motions_left(rows, max(self._tolerance, DEPENDENT)), axis=1) > DEPENDENT
            for rows in (held, np.concatenate([held, resting]))
        )
        slow = SAME_REST * float(np.abs(x[list(self.system.v_places)]).max(initial=self._fastest))
        for k, joint in enumerate(self.joints):
            place = self._v(joint)
            stopped = before[joint.v] and not after[joint.v] and abs(x[place]) <= slow
            if stopped and joint.friction is not None:
                x[place] = 0.0
                self.rest.add(k)

    def _freedoms(self, t: float, x: Array, joints: list[int]) -> tuple[Array, Array]:
        """Return the motions of joints (f, n) along those that constraints leave, and the inertia (f, f) of these."""
        M, psi = self._mass_matrix_and_psi(t, x)
        N = motions_left(np.concatenate([psi, self.held_rows(t, x)]), self._tolerance)
        return N[[self.joints[k].v for k in joints]].T, N.T @ M @ N

    def _share(self, t: float, x: Array, columns: Array, inertia: Array, forced: dict[int, int]) -> None:
        """Find the states of joints at rest that do not move independently, and which of them bear."""
        still, forced = sorted(self.rest), dict(forced)
        for _ in range(1 + len(still)):
            others = [k for k in still if k not in forced]
            self.carried = dict.fromkeys(others, 0.0)
            for k in still:
                self.state[k] = forced.get(k, HELD)
            self._write()
            a = self.rates(t, x)[0][[self.joints[k].v for k in others]]
            low, high = np.array([self._bounds(k) for k in others]).reshape(-1, 2).T
            place = [still.index(k) for k in others]
            found = RestingJoints(columns[:, place], inertia, a, *map(bounded, (low, high))).settled()
            self.carried = {others[i]: x for i, x in found.carried.items()}
            for k, state in zip(others, found.states):
                self.state[k] = state
            wrong = self._wrong(t, x, still)
            if not wrong:
                self._note_shared(t)
                return
            _, k, mode = max(wrong)
            forced = {j: state for j, state in forced.items() if j != k} | ({k: mode} if mode != HELD else {})
        raise self._inconsistent(t, still)

    def _note_shared(self, t: float) -> None:
        """Note since when joints have been sticking together whose friction is not unique."""
        if self.carried:
            for k in sorted(self.rest):
                if self.state[k] == HELD:
                    self.shared.setdefault(self.joints[k].name, t)

    def _relieve(self, t: float, x: Array, k: int, over: bool) -> dict[int, int] | None:
        """Let a carried joint bear in the place of a joint k that comes to its upper or lower bound; return what moves,
        and where to, if none can."""
        still = sorted(self.rest)
        at_low = {still.index(j): lam <= sum(self._bounds(j)) / 2.0 for j, lam in self.carried.items()}
        bearing = [i for i, j in enumerate(still) if j not in self.carried]
        columns, _ = self._freedoms(t, x, still)
        other, moving = replacement(columns, bearing, still.index(k), over, at_low)
        if other is None:
            return {k: -1 if over else 1, **{still[i]: 1 if at_low[i] else -1 for i in moving}}
        self.carried.pop(still[other])
        self.carried[k] = self._bounds(k)[over]
        return {} if self._wrong(t, x, still) else None

    def _pivot(self, t: float, x: Array, still: list[int]) -> None:
        """Change the state that is most wrong until none is; try all combinations where that goes in circles."""
        seen = set()
        while True:
            wrong = self._wrong(t, x, still)
            if not wrong:
                return
            seen.add(tuple(self.state[k] for k in still))
            _, k, mode = max(wrong)
            self.state[k] = mode
            if tuple(self.state[j] for j in still) in seen:
                break
        options = [[HELD, *self._directions(k)] for k in still]
        for states in itertools.islice(itertools.product(*options), COMBINATIONS):
            for k, mode in zip(still, states):
                self.state[k] = mode
            if not self._wrong(t, x, still):
                return
        raise self._inconsistent(t, still)

    def _inconsistent(self, t: float, still: list[int]) -> NumericalError:
        names = ", ".join(self.joints[k].name for k in still)
        return NumericalError(
            f"no contact states of the joints at rest ({names}) are consistent at t = {t:.6g} s",
            time=t, status="modes",
        )  # fmt: skip

    def _directions(self, k: int) -> list[int]:
        """Return the directions in which a joint at rest may move off."""
        push = self.contact.get(k)
        return [1, -1] if push is None else [int(push)]

    def _wrong(self, t: float, x: Array, still: list[int]) -> list[tuple[float, int, int]]:
        """Return what contradicts the contact states: (by how much, joint, the state that it asks for)."""
        self._write()
        a, lam = self.rates(t, x)
        if not (np.all(np.isfinite(a)) and np.all(np.isfinite(lam))):
            names = ", ".join(self.joints[k].name for k in still)
            raise NumericalError(
                f"the forces in the joints at rest ({names}) are not unique at t = {t:.6g} s",
                time=t, status="modes",
            )  # fmt: skip
        strongest = max(float(np.abs(lam).max()), *(max(g.breakaway) for g in self.joints))
        # where a joint leaves its stop the multiplier is zero, and says nothing about the size of forces
        largest = max(strongest, self._load)
        contradictions = []
        for k in still:
            low, high = self._bounds(k)
            if self.state[k] == HELD:
                over, under = float(lam[k] - high) / largest, float(low - lam[k]) / largest
                if max(over, under) > FORCE:
                    contradictions.append((max(over, under), k, -1 if over > under else 1))
                continue
            # the force that would have to be added for the joint not to move against its direction
            short = -self.state[k] * a[self.joints[k].v] * self._inertia[self.joints[k].v] / largest
            if short > FORCE:
                contradictions.append((float(short), k, HELD))
        if not contradictions:
            self._load = largest
        return contradictions

    def _note(self, t: float, kind: str, k: int, **details: Any) -> None:
        """Note what happens to a joint; states that are found anew at one instant are told once."""
        told = {"time": t, "name": self.joints[k].name, "kind": kind, **details}
        if kind == "impact" or told not in itertools.takewhile(lambda x: x["time"] == t, self._log[::-1]):
            self.counts[kind] += 1
            self._log.append(told)
