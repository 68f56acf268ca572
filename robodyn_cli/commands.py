"""The commands of the program, one line each: data alone, below all layers that use them."""

from __future__ import annotations

from robodyn_cli.record import record


@record
class Command:
    """One command.

    help : one line for ``--help``.
    run : for a command that a scene may name under ``command``, its function as ``module:function`` below
    ``robodyn_cli``; ``function(scene, progress=..., watch=...)`` returns a Result.
    streamed : that function takes a ``writer`` too, which writes long runs block by block.
    brief : it takes so little time that ``validate`` runs it to find what is wrong.
    """

    help: str
    run: str = ""
    streamed: bool = False
    brief: bool = False


# what the command line calls is the function ``command`` in cli/commands/NAME.py
COMMANDS: dict[str, Command] = {
    "inverse": Command("Torques that a motion needs (inverse dynamics).", "works.inverse:inverse"),
    "simulate": Command(
        "Motion that the torques give (forward dynamics).", "works.simulate:simulate", streamed=True
    ),
    "deploy": Command(
        "Simulate a mechanism with loops until it locks.", "works.deploy.deploy:deploy", streamed=True
    ),
    "kinematics": Command(
        "Motion without forces, mobility, transmission.", "works.kinematics:kinematics", brief=True
    ),
    "assemble": Command(
        "Close the loops, and find the ways in which they close.", "works.assemble:assemble", brief=True
    ),
    "reach": Command("Joint positions that bring a frame to a pose.", "works.reach:reach", brief=True),
    "statics": Command(
        "Balance and its stability, or torques that hold a pose.", "works.statics:statics", brief=True
    ),
    "linearise": Command(
        "Linear model about a state or along a motion: A, B, C, D, poles, modes.",
        "works.linearise.linearise:linearise",
        brief=True,
    ),
    "size": Command("Find the cheapest or lightest motors and gears for a motion.", "works.size.size:size"),
    "plan": Command("What a scene needs, what is left out, and operations."),
    "animate": Command("Make a movie of a result, or a strip of stills."),
    "cache": Command("Show how much compiled code is kept, or clear it."),
    "check": Command("Check a result against what its scene expects."),
    "compare": Command("Compare two results, or two directories of results."),
    "crosscheck": Command("Compare a scene with Pinocchio or MuJoCo."),
    "import": Command("Write the robot of a URDF file as YAML."),
    "export": Command("Write a result as CSV, Parquet, MATLAB or NumPy files."),
    "info": Command("Tree, frames, M, C, G and Jacobians at a state."),
    "new": Command("Write a commented scene to begin with."),
    "plot": Command("Draw stored results again, several over one another."),
    "report": Command("Write results as one page for a browser, moving drawings included."),
    "run": Command("Run many scenes, each by its own command; check them."),
    "schema": Command("Print the JSON Schema of scenes, for editors."),
    "sensitivity": Command("Derivatives of figures of a run by numbers of its scene."),
    "stability": Command(
        "Stiffness, step limits, and what each method does.", "over.numerics.stability:stability"
    ),
    "sweep": Command("Many runs with other values of some keys: sweeps and Monte Carlo."),
    "validate": Command("Check scenes and list all that is wrong."),
    "view": Command("Open results in the browser."),
    "work-precision": Command("Error against run time, for every method."),
}

# kinds of files that plots are drawn as
PLOT_FORMATS = ("png", "svg", "pdf")

# ways in which samples of a study are drawn
SAMPLERS = ("random", "sobol", "latin")

# the commands that a scene may name
SCENE_COMMANDS: tuple[str, ...] = tuple(name for name, command in COMMANDS.items() if command.run)
