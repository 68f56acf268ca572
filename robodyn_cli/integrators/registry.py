"""The methods of integration: one file a family, one line here."""

from __future__ import annotations

from robodyn_cli.integrators.bdf import Bdf
from robodyn_cli.integrators.explicit import ClassicalRungeKutta, Dop853, Dopri5
from robodyn_cli.integrators.gauss import Gauss
from robodyn_cli.integrators.gauss_orders import (
    Gauss4,
    Gauss6,
    Gauss8,
    Gauss10,
    Gauss12,
    Gauss14,
    ImplicitMidpoint,
)
from robodyn_cli.integrators.generalized_alpha import GeneralizedAlpha
from robodyn_cli.integrators.loop import Stepper
from robodyn_cli.integrators.radau import Radau, Radau9, Radau13
from robodyn_cli.integrators.rosenbrock import Rodas5P, Rosenbrock23
from robodyn_cli.integrators.symplectic import Symplectic4, Symplectic6, Symplectic8, Verlet

methods: dict[str, type[Stepper]] = {
    "gauss": Gauss,
    "gauss8": Gauss8,
    "gauss10": Gauss10,
    "gauss12": Gauss12,
    "gauss14": Gauss14,
    "gauss4": Gauss4,
    "gauss6": Gauss6,
    "implicit_midpoint": ImplicitMidpoint,
    "verlet": Verlet,
    "symplectic4": Symplectic4,
    "symplectic6": Symplectic6,
    "symplectic8": Symplectic8,
    "dop853": Dop853,
    "dopri5": Dopri5,
    "rk4": ClassicalRungeKutta,
    "rodas5p": Rodas5P,
    "rosenbrock23": Rosenbrock23,
    "bdf": Bdf,
    "radau": Radau,
    "radau9": Radau9,
    "radau13": Radau13,
    "generalized_alpha": GeneralizedAlpha,
}
