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


def covering(families: Families, apart: Collection[frozenset[Part]], most: int) -> list[Case]:
    """Return scenes that hold every pair but those that stay apart.

    families : names of features by family, of which a scene has at most one each.
    apart : sets of features that no scene must have all of. most : features in a scene, so that one that fails is read
    easily.
    """
    against: dict[Part, list[frozenset[Part]]] = {}
    for group in apart:
        for part in group:
            against.setdefault(part, []).append(group - {part})
    left = {
        frozenset(pair): None for pair in sets_of(families) if not any(group <= set(pair) for group in apart)
    }
    partners: dict[Part, set[Part]] = {part: set() for part in parts_of(families)}
    for one, two in left:
        partners[one].add(two)
        partners[two].add(one)
    cases = []
    while left:
        chosen = list(next(iter(left)))
        while len(chosen) < most:
            taken, here = {family for family, _ in chosen}, set(chosen)
            possible = [
                part for part in partners
                if part[0] not in taken and not any(group <= here for group in against.get(part, ()))
            ]  # fmt: skip
            gains = [
                (sum(x in partners[p] for x in chosen), len(partners[p]), -k) for k, p in enumerate(possible)
            ]
            if not gains or max(gains)[0] == 0:
                break
            chosen.append(possible[-max(gains)[2]])
        for one, two in combinations(chosen, 2):
            left.pop(frozenset((one, two)), None)
            partners[one].discard(two)
            partners[two].discard(one)
        cases.append(dict(sorted(chosen)))
    return cases
