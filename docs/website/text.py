"""Markdown as text: headings, sections, fences, links."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator

FENCE = re.compile(r"(^```.*?^```[ \t]*$|<!--.*?-->)", re.DOTALL | re.MULTILINE)
LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\]]*\])*)\]\(([^)\s]+)\)")
HEADING = re.compile(r"^(#+) (.+)$")
SPACE = (r"\quad", r"\qquad")
TOKEN = re.compile(r"\\q?quad\b|\\(?:begin|left|end|right)\b|\\.|[{}]")
DEEPER, HIGHER = ("{", r"\begin", r"\left"), ("}", r"\end", r"\right")


def slug(heading: str) -> str:
    """Return the anchor that GitHub gives a heading."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")


def lines_with_fences(text: str) -> Iterator[tuple[str, bool]]:
    """Yield the lines of a page, each with whether it is inside a fence."""
    inside = False
    for line in text.splitlines():
        edge = line.startswith("```")
        yield line, inside or edge
        inside ^= edge


def headings(text: str) -> list[tuple[int, str]]:
    """Return (level, heading) of a page in order."""
    found = [HEADING.match(line) for line, inside in lines_with_fences(text) if not inside]
    return [(len(match[1]), match[2]) for match in found if match]


def sections(text: str, level: int) -> tuple[str, list[tuple[str, str]]]:
    """Return what stands before the first heading of a level, and (heading, body) of each heading of that level."""
    parts: list[tuple[str, list[str]]] = [("", [])]
    for line, inside in lines_with_fences(text):
        match = None if inside else HEADING.match(line)
        if match and len(match[1]) == level:
            parts.append((match[2], []))
        else:
            parts[-1][1].append(line)
    (_, first), *rest = parts
    return "\n".join(first) + "\n", [(name, "\n".join(body).strip() + "\n") for name, body in rest]


def promoted(text: str, by: int) -> str:
    """Return a text whose headings stand higher by some levels."""
    out = []
    for line, inside in lines_with_fences(text):
        out.append(line[by:] if not inside and HEADING.match(line) else line)
    return "\n".join(out) + "\n"


def prose(text: str, change: Callable[[str], str]) -> str:
    """Return a text with a function applied to all that is neither fence nor comment."""
    return "".join(part if FENCE.fullmatch(part) else change(part) for part in FENCE.split(text))


def without_comments(text: str) -> str:
    """Return a text without HTML comments."""
    return prose(re.sub(r"(?<=\n)<!--[^>]*-->\n", "", text), lambda part: part)


def without_contents(text: str) -> str:
    """Return a text without the paragraph that lists its sections, which the site does itself."""
    return re.sub(r"^Contents: .*?\n\n", "", text, flags=re.DOTALL | re.MULTILINE)


def side_by_side(text: str) -> list[str]:
    """Return the formulas that wide spaces part, which stand below one another where there is no room."""
    parts, begin, depth = [], 0, 0
    for token in TOKEN.finditer(text):
        depth += (token[0] in DEEPER) - (token[0] in HIGHER)
        if token[0] in SPACE and not depth:
            parts.append(text[begin : token.start()])
            begin = token.end()
    return [part for part in (*parts, text[begin:]) if part.strip()]
