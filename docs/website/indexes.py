"""The index of all keys of a scene, and the index of all messages: errors with their exit codes, and warnings."""

from __future__ import annotations

import ast
import dataclasses
import inspect
import re
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

import make_scene_reference as reference

from robodyn_cli import errors
from website.pages import ROOT, Site
from website.text import slug

SCENE = "docs/scene.md"
PACKAGE = ROOT / "robodyn_cli"
HOLE = "…"  # stands for what a message fills in
FEWEST_WORDS = 3
# errors of Python that users do not meet, or meet as another one
INNER = (
    "ValueError",
    "TypeError",
    "AttributeError",
    "KeyError",
    "NotImplementedError",
    "AssertionError",
    "StopIteration",
)
INNER += (
    "IsADirectoryError",
    "TimeoutError",
    "FrozenInstanceError",
    "RuntimeError",
    "OSError",
    "BadParameter",
)
# functions that make the error of a place in a file
OF_SCENES = ("error", "located", "wrong", "missing", "bad_tag", "unknown", "refused", "_refused", "_refusal")


# -- keys ----------------------------------------------------------------------------------------------


def keys_page(site: Site) -> str:
    """Return the index of all keys: the section that has each, and what it means."""
    page = (ROOT / SCENE).read_text(encoding="utf-8")
    anchors = {}
    for match in reference.TABLE.finditer(page):
        anchors[match[2]] = slug(reference.HEADING.findall(page, 0, match.start())[-1])
    rows: dict[str, list[str]] = {}
    for name, cls in reference.sections().items():
        home, anchor = site.homes[SCENE, anchors[name]]
        for key, meaning in meanings(cls):
            row = f"| `{key}` | [{name}](../{home}#{anchor}) | {meaning} |".replace("``", "`")
            rows.setdefault(key[0].lower(), []).append(row)
    parts = ["# Index of keys", "Every key that a scene may have, with the section that it stands in."]
    for letter in sorted(rows):
        table = ["| key | in | meaning |", "|---|---|---|", *sorted(rows[letter], key=str.lower)]
        parts.append(f"## {letter.upper()}\n\n" + "\n".join(table))
    return "\n\n".join(parts) + "\n"


def meanings(cls: type) -> Iterator[tuple[str, str]]:
    """Yield the keys of a section and what each means, on one line."""
    for row in reference.table(cls, {}).splitlines()[2:]:
        cells = [cell.strip() for cell in re.split(r"(?<!\\)\|", row)[1:-1]]
        yield cells[0].strip("`"), cells[4]


# -- messages ------------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True, order=True)
class Message:
    """A text with holes, the kind of error, "" of a warning, and the room of the program that says it."""

    text: str
    kind: str
    room: str


@lru_cache
def classes() -> dict[str, int]:
    """Return the errors that a user meets, each with its exit code."""
    found = inspect.getmembers(
        errors, lambda one: inspect.isclass(one) and issubclass(one, errors.RobodynError)
    )
    return {name: cls.exit_code for name, cls in found}


def messages(below: Path = PACKAGE) -> list[Message]:
    """Return all messages that the source holds, or a part of it."""
    found: set[Message] = set()
    for path in sorted(below.rglob("*.py")):
        room = path.relative_to(PACKAGE).parts[0].removesuffix(".py")
        tree = ast.parse(path.read_text(encoding="utf-8"))
        for node in ast.walk(tree):
            found.update(Message(text, kind, room) for kind, text in said(node))
    return sorted(found)


def said(node: ast.AST) -> Iterator[tuple[str, str]]:
    """Yield (kind of error, text) of an error that is made here, and the texts of a function that gives warnings."""
    known = classes()
    call = node.exc if isinstance(node, ast.Raise) else node
    if isinstance(call, ast.Call):
        name = named(call.func)
        kind = name if name in known else "SceneError" if name in OF_SCENES else ""
        raised = isinstance(node, ast.Raise) and name not in INNER
        if name in known or (raised and kind):
            for argument in call.args:
                yield from ((kind, text) for text in texts(argument))
    if isinstance(node, ast.FunctionDef) and re.search(r"warning|doubt", node.name):
        for statement in node.body[1:]:
            for inner in ast.walk(statement):
                if isinstance(inner, ast.JoinedStr):
                    yield from (("", text) for text in texts(inner))


def named(function: ast.expr) -> str:
    return getattr(function, "id", getattr(function, "attr", ""))


def texts(node: ast.expr) -> Iterator[str]:
    """Yield the message of an expression, if it is one: words with holes."""
    text = re.sub(rf"{HOLE}+", HOLE, written(node))
    text = " ".join(text.split()).removeprefix(f"{HOLE}: ")
    if len(re.findall(r"[A-Za-z]{2,}", text)) >= FEWEST_WORDS:
        yield text


def written(node: ast.expr) -> str:
    """Return the text of an expression, with a hole for each part that is not known before it is said."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.JoinedStr):
        return "".join(written(part) for part in node.values)
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        return written(node.left) + written(node.right)
    return HOLE


def messages_page() -> str:
    """Return the index of all messages."""
    codes = classes()
    found = messages()
    parts = [
        "# Index of messages",
        f"What errors and warnings say; {HOLE} stands for names, values and places of the scene. Beside each stands\n"
        "the part of the program that says it ([design](../about/design.md)). The search finds each by its words.\n"
        "[Exit codes](../commands/exit-codes.md) tell what a script makes of them.",
    ]
    for kind in sorted({m.kind for m in found}, key=lambda name: (codes.get(name, 99), name)):
        inside = [m for m in found if m.kind == kind]
        heading = f"{kind} (exit code {codes[kind]})" if kind else "Warnings"
        about = (
            (getattr(errors, kind).__doc__ or "").split("\n\n")[0]
            if kind
            else "`--strict` takes them as errors."
        )
        rows = sorted(
            (f"- {plain(m.text)} *({m.room})*" for m in inside),
            key=lambda row: row.lower().lstrip(f"- {HOLE}"),
        )
        parts.append(f"## {heading}\n\n{' '.join(about.split())}\n\n" + "\n".join(rows))
    return "\n\n".join(parts) + "\n"


def plain(text: str) -> str:
    """Return a text of which Markdown takes nothing for its own."""
    return re.sub(r"([\\`*_{}\[\]<>#$|~])", r"\\\1", text)


def add_keys(site: Site) -> None:
    """Add the index of keys."""
    site.add("reference/keys.md", keys_page(site), "")


def add_messages(site: Site) -> None:
    """Add the index of messages, for which the whole source is read."""
    site.add("reference/messages.md", messages_page(), "")
