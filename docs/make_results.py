"""Refresh the results in the README by running its three commands: what they print, the images, the movie; and the
image of docs/drives.md.

python docs/make_results.py
"""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

ROOT = Path(__file__).resolve().parents[1]
README = ROOT / "README.md"
IMAGES = ROOT / "docs" / "images"
# scene, command, drawings to keep
RUNS = (
    ("2r_circle", "inverse", ("torques", "mechanism")),
    ("double_pendulum", "simulate", ("joint_angles", "tip_path")),
    ("four_bar_deploy", "deploy", ("mechanism", "joint_angles", "multipliers", "singular_values")),
)
# images of other pages
DRAWN = (("2r_drives", "inverse", ("drives",)),)
# scene, words of animate: short and small, and yet no jerks
MOVIE = ("four_bar_deploy", ("--speed", "3", "--fps", "10"))
LEFT_OUT = ("  cost ", "results: ")
COLOURS = 64  # enough for lines and text, and a third of the size


def output(*command: str) -> str:
    """Return what a command prints on standard output."""
    run = subprocess.run([sys.executable, *command], cwd=ROOT, check=True, capture_output=True, text=True)
    return run.stdout


def boxed(page: str, begin: str, text: str) -> str:
    """Return the page with the text block that begins with ``begin`` replaced."""
    pattern = rf"```text\n{re.escape(begin)}.*?```"
    assert text.startswith(begin) and len(re.findall(pattern, page, re.DOTALL)) == 1, begin
    return re.sub(pattern, lambda _: f"```text\n{text}```", page, flags=re.DOTALL)


def main() -> None:
    """Run, pick, shrink, write."""
    IMAGES.mkdir(exist_ok=True)
    page = README.read_text(encoding="utf-8")
    with tempfile.TemporaryDirectory() as folder:
        for scene, command, names in (*RUNS, *DRAWN):
            out = Path(folder) / scene
            printed = output("-m", "robodyn_cli", command, f"configs/{scene}.yaml", "-v", "--out", str(out))
            if (scene, command, names) in RUNS:
                lines = [line for line in printed.splitlines() if not line.startswith(LEFT_OUT)]
                page = boxed(page, lines[0], "\n".join(lines) + "\n")
            for name in names:
                with Image.open(out / f"{name}.png") as image:
                    small = image.convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE)
                    small.save(IMAGES / f"{scene}_{name}.png", optimize=True)
            if scene == MOVIE[0]:
                movie = str(IMAGES / f"{scene}.gif")
                output("-m", "robodyn_cli", "animate", str(out), "--file", movie, *MOVIE[1])
    snippet = next(b for b in re.findall(r"```python\n(.*?)```", page, re.DOTALL) if "true error" in b)
    README.write_text(boxed(page, "true error", output("-c", snippet)), encoding="utf-8")


if __name__ == "__main__":
    main()
