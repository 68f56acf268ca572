"""Draw the images of the README by running its three commands.

python docs/make_images.py
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

ROOT = Path(__file__).resolve().parents[1]
IMAGES = ROOT / "docs" / "images"
# scene, command, drawings to keep
RUNS = (
    ("2r_circle", "inverse", ("torques", "mechanism")),
    ("double_pendulum", "simulate", ("joint_angles", "tip_path")),
    ("four_bar_deploy", "deploy", ("mechanism", "joint_angles", "multipliers", "singular_values")),
)
COLOURS = 64  # enough for lines and text, and a third of the size


def main() -> None:
    """Run, pick, shrink."""
    IMAGES.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        for scene, command, names in RUNS:
            out = Path(folder) / scene
            run = [sys.executable, "-m", "robodyn_cli", command, f"configs/{scene}.yaml", "--out", str(out)]
            subprocess.run(run, cwd=ROOT, check=True)
            for name in names:
                with Image.open(out / f"{name}.png") as image:
                    small = image.convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE)
                    small.save(IMAGES / f"{scene}_{name}.png", optimize=True)


if __name__ == "__main__":
    main()
