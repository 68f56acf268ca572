"""Commands that are run for the site: what each prints and draws."""

from __future__ import annotations

import dataclasses
import importlib
import re
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import yaml
from PIL import Image

from robodyn_cli.commands import COMMANDS
from robodyn_cli.errors import REPLACING
from website.pages import ROOT

CONFIGS = ROOT / "configs"
COLOURS = 64  # enough for lines and text, and a third of the size
NO_FOLDER = ("crosscheck",)  # commands that draw with some options alone
LONGEST = 1800  # seconds that a command may take
# what draws the kinds of plots that neither a scene by its own command draws, nor the first example of a command
FURTHER = (
    "simulate configs/benchmarks/slider_crank.yaml --set simulate.fluctuation=[phi]",
    "linearise configs/double_pendulum.yaml --along --instants 0,0.5,2",
    "linearise configs/cart_pole_lqr.yaml",
    "linearise configs/controlled_arm.yaml",
    "sweep configs/four_bar_deploy.yaml --vary 'robot.links.crank.mass=normal(20.15, 2 %)' "
    "--vary 'robot.links.coupler.mass=normal(8, 2 %)' -n 64 --of lock.time",
    "sweep configs/2r_circle.yaml --vary 'robot.links.link2.mass=linspace(10, 20, 5)' "
    "--vary 'trajectory.radius=linspace(0.1, 0.3, 5)' --of peak_torque.theta1",
    "stability configs/four_bar_deploy.yaml --quick",
    "stability --suite --quick",
    "crosscheck configs/double_pendulum.yaml --with mujoco --own-settings",
)


@dataclasses.dataclass(frozen=True)
class Shot:
    """A command that is run: its words after ``robodyn``."""

    words: str

    @property
    def command(self) -> str:
        return shlex.split(self.words)[0]

    @property
    def scene(self) -> str:
        """Return the scene, by its path below configs without suffix, "" of commands without one."""
        found = re.search(r"configs/([\w/]+)\.yaml", self.words)
        return found[1] if found else ""

    @property
    def file(self) -> Path:
        """Return the file of the scene."""
        found = re.search(r"(configs|examples)/[\w/]+\.yaml", self.words)
        if not found:
            raise ValueError(f"no scene in: {self.words}")
        return (ROOT if found[1] == "configs" else Path(__file__).parent) / found[0]

    @property
    def name(self) -> str:
        """Return a name for files."""
        return re.sub(
            r"[^a-z0-9]+", "-", self.words.lower().replace("configs/", "").replace(".yaml", "")
        ).strip("-")

    def folder(self, out: Path) -> Path:
        return out / "runs" / self.name

    def printed(self, out: Path) -> str:
        return (self.folder(out) / "printed.txt").read_text(encoding="utf-8")

    def pictures(self, out: Path) -> dict[str, Path]:
        """Return the plots that it has drawn, by their names."""
        return {path.stem: path for path in sorted(self.folder(out).glob("*.png"))}


def command_of(scene: Path) -> str:
    """Return what a scene says that is done with it, "" of a file that is none."""
    data = yaml.safe_load(scene.read_text(encoding="utf-8"))
    return str(data.get("command", "")) if isinstance(data, dict) and "schema" in data else ""


def scenes() -> list[Shot]:
    """Return each scene of ``configs`` by its own command."""
    files = [path for path in sorted(CONFIGS.rglob("*.yaml")) if command_of(path)]
    return [Shot(f"{command_of(path)} configs/{path.relative_to(CONFIGS).as_posix()}") for path in files]


def examples(command: str) -> list[str]:
    """Return the examples in the help of a command."""
    return list(importlib.import_module(f"robodyn_cli.cli.commands.{command.replace('-', '_')}").EXAMPLES)


def first_drawing(command: str) -> str:
    """Return the first example of a command that draws."""
    return next(words for words in examples(command) if not re.search("--no-plots|--json", words))


def drawing() -> list[Shot]:
    """Return the first example of each command that draws, and what draws the plots that these do not."""
    known = {shot.words for shot in scenes()}
    first = [
        first_drawing(command) for command, row in COMMANDS.items() if row.plots and command not in NO_FOLDER
    ]
    return [Shot(words) for words in dict.fromkeys((*first, *FURTHER)) if words not in known]


def done(shots: Sequence[Shot], out: Path, jobs: int) -> None:
    """Run commands below ``out``; those that an earlier call has run there are taken as they are.

    Raises
    ------
    SystemExit : a command fails.
    """
    with ThreadPoolExecutor(jobs) as pool:
        failed = [shot.words for shot, well in zip(shots, pool.map(lambda s: run(s, out), shots)) if not well]
    if failed:
        sys.exit("\n".join(["of the site's commands fail:", *failed]))


def run(shot: Shot, out: Path) -> bool:
    """Run a command, tell at once what is wrong, and return whether nothing is."""
    folder = shot.folder(out)
    if (folder / "printed.txt").exists():
        return True
    shutil.rmtree(folder, ignore_errors=True)
    begin = time.monotonic()
    words = [sys.executable, "-m", "robodyn", *shlex.split(shot.words), "--out", f"runs/{shot.name}"]
    found = subprocess.run(words, cwd=out, capture_output=True, text=True, timeout=LONGEST)
    print(f"{time.monotonic() - begin:6.1f} s  robodyn {shot.words}", flush=True)
    if found.returncode not in REPLACING:  # a singular pose is an answer too
        print(f"robodyn {shot.words}: exit code {found.returncode}\n{found.stderr}", flush=True)
        return False
    folder.mkdir(parents=True, exist_ok=True)
    for picture in folder.glob("*.png"):
        Image.open(picture).convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE).save(
            picture, optimize=True
        )
    said = found.stdout.splitlines(True)
    if found.returncode:
        said += [line for line in found.stderr.splitlines(True) if line.startswith("robodyn: error")]
    text = "".join(line for line in said if not line.startswith(("  cost ", "results")))
    (folder / "printed.txt").write_text(text, encoding="utf-8")
    return True
