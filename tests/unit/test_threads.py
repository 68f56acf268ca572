"""Commands ask the linear algebra for one thread before numpy is there to hear it."""

from __future__ import annotations

import os
import subprocess
import sys

from robodyn_cli.threads import VARIABLES, single_thread

# an import of numpy that comes too early would not hear what is asked for later
WATCHED = """
import os, sys
class Watch:
    def find_spec(self, name, *rest):
        if name == "numpy":
            print(*(os.environ.get(x) for x in {names!r}))
            sys.meta_path.remove(self)
sys.meta_path.insert(0, Watch())
sys.argv = ["robodyn", "validate", "configs/double_pendulum.yaml", "--quiet"]
from robodyn_cli.cli.main import main
main()
"""


def test_what_the_user_says_stays() -> None:
    environment = {VARIABLES[1]: "4", "PATH": "x"}
    single_thread(environment)
    assert environment == {"PATH": "x", **dict.fromkeys(VARIABLES, "1"), VARIABLES[1]: "4"}


def test_commands_ask_before_numpy_is_imported() -> None:
    environment = {k: v for k, v in os.environ.items() if k not in VARIABLES}
    environment[VARIABLES[2]] = "3"
    code = WATCHED.format(names=VARIABLES)
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True)
    assert done.stdout.split() == ["1", "1", "3"], done.stderr
