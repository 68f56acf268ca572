"""Build the site: python -m website OUT"""

from __future__ import annotations

import argparse
import shutil
import sys
from pathlib import Path

from website.contents import add_adding, add_contents
from website.pages import ROOT, Links, Site, from_docs


def written(site: Site, folder: Path) -> None:
    """Write pages and what they show into a folder, for Sphinx.

    Raises
    ------
    SystemExit : a link leads nowhere.
    """
    links = Links(site)
    for path in site.pages:
        target = folder / path
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(links.rewritten(path), encoding="utf-8")
    if links.broken:
        sys.exit("links that lead nowhere:\n  " + "\n  ".join(links.broken))
    for name in links.used:
        target = folder / name.removeprefix("docs/")
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, target)


def whole_site() -> Site:
    """Return the pages that need no run."""
    site = from_docs()
    add_adding(site)
    return site


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m website", description="Build the site.")
    parser.add_argument("out", type=Path, help="folder; pages go to OUT/html")
    out = parser.parse_args().out.resolve()
    from sphinx.cmd.build import build_main

    site = whole_site()
    add_contents(site)
    source = out / "source"
    shutil.rmtree(source, ignore_errors=True)
    written(site, source)
    shutil.copytree(ROOT / "configs", out / "configs", dirs_exist_ok=True)
    here = Path(__file__).parent
    words = ["-b", "html", "-W", "--keep-going", "-q", "-c", str(here), str(source), str(out / "html")]
    sys.exit(build_main(words))


if __name__ == "__main__":
    main()
