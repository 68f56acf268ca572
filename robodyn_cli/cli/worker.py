"""The process that runs one scene of a batch; its one argument is what to run, as JSON, and it prints the summary."""

from __future__ import annotations

import dataclasses
import json
import os
import sys
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robodyn_cli.cli import interrupts
from robodyn_cli.cli.main import prepare_process
from robodyn_cli.errors import INTERRUPTED

if TYPE_CHECKING:
    from robodyn_cli.report.registry import Drawings


def command_line(
    drawings: Drawings | None, overrides: Sequence[str], command: str, scene: Path, directory: Path
) -> list[str]:
    """Return the command line of a worker; files in the current directory cannot shadow modules."""
    package = str(Path(__file__).parents[2])
    code = f"import sys; sys.path[0] = {package!r}; from robodyn_cli.cli.worker import main; main()"
    job = {"command": command, "scene": str(scene), "out": str(directory), "overrides": list(overrides),
           "drawings": None if drawings is None else dataclasses.asdict(drawings)}  # fmt: skip
    return [sys.executable, "-c", code, json.dumps(job)]


def main() -> None:
    """Run the scene as its command would; the exit code is the same. Ends when standard input does."""
    prepare_process()
    threading.Thread(target=_end_with_the_batch, daemon=True).start()
    interrupts.end(_run(**json.loads(sys.argv[1])))


def _run(command: str, scene: str, out: str, overrides: list[str], drawings: dict[str, Any] | None) -> int:
    from robodyn_cli.cli.console import Console, guarded
    from robodyn_cli.cli.runner import SceneRun, run_scene
    from robodyn_cli.report.registry import Drawings

    drawn = None
    if drawings is not None:
        drawn = Drawings(**{**drawings, "names": drawings["names"] and tuple(drawings["names"])})
    job = SceneRun(command, Path(scene), Path(out), overrides, drawn)
    return guarded(lambda: run_scene(job, Console(as_json=True, quiet=True), lambda *_: ""))()


def _end_with_the_batch() -> None:
    """End at once when the batch has ended: nothing reads the result any more."""
    while os.read(0, 1):
        pass
    os._exit(INTERRUPTED)
