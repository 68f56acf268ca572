"""Records behave as the dataclasses that they stand in for."""

from __future__ import annotations

import copy
import dataclasses
import importlib
import inspect
import pkgutil
import runpy
import types
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import pytest

import robodyn_cli
from robodyn_cli.record import mutable_record, record


def made(decorator: Any) -> Any:
    """Return a class of its own, made by the decorator."""

    class Shape:
        kind: ClassVar[str] = "shape"
        size: int
        name: str = "none"
        parts: list[int] = dataclasses.field(default_factory=list)
        note: str = dataclasses.field(default="", compare=False, repr=False)

        @cached_property
        def double(self) -> int:
            return 2 * self.size

    Shape.__qualname__ = "Shape"
    return decorator(Shape)


PAIRS = (
    pytest.param(record, dataclasses.dataclass(frozen=True), id="frozen"),
    pytest.param(mutable_record, dataclasses.dataclass, id="mutable"),
)


@pytest.mark.parametrize("ours, theirs", PAIRS)
def test_as_a_dataclass(ours: Any, theirs: Any) -> None:
    """Construction, defaults, text, order of fields, copies and parts agree with the library's own."""
    A, B = made(ours), made(theirs)
    calls: list[tuple[tuple[Any, ...], dict[str, Any]]] = [
        ((1,), {}), ((1, "a"), {}), ((1, "a", [3], "n"), {}), ((), {"size": 2}), ((1,), {"parts": [1], "note": "x"}),
        ((1,), {"name": "b"}),
    ]  # fmt: skip
    for args, kwargs in calls:
        a, b = A(*args, **kwargs), B(*args, **kwargs)
        assert repr(a) == repr(b) and vars(a) == vars(b)
        assert dataclasses.asdict(a) == dataclasses.asdict(b) and a.double == b.double
        assert vars(dataclasses.replace(a, size=7)) == vars(dataclasses.replace(b, size=7))
        assert a == copy.copy(a) == copy.deepcopy(a) == A(*args, **kwargs) != b
    assert A(1).parts is not A(1).parts
    assert A.__match_args__ == B.__match_args__ and A(1) != A(2) and A(1) == A(1, note="not compared")


@pytest.mark.parametrize("ours, theirs", PAIRS)
def test_fields_are_the_library_s(ours: Any, theirs: Any) -> None:
    """All that a field knows agrees, and what is left of it in the class, in a class that is derived too."""
    A, B = made(ours), made(theirs)
    C, D = (decorator(type("C", (base,), {"__annotations__": {"name": "str", "more": "float", "size": "int"},
                                          "more": 1.0, "size": 4}))
            for decorator, base in ((ours, A), (theirs, B)))  # fmt: skip
    slots = (
        "name",
        "type",
        "default",
        "default_factory",
        "init",
        "repr",
        "hash",
        "compare",
        "metadata",
        "kw_only",
    )
    for a, b in ((A, B), (C, D)):
        known = [[[getattr(f, slot) for slot in slots] for f in dataclasses.fields(x)] for x in (a, b)]
        assert known[0] == known[1]
        names = ("kind", "size", "name", "parts", "note", "more")
        assert [vars(a).get(name) for name in names] == [vars(b).get(name) for name in names]
    assert repr(C()) == repr(D()) and C().name == "none"
    assert dataclasses.fields(dataclasses.make_dataclass("E", ["e"], bases=(C,), init=False))[-1].name == "e"
    with pytest.raises(ValueError, match="default_factory"):
        ours(type("F", (), {"__annotations__": {"f": "list[int]"}, "f": []}))


