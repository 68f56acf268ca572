"""The linear quadratic regulator about a pose.

Which modes of a linear system its inputs reach, and its outputs show.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from typing import Any, ClassVar

import numpy as np

from robodyn_cli.control.base import PER_JOINT, POSITIVE_PER_JOINT, Controller, Problems, Situation
from robodyn_cli.control.design import ControlDesign, Leading
from robodyn_cli.record import record
from robodyn_cli.schema.fields import Choice, JointMap, Number, Section, key
from robodyn_cli.spatial.algebra import Array

MARGIN = 1e-9  # of the size of A: a mode that decays slower counts as one that does not
SPLIT = 1e-7  # of the size of A: so far apart may rounding put a double eigenvalue
RANK = 1e-10  # a singular value this small, relative, is that of a mode which is not reached at all


@record
class Weights:
    """Weights of ``lqr``."""

    q: Any = key(PER_JOINT, default=1.0, unit="1/rad^2 or 1/m^2", doc="Cost of positions.")
    qd: Any = key(PER_JOINT, default=0.0, unit="s^2/rad^2 or s^2/m^2", doc="Cost of rates.")
    tau: Any = key(POSITIVE_PER_JOINT, default=1.0, unit="1/(N m)^2 or 1/N^2", doc="Cost of torques.")


@record
class Regulator:
    """tau = hold - gain (q - at, qd) of independent joints of one coordinate; gain (n, 2 f), hold (n,), at (f,)."""

    joints: tuple[str, ...]
    gain: tuple[tuple[float, ...], ...]
    hold: tuple[float, ...]
    at: tuple[float, ...]


@record
class Lqr(Controller):
    """``tau = tau_0 - K x`` with ``x = (q - q_0, qd)``, which makes the integral of the cost least:

        x^T Q x + u^T R u,   x-dot = A x + B u

    for the model linearised about the pose q_0 at rest, tau_0 holding it there. Q counts all joints; K belongs to
    independent ones, which in a mechanism with loops give the others. With a sampling period, x and u are those at the
    samples and their costs are summed (discrete regulator); or, with ``cost: integral``, the integral is made least by
    torques that are held in between.

    regulator : what ``ready/controllers.py`` finds before the equations are built.
    """

    numbers: ClassVar[tuple[str, ...]] = ("limit", "rate_limit", "sensors", "period", "pose", "regulator")

    type: str = key(Choice(("lqr",)), doc="Kind of controller.")
    gains: Weights = key(Section(Weights), default=Weights(), doc="Weights Q (`q`, `qd`) and R (`tau`).")
    pose: dict[str, float] = key(
        JointMap(Number()), default=None, unit="rad or m", doc="The pose q_0; by default the start."
    )
    cost: str | None = key(
        Choice(("samples", "integral")),
        default=None,
        doc="What is least: with a period the sum over the `samples` (by default) or the `integral` over time, without "
        "one the `integral`.",
    )
    regulator: Any = dataclasses.field(default=None, compare=False, repr=False)

    def problems(self) -> Problems:
        if self.cost == "samples" and self.period is None:
            yield ("cost",), "'samples' goes with 'period'; without one it is the 'integral'"

    def written(self, of: Leading) -> ControlDesign | None:
        found: ControlDesign | None = self.design
        return found

    def torques(self, at: Situation) -> list[Any]:
        own = self.regulator
        seen = [at.seen_of(name) for name in own.joints]
        x = [*(q - q0 for (q, _), q0 in zip(seen, own.at)), *(qd for _, qd in seen)]
        return [tau - sum(k * y for k, y in zip(row, x)) for tau, row in zip(own.hold, own.gain)]


def unreachable_mode(A: Array, B: Array) -> complex | None:
    """Return an eigenvalue [1/s] that does not decay and that inputs do not reach, None without one."""
    size = size_of(A)
    return hidden(A, B, [mode for mode in np.linalg.eigvals(A) if mode.real >= -MARGIN * size], RANK)


def costless_mode(A: Array, Q: Array) -> complex | None:
    """Return an eigenvalue [1/s] that neither grows nor decays and that Q does not see, None without one.

    A regulator leaves such a mode as it is; one that grows is brought to rest in any case (Anderson and Moore 1990).
    """
    near = SPLIT * size_of(A)  # what rounding makes of a double eigenvalue
    modes = [mode for mode in np.linalg.eigvals(A) if abs(mode.real) <= near]
    poles = [complex(0.0, mode.imag if abs(mode.imag) > near else 0.0) for mode in modes]
    return hidden(A.T, Q, poles, RANK)


def size_of(A: Array) -> float:
    """Return the size of a system by which rounding is judged [1/s]."""
    return max(1.0, float(np.abs(A).max(initial=0.0)))


def reached(A: Array, B: Array, s: complex, tolerance: float) -> bool:
    """Tell whether inputs reach the mode of x-dot = A x + B u with the pole s: whether [A - s E, B] has full rank.

    The test of Popov, Belevitch and Hautus (Kailath 1980, "Linear Systems", section 6.2). With A^T and C^T: whether
    y = C x shows the mode. States are scaled so that their units do not matter.

    Parameters
    ----------
    A : (n, n). B : (n, inputs); the units of an input do not matter for one alone. s : a pole [1/s].
    tolerance : a singular value this small beside the largest counts as zero.
    """
    from scipy.linalg import matrix_balance

    balanced, (scale, _) = matrix_balance(A, permute=False, separate=True)
    forces = B / scale[:, None]
    forces = forces / max(float(np.abs(forces).max(initial=0.0)), 1e-300)
    size = max(float(np.abs(balanced).max(initial=0.0)), 1e-300)
    rows = np.concatenate([(balanced - s * np.eye(len(A))) / size, forces], axis=1)
    values = np.linalg.svd(rows, compute_uv=False)
    return bool(values[-1] > tolerance * values[0])


def hidden(A: Array, B: Array, poles: Iterable[complex], tolerance: float) -> complex | None:
    """Return the first of some poles whose mode is not ``reached``, None without one."""
    return next((complex(s) for s in poles if not reached(A, B, s, tolerance)), None)
