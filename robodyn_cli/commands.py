"""The commands of the program, a row each: data alone, below all layers that use them.

Who asks something of commands (``validate``, ``plan``, ``sweep``, ``sensitivity``, plots, ...) reads one column. What a
row does not have, the command does not have, and it is refused by name: nothing takes one command for another.
"""

from __future__ import annotations

from robodyn_cli.record import record


@record
class Command:
    """One command. Places are ``module:member`` below ``robodyn_cli``.

    help : one line for ``--help``.
    run : of a command that a scene may name under ``command``: f(scene, progress=, watch=) -> Result.
    check : what ``validate`` tries, beside every ``run``: f(scene) -> names of missing data. It does what the command
    does before its first step, and raises what the command raises there.
    summary : the records of its summary, one after another, as ``module:class`` below ``summaries/``.
    plan : f(scene) -> the ``Subject`` of a plan.
    batch : class of ``many.command.Command``, which makes many runs in compiled code.
    slopes : exact derivatives: f(asked, numbers of keys) -> a ``Slope`` for each of these keys, by output.
    good : status of a run that ended as it should.
    given : sections with what the motion is asked to be, which are no numbers of the equations.
    plots : modules of ``report/plots/`` that draw its result, in the order of pages, where it has the data for them.
    blames : key that an error of geometry is about.
    streamed : the function takes a ``writer`` too, which writes long runs block by block.
    goes_on : it takes ``initial.from``, and goes on after it was killed.
    studied : ``sweep`` and ``sensitivity`` take it.
    """

    help: str
    run: str = ""
    check: str = ""
    summary: tuple[str, ...] = ()
    plan: str = ""
    batch: str = ""
    slopes: str = ""
    good: str = "ok"
    given: tuple[str, ...] = ()
    plots: tuple[str, ...] = ()
    blames: str = "initial"
    streamed: bool = False
    goes_on: bool = False
    studied: bool = True


# drawings of any motion, beside those of its command
MOTION = (
    "multipliers",
    "reactions",
    "constraint_residual",
    "singular_values",
    "mechanism",
)
# drawings of joints, and of torques
JOINTS = ("joint_angles", "joint_rates")
DRIVEN = ("torques", "torque_terms", "drives", "limits")
# drawings of one configuration
STILL = ("branches", "mechanism")

