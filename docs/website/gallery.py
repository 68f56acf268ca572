"""The gallery: every scene with its command and pictures, and every kind of plot with a command that draws it."""

from __future__ import annotations

import importlib
import posixpath
import re
import shutil
from pathlib import Path

from robodyn_cli.commands import COMMANDS
from website import runs
from website.contents import toctree
from website.pages import Site
from website.runs import Shot

# folders of configs, each with its heading; the order of the page
GROUPS = {
    "": "Arms, bodies, four-bars",
    "mechanisms": "Mechanisms",
    "trajectories": "Motions",
    "search": "Searches",
    "published": "Published robots",
    "benchmarks": "Benchmarks",
}

# what stands for a scene whose mechanism others show too
CARDS = {
    "2r_drives": "drives",
    "arm_weightless": "torques",
    "controlled_arm": "tracking",
    "mechanisms/flywheel": "flywheel",
    "mechanisms/solar_array_springs": "joint_angles",
    "benchmarks/puma560_hold": "torques",
}


def title(file: Path) -> str:
    """Return the title of a scene."""
    found = re.search(r"^title: *(.+?) *$", file.read_text(encoding="utf-8"), re.MULTILINE)
    return found[1].strip("\"'") if found else file.stem


def description(file: Path) -> str:
    """Return the comment at the head of a scene."""
    lines = []
    for line in file.read_text(encoding="utf-8").splitlines():
        if not line.startswith("#"):
            break
        lines.append(line.lstrip("# "))
    return re.sub(r"(?<![`\w/])((?:configs/)?[\w/]+\.(?:yaml|py))", r"`\1`", "\n".join(lines))


def whole(file: Path) -> str:
    """Return a scene as it is written, and the files that it includes."""
    text = file.read_text(encoding="utf-8")
    parts = [f"```yaml\n{text.rstrip()}\n```\n"]
    for name in dict.fromkeys(re.findall(r":\s*([\w./-]+\.(?:yaml|csv))\b", text)):
        if (file.parent / name).is_file():
            kind = "yaml" if name.endswith("yaml") else "text"
            other = (file.parent / name).read_text(encoding="utf-8").rstrip()
            parts.append(f"It includes `{name}`:\n\n```{kind}\n{other}\n```\n")
    return "\n".join(parts)


def figure(path: str, target: str = "", words: str = "", *, alt: str) -> str:
    """Return a picture with a link, and words below; ``alt`` is what it shows, without links."""
    head = [f":::{{figure}} {path}", f":alt: {alt}"] + ([f":target: {target}"] if target else [])
    return "\n".join([*head, "", words, ":::", ""]) if words else "\n".join([*head, ":::", ""])


def cards(entries: list[str]) -> str:
    """Return pictures side by side."""
    return "\n".join(["::::{container} cards", *entries, "::::", ""])


def picture(shot: Shot, kind: str) -> str:
    """Return the place of a picture in the site, from its root."""
    return f"gallery/images/{shot.name}/{kind}.png"


def scene_page(shot: Shot, out: Path) -> str:
    """Return the page of a scene."""
    parts = [f"# {title(shot.file)}", description(shot.file), f"```sh\nrobodyn {shot.words}\n```"]
    parts.append(f"```text\n{shot.printed(out)}```")
    up = "../" * (shot.scene.count("/") + 1)
    for kind in sorted(shot.pictures(out), key=lambda name: (name != "mechanism", name)):
        words = f"[{kind}]({up}gallery/plots.md#{kind})"
        parts.append(figure(f"{up}{picture(shot, kind)}", words=words, alt=f"{kind} of {title(shot.file)}"))
    return "\n\n".join([*parts, "## The scene", whole(shot.file)])


