"""All constraint rows of a scene together, and those that relate joint coordinates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property

from robodyn_cli.expr.calculus import directional
from robodyn_cli.expr.graph import Scalar, free_symbols
from robodyn_cli.loops.base import Row
from robodyn_cli.model.model import Model
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Matrix, Values, zeros


@record
class Constraints:
    """Rows eta = 0, Psi v + eta_t = 0, Psi v-dot + gamma = 0; ``dropped`` rows vanish identically.

    ``prescribed`` rows drive a joint; the others close loops.
    """

    rows: tuple[Row, ...]
    dropped: tuple[str, ...]
    prescribed: tuple[int, ...]

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(r.name for r in self.rows)

    @property
    def eta(self) -> list[Scalar]:
        return [r.eta for r in self.rows]

    @property
    def eta_t(self) -> list[Scalar]:
        return [r.eta_t for r in self.rows]

    @property
    def gamma(self) -> list[Scalar]:
        return [r.gamma for r in self.rows]

    @property
    def of_loops(self) -> list[int]:
        """Indices of the rows that close loops or couple joints: all but the prescribed ones."""
        return [i for i in range(len(self.rows)) if i not in self.prescribed]

    @property
    def loop_rows(self) -> tuple[Row, ...]:
        """The rows that close loops or couple joints."""
        return tuple(self.rows[i] for i in self.of_loops)

    @cached_property
    def rheonomic(self) -> tuple[int, ...]:
        """Rows that depend on time itself."""
        return tuple(
            i
            for i, row in enumerate(self.rows)
            if i in self.prescribed or any(s.value[1] == "t" for s in free_symbols([row.eta]))
        )

    def velocity_residual(self, v: Values) -> list[Scalar]:
        """Return Psi v + eta_t."""
        out = []
        for row in self.rows:
            total: Scalar = row.eta_t
            for x, rate in zip(row.psi, v):
                total = total + x * rate
            out.append(total)
        return out

    def psi(self, nv: int) -> Matrix:
        """Return Psi (m, nv)."""
        out = zeros(len(self.rows), nv)
        for i, row in enumerate(self.rows):
            out[i] = row.psi
        return out

    def only(self, keep: Sequence[int]) -> Constraints:
        """Return the constraints with a subset of the rows."""
        place = {old: new for new, old in enumerate(keep)}
        return Constraints(
            tuple(self.rows[i] for i in keep),
            self.dropped,
            tuple(place[i] for i in self.prescribed if i in place),
        )


def coordinate_row(
    name: str, model: Model, q: Sequence[Scalar], terms: Mapping[str, float], value: Scalar, kind: str
) -> Row:
    """Return the row of a linear relation between joint coordinates, eta = sum c_i q_i - s(t), with its derivatives.

    ``terms`` are by column of q, of joints whose velocities are the rates of positions.
    """
    t = model.graph.symbol("t", "t")
    psi = zeros(model.nv)
    eta: Scalar = 0.0
    for joint, coefficient in terms.items():
        psi[model.v_names.index(joint)] = coefficient
        eta = eta + coefficient * q[model.q_names.index(joint)]
    rate = directional([value], [t], [1.0])[0]
    second = directional([rate], [t], [1.0])[0]
    return Row(name, eta - value, psi, -second, -rate, kind)
