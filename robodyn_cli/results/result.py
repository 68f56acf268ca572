"""The result of a run in memory: named arrays with units, the columns of these, and a summary."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypedDict

import numpy as np

from robodyn_cli.errors import RobodynError, did_you_mean
from robodyn_cli.record import mutable_record
from robodyn_cli.registry import Registry
from robodyn_cli.results import catalogue
from robodyn_cli.results.summary import as_keys
from robodyn_cli.spatial.algebra import Array

if TYPE_CHECKING:
    import pandas
    import xarray
    from typing_extensions import Unpack

    from robodyn_cli.equations.problem import Problem
    from robodyn_cli.results.held import HeldColumns
    from robodyn_cli.results.report import Report
    from robodyn_cli.scene.types import Scene

# what shows a result, or hands it to another library: named here, and imported when it is called, since drawings
# are above results
VIEWS: Registry[Any] = Registry(
    "robodyn_cli",
    {
        "plot": "report.notebook:plot",
        "html": "report.notebook:as_html",
        "function": "cli.python:function",
        "xarray": "results.export:to_xarray",
        "pandas": "results.export:to_pandas",
    },
)


@mutable_record
class Variable:
    """An array with what is needed to read it alone.

    ``data`` has the time dimension first when ``dims[0] == "time"``; ``names`` label the columns of the
    last dimension (joints, constraint rows, axes); ``column_units`` are theirs where they differ. ``held`` says which
    are constant between updates of a sampled controller, and when these are.
    """

    data: Array
    dims: tuple[str, ...]
    units: str
    long_name: str
    names: tuple[str, ...] = ()
    column_units: tuple[str, ...] = ()
    held: HeldColumns | None = None


class Meta(TypedDict, total=False):
    """Units, names and meaning of an array; the catalogue gives those left out."""

    units: str | None
    long_name: str | None
    dims: tuple[str, ...] | None
    names: tuple[str, ...] | list[str]
    column_units: tuple[str, ...]
    held: HeldColumns | None


def make_variable(path: str, data: Any, **meta: Unpack[Meta]) -> Variable:
    """Return ``data`` as a Variable; the catalogue gives what is left out, and shapes are checked."""
    known = catalogue.lookup(path)
    units, long_name, dims = meta.get("units"), meta.get("long_name"), meta.get("dims")
    names, column_units = meta.get("names", ()), meta.get("column_units", ())
    if dims is None:
        dims = known.dims if known else ("time",)
    if known and not names and known.dims == tuple(dims):
        names = known.names
    if known and known.by_column and not column_units:
        column_units = tuple(known.by_column[name] for name in names)
    units = known.units if units is None and known else units
    long_name = known.long_name if long_name is None and known else long_name
    if units is None or long_name is None:
        raise ValueError(f"{path}: not in the catalogue of results, so units and long_name must be given")
    array = np.asarray(data, dtype=float)
    if array.ndim != len(dims):
        raise ValueError(f"{path}: {array.ndim} dimensions, but dims is {tuple(dims)}")
    if names and array.shape[-1] != len(names):
        raise ValueError(f"{path}: {array.shape[-1]} columns, but {len(names)} names")
    if column_units and array.shape[-1] != len(column_units):
        raise ValueError(f"{path}: {array.shape[-1]} columns, but {len(column_units)} units of columns")
    held = meta.get("held")
    if held is not None and len(held.offset) != (array.shape[-1] if array.ndim > 1 else 1):
        raise ValueError(f"{path}: {len(held.offset)} offsets of what is held")
    return Variable(array, tuple(dims), units, long_name, tuple(names), tuple(column_units), held)


@mutable_record
class Result:
    """The result of a run.

    ``variables`` maps the HDF5 path without its leading slash (``"q"``, ``"torque_terms/gravity"``,
    ``"points/tip"``) to a Variable; ``summary`` is what goes into ``summary.json``; ``attributes`` are the
    root attributes of the HDF5 file; ``others`` are the entries of datasets that hold no numbers; ``problem`` are the
    equations of the scene where drawings may take those that a command has built, and is not stored. ``status`` is
    ``"ok"``, ``"locked"``, ``"no_lock"``, ``"overload"``, ``"undersized"``, ``"missed"`` or ``"failed"``.
    """

    command: str
    title: str
    status: str
    scene_text: str
    variables: dict[str, Variable] = dataclasses.field(default_factory=dict)
    events: list[dict[str, Any]] = dataclasses.field(default_factory=list)
    summary: dict[str, Any] = dataclasses.field(default_factory=dict)
    attributes: dict[str, Any] = dataclasses.field(default_factory=dict)
    others: dict[str, tuple[str, ...]] = dataclasses.field(default_factory=dict)
    notes: tuple[str, ...] = ()
    problem: Problem | None = dataclasses.field(default=None, compare=False, repr=False)

    @staticmethod
    def of(command: str, scene: Scene, status: str = "ok") -> Result:
        """Return the empty result of a command on a scene."""
        over = scene.outputs.abscissa
        own = {} if over is None else {"abscissa": over}
        return Result(command, scene.title or command, status, scene.text, attributes=own, notes=scene.notes)

    @property
    def head(self) -> dict[str, str]:
        """The first keys of every summary."""
        return {"status": self.status, "command": self.command, "title": self.title}

    def summarise(self, *records: Any, seconds: Mapping[str, float] | None = None) -> None:
        """Make the summary of records, whose fields are its keys, and of the wall times by stage."""
        keys = {name: value for record in records for name, value in as_keys(record).items()}
        times = {} if seconds is None else {"wall_time_s": dict(seconds)}
        notes = {"notes": list(self.notes)} if self.notes else {}
        self.summary = {**self.head, **keys, **notes, **times}

    def unless(self, failure: RobodynError | None) -> Result:
        """Return the result of a run.

        Raises
        ------
        RobodynError : the ``failure`` that ended the run, with the result until then.
        """
        if failure is None:
            return self
        failure.result = self
        raise failure

    def __getitem__(self, path: str) -> Array:
        """Return the array stored under ``path`` (``result["q"]``).

        Raises
        ------
        KeyError : with the paths that there are.
        """
        name = path.strip("/")
        if name not in self.variables:
            near = did_you_mean(name, self.variables)
            raise KeyError(f"no dataset {name!r}{near}; allowed: {', '.join(self.variables)}")
        return self.variables[name].data

    def __contains__(self, path: object) -> bool:
        return isinstance(path, str) and path.strip("/") in self.variables

    def add(self, path: str, data: Any, **meta: Unpack[Meta]) -> None:
        """Store an array under ``path``; ``meta`` and the checks of shapes are those of ``make_variable``."""
        self.variables[path.strip("/")] = make_variable(path, data, **meta)

    def group(self, prefix: str) -> dict[str, Variable]:
        """Return the variables below ``prefix`` by the rest of their path (``group("points")["tip"]``)."""
        start = prefix.strip("/") + "/"
        return {path[len(start) :]: item for path, item in self.variables.items() if path.startswith(start)}

    @property
    def time(self) -> Array:
        """Sample times, shape (T,), in seconds."""
        return self["time"]

    def plot(self, name: str) -> Any:
        """Return a plot as of ``--plots`` (``result.plot("torques")``): a figure of matplotlib, which notebooks show.

        Raises
        ------
        CapabilityError : there is no such plot, or no data for it; the message lists those that are possible.
        """
        return VIEWS["plot"](self, name)

    def animate(self, file: str | os.PathLike[str] | None = None, **options: Any) -> Report:
        """Make a movie of the result, as the function ``animate`` does; without a file a notebook shows it.

        Raises
        ------
        CapabilityError : the result has no poses. Others as of the function.
        """
        return VIEWS["function"]("animate")(self, file=file, **options)

    def report(self, file: str | os.PathLike[str] | None = None, **options: Any) -> Report:
        """Make a page for a browser, as the function ``report`` does; without a file a notebook shows it.

        Raises
        ------
        RobodynError : as of the function.
        """
        return VIEWS["function"]("report")(self, file=file, **options)

    def export(self, to: str, out: str | os.PathLike[str]) -> Report:
        """Write the result in another form into a directory, as the function ``export`` does.

        Raises
        ------
        RobodynError : as of the function.
        """
        return VIEWS["function"]("export")(self, to=to, out=out)

    def compare(self, baseline: Result | str | os.PathLike[str], **options: Any) -> Report:
        """Return how the result differs from another, dataset by dataset, as the function ``compare`` tells it.

        Raises
        ------
        RobodynError : as of the function.
        """
        return VIEWS["function"]("compare")(self, baseline, **options)

    def check(self, scene: Any = None) -> Report:
        """Return whether the result holds what its scene, or another one, expects, as the function ``check`` tells it.

        Raises
        ------
        RobodynError : as of the function.
        """
        return VIEWS["function"]("check")(self, scene)

    def to_xarray(self) -> xarray.Dataset:
        """Return all datasets by their paths, with units, times and names of columns; see ``results.frames``."""
        dataset: xarray.Dataset = VIEWS["xarray"](self)
        return dataset

    def to_pandas(self, table: str | None = None) -> pandas.DataFrame:
        """Return everything over time, or another table, as a DataFrame; see ``results.frames``."""
        frame: pandas.DataFrame = VIEWS["pandas"](self, table)
        return frame

    def __repr__(self) -> str:
        """Return a line: what was run, how it ended, and what there is."""
        samples = f"{len(self.time)} samples, " if "time" in self else ""
        return f"<Result of {self.command}, {self.title!r}: {self.status}, {samples}{len(self.variables)} datasets>"

    def _repr_html_(self) -> str:
        """Return what a notebook shows: the main figures with their errors, and a picture."""
        text: str = VIEWS["html"](self)
        return text


def column_names(variable: Variable) -> list[str]:
    """Return the names of the columns; their numbers where they have none."""
    return list(variable.names) or [str(index + 1) for index in range(variable.data.shape[-1])]


def units_of(variable: Variable) -> list[str]:
    """Return the units of each column; those of a wrench or a twist by the letters of its names."""
    if variable.column_units:
        return list(variable.column_units)
    both = variable.units.split(", ")
    if len(both) == 2 and variable.names:
        # force and moment, angular velocity and velocity
        return [both[1] if name[0] in "mv" else both[0] for name in variable.names]
    return [variable.units] * variable.data.shape[-1]


def by_unit(variable: Variable) -> dict[str, list[int]]:
    """Return the columns that go into one panel: those of one unit."""
    groups: dict[str, list[int]] = {}
    for column, units in enumerate(units_of(variable)):
        groups.setdefault(units, []).append(column)
    return groups


def magnitude(data: Array, names: Sequence[str], letter: str) -> Array:
    """Return the length (T,) of the force (``letter`` f) or of the moment (m) of a wrench (T, n).

    names : of its columns (``fx``, ``mz``), of which some may be missing.
    """
    columns = [k for k, name in enumerate(names) if name.startswith(letter)]
    return np.asarray(np.sqrt((data[:, columns] ** 2).sum(axis=1)))


def evenly(count: int, most: int) -> Array:
    """Return at most ``most`` of ``count`` samples (..,), evenly apart, the first and the last included."""
    places: Array = np.linspace(0, count - 1, min(count, most)).round().astype(int)
    return places
