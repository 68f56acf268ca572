"""Dataclasses that cost little to define: their methods are closures, no code is generated for them.

``dataclasses.dataclass`` writes and compiles half a dozen functions for each class, and searches its annotations for
features that no record has. For our classes together that took longer than a small run takes. So methods and fields
come from here; ``dataclasses.fields``, ``replace`` and ``asdict`` work as ever. Making an instance takes as long as it
takes with a frozen dataclass.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from operator import attrgetter
from typing import TYPE_CHECKING, Any, NoReturn, TypeVar

if TYPE_CHECKING:
    from typing_extensions import dataclass_transform
else:

    def dataclass_transform(**_: Any) -> Callable[[Any], Any]:
        return lambda decorator: decorator


T = TypeVar("T")
Method = Callable[..., Any]
put = object.__setattr__
MISSING = dataclasses.MISSING

FIELDS = "__dataclass_fields__"
# what the library gives any dataclass that it writes no methods for; with a docstring, as in ``_equip``
SAMPLE: Any = dataclasses.make_dataclass(
    "SAMPLE", ["field"], init=False, repr=False, eq=False, namespace={"__doc__": "A sample."}
)
KIND = getattr(SAMPLE, FIELDS)["field"]._field_type
SHARED = {
    name: value for name, value in vars(SAMPLE).items() if name in ("__dataclass_params__", "__replace__")
}
CLASS_VARIABLE = "ClassVar", "typing.ClassVar"


@dataclass_transform(frozen_default=True, field_specifiers=(dataclasses.field,))
def record(cls: type[T]) -> type[T]:
    """Make a class a frozen dataclass: a value, compared and hashed by its fields.

    Fields may have defaults, factories, ``compare=False`` and ``repr=False``; ``__post_init__`` is called last; a
    method that the class has itself stays. Bases must be records too, or no dataclasses,
    whose attributes are no defaults of fields.
    """
    return _equip(cls, frozen=True)


@dataclass_transform(field_specifiers=(dataclasses.field,))
def mutable_record(cls: type[T]) -> type[T]:
    """Make a class a dataclass whose fields may change, so that it has no hash; otherwise as ``record``."""
    return _equip(cls, frozen=False)


def _equip(cls: type[T], frozen: bool) -> type[T]:
    own = vars(cls)
    hashes = own.get("__hash__") is not None  # with an __eq__ alone Python puts None there
    if cls.__doc__ is None:
        cls.__doc__ = cls.__name__  # else the signature is taken apart to make one
    described = _fields_of(cls)
    fields = tuple(described.values())
    names = [f.name for f in fields if f.compare]
    compared: Callable[[Any], tuple[Any, ...]] = (
        attrgetter(*names) if len(names) > 1 else lambda x: tuple([getattr(x, name) for name in names])
    )
    methods: dict[str, Any] = {
        "__init__": _initialiser(cls, fields),
        "__repr__": _describer([f.name for f in fields if f.repr]),
        "__eq__": _comparer(compared),
    }
    if frozen:
        methods |= {"__setattr__": _refuse_setting, "__delattr__": _refuse_deleting}
    methods = {name: method for name, method in methods.items() if name not in own}
    if not hashes:
        methods["__hash__"] = (lambda self: hash(compared(self))) if frozen else None
    described_by = {FIELDS: described, "__match_args__": tuple(described), **SHARED}
    for name, value in (methods | described_by).items():
        setattr(cls, name, value)
    return cls


def _fields_of(cls: type) -> dict[str, dataclasses.Field[Any]]:
    """Return the fields by name, those of bases first; class attributes become the defaults themselves, as ever."""
    own = vars(cls)
    fields: dict[str, dataclasses.Field[Any]] = {}
    for base in cls.__mro__[-1:0:-1]:
        fields |= getattr(base, FIELDS, {})
    for name, kind in cls.__annotations__.items():
        if str(kind).startswith(CLASS_VARIABLE):
            continue
        # what a base that is no record has is no default
        value: Any = own[name] if name in own else getattr(cls, name, MISSING) if name in fields else MISSING
        field: Any = value if isinstance(value, dataclasses.Field) else dataclasses.field(default=value)
        if field.default.__class__.__hash__ is None:
            raise ValueError(f"the default of {cls.__qualname__}.{name} may change: give a default_factory")
        if field is value and field.default is MISSING:
            delattr(cls, name)
        elif field is value:
            setattr(cls, name, field.default)
        field.name, field.type, field.kw_only, field._field_type = name, kind, False, KIND
        fields[name] = field
    return fields


def _initialiser(cls: type, fields: Sequence[dataclasses.Field[Any]]) -> Method:
    names = [f.name for f in fields]
    count = len(names)
    known = frozenset(names)
    defaults = {f.name: f.default for f in fields if f.default is not MISSING}
    factories = {f.name: f.default_factory for f in fields if f.default_factory is not MISSING}
    finish = getattr(cls, "__post_init__", None)

    def __init__(self: Any, *args: Any, **kwargs: Any) -> None:
        if len(args) == count and not kwargs:
            for name, value in zip(names, args):
                put(self, name, value)
        else:
            given = dict(zip(names, args), **kwargs)
            values = {**defaults, **given}
            for name, make in factories.items():
                if name not in given:
                    values[name] = make()
            if len(given) != len(args) + len(kwargs) or values.keys() != known:
                raise _misfit(cls, names, args, kwargs, values)
            for name in names:
                put(self, name, values[name])
        if finish is not None:
            finish(self)

    return __init__


def _misfit(
    cls: type, names: Sequence[str], args: Sequence[Any], kwargs: dict[str, Any], values: dict[str, Any]
) -> TypeError:
    """Return the error of a call whose arguments are too many, too few, unknown or given twice."""
    faults = {
        "missing": [name for name in names if name not in values],
        "unknown": [name for name in kwargs if name not in names],
        "given twice": [name for name in names[: len(args)] if name in kwargs],
        "too many": [f"{len(args)} for {len(names)}"] if len(args) > len(names) else [],
    }
    words = "; ".join(f"{fault}: {', '.join(which)}" for fault, which in faults.items() if which)
    return TypeError(f"arguments of {cls.__qualname__}: {words}")


def _describer(names: Sequence[str]) -> Method:
    def __repr__(self: Any) -> str:
        return f"{type(self).__qualname__}({', '.join(f'{name}={getattr(self, name)!r}' for name in names)})"

    return __repr__


def _comparer(values: Callable[[Any], tuple[Any, ...]]) -> Method:
    def __eq__(self: Any, other: Any) -> Any:
        if other.__class__ is not self.__class__:
            return NotImplemented
        return values(self) == values(other)

    return __eq__


def _refuse_setting(self: Any, name: str, value: Any) -> NoReturn:
    raise dataclasses.FrozenInstanceError(f"cannot assign to field {name!r}")


def _refuse_deleting(self: Any, name: str) -> NoReturn:
    raise dataclasses.FrozenInstanceError(f"cannot delete field {name!r}")
