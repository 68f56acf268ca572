"""What a built package has beside the declarations of pyproject.toml: example scenes, addresses, a long description."""

from __future__ import annotations

import re
import runpy
import shutil
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py

ROOT = Path(__file__).parent
PAGE = ROOT / "README.md"
# a link or a picture of the README whose target lies in the repository: "[text](docs/cli.md)", "![text](docs/x.png)"
RELATIVE = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\]]*\])*)\]\((?!https?:|#)([^)\s]+)\)")
# what is left of a table of pictures, or of a row of them, without them
EMPTY_TABLE = re.compile(r"^\|[ |]*\|\n(?:\|[-|]*\|\n(?:\|[ |]*\|\n)*)?", re.MULTILINE)


def repository() -> str:
    """Return the address of the repository, "" as long as its owner has written none into version.py."""
    return str(runpy.run_path(str(ROOT / "robodyn_cli" / "version.py"))["REPOSITORY"]).rstrip("/")


def long_description(text: str, address: str) -> str:
    """Return the README for an index of packages, on which relative links lead nowhere.

    They lead into the repository, or, without its address, links are their text and pictures are left out.
    """

    def absolute(found: re.Match[str]) -> str:
        mark, words, target = found.groups()
        words = RELATIVE.sub(absolute, words)
        if not address:
            return "" if mark else words
        return f"{mark}[{words}]({address}/{'raw' if mark else 'blob'}/main/{target})"

    return EMPTY_TABLE.sub("", RELATIVE.sub(absolute, text))


def urls(address: str) -> dict[str, str]:
    """Return the addresses of the package by their usual names."""
    if not address:
        return {}
    pages = {"Documentation": "/tree/main/docs", "Changelog": "/blob/main/CHANGELOG.md", "Issues": "/issues"}
    return {"Repository": address, **{name: f"{address}{page}" for name, page in pages.items()}}


class BuildWithExamples(build_py):
    """Puts the scenes of ``configs`` into the package, for ``robodyn new --example``."""

    def run(self) -> None:
        super().run()
        if not self.editable_mode:
            shutil.copytree(
                ROOT / "configs", Path(self.build_lib) / "robodyn_cli" / "examples", dirs_exist_ok=True
            )


if __name__ == "__main__":
    setup(
        cmdclass={"build_py": BuildWithExamples},
        long_description=long_description(PAGE.read_text(encoding="utf-8"), repository()),
        long_description_content_type="text/markdown",
        project_urls=urls(repository()),
    )
