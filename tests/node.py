"""Scripts for node, which stands for a browser in tests of what runs in a page; skipped where there is none."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

NODE = shutil.which("node")
needs_node = pytest.mark.skipif(NODE is None, reason="node is not installed")


def run_node(script: str, data: Any, folder: Path) -> Any:
    """Return what a script, the body of an async function of ``data``, returns; both pass through JSON."""
    assert NODE is not None
    (folder / "data.json").write_text(json.dumps(data))
    whole = (
        "const fs = require('fs'); const data = JSON.parse(fs.readFileSync('data.json', 'utf8'));\n"
        f"(async () => {{\n{script}\n}})().then((x) => fs.writeFileSync('out.json', JSON.stringify(x)))"
        ".catch((e) => { console.error(e); process.exit(1); });\n"
    )
    (folder / "script.js").write_text(whole)
    done = subprocess.run(
        [NODE, "script.js"], cwd=folder, capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stderr
    return json.loads((folder / "out.json").read_text())
