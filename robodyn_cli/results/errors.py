"""Errors of the result layer that need a name of their own."""

from __future__ import annotations

from robodyn_cli.errors import CapabilityError, RobodynError


class ResultFileError(RobodynError):
    """A file is not a result that can be read: foreign, damaged or too new (exit code 2)."""

    exit_code = 2


class DirectoryInUseError(CapabilityError):
    """Another run is writing into the output directory (exit code 2)."""
