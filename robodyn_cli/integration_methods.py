"""The methods of integration as data: what a scene may name, and where its code is. A new method is one line here.

Nothing is imported from here, so that a scene is checked without loading the methods; the registry
(``integrators/registry.py``) makes them from these lines.
"""

from __future__ import annotations

from robodyn_cli.record import record


@record
class IntegrationMethod:
    """One method.

    place : ``module:member`` in ``integrators/methods``; a module is a family. order : of the solution.
    fixed_step : it takes steps of a length that is given. stiff : it damps what its step does not resolve, and
    factors the exact Jacobian. symplectic : with a fixed step the error of the energy stays bounded.
    """

    name: str
    place: str
    order: int
    fixed_step: bool = False
    stiff: bool = False
    symplectic: bool = False

    @property
    def family(self) -> str:
        return self.place.partition(":")[0]


_TABLE = (
    IntegrationMethod("gauss", "gauss:Gauss", 16, symplectic=True),
    IntegrationMethod("gauss8", "gauss:Gauss", 8, symplectic=True),
    IntegrationMethod("gauss10", "gauss:Gauss", 10, symplectic=True),
    IntegrationMethod("gauss12", "gauss:Gauss", 12, symplectic=True),
    IntegrationMethod("gauss14", "gauss:Gauss", 14, symplectic=True),
    IntegrationMethod("dop853", "explicit:dop853", 8),
    IntegrationMethod("dopri5", "explicit:dopri5", 5),
    IntegrationMethod("rodas5p", "rosenbrock:rodas5p", 5, stiff=True),
    IntegrationMethod("rosenbrock23", "rosenbrock:rosenbrock23", 2, stiff=True),
    IntegrationMethod("bdf", "bdf:Bdf", 5, stiff=True),
    IntegrationMethod("radau", "radau:Radau", 5, stiff=True),
    IntegrationMethod("radau9", "radau:Radau", 9, stiff=True),
    IntegrationMethod("radau13", "radau:Radau", 13, stiff=True),
    IntegrationMethod("rk4", "explicit:rk4", 4, fixed_step=True),
    IntegrationMethod("gauss4", "gauss:Gauss", 4, fixed_step=True, symplectic=True),
    IntegrationMethod("gauss6", "gauss:Gauss", 6, fixed_step=True, symplectic=True),
    IntegrationMethod("implicit_midpoint", "gauss:Gauss", 2, fixed_step=True, symplectic=True),
    IntegrationMethod("verlet", "symplectic:Composition", 2, fixed_step=True, symplectic=True),
    IntegrationMethod("symplectic4", "symplectic:Composition", 4, fixed_step=True, symplectic=True),
    IntegrationMethod("symplectic6", "symplectic:Composition", 6, fixed_step=True, symplectic=True),
    IntegrationMethod("symplectic8", "symplectic:Composition", 8, fixed_step=True, symplectic=True),
    IntegrationMethod(
        "generalized_alpha", "generalized_alpha:GeneralizedAlpha", 2, fixed_step=True, stiff=True
    ),
)

METHODS = {method.name: method for method in _TABLE}
FIXED_STEP = tuple(name for name, method in METHODS.items() if method.fixed_step)
