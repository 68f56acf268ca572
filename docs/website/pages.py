"""The pages that come from files of docs/: which they are, how long ones are split, and where links lead then."""

from __future__ import annotations

import dataclasses
import posixpath
import re
import runpy
from pathlib import Path

from website.text import (
    LINK,
    headings,
    lines_with_fences,
    promoted,
    prose,
    sections,
    slug,
    without_comments,
    without_contents,
)

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
# where files outside docs/, and those that the site names otherwise, stand in the site
PLACES = {
    "README.md": "index.md",
    "CHANGELOG.md": "about/changelog.md",
    "CONTRIBUTING.md": "about/contributing.md",
    "SECURITY.md": "about/security.md",
    **{
        f"docs/{name}.md": f"about/{name}.md"
        for name in ("design", "versions", "benchmarks", "benchmarks-rows")
    },
    "docs/stability.md": "about/stability.md",
    **{f"docs/{name}.md": f"how-to/{name}.md" for name in ("choosing-an-integrator", "drives", "motions")},
    "docs/published.md": "how-to/published.md",
    "docs/python.md": "python/index.md",
    "docs/tutorial.ipynb": "tutorials/notebook.ipynb",
    "docs/hdf5.md": "reference/hdf5.md",
}
# long files, with the folder that takes a page for each section
SPLIT = {"docs/scene.md": "scene", "docs/theory.md": "equations", "docs/cli.md": "commands"}
# sections of docs/cli.md that are split again, with the folder of theirs
AGAIN = {"Commands": "commands", "summary.json": "summaries"}
OPTIONS = "Options of "


@dataclasses.dataclass
class Page:
    """A page of the site: its text, with links as in the file that it comes from, and what is added below its heading
    and at its end, with links as in the site. A page that comes from no file has links as in the site throughout."""

    text: str
    source: str  # path in the repository, "" of a page that comes from no file
    below: str = ""
    after: str = ""


@dataclasses.dataclass
class Site:
    """Pages by their path in the site, and the page and anchor at which each heading of a file is."""

    pages: dict[str, Page] = dataclasses.field(default_factory=dict)
    homes: dict[tuple[str, str], tuple[str, str]] = dataclasses.field(default_factory=dict)
    files: dict[str, str] = dataclasses.field(default_factory=dict)  # other files, by path in the repository

    def add(self, path: str, text: str, source: str) -> None:
        """Add a page, with the homes of its headings; the first page that has a heading keeps it."""
        self.pages[path] = Page(text, source)
        self.homes.setdefault((source, ""), (path, ""))
        seen: dict[str, int] = {}
        for _, heading in headings(text):
            anchor = slug(heading)
            seen[anchor] = seen.get(anchor, -1) + 1
            if not seen[anchor]:
                self.homes.setdefault((source, anchor), (path, anchor))


def repository() -> str:
    """Return the address of the repository, "" as long as its owner has written none."""
    return str(runpy.run_path(str(ROOT / "robodyn_cli" / "version.py"))["REPOSITORY"]).rstrip("/")


def place(source: str) -> str:
    """Return where a file that is not split stands in the site."""
    return PLACES.get(source, source.removeprefix("docs/"))


def sources() -> list[str]:
    """Return the files that the site is made of, by their path in the repository."""
    found = [
        p for pattern in ("*.md", "*/*.md", "*.ipynb") for p in DOCS.glob(pattern) if "website" not in p.parts
    ]
    names = [p.relative_to(ROOT).as_posix() for p in sorted(found)]
    return [*names, "CHANGELOG.md", "CONTRIBUTING.md", "SECURITY.md"]


def from_docs() -> Site:
    """Return the pages that come from files."""
    site = Site()
    for name in sources():
        text = (ROOT / name).read_text(encoding="utf-8")
        if name.endswith(".ipynb"):
            site.pages[place(name)] = Page(text, name)
            site.homes[name, ""] = (place(name), "")
        elif name in SPLIT:
            split(site, name, text)
        else:
            site.add(place(name), without_contents(text), name)
    site.homes["README.md", ""] = ("index.md", "")
    return site


def split(site: Site, name: str, text: str) -> None:
    """Add a page for each section of a file, below a first one that lists them."""
    folder = SPLIT[name]
    first, parts = sections(without_contents(text), 2)
    children: list[str] = []
    site.add(f"{folder}/index.md", first, name)
    for heading, body in parts:
        if name == "docs/cli.md" and heading in AGAIN:
            children += split_again(site, heading, body)
            continue
        path = f"{folder}/{slug(heading)}.md"
        site.add(path, f"# {heading}\n\n{promoted(body, 1)}", name)
        children.append(path)
    site.pages[f"{folder}/index.md"].text += toctree(f"{folder}/index.md", children)


