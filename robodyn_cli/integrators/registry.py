"""The methods of integration: one file a family, one line here."""

from __future__ import annotations

from robodyn_cli.integrators.explicit import ClassicalRungeKutta, Dop853, Dopri5
from robodyn_cli.integrators.gauss import Gauss
from robodyn_cli.integrators.loop import Stepper
from robodyn_cli.integrators.radau import Radau, Radau9, Radau13
from robodyn_cli.integrators.rosenbrock import Rodas5P, Rosenbrock23

methods: dict[str, type[Stepper]] = {
    "gauss": Gauss,
    "dop853": Dop853,
    "dopri5": Dopri5,
    "rk4": ClassicalRungeKutta,
    "rodas5p": Rodas5P,
    "rosenbrock23": Rosenbrock23,
    "radau": Radau,
    "radau9": Radau9,
    "radau13": Radau13,
}
