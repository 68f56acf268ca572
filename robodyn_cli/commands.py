"""The commands of the program, a row each: data alone, below all layers that use them.

Who asks something of commands (``validate``, ``plan``, ``sweep``, ``sensitivity``, plots, ...) reads one column. What a
row does not have, the command does not have, and it is refused by name: nothing takes one command for another.
"""

from __future__ import annotations

import keyword

from robodyn_cli.record import record


@record
class Command:
    """One command. Places are ``module:member`` below ``robodyn_cli``.

    help : one line for ``--help``. job : the heading that it stands under there.
    run : of a command that a scene may name under ``command``: f(scene, progress=, watch=) -> Result.
    check : what ``validate`` tries, beside every ``run``: f(scene) -> names of missing data. It does what the command
    does before its first step, and raises what the command raises there.
    summary : the records of its summary, one after another, as ``module:class`` below ``summaries/``.
    headlines : keys of its summary by which results are told first, on the terminal, on pages, in comparisons, in docs,
    with kinds of names in capitals. Words, unit and error of each are those of its declaration in ``summaries/``.
    plan : f(scene) -> the ``Subject`` of a plan.
    batch : class of ``many.command.Command``, which makes many runs in compiled code.
    slopes : exact derivatives: f(asked, numbers of keys) -> a ``Slope`` for each of these keys, by output; or the class
    of them, ``Direct``, of a command that integrates nothing.
    together : class of exact derivatives in many runs at once, called with a structure of ``batch``, rows of values and
    outputs.
    good : status of a run that ended as it should.
    given : sections with what the motion is asked to be, which are no numbers of the equations.
    plots : those of its result, below ``report/plots/``, in the order of pages. plots_asked : further ones, which are
    drawn where they are asked for by name.
    blames : key that an error of geometry is about.
    samples : key of the scene that says how many samples over time it takes.
    streamed : the function takes a ``writer`` too, which writes long runs block by block.
    goes_on : it goes on after it was killed. takes_up : it takes ``initial.from``, and gives what others take.
    studied : ``sweep`` and ``sensitivity`` take it.
    """

    help: str
    job: str
    run: str = ""
    check: str = ""
    summary: tuple[str, ...] = ()
    headlines: tuple[str, ...] = ()
    plan: str = ""
    batch: str = ""
    slopes: str = ""
    together: str = ""
    good: str = "ok"
    given: tuple[str, ...] = ()
    plots: tuple[str, ...] = ()
    plots_asked: tuple[str, ...] = ()
    blames: str = "initial"
    samples: str = ""
    streamed: bool = False
    goes_on: bool = False
    takes_up: bool = False
    studied: bool = True


# headings of the list of commands, in its order
MOTIONS = "Motions and forces"
DESIGNS = "Poses, models, drives"
SCENES = "Scenes and robots"
STUDIES = "Many runs"
RESULTS = "Results"
TRUST = "Methods, other engines, upkeep"
JOBS = (MOTIONS, DESIGNS, SCENES, STUDIES, RESULTS, TRUST)

# drawings of any motion, beside those of its command
MOTION = (
    "constraints:multipliers",
    "constraints:reactions",
    "constraints:constraint_residual",
    "constraints:singular_values",
    "mechanism:mechanism",
)
# drawings of named points
POINTS = ("mechanism:tip_path", "joints:point_coordinates")
# drawings of joints, and of torques
JOINTS = ("joints:joint_angles", "joints:joint_rates")
MARGINS = ("drives:motorisation",)
DRIVEN = ("torques:torques", "torques:torque_terms", "drives:drives", "torques:limits", *MARGINS)
DESIGN = tuple(
    f"design:{name}"
    for name in ("four_bars", "centrodes", "pole_paths", "curvature", "velocity_ratios", "pressure_angle")
)
# figures of columns that a run is asked for, of what a controller leads, and of what drives bear
ENDS = ("smallest", "smallest_time", "largest", "largest_time", "final")
EXTREMES = tuple(f"extremes.COLUMN.{key}" for key in ENDS)
RESPONSE = ("step", "rise", "overshoot", "settling", "final_error", "effort", "energy")
TRACKING = tuple(f"control.tracking.TRACKED.{key}" for key in ("peak", "at", "rms"))
LED = (*TRACKING, *(f"response.TRACKED.{key}" for key in RESPONSE))
SIZES = tuple(f"joints.JOINT.{key}" for key in ("peak_torque", "peak_torque_time", "rms_torque"))
# drawings of one configuration
STILL = ("mechanism:branches", "mechanism:mechanism")

