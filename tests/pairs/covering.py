"""A covering array: few scenes, in which every pair of features meets that goes together (greedy, deterministic)."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from itertools import combinations

Case = dict[str, str]
Part = tuple[str, str]  # family, name of the feature
Families = Mapping[str, Collection[str]]


def parts_of(families: Families) -> list[Part]:
    """Return all features."""
    return [(family, name) for family, names in families.items() for name in names]


def sets_of(families: Families, strength: int = 2) -> Iterator[tuple[Part, ...]]:
    """Return all sets of features of different families, as many in a set as ``strength``."""
    for parts in combinations(parts_of(families), strength):
        if len({family for family, _ in parts}) == strength:
            yield parts


def covering(families: Families, apart: Collection[tuple[Part, ...]], most: int) -> list[Case]:
    """Return scenes that hold every pair but those that stay apart.

    families : names of features by family, of which a scene has at most one each.
    apart : pairs that a scene must not have. most : features in a scene, so that one that fails is easily read.
    """
    never = {frozenset(pair) for pair in apart}
    left = {frozenset(pair): None for pair in sets_of(families) if frozenset(pair) not in never}
    partners: dict[Part, set[Part]] = {part: set() for part in parts_of(families)}
    for one, two in left:
        partners[one].add(two)
        partners[two].add(one)
    cases = []
    while left:
        chosen = list(next(iter(left)))
        possible = [part for part in partners if all(frozenset((part, x)) not in never for x in chosen)]
        while len(chosen) < most:
            taken = {family for family, _ in chosen}
            possible = [p for p in possible if p[0] not in taken and frozenset((p, chosen[-1])) not in never]
            gains = [(sum(x in partners[p] for x in chosen), len(partners[p]), -k) for k, p in enumerate(possible)]
            if not gains or max(gains)[0] == 0:
                break
            chosen.append(possible[-max(gains)[2]])
        for one, two in combinations(chosen, 2):
            left.pop(frozenset((one, two)), None)
            partners[one].discard(two)
            partners[two].discard(one)
        cases.append(dict(sorted(chosen)))
    return cases