# what the command line calls is the function ``command`` in cli/commands/NAME.py
COMMANDS: dict[str, Command] = {
    "inverse": Command(
        "Torques that a motion needs (inverse dynamics).",
        run="works.inverse:inverse",
        check="over.checks:inverse",
        summary=("inverse:InverseSummary", "drives:DriveKeys"),
        plan="over.plan.inverse:InversePlan",
        batch="over.many.inverse:InverseRuns",
        slopes="over.sensitivity.inverse:slopes",
        given=("trajectory",),
        plots=(*JOINTS, "joint_accelerations", *DRIVEN, "tip_path", "energy", *MOTION),
        blames="trajectory",
    ),
    "simulate": Command(
        "Motion that the torques give (forward dynamics).",
        run="works.simulate:simulate",
        check="over.checks:simulate",
        summary=("motion:MotionSummary", "drives:ControlKeys", "drives:DriveKeys"),
        plan="over.plan.forward:Forward",
        batch="over.many.simulate:Simulate",
        slopes="over.sensitivity.exact:simulate",
        plots=(*JOINTS, "tracking", *DRIVEN, "tip_path", "energy", "energy_drift", *MOTION),
        streamed=True,
        goes_on=True,
    ),
    "deploy": Command(
        "Simulate a mechanism with loops until it locks.",
        run="works.deploy.deploy:deploy",
        check="over.checks:deploy",
        summary=("motion:MotionSummary", "drives:ControlKeys", "deploy:DeploySummary"),
        plan="over.plan.forward:ForwardUntilLock",
        batch="over.many.simulate:Deploy",
        slopes="over.sensitivity.exact:deploy",
        good="locked",
        plots=("joint_angles", "tip_path", *MOTION),
        streamed=True,
    ),
    "kinematics": Command(
        "Motion without forces, mobility, transmission.",
        run="works.kinematics:kinematics",
        check="over.checks:kinematics",
        summary=("mechanism:KinematicsSummary",),
        slopes="over.sensitivity.kinematics:slopes",
        given=("trajectory", "kinematics"),
        plots=(*JOINTS, "tip_path", "point_motion", "transmission_angle", *MOTION),
        blames="trajectory",
    ),
    "assemble": Command(
        "Close the loops, and find the ways in which they close.",
        run="works.assemble:assemble",
        check="over.checks:assemble",
        summary=("mechanism:AssembleSummary",),
        plots=STILL,
        studied=False,
    ),
    "reach": Command(
        "Joint positions that bring a frame to a pose.",
        run="works.reach:reach",
        check="over.checks:reach",
        summary=("mechanism:ReachSummary",),
        plots=STILL,
        blames="reach",
    ),
    "statics": Command(
        "Balance and its stability, or torques that hold a pose.",
        run="works.statics:statics",
        check="over.checks:statics",
        summary=("mechanism:StaticsSummary",),
        slopes="over.sensitivity.statics:slopes",
        plots=STILL,
    ),
    "linearise": Command(
        "Linear model about a state or along a motion: A, B, C, D, poles, modes.",
        run="works.linearise.linearise:linearise",
        check="over.checks:linearise",
        summary=("linear:LinearSummary",),
        plots=("poles", "poles_over_time", "mode_shapes", "frequency_response"),
    ),
    "size": Command(
        "Find the cheapest or lightest motors and gears for a motion.",
        run="works.size.size:size",
        check="over.checks:size",
        summary=("inverse:InverseSummary", "drives:DriveKeys", "size:SizeSummary"),
        plots=("size_front", "drives"),
        blames="trajectory",
    ),
    "plan": Command("What a scene needs, what is left out, and operations.", summary=("checks:PlanReport",)),
    "animate": Command("Make a movie of a result, or a strip of stills.", summary=("checks:MovieReport",)),
    "cache": Command("Show how much compiled code is kept, or clear it.", summary=("checks:CacheReport",)),
    "check": Command("Check a result against what its scene expects.", summary=("checks:CheckReport",)),
    "compare": Command(
        "Compare two results, or two directories of results.",
        summary=("checks:ComparisonReport", "checks:TreeReport"),
    ),
    "crosscheck": Command("Compare a scene with Pinocchio or MuJoCo.", summary=("checks:CrosscheckReport",)),
    "import": Command("Write the robot of a URDF file as YAML."),
    "export": Command("Write a result as CSV, Parquet, MATLAB or NumPy files."),
    "info": Command(
        "Tree, frames, M, C, G and Jacobians at a state.", summary=("mechanism:InfoReport",), plots=("state",)
    ),
    "new": Command("Write a commented scene to begin with."),
    "plot": Command("Draw stored results again, several over one another."),
    "report": Command(
        "Write results as one page for a browser, moving drawings included.", summary=("checks:PageReport",)
    ),
    "run": Command("Run many scenes, each by its own command; check them.", summary=("checks:BatchReport",)),
    "schema": Command("Print the JSON Schema of scenes, for editors."),
    "sensitivity": Command(
        "Derivatives of figures of a run by numbers of its scene.",
        summary=("study:SensitivitySummary",),
        plots=("sensitivity_tornado",),
    ),
    "stability": Command(
        "Stiffness, step limits, and what each method does.",
        run="over.numerics.stability:stability",
        check="over.checks:stability",
        summary=("stability:SuiteSummary", "stability:StabilitySummary"),
        plots=("stability_spectrum", "stability_methods", "energy_growth", "baumgarte", "stability_suite"),
        studied=False,
    ),
    "sweep": Command(
        "Many runs with other values of some keys: sweeps and Monte Carlo.",
        summary=("study:StudySummary",),
        plots=("study_response", "study_map", "study_histograms", "study_influence"),
    ),
    "validate": Command("Check scenes and list all that is wrong.", summary=("checks:ValidationReport",)),
    "view": Command("Open results in the browser."),
    "work-precision": Command(
        "Error against run time, for every method.",
        summary=("stability:WorkPrecisionSummary",),
        plots=("work_precision",),
    ),
}

# kinds of files that plots are drawn as
PLOT_FORMATS = ("png", "svg", "pdf")

# ways in which samples of a study are drawn
SAMPLERS = ("random", "sobol", "latin")

# the commands that a scene may name
SCENE_COMMANDS: tuple[str, ...] = tuple(name for name, command in COMMANDS.items() if command.run)
# those of them that ``sweep`` and ``sensitivity`` take
STUDIED: tuple[str, ...] = tuple(name for name in SCENE_COMMANDS if COMMANDS[name].studied)


def places(column: str) -> dict[str, str]:
    """Return the places of one column by command, of the commands that have one."""
    return {name: place for name, row in COMMANDS.items() if (place := getattr(row, column))}