# what the command line calls is the function ``command`` in cli/commands/NAME.py
COMMANDS: dict[str, Command] = {
    "inverse": Command(
        "Torques that a motion needs (inverse dynamics).",
        MOTIONS,
        run="works.inverse:inverse",
        check="over.checks:inverse",
        summary=(
            "inverse:InverseSummary",
            "drives:DriveKeys",
            "drives:MotorisationKeys",
            "design:BalanceKeys",
        ),
        headlines=("fastest.duration", *SIZES),
        plan="over.plan.subjects:InversePlan",
        batch="over.many.inverse:InverseRuns",
        slopes="over.sensitivity.along_motions:InverseSlopes",
        given=("trajectory",),
        plots=(
            *JOINTS,
            "joints:joint_accelerations",
            *DRIVEN,
            "design:shaking",
            "design:shaking_polar",
            "design:flywheel",
            *POINTS,
            "energy:energy",
            *MOTION,
        ),
        blames="trajectory",
        samples="inverse.samples",
    ),
    "simulate": Command(
        "Motion that the torques give (forward dynamics).",
        MOTIONS,
        run="works.simulate:simulate",
        check="over.checks:simulate",
        summary=(
            "motion:MotionSummary",
            "control:ControlKeys",
            "response:ResponseKeys",
            "drives:DriveKeys",
            "drives:MotorisationKeys",
            "extremes:RunExtremes",
        ),
        headlines=("final.q.JOINT", "final.qd.JOINT", *LED, *EXTREMES),
        plan="over.plan.subjects:Forward",
        batch="over.many.simulate:Simulate",
        slopes="over.sensitivity.report:simulate",
        plots=(
            *JOINTS,
            "joints:tracking",
            "design:fluctuation",
            *DRIVEN,
            *POINTS,
            "energy:energy",
            "energy:energy_drift",
            *MOTION,
        ),
        streamed=True,
        goes_on=True,
        takes_up=True,
        samples="simulate.samples",
    ),
    "deploy": Command(
        "Simulate a mechanism until it locks, by one latch or several.",
        MOTIONS,
        run="works.deploy.deploy:deploy",
        check="over.checks:deploy",
        summary=(
            "motion:MotionSummary",
            "control:ControlKeys",
            "response:ResponseKeys",
            "deploy:DeploySummary",
            "extremes:RunExtremes",
            "drives:DriveKeys",
            "drives:MotorisationKeys",
        ),
        headlines=("lock.time", "lock.latch.energy_lost", "lock.latch.angular_impulse", *LED, *EXTREMES),
        plan="over.plan.subjects:ForwardUntilLock",
        batch="over.many.simulate:Deploy",
        slopes="over.sensitivity.report:deploy",
        good="locked",
        plots=("joints:joint_angles", "design:fluctuation", "drives:drives", *MARGINS, *POINTS, *MOTION),
        plots_asked=("joints:joint_rates", "energy:energy", "energy:energy_drift"),
        streamed=True,
        takes_up=True,
        samples="simulate.samples",
    ),
    "kinematics": Command(
        "Motion without forces, mobility, transmission.",
        MOTIONS,
        run="works.kinematics:kinematics",
        check="over.checks:kinematics",
        summary=("mechanism:KinematicsSummary", "drives:MotorisationKeys", "design:DesignKeys"),
        headlines=(
            "joints.JOINT.smallest",
            "joints.JOINT.largest",
            "joints.JOINT.peak_speed",
            "points.POINT.path_length",
            "points.POINT.peak_speed",
            "singular_ratio.smallest",
            *(f"transmission_angle.{end}_deg" for end in ("smallest", "largest")),
            *EXTREMES,
        ),
        batch="over.many.kinematics:KinematicsRuns",
        slopes="over.sensitivity.of_kinematics:KinematicsSlopes",
        together="over.sensitivity.of_kinematics:PlacesTogether",
        given=("trajectory", "kinematics"),
        plots=(
            *JOINTS,
            *MARGINS,
            *POINTS,
            "joints:point_motion",
            "joints:transmission_angle",
            *DESIGN,
            *MOTION,
        ),
        blames="trajectory",
        samples="kinematics.samples",
    ),
    "assemble": Command(
        "Close the loops, and find the ways in which they close.",
        DESIGNS,
        run="works.assemble:assemble",
        check="over.checks:assemble",
        summary=("assemble:AssembleSummary",),
        headlines=("configuration.JOINT",),
        plots=STILL,
    ),
    "reach": Command(
        "Joint positions that bring a frame to a pose.",
        DESIGNS,
        run="works.reach:reach",
        check="over.checks:reach",
        summary=("mechanism:ReachSummary",),
        headlines=("configuration.JOINT",),
        plots=STILL,
        blames="reach",
    ),
    "statics": Command(
        "Balance and its stability, or torques that hold a pose.",
        MOTIONS,
        run="works.statics:statics",
        check="over.checks:statics",
        summary=("mechanism:StaticsSummary",),
        headlines=("configuration.JOINT", "torques_of_joints.JOINT"),
        batch="over.many.rest.statics:StaticsRuns",
        slopes="over.sensitivity.statics:StaticsSlopes",
        plots=STILL,
    ),
    "linearise": Command(
        "Linear model about a state or along a motion: A, B, C, D, poles, modes.",
        DESIGNS,
        run="works.linearise.linearise:linearise",
        check="over.checks:linearise",
        summary=("linear:LinearSummary", "linear:LoopKeys"),
        plots=(
            "linear:poles",
            "linear:poles_over_time",
            "mechanism:mode_shapes",
            "linear:frequency_response",
            "loops:nyquist",
            "loops:nichols",
            "loops:singular_loop",
        ),
    ),
    "size": Command(
        "Find the cheapest or lightest motors and gears for a motion.",
        DESIGNS,
        run="works.size.size:size",
        check="over.checks:size",
        summary=(
            "inverse:InverseSummary",
            "drives:DriveKeys",
            "drives:MotorisationKeys",
            "inverse:SizeSummary",
        ),
        headlines=("size.cost", "size.mass"),
        plots=("drives:size_front", "drives:drives"),
        blames="trajectory",
        samples="inverse.samples",
    ),
    "plan": Command(
        "What a scene needs, what is left out, and operations.", SCENES, summary=("checks:PlanReport",)
    ),
    "animate": Command(
        "Make a movie of a result, or a strip of stills.", RESULTS, summary=("checks:MovieReport",)
    ),
    "cache": Command(
        "Show how much compiled code is kept, or clear it.", TRUST, summary=("checks:CacheReport",)
    ),
    "check": Command(
        "Check a result against what its scene expects.", RESULTS, summary=("checks:CheckReport",)
    ),
    "compare": Command(
        "Compare two results, two directories of results, or the figures of several.",
        RESULTS,
        summary=("checks:ComparisonReport", "checks:TreeReport", "checks:VariantsReport"),
    ),
    "crosscheck": Command(
        "Compare a scene with Pinocchio, MuJoCo or Drake.",
        TRUST,
        summary=("crosscheck:CrosscheckReport", "crosscheck:OwnSettingsSummary"),
        plots=("crosscheck:own_settings",),
    ),
    "equations": Command(
        "Equations of motion with the scene's names: text, LaTeX or SymPy.",
        SCENES,
        summary=("equations:EquationsReport",),
    ),
    "import": Command("Write the robot of a URDF, SDF or MJCF file as YAML.", SCENES),
    "export": Command(
        "Write a result as CSV, Parquet, MATLAB, NumPy files, or a robot as URDF, MJCF, SDF.", RESULTS
    ),
    "info": Command(
        "Tree, frames, M, C, G and Jacobians at a state.",
        SCENES,
        summary=("mechanism:InfoReport",),
        plots=("mechanism:state",),
    ),
    "new": Command("Write a commented scene to begin with.", SCENES),
    "plot": Command("Draw stored results again, several over one another.", RESULTS),
    "optimise": Command(
        "Search for values of keys: the least or largest output, or outputs at targets.",
        STUDIES,
        summary=("search:SearchSummary",),
        plots=("search:search_path", "search:search_keys"),
    ),
    "report": Command(
        "Write results as one page for a browser, moving drawings included.",
        RESULTS,
        summary=("checks:PageReport",),
    ),
    "run": Command(
        "Run many scenes, each by its own command; check them.", STUDIES, summary=("checks:BatchReport",)
    ),
    "schema": Command("Print the JSON Schema of scenes, for editors.", SCENES),
    "sensitivity": Command(
        "Derivatives of figures of a run by numbers of its scene.",
        STUDIES,
        summary=("study:SensitivitySummary",),
        plots=("study:sensitivity_tornado",),
    ),
    "stability": Command(
        "Stiffness, step limits, and what each method does.",
        TRUST,
        run="over.stability.stability:stability",
        check="over.checks:stability",
        summary=("stability:SuiteSummary", "stability:StabilitySummary"),
        plots=(
            "stability:stability_spectrum",
            "stability:stability_methods",
            "stability:energy_growth",
            "stability:baumgarte",
            "methods:stability_suite",
        ),
        studied=False,
    ),
    "sweep": Command(
        "Many runs with other values of some keys: sweeps and Monte Carlo.",
        STUDIES,
        summary=("study:StudySummary",),
        plots=("study:study_response", "study:study_map", "study:study_histograms", "study:study_influence"),
    ),
    "validate": Command(
        "Check scenes and list all that is wrong.", SCENES, summary=("checks:ValidationReport",)
    ),
    "view": Command("Open results in the browser.", RESULTS),
    "work-precision": Command(
        "Error against run time, for every method.",
        TRUST,
        summary=("stability:WorkPrecisionSummary",),
        plots=("methods:work_precision",),
    ),
}

# kinds of files that plots are drawn as
PLOT_FORMATS = ("png", "svg", "pdf")
PLOT_STYLES = ("screen", "paper", "slides")

# ways in which samples of a study are drawn
SAMPLERS = ("random", "sobol", "latin")

# the commands that a scene may name
SCENE_COMMANDS: tuple[str, ...] = tuple(name for name, command in COMMANDS.items() if command.run)
# those of them that ``sweep`` and ``sensitivity`` take
STUDIED: tuple[str, ...] = tuple(name for name in SCENE_COMMANDS if COMMANDS[name].studied)


def places(column: str) -> dict[str, str]:
    """Return the places of one column by command, of the commands that have one."""
    return {name: place for name, row in COMMANDS.items() if (place := getattr(row, column))}


def python_name(word: str) -> str:
    """Return a word of the command line as a name in Python: ``own_settings`` of ``own-settings``, ``with_`` of
    ``with``."""
    name = word.replace("-", "_")
    return f"{name}_" if keyword.iskeyword(name) else name
