"""Check built pages by axe: names, headings and keys on a screen and on a telephone, contrasts by day and by night.

Each page is loaded once; what differs between the states is judged in each of them. On a telephone no page is wider
than the screen.

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
# below 63 em the side bar becomes a drawer behind a button, and code and tables scroll
SCREEN, TELEPHONE = {"width": 1400, "height": 1000}, {"width": 400, "height": 800}
# by night a page differs in its colours alone, and they are the same in all widths
COLOURS = {"resultTypes": ["violations"], "runOnly": ["color-contrast"]}
OTHERS = {"resultTypes": ["violations"], "rules": {"color-contrast": {"enabled": False}}}
# colours that are on their way to others would be judged as they are then
READY = """
document.querySelectorAll('details').forEach((one) => { one.open = true; });
document.head.append(Object.assign(document.createElement('style'), {textContent: '* {transition: none !important}'}));
"""
# rows, items, formulas and words of code look like others of their kind, and axe takes a minute for the colours of
# thousands
THINNED = """
document.querySelectorAll('tbody, ul, ol').forEach((one) => [...one.children].slice(5).forEach((row) => row.remove()));
[...document.querySelectorAll('math')].slice(20).forEach((one) => one.remove());
const seen = new Set();
document.querySelectorAll('pre span[class]').forEach((one) => {
  const kind = `${one.className} in ${one.closest('.highlight')?.parentElement.className}`;
  if (seen.has(kind)) one.remove(); else seen.add(kind);
});
"""
STATES = (
    ("wide", "light", SCREEN, READY, OTHERS),
    ("narrow", "light", TELEPHONE, "", OTHERS),
    ("light", "light", SCREEN, THINNED, COLOURS),
    ("dark", "dark", SCREEN, "", COLOURS),
)
# a page hears of its new size with the next frame
DRAWN = "() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))"
# the innermost things that stand out of a page and do not scroll inside something
TOO_WIDE = """
() => {
  if (document.documentElement.scrollWidth <= innerWidth) return [];
  const found = [...document.querySelectorAll('main *')].filter((one) => {
    if (one.getBoundingClientRect().right <= innerWidth + 1) return false;
    for (let up = one.parentElement; up; up = up.parentElement)
      if (getComputedStyle(up).overflowX !== 'visible' && up !== document.body) return false;
    return ![...one.children].some((inner) => inner.getBoundingClientRect().right > innerWidth + 1);
  });
  return (found.length ? found : [document.body]).map((one) => one.outerHTML);
}
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
    pages = counted(sorted(folder.rglob("*.html"), key=lambda page: -page.stat().st_size))
    async with async_playwright() as driver:
        # root, as in containers, has no sandbox
        browser = await driver.chromium.launch(executable_path=path, args=["--no-sandbox"])
        found = await asyncio.gather(*(in_tab(browser, pages, folder) for _ in range(tabs)))
        await browser.close()
    return sum(found)


def counted(pages: list[Path]) -> Iterator[Path]:
    """Yield pages, and tell now and then how many are left: all of them take minutes."""
    for k, page in enumerate(pages):
        if k and k % 50 == 0:
            print(f"{k} of {len(pages)} pages", flush=True)
        yield page


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
    """Yield what is wrong with the page of a tab, in each state."""
    for state, scheme, size, change, options in STATES:
        await tab.emulate_media(color_scheme=scheme)
        await tab.set_viewport_size(size)
        await tab.evaluate(change)
        await tab.evaluate(DRAWN)
        if size is TELEPHONE and (places := await tab.evaluate(TOO_WIDE)):
            yield told(state, "wider than the screen", places)
        for rule in (await tab.evaluate("(options) => axe.run(document, options)", options))["violations"]:
            yield told(state, f"{rule['id']}: {rule['help']}", [node["html"] for node in rule["nodes"]])


def told(state: str, fault: str, places: list[str]) -> str:
    """Return a fault with the first of its places."""
    return f"({state}): {fault} ({len(places)}): {'; '.join(place[:160] for place in places[:SHOWN])}"


if __name__ == "__main__":
    count = asyncio.run(barriers(Path(sys.argv[1]).resolve(), os.cpu_count() or 1))
    print(f"{count} faults of pages" if count else "axe finds nothing against the pages")
    sys.exit(bool(count))
