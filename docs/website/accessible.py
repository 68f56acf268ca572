"""Check built pages by axe: names, contrasts, headings and keys, by day and by night.

python -m website.accessible OUT/html
"""

from __future__ import annotations

import asyncio
import os
import shutil
import sys
from collections.abc import AsyncIterator, Iterator
from importlib.resources import files
from pathlib import Path

from playwright.async_api import Browser, Page, async_playwright

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome")
SHOWN = 3  # places of a rule on a page
LONGEST = 300  # seconds that a page may take to load
# by night a page differs in its colours alone
COLOURS = {"resultTypes": ["violations"], "runOnly": ["color-contrast"]}
OTHERS = {"resultTypes": ["violations"], "rules": {"color-contrast": {"enabled": False}}}
# colours that are on their way to others would be judged as they are then
READY = """
document.querySelectorAll('details').forEach((one) => { one.open = true; });
document.head.append(Object.assign(document.createElement('style'), {textContent: '* {transition: none !important}'}));
"""
# rows and items look like those before them, and axe takes a minute for the colours of thousands
THINNED = """
document.querySelectorAll('tbody, ul, ol').forEach((one) => [...one.children].slice(20).forEach((row) => row.remove()));
"""


async def barriers(folder: Path, tabs: int) -> int:
    """Print what axe finds against the pages below a folder as soon as it is found, and return how much that is.

    Raises
    ------
    SystemExit : there is no browser.
    """
    path = next((found for name in BROWSERS if (found := shutil.which(name))), None)
    if path is None:
        sys.exit(f"no browser: one of {', '.join(BROWSERS)}")
    # large ones first, so that no tab is left alone with one at the end
    pages = iter(sorted(folder.rglob("*.html"), key=lambda page: -page.stat().st_size))
    async with async_playwright() as driver:
        # root, as in containers, has no sandbox
        browser = await driver.chromium.launch(executable_path=path, args=["--no-sandbox"])
        found = await asyncio.gather(*(in_tab(browser, pages, folder) for _ in range(tabs)))
        await browser.close()
    return sum(found)


async def in_tab(browser: Browser, pages: Iterator[Path], folder: Path) -> int:
    """Look at the pages that other tabs leave, one after another; return how much is found."""
    # tabs of one context share a process, and wait for one another
    context = await browser.new_context(offline=True, bypass_csp=True)
    context.set_default_timeout(1000 * LONGEST)
    await context.add_init_script((files("axe_playwright_python") / "axe.min.js").read_text("utf-8"))
    tab, count = await context.new_page(), 0
    for path in pages:
        await tab.goto(path.as_uri())
        async for text in found_on(tab):
            print(f"{path.relative_to(folder)} {text}", flush=True)
            count += 1
    return count


async def found_on(tab: Page) -> AsyncIterator[str]:
    """Yield what axe finds against the page of a tab by day and by night."""
    for scheme, change, options in (
        ("light", READY, OTHERS),
        ("light", THINNED, COLOURS),
        ("dark", "", COLOURS),
    ):
        await tab.emulate_media(color_scheme="dark" if scheme == "dark" else "light")
        await tab.evaluate(change)
        for rule in (await tab.evaluate("(options) => axe.run(document, options)", options))["violations"]:
            places = [node["html"][:160] for node in rule["nodes"]]
            yield f"({scheme}): {rule['id']} ({len(places)}): {rule['help']}: {'; '.join(places[:SHOWN])}"


if __name__ == "__main__":
    count = asyncio.run(barriers(Path(sys.argv[1]).resolve(), os.cpu_count() or 1))
    print(f"axe finds {count} faults of pages" if count else "axe finds nothing against the pages")
    sys.exit(bool(count))
