"""Errors that a user can cause or meet, each with the exit code of the command line; exit codes that no error carries,
and which of several is the worst (docs/cli.md).

Every message is one or two sentences that name the place (file, line, key), the value and what is allowed.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

FAILED = 1  # no lock, an expectation that does not hold, results that differ
WRONG_USAGE = 2
INTERNAL = 70
NO_OUTPUT = 74
INTERRUPTED = 130

# of a run by its status, where no error says more
OF_STATUS = {
    "ok": 0, "locked": 0, "no_lock": FAILED, "overload": FAILED, "undersized": FAILED, "missed": FAILED,
}  # fmt: skip
# with these a run puts what it found in the place of an earlier run's files; with others it leaves them as they are
REPLACING = (0, FAILED, 3, 4)
# from good to bad; what is not listed is worse than all of them
BADNESS = (0, FAILED, 3, WRONG_USAGE, 4, 5, NO_OUTPUT, INTERNAL)
ALL = (*BADNESS, INTERRUPTED)


def worst(codes: Iterable[int]) -> int:
    """Return the worst of several exit codes: 1 over 0, 3 over 1, 2 over 3, then 4, 5, 74, 70."""
    return max(codes, key=lambda code: BADNESS.index(code) if code in BADNESS else len(BADNESS), default=0)


LONGEST = 60  # characters of a value that a message quotes
MOST_LISTED = 100  # names that a message lists


class RobodynError(Exception):
    """Base of all errors that robodyn raises on purpose.

    sentence : what is wrong. about : what stands before it where it is shown: a place in a file or an option, and the
    key. ``exit_code`` is what the command line returns; ``details`` are machine-readable facts for ``--json``.
    ``result`` is what a command had computed until then (a ``results.result.Result``), None where there is nothing to
    show.
    """

    exit_code = 70
    result: object | None = None

    def __init__(self, sentence: str, about: Sequence[str] = (), **details: Any) -> None:
        super().__init__(sentence)
        self.sentence = sentence
        self.about = tuple(filter(None, about))
        self.details = details

    def __str__(self) -> str:
        return self.message

    @property
    def message(self) -> str:
        """What is wrong and with what, in words."""
        return ": ".join((*self.about, self.sentence))

    def beyond(self, known: str) -> str:
        """Return the message for a reader who knows what it is about: without this, if it begins so."""
        return ": ".join((*self.about[self.about[:1] == (known,) :], self.sentence))

    @property
    def facts(self) -> dict[str, Any]:
        """What a summary says of the error that ended a run."""
        return {"kind": type(self).__name__, "message": self.message, "exit_code": self.exit_code}

    @property
    def termination(self) -> dict[str, Any]:
        """Why a run ended, as its summary says it."""
        return {"reason": self.message, **self.details}


class SceneError(RobodynError):
    """The scene file says something that is not allowed (exit code 2)."""

    exit_code = 2


class CapabilityError(RobodynError):
    """The scene is valid, but the method or command asked for cannot do it (exit code 2)."""

    exit_code = 2


class GeometryError(RobodynError):
    """The geometry cannot be met: a loop that does not close, a target out of reach (exit code 5)."""

    exit_code = 5


class NumericalError(RobodynError):
    """The numerics failed: divergence, step size underflow, singular mass matrix (exit code 3)."""

    exit_code = 3


def of_option(
    option: str, sentence: str, kind: type[RobodynError] = SceneError, **details: Any
) -> RobodynError:
    """Return the error of an option as it was given, ``--at q=1``: it is about that, and about no place in a file."""
    return kind(sentence, (option,), option=option.partition(" ")[0], **details)


def unknown_data(names: Sequence[str]) -> SceneError:
    """Return the error that names data the equations need and the scene does not give."""
    listed = ", ".join(sorted(set(names)))
    hint = ""
    if any("inertia.x" in n or "inertia.y" in n or n.startswith("com[2]") for n in names):
        hint = " (the motion or the load leaves the plane)"
    return SceneError(
        f"the equations of motion need {listed}, which the scene does not give{hint}",
        missing=sorted(set(names)),
    )


def no_linear_algebra(error: Exception) -> NumericalError:
    """Return the error of a matrix that cannot be decomposed, from numpy's LinAlgError or a division by zero."""
    return NumericalError(
        f"a matrix of the equations cannot be solved with ({error}): numbers of the scene are too large, too "
        "small or too far apart for double precision"
    )


def out_of_range(error: OverflowError) -> NumericalError:
    """Return the error of a number that no double holds, from Python's OverflowError."""
    return NumericalError(
        f"a number of the scene, or a result of some, exceeds the range of a double (1.8e308): {error.args[-1]}"
    )


class SingularConfigurationError(RobodynError):
    """The mechanism met a singular configuration that the run was not told to expect (exit code 4)."""

    exit_code = 4


class StrictError(NumericalError):
    """A run whose result is whole has warnings, which ``--strict`` takes as errors (exit code 3)."""


class OutputError(RobodynError):
    """A result cannot be written (exit code 74)."""

    exit_code = 74


class ResultFileError(RobodynError):
    """A file is not a result that can be read: foreign, damaged or too new (exit code 2)."""

    exit_code = 2


class DirectoryInUseError(CapabilityError):
    """Another run is writing into the output directory (exit code 2)."""


def shown(value: Any) -> str:
    """Return a value as quoted in messages: one line, not long."""
    text = repr(value)
    if len(text) <= LONGEST:
        return text
    return f"{text[: LONGEST - 3]}...{text[-1] if isinstance(value, str) else ''}"


def listed(names: Sequence[str]) -> str:
    """Return names in a row, each once; of very many the first."""
    names = list(dict.fromkeys(names))
    more = f", ... ({len(names)} in all)" if len(names) > MOST_LISTED else ""
    return ", ".join(names[:MOST_LISTED]) + more


def plural_of(word: str) -> str:
    """Return the plural of a word: joints, latches, bodies."""
    if word.endswith("y") and word[-2:-1] not in tuple("aeiou"):
        return f"{word[:-1]}ies"
    return f"{word}es" if word.endswith(("ch", "sh", "s", "x")) else f"{word}s"


def did_you_mean(word: str, options: Iterable[str]) -> str:
    """Return ``" (did you mean 'x'?)"`` for the option nearest to ``word``, or an empty text; of keys with a part too
    many the one without."""
    options = list(options)
    near = max((x for x in options if word.startswith(f"{x}.")), key=len, default=None)
    if near is None or any(x.startswith(f"{near}.") for x in options):
        near = nearest_word(word, options)
    return f" (did you mean {near!r}?)" if near is not None else ""


def unknown_name(kind: str, name: str, options: Iterable[str]) -> str:
    """Return the message about a name that there is not."""
    options = list(options)
    allowed = listed(options) or "none is defined"
    return f"unknown {kind} {shown(name)}{did_you_mean(name, options)}; allowed: {allowed}"


def nearest_word(word: str, options: Iterable[str], likeness: float = 0.6) -> str | None:
    """Return the option that ``word`` may be a slip of the pen for, or None; ``likeness`` : 1 for equal words."""
    import difflib  # only when something is already wrong

    lower = {option.lower(): option for option in options}
    near = difflib.get_close_matches(word.lower()[:80], lower, n=1, cutoff=likeness)
    return lower[near[0]] if near else None
