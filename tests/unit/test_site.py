"""The site holds every page, section and command, and its links lead somewhere; ``.ci/site`` builds and tries it."""

from __future__ import annotations

import re
from functools import lru_cache
from pathlib import Path

import pytest
from website.__main__ import whole_site
from website.contents import listed
from website.pages import DOCS, ROOT, Links, Site, sources
from website.text import headings, slug

from robodyn_cli.commands import COMMANDS


@lru_cache
def site() -> Site:
    return whole_site()


def test_every_file_of_docs_is_on_the_site() -> None:
    files = {p.relative_to(ROOT).as_posix() for suffix in ("md", "ipynb") for p in DOCS.rglob(f"*.{suffix}")}
    assert files <= set(sources())
    assert files <= {source for source, _ in site().homes}


def test_every_heading_of_docs_is_on_the_site() -> None:
    for name in sources():
        if name.endswith(".md") and name != "docs/index.md":
            text = (ROOT / name).read_text(encoding="utf-8")
            missing = {slug(h) for _, h in headings(text)} - {a for n, a in site().homes if n == name}
            assert not missing, f"{name}: {missing}"


def test_every_command_has_a_page() -> None:
    for command in COMMANDS:
        assert "## Options" in site().pages[f"commands/{command}.md"].text


def test_every_page_is_in_the_contents() -> None:
    pages = [page for pages in listed(site()).values() for page in pages]
    trees = "".join(page.text for page in site().pages.values())
    for path in site().pages:
        listed_below = re.search(rf"^{Path(path).stem}$", trees, re.MULTILINE)
        assert path == "index.md" or path in pages or listed_below, path
    assert len(pages) == len(set(pages))


def test_links_lead_somewhere() -> None:
    links = Links(site())
    for path in site().pages:
        links.rewritten(path)
    assert links.broken == []


@pytest.mark.parametrize("name", [name for name in sources() if name.endswith(".md")])
def test_anchors_are_clear(name: str) -> None:
    """Of two headings of one name, links reach the first alone."""
    found = [slug(heading) for _, heading in headings((ROOT / name).read_text(encoding="utf-8"))]
    doubled = {anchor for anchor in found if found.count(anchor) > 1}
    assert not doubled or name == "CHANGELOG.md"


def test_the_contents_of_the_reference_are_whole() -> None:
    text = (DOCS / "scene.md").read_text(encoding="utf-8")
    contents = re.search(r"^Contents: (.*?)\n\n", text, re.DOTALL | re.MULTILINE)
    assert contents is not None
    assert re.findall(r"\(#([^)]+)\)", contents[1]) == [slug(h) for level, h in headings(text) if level == 2]


def test_the_first_page_has_three_commands_to_the_first_picture() -> None:
    blocks = re.findall(
        r"^```sh\n(.*?)^```", (DOCS / "index.md").read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE
    )
    assert len(blocks) == 1 and len(blocks[0].splitlines()) == 3
    assert "pip install robodyn\n" in blocks[0]