def split_again(site: Site, heading: str, body: str) -> list[str]:
    """Add a page for each part of a long section of docs/cli.md; return those to list beside other sections."""
    folder, name = AGAIN[heading], "docs/cli.md"
    intro, parts = sections(body, 3)
    if heading == "Commands":
        site.pages["commands/index.md"].text += f"\n## Commands\n\n{intro}"
        site.homes[name, slug(heading)] = ("commands/index.md", slug(heading))
        children = []
        for title, text in parts:
            children += commands_of(site, title, text)
        return children
    paths = []
    site.add(f"{folder}/index.md", f"# {heading}\n\n{intro}", name)
    for title, text in parts:
        paths.append(f"{folder}/{slug(title)}.md")
        site.add(paths[-1], f"# {title}\n\n{promoted(text, 2)}", name)
    site.pages[f"{folder}/index.md"].text += toctree(f"{folder}/index.md", paths)
    return []


def commands_of(site: Site, title: str, text: str) -> list[str]:
    """Add the page of each command that a section of options is about, or one for a section that is about none."""
    name = "docs/cli.md"
    if not title.startswith(OPTIONS):
        path = f"commands/{slug(title)}.md"
        site.add(path, f"# {title}\n\n{promoted(text, 2)}", name)
        return [path]
    paths = []
    for command in re.split(r", | and ", title.removeprefix(OPTIONS)):
        paths.append(f"commands/{command}.md")
        site.add(paths[-1], f"# robodyn {command}\n\n## Options\n\n{promoted(text, 1)}", name)
        site.homes.setdefault((name, slug(title)), (paths[-1], "options"))
    return paths


def toctree(page: str, children: list[str], caption: str = "", depth: int = 1) -> str:
    """Return the list of pages below a page."""
    folder = posixpath.dirname(page)
    paths = [posixpath.relpath(child, folder or ".").rpartition(".")[0] for child in children]
    head = [f":maxdepth: {depth}"] + ([f":caption: {caption}"] if caption else [])
    return "\n".join(["", "```{toctree}", *head, "", *paths, "```", ""])


class Links:
    """Leads the links of pages to where their targets are in the site, or in the repository."""

    def __init__(self, site: Site) -> None:
        self.site, self.address = site, repository()
        self.used: set[str] = set()  # files that pages show or offer, by their path in the repository
        self.broken: list[str] = []

    def rewritten(self, path: str) -> str:
        """Return the text of a page for the site."""
        page = self.site.pages[path]

        def change(part: str) -> str:
            return LINK.sub(lambda m: self.link(path, page.source, m), part)

        text = prose(without_comments(page.text), change) if page.source else page.text
        if page.below:
            first, _, rest = text.partition("\n")
            text = f"{first}\n\n{page.below}\n{rest}"
        return f"{text}\n{page.after}" if page.after else text

    def link(self, path: str, source: str, match: re.Match[str]) -> str:
        """Return a link of a page as the site has it."""
        mark, words, target = match.groups()
        if target.startswith(("http:", "https:", "mailto:")):
            return match.group()
        words = LINK.sub(lambda m: self.link(path, source, m), words)
        name, _, anchor = target.partition("#")
        file = posixpath.normpath(posixpath.join(posixpath.dirname(source), name)) if name else source
        here = posixpath.dirname(path)
        home = self.site.homes.get((file, anchor))
        if home:
            to = posixpath.relpath(home[0], here or ".")
            words = self.title(home) if words == posixpath.basename(name) else words
            anchor = f"#{home[1]}" if home[1] else ""
            return f"{mark}[{words}]({to}{anchor})"
        if file in self.site.files:
            return f"{mark}[{words}]({posixpath.relpath(self.site.files[file], here or '.')})"
        if mark and (ROOT / file).is_file():
            self.used.add(file)
            return f"![{words}]({posixpath.relpath(file.removeprefix('docs/'), here or '.')})"
        if not (ROOT / file).exists() or (file.endswith(".md") and file in sources()):
            self.broken.append(f"{source}: {target}")
        return f"[{words}]({self.address}/blob/main/{file})" if self.address else words

    def title(self, home: tuple[str, str]) -> str:
        """Return the heading at a place."""
        found = headings(self.site.pages[home[0]].text)
        return next((words for _, words in found if slug(words) == home[1] or not home[1]), home[0])


def first_words(text: str) -> str:
    """Return the first paragraph of a page below its title, on one line."""
    plain = [line for line, inside in lines_with_fences(text) if not inside and not line.startswith("#")]
    return " ".join("\n".join(plain).strip().split("\n\n")[0].split())
