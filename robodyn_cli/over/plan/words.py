"""Names and numbers as phrases."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

SHOWN = 6  # names in a list before it is cut short


def listed(names: Iterable[str]) -> str:
    """Return names as a phrase; long lists are cut short."""
    names = list(dict.fromkeys(names))
    if len(names) > SHOWN:
        return f"{', '.join(names[: SHOWN - 1])} and {len(names) - SHOWN + 1} more"
    if len(names) < 2:
        return "".join(names)
    return f"{', '.join(names[:-1])} and {names[-1]}"


def plural(count: int, word: str) -> str:
    """Return ``2 joints``, ``1 joint``, ``no joint``; ``3 moving bodies``."""
    if count > 1:
        word = f"{word[:-1]}ies" if word.endswith("dy") else f"{word}s"
    return f"{count or 'no'} {word}"


def listed_data(names: Iterable[str]) -> str:
    """Return names such as ``inertia.xx of link2`` as a phrase, links with the same data together."""
    of_link: dict[str, list[str]] = {}
    for name in names:
        what, _, link = name.partition(" of ")
        of_link.setdefault(link, []).append(what)
    same: dict[tuple[str, ...], list[str]] = {}
    for link, whats in of_link.items():
        same.setdefault(tuple(whats), []).append(link)
    return "; ".join(f"{', '.join(_short(whats))} of {listed(links)}" for whats, links in same.items())


def _short(whats: Sequence[str]) -> list[str]:
    """Return ``inertia.xx, yy`` for ``inertia.xx``, ``inertia.yy``."""
    tensor = [w.partition(".")[2] for w in whats if w.startswith("inertia.")]
    found = [w for w in whats if not w.startswith("inertia.")]
    return [*found, f"inertia.{tensor[0]}", *tensor[1:]] if tensor else found