@pytest.mark.parametrize("ours, theirs", PAIRS)
@pytest.mark.parametrize(
    "args, kwargs, words",
    [
        ((), {}, "missing: size"),
        ((1, "a", [], "", 5), {}, "too many: 5 for 4"),
        ((1,), {"color": 1}, "unknown: color"),
        ((1,), {"size": 2}, "given twice: size"),
        ((1, "a", [], ""), {"size": 2}, "given twice: size"),
        ((), {"name": "a", "color": 2, "parts": [], "note": ""}, "missing: size; unknown: color"),
    ],
)
def test_wrong_arguments(ours: Any, theirs: Any, args: Any, kwargs: Any, words: str) -> None:
    with pytest.raises(TypeError, match=f"arguments of Shape: {words}$"):
        made(ours)(*args, **kwargs)
    with pytest.raises(TypeError):
        made(theirs)(*args, **kwargs)


def test_values_stay() -> None:
    shape = made(record)(1)
    with pytest.raises(dataclasses.FrozenInstanceError, match="assign to field 'size'"):
        shape.size = 2
    with pytest.raises(dataclasses.FrozenInstanceError, match="delete field 'size'"):
        del shape.size
    other = made(mutable_record)(1)
    other.size = 2
    assert other.size == 2


def test_hashes_are_of_what_is_compared() -> None:
    @record
    class Pair:
        first: int
        second: str = dataclasses.field(default="", compare=False)

    assert hash(Pair(1, "a")) == hash(Pair(1, "b")) and len({Pair(1), Pair(1), Pair(2)}) == 2
    with pytest.raises(TypeError, match="unhashable"):
        hash(made(mutable_record)(1))

    @record
    class One:
        x: Any

    x = np.zeros(3)
    assert One(x) == One(x)  # the same object is equal to itself, as in any tuple


def test_bases_and_own_methods() -> None:
    @record
    class Base:
        a: int
        b: int = 2

        def __post_init__(self) -> None:
            if self.a < 0:
                raise ValueError("negative")

    @record
    class Derived(Base):
        """Derived."""

        b: int = 3
        c: int = 4

        def __repr__(self) -> str:
            return "mine"

        def __eq__(self, other: object) -> bool:
            return True

        def __hash__(self) -> int:
            return 5

    assert vars(Derived(1)) == {"a": 1, "b": 3, "c": 4} and repr(Derived(1)) == "mine"
    assert Derived(1) == Derived(2) and hash(Derived(1)) == 5 and Derived.__doc__ == "Derived."
    assert Base(1) == Base(1, 2) != Base(2)
    for make in (Base, Derived):
        with pytest.raises(ValueError, match="negative"):
            make(-1)


def test_what_a_base_answers_is_no_default_of_a_field() -> None:
    class Kind:
        """Declares answers of all of its kind."""

        a: int | None = None

    @record
    class Member(Kind):
        """Has a field of the same name."""

        a: int
        b: int = 2

    assert Member(1) == Member(a=1, b=2) and Member(1).a == 1
    with pytest.raises(TypeError, match="missing: a"):
        Member(b=2)  # type: ignore[call-arg]


def test_no_class_is_written_as_code() -> None:
    """All dataclasses of the package are records: every one written as code costs half a millisecond at each start."""
    found = 0
    for module in pkgutil.walk_packages(robodyn_cli.__path__, "robodyn_cli."):
        if module.name.endswith("__main__"):
            continue
        for name, cls in vars(importlib.import_module(module.name)).items():
            if isinstance(cls, type) and dataclasses.is_dataclass(cls) and cls.__module__ == module.name:
                found += 1
                init = cls.__init__
                assert isinstance(init, types.FunctionType)
                assert init.__code__.co_filename != "<string>", f"{module.name}.{name}: use record"
    assert found > 100


def test_no_signature_is_taken_apart_at_start_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """The library does so for a dataclass without a docstring, which takes as long as several modules to import."""

    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("taken apart")

    monkeypatch.setattr(inspect, "signature", refuse)
    own = runpy.run_path(str(importlib.import_module("robodyn_cli.record").__file__))

    @own["record"]
    class Bare:
        x: int

    assert Bare.__doc__ == "Bare"
