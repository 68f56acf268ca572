"""What a command has found that stores no result, as Python gets it: a map, attributes, the words of the terminal."""

from __future__ import annotations

import base64
import copy
import html
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from robodyn_cli.errors import did_you_mean

PICTURES = {".gif": "image/gif", ".webp": "image/webp", ".png": "image/png", ".mp4": "video/mp4"}
PAGE_HEIGHT = 700  # pixels of a page in a notebook


class Facts(Mapping[str, Any]):
    """A map whose keys are attributes too, down to the maps and lists in it: ``report.criteria[0].name``."""

    def __init__(self, summary: Mapping[str, Any]) -> None:
        self.summary = dict(summary)

    def __getitem__(self, key: str) -> Any:
        return self.summary[key]

    def __iter__(self) -> Iterator[str]:
        return iter(self.summary)

    def __len__(self) -> int:
        return len(self.summary)

    def __getattr__(self, name: str) -> Any:
        # copying and pickling ask before there is a summary
        if name == "summary" or name.startswith("__"):
            raise AttributeError(name)
        if name not in self.summary:
            near = did_you_mean(name, self.summary)
            raise AttributeError(f"no fact {name!r}{near}; allowed: {', '.join(self.summary)}")
        return _facts(self.summary[name])

    def __dir__(self) -> list[str]:
        return sorted({*super().__dir__(), *self.summary})

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.summary!r})"

    def __deepcopy__(self, memo: dict[int, Any]) -> Any:
        new = copy.copy(self)
        new.summary = copy.deepcopy(self.summary, memo)
        return new


def _facts(value: Any) -> Any:
    if isinstance(value, dict):
        return Facts(value)
    return [_facts(x) for x in value] if isinstance(value, list) else value


class Report(Facts):
    """What a command has found.

    ``summary`` is what the command prints with ``--json``, ``str(report)`` what it prints for people, ``exit_code``
    what it ends with. ``content`` is the picture or the page where it went to no file; a notebook shows it.
    """

    def __init__(
        self, summary: Mapping[str, Any], text: str, exit_code: int, content: tuple[bytes, str] | None = None
    ) -> None:
        super().__init__(summary)
        self.text, self.exit_code, self._content = text, exit_code, content

    @property
    def ok(self) -> bool:
        """Whether the command ends with 0."""
        return self.exit_code == 0

    @property
    def content(self) -> bytes | None:
        """The bytes of a picture or page; None where they are in a file."""
        return None if self._content is None else self._content[0]

    def save(self, path: str | Path) -> Path:
        """Write the content to a file, whole or not at all; return its path.

        Raises
        ------
        ValueError : there is none. OutputError : it cannot be written.
        """
        from robodyn_cli.results.atomic import write_bytes

        if self._content is None:
            raise ValueError("there is no content: it is in the file that was named")
        write_bytes(Path(path), self._content[0])
        return Path(path)

    def __str__(self) -> str:
        return self.text

    def __repr__(self) -> str:
        first, *more = self.text.split("\n") if self.text else [", ".join(self.summary)]
        return f"<Report: {first}{' ...' if more else ''}>"

    def _repr_html_(self) -> str:
        """Return what a notebook shows: the picture or the page, else the words of the terminal."""
        if self._content is None:
            return f"<pre>{html.escape(self.text)}</pre>"
        data, suffix = self._content
        name = html.escape(self.text.partition("\n")[0] or "what the command made", quote=True)
        if suffix in (".html", ".htm"):
            page = html.escape(data.decode(), quote=True)
            look = f"width:100%;height:{PAGE_HEIGHT}px;border:0"
            return f'<iframe title="{name}" srcdoc="{page}" style="{look}"></iframe>'
        text = f"data:{PICTURES.get(suffix, 'application/octet-stream')};base64,{base64.b64encode(data).decode()}"
        if suffix == ".mp4":
            return f'<video controls loop aria-label="{name}" src="{text}"></video>'
        return f'<img alt="{name}" src="{text}">'
