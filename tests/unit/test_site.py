"""The site holds every page, section and command, and its links lead somewhere; ``.ci/site`` builds and tries it."""

from __future__ import annotations

import re
from functools import lru_cache
from pathlib import Path

import pytest
from website.__main__ import whole_site
from website.contents import listed
from website.examples import WITHOUT, all_examples
from website.gallery import whole
from website.indexes import messages
from website.pages import DOCS, ROOT, Links, Site, sources
from website.runs import drawing, scenes
from website.text import headings, sections, slug

import robodyn
from robodyn_cli import load_scene
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
    trees = "".join(page.text + page.after for page in site().pages.values())
    for path in site().pages:
        listed_below = re.search(rf"^{Path(path).stem}$", trees, re.MULTILINE)
        assert path == "index.md" or path in pages or listed_below, path
    assert len(pages) == len(set(pages))


def test_links_lead_somewhere() -> None:
    links = Links(site())
    for path in site().pages:
        links.rewritten(path)
    assert links.broken == []


def test_headings_are_where_links_look_for_them() -> None:
    for (name, _), (path, anchor) in site().homes.items():
        assert not anchor or anchor in {slug(h) for _, h in headings(site().pages[path].text)}, (
            f"{name}: {path}#{anchor}"
        )
    assert site().homes["docs/cli.md", "statics"] == ("summaries/statics.md", "statics")


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


def test_every_section_of_a_scene_has_a_whole_example() -> None:
    """That loads, and writes a key of the section, if the section has a table of keys."""
    text = (DOCS / "scene.md").read_text(encoding="utf-8")
    parts = {slug(heading): body for heading, body in sections(text, 2)[1]}
    examples = all_examples()
    assert sorted(parts) == sorted([*examples, *WITHOUT])
    for name, example in examples.items():
        scene = load_scene(example.shot.file)
        assert example.plot in {place.partition(":")[2] for place in COMMANDS[example.shot.command].plots}
        assert scene.command is not None
        tables = re.findall(r"<!-- keys: .*?<!-- end -->", parts[name], re.DOTALL)
        keys = {key for table in tables for key in re.findall(r"^\| `(\w+)` \|", table, re.MULTILINE)}
        assert not keys or keys & set(re.findall(r"(\w+):", whole(example.shot.file))), name


def test_indexes_hold_keys_and_messages() -> None:
    keys = site().pages["reference/keys.md"].text
    assert all(f"| `{key}` |" in keys for key in ("mass", "coulomb", "schema", "vary"))
    found = messages(ROOT / "robodyn_cli" / "drives")
    assert {"SceneError", "CapabilityError", ""} <= {message.kind for message in found}
    assert all(len(message.text.split()) > 2 for message in found)


def test_the_python_pages_have_every_name() -> None:
    text = "".join(page.text for path, page in site().pages.items() if path.startswith("python/"))
    assert all(f"\n## {name}\n" in text for name in robodyn.__all__ if name != "__version__")


def test_examples_of_all_kinds_of_commands_are_run() -> None:
    commands = {shot.command for shot in (*scenes(), *drawing())}
    assert {name for name, row in COMMANDS.items() if row.plots} <= commands
