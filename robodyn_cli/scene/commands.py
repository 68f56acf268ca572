"""The commands that a scene may name under ``command``, so that ``robodyn run`` can run it: one line each."""

from __future__ import annotations

from robodyn_cli.record import record


@record
class SceneCommand:
    """Where a command lives, by name: a module is imported when its command runs, start-up time is a feature.

    ``function(scene, progress=..., watch=...)`` in ``module`` returns a Result and reports the time of its stages.
    ``streamed``: it takes a ``writer``, which writes long runs block by block. ``plots`` is the module with
    ``plot_files()`` and ``draw_all(result, directory)``.
    """

    module: str
    function: str
    streamed: bool = False
    plots: str = "robodyn_cli.report.registry"


SCENE_COMMANDS: dict[str, SceneCommand] = {
    "inverse": SceneCommand("robodyn_cli.run.inverse.inverse", "inverse"),
    "simulate": SceneCommand("robodyn_cli.run.simulate", "simulate", streamed=True),
    "deploy": SceneCommand("robodyn_cli.run.deploy.deploy", "deploy", streamed=True),
    "stability": SceneCommand(
        "robodyn_cli.run.numerics.stability", "stability", plots="robodyn_cli.report.plots_stability"
    ),
    "statics": SceneCommand("robodyn_cli.run.mechanism.statics", "statics"),
    "assemble": SceneCommand("robodyn_cli.run.mechanism.assemble", "assemble"),
    "kinematics": SceneCommand("robodyn_cli.run.mechanism.kinematics", "kinematics"),
}
