"""The pages of the Python package, from its docstrings."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from typing import Any

import robodyn
from robodyn_cli.commands import COMMANDS, python_name
from website.contents import toctree
from website.pages import Site

TITLE = re.compile(r"^(\w[\w ,]*)\n-{3,}\n", re.MULTILINE)
CODE = re.compile(r"(``.+?``|`.+?`)")


def add_api(site: Site) -> None:
    """Add the functions, the classes and the errors of ``robodyn`` below its page."""
    functions = [python_name(name) for name in COMMANDS]
    others = [name for name in robodyn.__all__ if name not in functions and name != "__version__"]
    found = {name: getattr(robodyn, name) for name in others}
    raised = [n for n, x in found.items() if inspect.isclass(x) and issubclass(x, Exception)]
    rest = [name for name in others if name not in raised]
    pages = {
        "functions": ("Commands as functions", functions),
        "objects": ("Scenes, results, models", rest),
        "errors": ("Errors", raised),
    }
    for name, (title, members) in pages.items():
        text = "\n\n".join([f"# {title}", *(entry(member, getattr(robodyn, member)) for member in members)])
        site.add(f"python/{name}.md", text + "\n", "")
    site.pages["python/index.md"].after = toctree("python/index.md", [f"python/{name}.md" for name in pages])


def entry(name: str, value: Any) -> str:
    """Return what is said of a function or a class."""
    parts = [f"## {name}", signature(f"robodyn.{name}", value), markdown(inspect.getdoc(value) or "")]
    if inspect.isclass(value) and issubclass(value, Exception):
        return "\n\n".join([parts[0], parts[2]])
    for member, inner in members(value):
        text = markdown(inspect.getdoc(inner) or "")
        head = f"### {name}.{member}"
        parts += (
            [head, text]
            if isinstance(inner, property)
            else [head, signature(f"{name}.{member}", inner), text]
        )
    return "\n\n".join(part for part in parts if part)


def members(value: Any) -> Iterator[tuple[str, Any]]:
    """Yield the methods and properties of a class that have a docstring, inherited ones too."""
    if not inspect.isclass(value) or not value.__module__.startswith("robodyn_cli"):
        return
    for name, inner in inspect.getmembers(value):
        own = isinstance(inner, property) or inspect.isfunction(inner) or inspect.ismethod(inner)
        if own and not name.startswith("_") and inspect.getdoc(inner):
            yield name, inner


def signature(name: str, value: Any) -> str:
    """Return a call as it is written, a keyword a line where it is long."""
    try:
        given = inspect.signature(value)
    except (TypeError, ValueError):
        return ""
    words = [
        re.sub(r": '?[^=]*?'?(?= =|$)", "", str(p)).replace(" = ", "=") for p in given.parameters.values()
    ]
    words = [word for word in words if word != "self"]
    at = next((k for k, p in enumerate(given.parameters.values()) if p.kind is p.KEYWORD_ONLY), None)
    if at is not None and not any(word.startswith("*") for word in words):
        words.insert(at - ("self" in given.parameters), "*")
    text = f"{name}({', '.join(words)})"
    if len(text) > 90:
        text = f"{name}(\n    " + ",\n    ".join(words) + ",\n)"
    return f"```python\n{text}\n```"


def markdown(text: str) -> str:
    """Return a docstring as Markdown: titles in bold, parameters as a list."""
    first, *rest = TITLE.split(text)
    parts = [prose(first)]
    for title, body in zip(rest[::2], rest[1::2]):
        parts.append(f"**{title}**\n\n{listed(body)}")
    return "\n\n".join(part for part in parts if part.strip())


def listed(body: str) -> str:
    """Return the entries ``name : text`` of a part of a docstring as a list; other text as it is."""
    out: list[str] = []
    for line in body.strip().splitlines():
        match = re.match(r"^([\w, *]+?) : (.*)", line)
        if match:
            out.append(f"- `{match[1].strip()}`: {escaped(match[2])}")
        elif out and line.startswith(" "):
            out.append(f"  {escaped(line.strip())}")
        else:
            out.append(escaped(line))
    return "\n".join(out)


def prose(text: str) -> str:
    """Return paragraphs; those with indented lines or prompts stand as they are."""
    out = []
    for part in text.strip().split("\n\n"):
        if part.startswith((">>>", "    ")):
            out.append(f"```text\n{part}\n```")
        else:
            out.append(escaped(part))
    return "\n\n".join(out)


def escaped(text: str) -> str:
    """Return a text of which Markdown takes nothing but code for its own."""
    pieces = CODE.split(text)
    marks = [
        piece if k % 2 else re.sub(r"([\\*_\[\]<>$|])", r"\\\1", piece) for k, piece in enumerate(pieces)
    ]
    return "".join(marks).replace("``", "`")
