"""Errors of the result layer that need a name of their own."""

from __future__ import annotations

from robodyn_cli.errors import CapabilityError, RobodynError


class ResultFileError(RobodynError):
    """A file given as a result cannot be read as one: foreign, damaged or from a newer robodyn (exit code 2)."""

    exit_code = 2


class DirectoryInUseError(CapabilityError):
    """Another run is writing into the output directory (exit code 2)."""
