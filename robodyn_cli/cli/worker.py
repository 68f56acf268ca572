"""The process that runs one scene of a batch: ``COMMAND SCENE DIR [--no-plots] [KEY=VALUE]...``."""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Sequence
from pathlib import Path

INTERRUPTED = 130
NO_PLOTS = "--no-plots"


def command_line(
    plots: bool, overrides: Sequence[str], command: str, scene: Path, directory: Path
) -> list[str]:
    """Return the command line of a worker; what lies in the current directory cannot shadow a module."""
    package = str(Path(__file__).parents[2])
    code = f"import sys; sys.path[0] = {package!r}; from robodyn_cli.cli.worker import main; main()"
    words = [sys.executable, "-c", code, command, str(scene), str(directory)]
    return [*words, *([] if plots else [NO_PLOTS]), *overrides]


def main() -> None:
    """Run the scene as its command would; the exit code is the same. Ends when standard input does."""
    threading.Thread(target=_end_with_the_batch, daemon=True).start()
    try:
        from robodyn_cli.cli.console import Console, guarded
        from robodyn_cli.cli.runner import run_scene

        command, scene, directory, *overrides = sys.argv[1:]
        draw_nothing = overrides[:1] == [NO_PLOTS]
        console = Console(quiet=True)
        guarded(
            console,
            lambda: run_scene(
                command,
                Path(scene),
                Path(directory),
                overrides[1:] if draw_nothing else overrides,
                draw_nothing,
                False,
                console,
                lambda _: "",
            ),
        )
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)


def _end_with_the_batch() -> None:
    """End at once when the batch has ended, whichever way: nobody would see the result."""
    while os.read(0, 1):
        pass
    os._exit(INTERRUPTED)
