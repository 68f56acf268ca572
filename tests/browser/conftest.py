"""A headless browser for tests: Chromium of the distribution, driven by playwright, without a network.

Without either of them the tests are skipped; with ROBODYN_BROWSER=required in the environment, as in ``.ci/run``, they
fail.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator
from importlib.resources import files
from pathlib import Path
from typing import Any

import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
Opener = Callable[..., Any]


def missing(what: str) -> None:
    if os.environ.get("ROBODYN_BROWSER") == "required":
        pytest.fail(f"{what}, and ROBODYN_BROWSER=required")
    pytest.skip(what)


@pytest.fixture(scope="session")
def chromium() -> Iterator[Any]:
    path = next((found for name in NAMES if (found := shutil.which(name))), None)
    if path is None:
        missing("no Chromium on the PATH")
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        missing("the package playwright is not installed")
    with sync_playwright() as driver:
        # root, as in containers, has no sandbox
        browser = driver.chromium.launch(executable_path=path, args=["--no-sandbox"])
        yield browser
        browser.close()


@pytest.fixture
def opened(chromium: Any) -> Iterator[Opener]:
    """Open a page by its file and wait until it is ready; whatever it says on the console, or asks for, fails the test."""
    contexts, said, asked = [], [], []

    def open_page(file: Path, **options: Any) -> Any:
        context = chromium.new_context(
            offline=True, **{"viewport": {"width": 1100, "height": 900}, **options}
        )
        contexts.append(context)
        page = context.new_page()
        page.on("console", lambda message: said.append(message.text))
        page.on("pageerror", lambda error: said.append(str(error)))
        page.on("request", lambda request: asked.append(request.url))
        page.goto(file.as_uri())
        page.locator("html[data-ready]").wait_for(state="attached", timeout=10_000)
        return page

    yield open_page
    for context in contexts:
        context.close()
    assert said == []
    assert [url for url in asked if not url.startswith(("file:", "data:"))] == []


def barriers(page: Any) -> list[str]:
    """Return what axe finds against a page that was opened with ``bypass_csp``, with all of it unfolded."""
    try:
        script = (files("axe_playwright_python") / "axe.min.js").read_text(encoding="utf-8")
    except ImportError:
        missing("the package axe-playwright-python is not installed")
    page.evaluate("document.querySelectorAll('details').forEach((one) => { one.open = true; })")
    page.evaluate(script)
    found = page.evaluate("axe.run(document, {resultTypes: ['violations']})")
    assert len(found["passes"]) > 20, "axe has looked"
    return [f"{rule['id']}: {node['html'][:200]}" for rule in found["violations"] for node in rule["nodes"]]
