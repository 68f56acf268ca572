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
    IntegrationMethod("taylor12", "taylor:Taylor", 12),
    IntegrationMethod("taylor16", "taylor:Taylor", 16),
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
DEFAULT, STIFF = "gauss", "radau13"  # between which `auto` chooses
FIXED_STEP = tuple(name for name, method in METHODS.items() if method.fixed_step)


def _by_family() -> list[list[IntegrationMethod]]:
    """Return the methods of each family, those with a fixed step apart, in the order of the table."""
    families: dict[tuple[str, bool], list[IntegrationMethod]] = {}
    for method in _TABLE:
        families.setdefault((method.family, method.fixed_step), []).append(method)
    return list(families.values())


def _representative(members: list[IntegrationMethod]) -> str:
    """Return the first member, of those with a fixed step the simplest."""
    return (min(members, key=lambda m: m.order) if members[0].fixed_step else members[0]).name


def _references(stiff: bool) -> tuple[str, ...]:
    """Return the best of each family with step control, those that suit ``stiff`` motions first or last."""
    best = [max(members, key=lambda m: m.order) for members in _by_family() if not members[0].fixed_step]
    return tuple(m.name for m in sorted(best, key=lambda m: (m.stiff != stiff, -m.order)))


# one of each family, and of each family the lowest and the highest order
REPRESENTATIVES = tuple(_representative(members) for members in _by_family())
EXTREMES = tuple(
    name
    for members in _by_family()
    for name in METHODS
    if name in {f(members, key=lambda m: m.order).name for f in (min, max)}
)
# for solutions to compare with, in the order in which they are tried: two of them are two families
REFERENCES, STIFF_REFERENCES = _references(stiff=False), _references(stiff=True)
