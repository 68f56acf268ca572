"""The site holds every page, section and command, and its links lead somewhere; ``.ci/site`` builds and tries it."""

from __future__ import annotations

import re
import subprocess
from functools import lru_cache
from pathlib import Path

import pytest
from website import blocks
from website.__main__ import linked, whole_site
from website.check import wrong
from website.commands import foot
from website.contents import listed
from website.examples import WITHOUT, all_examples
from website.gallery import CARDS, index, names, whole
from website.indexes import messages
from website.pages import DOCS, ROOT, Links, Site, sources
from website.runs import Shot, done, drawing, examples, scenes
from website.text import headings, sections, side_by_side, slug

import robodyn
from robodyn_cli import load_scene
from robodyn_cli.commands import COMMANDS

HEADER = re.compile(r"^(\|.*\|)\n\|[-:| ]+\|$", re.MULTILINE)


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


def test_links_that_lead_nowhere_are_told_before_the_long_runs() -> None:
    broken = whole_site()
    broken.add("about/lost.md", "# Lost\n\n[a key](../docs/scene.md#no-such-key)\n", "docs/lost.md")
    with pytest.raises(SystemExit, match="docs/lost.md: ../docs/scene.md#no-such-key"):
        linked(broken)


def test_built_pages_are_checked(tmp_path: Path) -> None:
    (tmp_path / "a.html").write_text(
        '<p id="here"><a href="b.html#there"></a><a href="c.html"></a><a href="#here"></a>'
    )
    (tmp_path / "b.html").write_text('<script src="https://example.org/x.js"></script>')
    assert sorted(wrong(tmp_path)) == [
        "a.html: b.html#there: no such place",
        "a.html: c.html leads nowhere",
        "b.html: loads https://example.org/x.js",
    ]


def test_what_fails_is_told_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """While others, that take longer, still run."""
    said: list[str] = []
    monkeypatch.setattr("builtins.print", lambda *words, **_: said.append(words[0]))
    ends = lambda words, **_: subprocess.CompletedProcess(words, 2 if "worse" in words else 0, "", "why")  # noqa: E731
    with monkeypatch.context() as patched, pytest.raises(SystemExit, match="commands fail:\ninfo worse$"):
        patched.setattr(subprocess, "run", ends)
        done([Shot("info worse"), Shot("info better")], tmp_path, jobs=1)
    assert [text.split("  ")[-1] for text in said] == [
        "robodyn info worse",
        "robodyn info worse: exit code 2\nwhy",
        "robodyn info better",
    ]
    code = [
        ("python", "print('seen'); raise SystemExit(3)", 0),
        ("python", "pass", 0),
        ("python", "raise SystemExit(3)", 3),
    ]
    monkeypatch.setattr(blocks, "blocks", lambda page: code)
    said.clear()
    assert blocks.followed("docs/tutorials/some.md", tmp_path) == 1
    assert [text.partition(" of\n")[0] for text in said if " s  " not in text] == [
        "docs/tutorials/some.md: exit code 3"
    ]
    assert "exit code" in said[1] and said[1].endswith("seen\n"), "at once, with what it has printed"


def test_examples_in_help_run_each_command_by_itself(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside one another, from the same results; what clears kernels has some of its own."""
    ran: list[tuple[str, str, str]] = []

    def end(
        words: list[str], *, cwd: Path, env: dict[str, str], **_: object
    ) -> subprocess.CompletedProcess[str]:
        ran.append((words[-1], cwd.name, env.get("ROBODYN_CACHE", "")))
        (cwd / words[-1].split()[1]).touch()
        return subprocess.CompletedProcess(
            words, blocks.ENDS.get(words[-1].removeprefix("robodyn "), 0), "", ""
        )

    monkeypatch.setattr(subprocess, "run", end)
    monkeypatch.setenv("ROBODYN_CACHE", "of-all")
    assert blocks.main(tmp_path, ["cache", "compare"]) == 0
    before = len(blocks.BEFORE)
    assert {folder for _, folder, _ in ran[:before]} == {blocks.HELP}
    assert sorted(words for words, _, _ in ran[before:]) == sorted(
        f"robodyn {words}" for name in ("cache", "compare") for words in examples(name)
    )
    for name, cache in (("cache", str(tmp_path / "blocks/cache/cache")), ("compare", "of-all")):
        assert {cache} == {used for _, folder, used in ran if folder == name}
        made = {path.name for path in (tmp_path / "blocks" / name).iterdir()}
        assert made == {"configs", name, *(words.split()[0] for words in blocks.BEFORE)}


def test_formulas_side_by_side_are_parted_at_wide_spaces_outside_of_others() -> None:
    inside = r"\left\{ c \quad d \right. = \begin{cases} x \quad \text{if } y \end{cases}"
    assert side_by_side(rf"a, \qquad {inside} \quad \{{b") == ["a, ", f" {inside} ", r" \{b"]
    assert side_by_side(r"a \qquad") == ["a "]


def test_headers_of_tables_have_words() -> None:
    """Formulas alone, and nothing, have no name for those who listen."""
    for name in (name for name in [*sources(), "README.md"] if name.endswith(".md")):
        for row in HEADER.findall((ROOT / name).read_text(encoding="utf-8")):
            cells = re.split(r"(?<!\\)\|", re.sub(r"\$.*?\$", "", row))[1:-1]
            assert all(re.search(r"\w", cell) for cell in cells), f"{name}: {row}"


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


def test_the_lock_of_the_first_page_and_the_tutorial_is_that_of_the_readme() -> None:
    """Which is what the command prints (docs/make_results.py)."""
    lock = re.search(
        r"^  time +(12\.28\S+ \+- \S+ s)$", (ROOT / "README.md").read_text("utf-8"), re.MULTILINE
    )
    for name in ("index.md", "tutorials/deployable.md"):
        text = (DOCS / name).read_text(encoding="utf-8")
        assert lock and re.findall(r"12\.28\d+ \+- \S+ s", text) == [lock[1]], name


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


def test_cards_of_the_gallery_say_what_they_show() -> None:
    """In words alone, a plot of the scene's own command."""
    found = re.findall(r"^:alt: (.*)$", index(scenes()), re.MULTILINE)
    assert len(found) == len(scenes()) and not any("](" in alt for alt in found)
    commands = {shot.scene: shot.command for shot in scenes()}
    assert all(kind in names(COMMANDS[commands[scene]].plots) for scene, kind in CARDS.items())


def test_pages_of_commands_lead_to_their_own_summaries() -> None:
    text = {command: foot(site(), command) for command in COMMANDS}
    assert "(../summaries/simulate-and-deploy.md)" in text["simulate"]
    assert "(../summaries/work-precision.md)" in text["work-precision"]
    assert (
        "summary.json" not in text["validate"] and "what-other-commands-print-as-json.md#" in text["validate"]
    )


def test_tables_of_options_stand_alone() -> None:
    """What stands above in the file is on another page of the site."""
    for command in COMMANDS:
        assert "as above" not in site().pages[f"commands/{command}.md"].text, command
