"""Names of the methods of integration, as scenes write them."""

from __future__ import annotations

FIXED_STEP = (
    "rk4", "gauss4", "gauss6", "implicit_midpoint", "verlet", "symplectic4", "symplectic6", "symplectic8",
    "generalized_alpha",
)  # fmt: skip
METHODS = (
    "gauss", "gauss8", "gauss10", "gauss12", "gauss14", "dop853", "dopri5", "rodas5p", "rosenbrock23", "bdf", "radau",
    "radau9", "radau13", *FIXED_STEP,
)  # fmt: skip
