"""All constraint rows of a scene together."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from robodyn_cli.expr.graph import Scalar
from robodyn_cli.loops.base import Row
from robodyn_cli.spatial.algebra import Matrix, zeros


@dataclasses.dataclass(frozen=True)
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
