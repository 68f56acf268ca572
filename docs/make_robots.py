"""Write the robots of `robodyn new --from` that the example scenes hold, with the robot's file in its place.

    python docs/make_robots.py            write robodyn_cli/robots/NAME.yaml
    python docs/make_robots.py --check    exit 1 if one is out of date

The others in that folder are written by hand.
"""

from __future__ import annotations

import re
import sys
import textwrap
from pathlib import Path

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "robodyn_cli" / "robots"
# the scene of configs/, and where its constants are from if it does not say so itself
SCENES = {
    "planar_2r": ("2r_circle", ""),
    "puma560": ("benchmarks/puma560", ""),
    "seven_joint_arm": ("seven_joint_arm", "Source: chosen here, of the size of light arms for 10 kg."),
    "five_bar": ("mechanisms/five_bar_circle", "Source: chosen here."),
    "slider_crank": ("benchmarks/slider_crank", ""),
    "stewart_platform": ("benchmarks/stewart_platform", "Source: chosen here."),
}
INCLUDED = re.compile(r"^robot: (\S+\.yaml)\n", re.MULTILINE)


def written(name: str) -> str:
    """Return the text of a robot's file."""
    scene, source = SCENES[name]
    path = ROOT / "configs" / f"{scene}.yaml"
    text = path.read_text(encoding="utf-8")
    found = INCLUDED.search(text)
    if found is not None:
        robot = (path.parent / found[1]).read_text(encoding="utf-8")
        text = text.replace(found[0], f"robot:\n{textwrap.indent(robot, '  ')}")
    command = re.search(r"^command: (\w+)$", text, re.MULTILINE)
    assert command is not None
    head = [f"#   robodyn {command[1]} {name}.yaml", *([f"# {source}"] if source else [])]
    comment = re.match(r"(#.*\n)+", text)
    assert comment is not None
    return comment[0] + "\n".join(head) + "\n" + text[comment.end() :]


def main() -> None:
    check = "--check" in sys.argv[1:]
    old = [name for name in SCENES if not is_written(name)]
    for name in old if not check else ():
        (FOLDER / f"{name}.yaml").write_text(written(name), encoding="utf-8")
    if check and old:
        sys.exit(f"out of date: {', '.join(old)}; run python docs/make_robots.py")


def is_written(name: str) -> bool:
    """Tell whether a robot's file is as it should be."""
    path = FOLDER / f"{name}.yaml"
    return path.exists() and path.read_text(encoding="utf-8") == written(name)


if __name__ == "__main__":
    main()
