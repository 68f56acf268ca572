"""What a package index, a citation and a user's type checker are told."""

from __future__ import annotations

import json
import re
import runpy
from pathlib import Path

import yaml

from robodyn_cli.version import __version__

ROOT = Path(__file__).parents[2]
SETUP = runpy.run_path(str(ROOT / "setup.py"), run_name="setup")
LINK = re.compile(r"\]\(([^)\s]+)\)")


def test_the_version_is_the_same_everywhere() -> None:
    assert json.loads((ROOT / "codemeta.json").read_text())["version"] == __version__
    assert yaml.safe_load((ROOT / "CITATION.cff").read_text())["version"] == __version__
    headings = re.findall(r"^## (\d+\.\d+\.\d+)", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert headings[0] == __version__


def test_the_long_description_has_no_link_into_the_repository() -> None:
    text = (ROOT / "README.md").read_text()
    bare = SETUP["long_description"](text, "")
    assert all(target.startswith(("http", "#")) for target in LINK.findall(bare)) and "![" not in bare
    assert re.search(r"^\|[ |]*\|$", bare, re.MULTILINE) is None  # no empty rows where pictures were
    whole = SETUP["long_description"](text, "https://example.org/robodyn")
    assert len(LINK.findall(whole)) == len(LINK.findall(text))
    assert "(https://example.org/robodyn/raw/main/docs/images/2r_circle_torques.png)" in whole
    assert "(https://example.org/robodyn/blob/main/docs/scene.md#units)" in whole
    assert all(target.startswith(("http", "#")) for target in LINK.findall(whole))


def test_addresses_are_named_when_there_is_one() -> None:
    assert SETUP["urls"]("") == {}
    assert SETUP["urls"]("https://example.org/robodyn")["Issues"] == "https://example.org/robodyn/issues"


def test_workflows_and_templates_can_be_read() -> None:
    files = sorted((ROOT / ".github").rglob("*.yml"))
    assert len(files) >= 5
    for file in files:
        tree = yaml.safe_load(file.read_text())
        assert "name" in tree and ("jobs" in tree or "body" in tree)
        for script in re.findall(r"\.ci/[a-z-]+", file.read_text()):
            assert (ROOT / script).exists()
