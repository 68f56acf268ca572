"""The methods of integration: one file a family, one line here, ``module:member``."""

from __future__ import annotations

from robodyn_cli.integrators.stepping.stepper import Stepper
from robodyn_cli.registry import Registry

methods: Registry[type[Stepper]] = Registry(
    "robodyn_cli.integrators.methods",
    {
        "gauss": "gauss:Gauss",
        "gauss8": "gauss_orders:Gauss8",
        "gauss10": "gauss_orders:Gauss10",
        "gauss12": "gauss_orders:Gauss12",
        "gauss14": "gauss_orders:Gauss14",
        "gauss4": "gauss_orders:Gauss4",
        "gauss6": "gauss_orders:Gauss6",
        "implicit_midpoint": "gauss_orders:ImplicitMidpoint",
        "verlet": "symplectic:Verlet",
        "symplectic4": "symplectic:Symplectic4",
        "symplectic6": "symplectic:Symplectic6",
        "symplectic8": "symplectic:Symplectic8",
        "dop853": "explicit:Dop853",
        "dopri5": "explicit:Dopri5",
        "rk4": "explicit:ClassicalRungeKutta",
        "rodas5p": "rosenbrock:Rodas5P",
        "rosenbrock23": "rosenbrock:Rosenbrock23",
        "bdf": "bdf:Bdf",
        "radau": "radau:Radau",
        "radau9": "radau:Radau9",
        "radau13": "radau:Radau13",
        "generalized_alpha": "generalized_alpha:GeneralizedAlpha",
    },
)
