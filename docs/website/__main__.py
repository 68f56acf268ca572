"""Build the site: python -m website OUT"""

from __future__ import annotations

import argparse
import os
import shutil
import sys
from pathlib import Path

from website import runs
from website.api import add_api
from website.commands import add_commands
from website.contents import add_adding, add_contents
from website.examples import HERE as EXAMPLES
from website.examples import add_examples, all_examples
from website.gallery import add_gallery, copy_pictures
from website.indexes import add_keys, add_messages
from website.pages import ROOT, Links, Site, from_docs


def linked(site: Site) -> tuple[dict[str, str], set[str]]:
    """Return the texts of all pages with links as the site has them, and the files that they show or offer.

    Raises
    ------
    SystemExit : a link leads nowhere.
    """
    links = Links(site)
    texts = {path: links.rewritten(path) for path in site.pages}
    if links.broken:
        sys.exit("links that lead nowhere:\n  " + "\n  ".join(links.broken))
    return texts, links.used


def written(site: Site, folder: Path) -> None:
    """Write pages and what they show into a folder, for Sphinx."""
    texts, used = linked(site)
    for path, text in texts.items():
        target = folder / path
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(text, encoding="utf-8")
    for name in used:
        target = folder / name.removeprefix("docs/")
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, target)


def whole_site() -> Site:
    """Return the pages that need no run."""
    site = from_docs()
    add_adding(site)
    add_keys(site)
    add_api(site)
    return site


def add_runs(site: Site, out: Path, jobs: int) -> None:
    """Add what commands print and draw."""
    scenes = {shot.words for shot in runs.scenes()}
    further = [one.shot for one in all_examples().values() if one.shot.words not in scenes]
    shots = add_gallery(site, out, jobs, further)
    add_commands(site, out, shots)
    add_examples(site)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m website", description="Build the site.")
    parser.add_argument("out", type=Path, help="folder; pages go to OUT/html, runs are kept there")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="commands run at a time")
    given = parser.parse_args()
    out = given.out.resolve()
    from sphinx.cmd.build import build_main

    for scenes in (ROOT / "configs", EXAMPLES):
        shutil.copytree(scenes, out / scenes.name, dirs_exist_ok=True)
    site = whole_site()
    add_messages(site)
    linked(site)  # what leads nowhere is told before the long runs
    add_runs(site, out, given.jobs)
    add_contents(site)
    source = out / "source"
    shutil.rmtree(source, ignore_errors=True)
    written(site, source)
    copy_pictures(out, source)
    here = Path(__file__).parent
    words = ["-b", "html", "-W", "--keep-going", "-q", "-c", str(here), str(source), str(out / "html")]
    sys.exit(build_main(words))


if __name__ == "__main__":
    main()
