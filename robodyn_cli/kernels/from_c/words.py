"""C texts as words: comments dropped, conditions decided, macros replaced."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Sequence

WORD = re.compile(
    r"""(?P<space>\s+|/\*.*?\*/)|(?P<text>"(?:[^"\\]|\\.)*")|(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?[fF]?)
    |(?P<name>[A-Za-z_]\w*)|(?P<sign>->|\+\+|--|\#\#|[-+*/<>=!]=|&&|\|\||[-+*/<>=!?:;,.(){}\[\]&])""",
    re.VERBOSE | re.DOTALL,
)
COMMENT = re.compile(r'("(?:[^"\\]|\\.)*")|/\*.*?\*/', re.DOTALL)
DEFINITION = re.compile(r"#define (\w+)(?:\((\w+)\))?(.*)")


def words_of(texts: Sequence[str], defined: Collection[str]) -> list[str]:
    """Return the words of files that follow one another; defined : macros without text.

    Files that they include have to be among them; those of the C library are known to ``ExpressionReader``.
    """
    macros: dict[str, tuple[str, list[str]]] = {name: ("", []) for name in defined}
    words: list[str] = []
    for text in texts:
        taken = [True]  # of the file, and of each condition around a line
        for line in COMMENT.sub(lambda found: found[1] or " ", text).splitlines():
            word, _, rest = line.strip().partition(" ")
            if word in ("#ifdef", "#ifndef"):
                taken.append((rest.strip() in macros) == (word == "#ifdef"))
            elif word == "#else":
                taken[-1] = not taken[-1]
            elif word == "#endif":
                taken.pop()
            elif not all(taken) or word == "#include":
                continue
            elif found := DEFINITION.match(line.strip()):
                macros[found[1]] = found[2] or "", list(_words(found[3]))
            else:
                words += _replaced(list(_words(line)), macros)
    return words


def _words(text: str) -> Iterator[str]:
    at = 0
    while at < len(text):
        found = WORD.match(text, at)
        if found is None:
            raise NotImplementedError(f"C that is not written here: {text[at:]}")
        at = found.end()
        if found.lastgroup != "space":
            yield found[0]


def _replaced(words: list[str], macros: dict[str, tuple[str, list[str]]]) -> list[str]:
    """Return words with macros replaced; what a macro takes is one word."""
    made: list[str] = []
    waiting = words[::-1]
    while waiting:
        word = waiting.pop()
        if word not in macros:
            made.append(word)
            continue
        parameter, body = macros[word]
        if parameter:
            _, argument, _ = waiting.pop(), waiting.pop(), waiting.pop()
            body = [argument if x == parameter else x for x in body]
            if body[1:2] == ["##"]:  # F(1.5) and F(sin) in single precision: 1.5f, sinf
                body = [body[0] + body[2]]
        waiting += body[::-1]
    return made


class WordReader:
    """Words, read one after another."""

    def __init__(self, words: Sequence[str]) -> None:
        self._words, self._at = words, 0

    @property
    def next(self) -> str:
        """The word that is read next; empty at the end."""
        return self._words[self._at] if self._at < len(self._words) else ""

    def beyond(self, count: int) -> str:
        """Return the word so many behind the next one."""
        return self._words[self._at + count]

    def take(self) -> str:
        self._at += 1
        return self._words[self._at - 1]

    def has(self, word: str) -> bool:
        """Take a word if it is the next one; tell whether it was."""
        found = self.next == word
        self._at += found
        return found

    def expect(self, *words: str) -> None:
        for word in words:
            if not self.has(word):
                raise NotImplementedError(
                    f"C that is not written here: {' '.join(self._words[self._at : self._at + 8])}"
                )