def index(shots: list[Shot]) -> str:
    """Return the first page of the gallery."""
    parts = [
        "# Gallery\n\nEvery scene of the [examples](../commands/new.md), by the command that it names, and "
        "[every kind of plot](plots.md).\n`robodyn new --example NAME` writes a scene and what it includes."
    ]
    paths = ["gallery/plots.md"]
    for folder, heading in GROUPS.items():
        inside = [shot for shot in shots if posixpath.dirname(shot.scene) == folder]
        paths += [f"gallery/{shot.scene}.md" for shot in inside]
        entries = [
            figure(
                f"../{picture(s, CARDS.get(s.scene, 'mechanism'))}",
                f"{s.scene}.html",
                f"[{title(s.file)}]({s.scene}.md)",
                alt=f"{CARDS.get(s.scene, 'mechanism')} of {title(s.file)}",
            )
            for s in inside
        ]
        parts.append(f"## {heading}\n\n{cards(entries)}")
    return "\n".join([*parts, toctree("gallery/index.md", paths).replace(":maxdepth", ":hidden:\n:maxdepth")])


def drawn_by(out: Path, shots: list[Shot]) -> dict[str, Shot]:
    """Return a run that drew each kind of plot: of the scenes that come first in the gallery, the first.

    Raises
    ------
    SystemExit : no run has drawn some kind.
    """
    groups = list(GROUPS)
    order = sorted(shots, key=lambda s: groups.index(posixpath.dirname(s.scene)) if s.scene else len(groups))
    found: dict[str, Shot] = {}
    for shot in order:
        for kind in shot.pictures(out):
            found.setdefault(kind, shot)
    missing = {name for row in COMMANDS.values() for name in names(row.plots)} - set(found)
    if missing:
        raise SystemExit(
            f"no run of the gallery draws {', '.join(sorted(missing))}: add one to FURTHER in runs.py"
        )
    return found


def names(places: tuple[str, ...]) -> list[str]:
    return [place.partition(":")[2] for place in places]


def about(place: str) -> str:
    """Return what the function of a plot says of it."""
    module, _, name = place.partition(":")
    source = importlib.import_module(f"robodyn_cli.report.plots.{module}").__file__ or ""
    text = Path(source).read_text(encoding="utf-8")
    found = re.search(rf'^def {name}\(.*?"""(.*?)"""', text, re.DOTALL | re.MULTILINE)
    words = " ".join(found[1].split("\n\n")[0].split()) if found else ""
    return words.replace("``", "`")


def plots_page(out: Path, shots: list[Shot]) -> str:
    """Return the page of all kinds of plots."""
    found = drawn_by(out, shots)
    places = {place.partition(":")[2]: place for row in COMMANDS.values() for place in row.plots}
    parts = ["# Kinds of plots", f"All {len(places)}, each with a command that draws it."]
    for kind, place in places.items():
        by = [
            f"[{name}](../commands/{name}.md)" for name, row in COMMANDS.items() if kind in names(row.plots)
        ]
        shot = found[kind]
        parts += [f"## {kind}", f"{about(place)} Drawn by {', '.join(by)}."]
        parts.append(f"```sh\nrobodyn {shot.words} --plots {kind}\n```")
        parts.append(figure(f"../{picture(shot, kind)}", alt=f"{kind}: {about(place)}"))
    return "\n\n".join(parts) + "\n"


def add_gallery(site: Site, out: Path, jobs: int, further: list[Shot]) -> list[Shot]:
    """Run what the gallery shows and further commands, and add its pages; return all that was run."""
    shots = runs.scenes()
    others = [*runs.drawing(), *further]
    # those that take longest are among the last, and begin first, so that none is left alone at the end
    runs.done([*reversed(others), *shots], out, jobs)
    site.add("gallery/index.md", index(shots), "")
    site.add("gallery/plots.md", plots_page(out, [*shots, *others]), "")
    for shot in shots:
        path = f"gallery/{shot.scene}.md"
        site.add(path, scene_page(shot, out), "")
        site.files[f"configs/{shot.scene}.yaml"] = path
    return [*shots, *others]


def copy_pictures(out: Path, source: Path) -> None:
    """Put the pictures of all runs where pages look for them."""
    for path in (out / "runs").glob("*/*.png"):
        target = source / "gallery" / "images" / path.parent.name / path.name
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(path, target)
