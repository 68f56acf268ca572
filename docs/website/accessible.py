"""Check built pages by axe: names, contrasts, headings and keys, by day and by night.

python -m website.accessible OUT/html
"""

from __future__ import annotations

import shutil
import sys
from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path

from playwright.sync_api import Page, sync_playwright

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome")
SHOWN = 3  # places of a rule on a page


def barriers(folder: Path) -> Iterator[str]:
    """Yield what axe finds against the pages below a folder.

    Raises
    ------
    SystemExit : there is no browser.
    """
    browser = next((found for name in BROWSERS if (found := shutil.which(name))), None)
    if browser is None:
        sys.exit(f"no browser: one of {', '.join(BROWSERS)}")
    with sync_playwright() as driver:
        # root, as in containers, has no sandbox
        opened = driver.chromium.launch(executable_path=browser, args=["--no-sandbox"])
        for scheme in ("light", "dark"):
            context = opened.new_context(color_scheme=scheme, offline=True, bypass_csp=True)
            page = context.new_page()
            for path in sorted(folder.rglob("*.html")):
                page.goto(path.as_uri())
                yield from (f"{path.relative_to(folder)} ({scheme}): {text}" for text in found_on(page))
            context.close()


def found_on(page: Page) -> Iterator[str]:
    """Yield what axe finds against a page, all of it unfolded."""
    page.evaluate("document.querySelectorAll('details').forEach((one) => { one.open = true; })")
    page.evaluate((files("axe_playwright_python") / "axe.min.js").read_text(encoding="utf-8"))
    for rule in page.evaluate("axe.run(document, {resultTypes: ['violations']})")["violations"]:
        places = [node["html"][:160] for node in rule["nodes"]]
        yield f"{rule['id']} ({len(places)}): {rule['help']}: {'; '.join(places[:SHOWN])}"


if __name__ == "__main__":
    root = Path(sys.argv[1]).resolve()
    found = list(barriers(root))
    print("\n".join(found) or "axe finds nothing against the pages")
    sys.exit(bool(found))
