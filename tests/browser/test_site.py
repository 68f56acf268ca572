"""Pages of the site as axe judges them, by ``docs/website/accessible.py``."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

from website.pages import DOCS

PAGE = """<!doctype html><html lang="en"><head><title>{title}</title><meta name="viewport" content="width=device-width">
<style>body {{ color: black; background: white }} {style}</style></head><body><main><h1>{title}</h1>{body}</main></body></html>"""
NIGHT = "p {transition: color 1s} @media (prefers-color-scheme: dark) {p {color: #eee}}"


def judged(folder: Path) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": str(DOCS)}
    words = [sys.executable, "-m", "website.accessible", str(folder)]
    return subprocess.run(words, env=environment, capture_output=True, text=True, timeout=120)


def write(folder: Path, name: str, body: str, style: str = "") -> None:
    folder.mkdir(exist_ok=True)
    (folder / f"{name}.html").write_text(PAGE.format(title=name, body=body, style=style))


def test_axe_looks_at_every_page_on_screens_of_all_kinds(tmp_path: Path, chromium: Any) -> None:
    for k in range(5):
        write(tmp_path, f"good{k}", "<p>words</p>")
    fine = judged(tmp_path)
    assert (fine.returncode, fine.stdout) == (0, "axe finds nothing against the pages\n"), fine.stderr
    write(tmp_path, "headless", "<table><tr><th></th><th>b</th></tr><tr><td>1</td><td>2</td></tr></table>")
    write(tmp_path, "folded", "<details><summary>more</summary><img src='x.png'></details>")
    write(tmp_path, "night", "<p>words</p>", NIGHT)
    write(tmp_path, "wide", "<p><code>words</code></p>", "code {display: block; width: 40em}")
    write(tmp_path, "scrolls", "<div><p>words</p></div>", "div {overflow-x: auto} p {width: 30em}")
    write(
        tmp_path, "long", f"<ul>{'<li>words</li>' * 40}<li><img src='x'></ul><p>words</p>", "p {color: #ddd}"
    )
    code = "<span class='a'>words</span> <span class='a'>words</span> <span class='b'>words</span>"
    write(tmp_path, "code", f"<pre>{code}</pre>", ".b {color: #ddd}")
    found = judged(tmp_path)
    assert found.returncode == 1
    said = sorted(re.split(r"(?<=[a-z]):| \(1\)", line)[0] for line in found.stdout.splitlines())
    assert said == [
        "12 faults of pages",
        "code.html (dark): color-contrast",
        "code.html (light): color-contrast",
        "folded.html (narrow): image-alt",
        "folded.html (wide): image-alt",
        "headless.html (narrow): empty-table-header",
        "headless.html (wide): empty-table-header",
        "long.html (dark): color-contrast",
        "long.html (light): color-contrast",
        "long.html (narrow): image-alt",
        "long.html (wide): image-alt",
        "night.html (dark): color-contrast",
        "wide.html (narrow): wider than the screen",
    ]
