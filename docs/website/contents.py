"""The table of contents: what stands under which caption, in which order. A page that none lists is an error."""

from __future__ import annotations

import posixpath

from website.pages import Site, toctree

# captions of the side bar, each with pages and folders; a folder stands for the pages in it that nothing else lists
CONTENTS: dict[str, tuple[str, ...]] = {
    "Tutorials": ("tutorials/",),
    "How to": ("how-to/", "adding/index.md"),
    "Gallery": ("gallery/index.md",),
    "Reference": (
        "scene/index.md",
        "commands/index.md",
        "summaries/index.md",
        "python/index.md",
        "equations/index.md",
        "reference/",
    ),
    "About": ("about/",),
}
ORDER = ("student", "deployable", "urdf", "controller", "ci", "notebook", "drives", "motions")


def rank(path: str) -> tuple[int, str]:
    """Return where a page of a folder stands among the others."""
    stem = posixpath.basename(path).partition(".")[0]
    return (ORDER.index(stem) if stem in ORDER else len(ORDER), stem)


def listed(site: Site) -> dict[str, list[str]]:
    """Return the pages under each caption."""
    found = {}
    for caption, entries in CONTENTS.items():
        pages: list[str] = []
        for entry in entries:
            inside = [p for p in site.pages if posixpath.dirname(p) + "/" == entry]
            pages += sorted(inside, key=rank) if entry.endswith("/") else [entry]
        found[caption] = [p for p in pages if p in site.pages]
    return found


def add_contents(site: Site) -> None:
    """Put the table of contents at the end of the first page."""
    for caption, pages in listed(site).items():
        if pages:
            site.pages["index.md"].text += toctree("index.md", pages, caption).replace(
                ":maxdepth", ":hidden:\n:maxdepth"
            )


def add_adding(site: Site) -> None:
    """Add the page above those of docs/adding."""
    below = sorted(p for p in site.pages if p.startswith("adding/"))
    text = "# Adding to the program\n\nEach page builds an example from the first line to the docs."
    text += " What else holds for all of them is in [contributing](../../CONTRIBUTING.md#adding-things).\n"
    site.add("adding/index.md", text + toctree("adding/index.md", below), "docs/adding/index.md")
