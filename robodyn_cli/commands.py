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
    summary : the records of its summary, one after another, as ``module:class`` below ``summaries/``.
    """

    help: str
    run: str = ""
    streamed: bool = False
    brief: bool = False
    summary: tuple[str, ...] = ()


# what the command line calls is the function ``command`` in cli/commands/NAME.py
COMMANDS: dict[str, Command] = {
    "inverse": Command(
        "Torques that a motion needs (inverse dynamics).",
        "works.inverse:inverse",
        summary=("inverse:InverseSummary", "drives:DriveKeys"),
    ),
    "simulate": Command(
        "Motion that the torques give (forward dynamics).",
        "works.simulate:simulate",
        streamed=True,
        summary=("motion:MotionSummary", "drives:ControlKeys", "drives:DriveKeys"),
    ),
    "deploy": Command(
        "Simulate a mechanism with loops until it locks.",
        "works.deploy.deploy:deploy",
        streamed=True,
        summary=("motion:MotionSummary", "drives:ControlKeys", "deploy:DeploySummary"),
    ),
    "kinematics": Command(
        "Motion without forces, mobility, transmission.",
        "works.kinematics:kinematics",
        brief=True,
        summary=("mechanism:KinematicsSummary",),
    ),
    "assemble": Command(
        "Close the loops, and find the ways in which they close.",
        "works.assemble:assemble",
        brief=True,
        summary=("mechanism:AssembleSummary",),
    ),
    "reach": Command(
        "Joint positions that bring a frame to a pose.",
        "works.reach:reach",
        brief=True,
        summary=("mechanism:ReachSummary",),
    ),
    "statics": Command(
        "Balance and its stability, or torques that hold a pose.",
        "works.statics:statics",
        brief=True,
        summary=("mechanism:StaticsSummary",),
    ),
    "linearise": Command(
        "Linear model about a state or along a motion: A, B, C, D, poles, modes.",
        "works.linearise.linearise:linearise",
        brief=True,
        summary=("linear:LinearSummary",),
    ),
    "size": Command(
        "Find the cheapest or lightest motors and gears for a motion.",
        "works.size.size:size",
        summary=("inverse:InverseSummary", "drives:DriveKeys", "size:SizeSummary"),
    ),
    "plan": Command("What a scene needs, what is left out, and operations.", summary=("checks:PlanReport",)),
    "animate": Command("Make a movie of a result, or a strip of stills."),
    "cache": Command("Show how much compiled code is kept, or clear it."),
    "check": Command("Check a result against what its scene expects.", summary=("checks:CheckReport",)),
    "compare": Command(
        "Compare two results, or two directories of results.",
        summary=("checks:ComparisonReport", "checks:TreeReport"),
    ),
    "crosscheck": Command("Compare a scene with Pinocchio or MuJoCo.", summary=("checks:CrosscheckReport",)),
    "import": Command("Write the robot of a URDF file as YAML."),
    "export": Command("Write a result as CSV, Parquet, MATLAB or NumPy files."),
    "info": Command("Tree, frames, M, C, G and Jacobians at a state."),
    "new": Command("Write a commented scene to begin with."),
    "plot": Command("Draw stored results again, several over one another."),
    "report": Command("Write results as one page for a browser, moving drawings included."),
    "run": Command("Run many scenes, each by its own command; check them.", summary=("checks:BatchReport",)),
    "schema": Command("Print the JSON Schema of scenes, for editors."),
    "sensitivity": Command(
        "Derivatives of figures of a run by numbers of its scene.", summary=("study:SensitivitySummary",)
    ),
    "stability": Command(
        "Stiffness, step limits, and what each method does.",
        "over.numerics.stability:stability",
        summary=("stability:SuiteSummary", "stability:StabilitySummary"),
    ),
    "sweep": Command(
        "Many runs with other values of some keys: sweeps and Monte Carlo.", summary=("study:StudySummary",)
    ),
    "validate": Command("Check scenes and list all that is wrong.", summary=("checks:ValidationReport",)),
    "view": Command("Open results in the browser."),
    "work-precision": Command(
        "Error against run time, for every method.", summary=("stability:WorkPrecisionSummary",)
    ),
}

# kinds of files that plots are drawn as
PLOT_FORMATS = ("png", "svg", "pdf")

# ways in which samples of a study are drawn
SAMPLERS = ("random", "sobol", "latin")

# the commands that a scene may name
SCENE_COMMANDS: tuple[str, ...] = tuple(name for name, command in COMMANDS.items() if command.run)
