"""Registries: members by name, each imported when it is first asked for.

Names are known at once, so schemas and messages list them all, and a run imports what its scene names.
"""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Mapping, MutableMapping
from typing import Any, TypeVar

T = TypeVar("T")


class Registry(MutableMapping[str, T]):
    """Members of one kind by the name that scenes give them, in the order in which they are listed.

    Parameters
    ----------
    package : where the members' modules are.
    places : ``module:member`` by name.
    made : whether a member is a class of which the registry holds one instance.

    A member that is at hand can be set like an item of any map.
    """

    def __init__(self, package: str, places: Mapping[str, str], made: bool = False) -> None:
        self._package = package
        self._places = dict(places)
        self._made = made
        self._members: dict[str, T] = {}

    def __getitem__(self, name: str) -> T:
        if name not in self._members:
            module, _, member = self._places[name].partition(":")
            named: Any = getattr(importlib.import_module(f"{self._package}.{module}"), member)
            # of two threads that ask first, both get the same instance
            return self._members.setdefault(name, self.make(name, named) if self._made else named)
        return self._members[name]

    def make(self, name: str, named: Any) -> T:
        """Return the member that a registry with ``made`` holds; ``named`` : what its line names."""
        return named()

    def __setitem__(self, name: str, member: T) -> None:
        self._places.setdefault(name, "")
        self._members[name] = member

    def __delitem__(self, name: str) -> None:
        del self._places[name]
        self._members.pop(name, None)

    def __contains__(self, name: object) -> bool:
        return name in self._places

    def __iter__(self) -> Iterator[str]:
        return iter(self._places)

    def __len__(self) -> int:
        return len(self._places)
