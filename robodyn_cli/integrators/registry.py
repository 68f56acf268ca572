"""The methods of integration by name, made from the lines of ``robodyn_cli.integration_methods`` when asked for."""

from __future__ import annotations

from typing import Any

from robodyn_cli.integration_methods import METHODS
from robodyn_cli.integrators.stepping.stepper import Method
from robodyn_cli.registry import Registry


class Methods(Registry[Method]):
    """A method is made from its line, so that one class serves all members of a family."""

    def make(self, name: str, named: Any) -> Method:
        return named(METHODS[name])


methods = Methods(
    "robodyn_cli.integrators.methods", {name: facts.place for name, facts in METHODS.items()}, made=True
)
