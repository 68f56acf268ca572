"""Every path that a result file may hold, with its dimensions, units and meaning.

The writer takes them from here, and the tables of ``docs/hdf5.md`` are made of it. A word in capitals is a placeholder
for a name from the scene. Where the error of a dataset stands is told by ``stated_errors``.
"""

from __future__ import annotations

from robodyn_cli.record import record
from robodyn_cli.results.entries import CONTROL, FEED_FORWARD, LINEAR, Entry

XYZ = ("x", "y", "z")
WRENCH = {f"{letter}{axis}": unit for letter, unit in (("f", "N"), ("m", "N m")) for axis in XYZ}
TWIST = {f"{letter}{axis}": unit for letter, unit in (("w", "rad/s"), ("v", "m/s")) for axis in XYZ}
CANDIDATE = {"motor": "1", "gear": "1", "cost": "1", "mass": "kg", "margin": "1"}
CORNER = {"speed": "rad/s", "torque": "N m"}
TRIAL = {
    "error": "rad or m", "relative": "1", "estimate": "rad or m", "steps": "1", "evaluations": "1", "seconds": "s",
    "until": "s",
}  # fmt: skip
TIMED = {
    "tolerance": "1", "step": "s", "error": "rad or m", "run_time_s": "s", "compile_time_s": "s", "evaluations": "1",
    "steps": "1", "lock_time": "s",
}  # fmt: skip

# limits of joints under ``joint_limits/`` by the dataset that they bound, with the signs of the sides on which they do
JOINT_LIMITS: dict[str, dict[str, tuple[float, ...]]] = {
    "q": {"lower": (1.0,), "upper": (1.0,)},
    "qd": {"speed": (1.0, -1.0), "least_speed": (1.0,), "largest_speed": (1.0,)},
    "qdd": {"acceleration": (1.0, -1.0), "least_acceleration": (1.0,), "largest_acceleration": (1.0,)},
    "tau": {"effort": (1.0, -1.0), "least_effort": (1.0,), "largest_effort": (1.0,)},
}


RUN: tuple[Entry, ...] = (
    Entry("time", ("time",), "s", "time"),
    Entry("q", ("time", "joint"), "rad or m", "joint position"),
    Entry("qd", ("time", "joint"), "rad/s or m/s", "joint velocity"),
    Entry("qdd", ("time", "joint"), "rad/s^2 or m/s^2", "joint acceleration"),
    Entry("tau", ("time", "joint"), "N m or N", "actuator torque or force"),
    Entry(
        "joint_limits/LIMIT", ("LIMIT_limit",), "of what it limits",
        "limits (`lower`, `upper`, `speed`, `acceleration`, `effort`; `least_effort`, `largest_effort` and so"
        " on where the directions differ) of the joints that have one",
    ),
    Entry("torque_terms/TERM", ("time", "joint"), "N m or N", "part of the actuator torque"),
    Entry("constraints/multipliers", ("time", "constraint"), "N or N m", "Lagrange multipliers of the loop closures"),
    Entry(
        "constraints/position_residual", ("time", "constraint"), "m or rad",
        "residual of the loop closures, position",
    ),
    Entry(
        "constraints/velocity_residual", ("time", "constraint"), "m/s or rad/s",
        "residual of the loop closures, velocity",
    ),
    Entry(
        "reactions/JOINT", ("time", "wrench"), "N, N m",
        "force and moment of the parent on the link in a joint", by_column=WRENCH,
    ),
    Entry(
        "loop_reactions/LOOP", ("time", "wrench"), "N, N m",
        "force and moment of a closure on its first link", by_column=WRENCH,
    ),
    Entry("force_wrenches/FORCE", ("time", "wrench"), "N, N m", "of a force on its last place", (), WRENCH),
    Entry(
        "latch_loads", ("time", "latch"), "N m or N",
        "what each of several latches exerts on its joint, or about its closure's axis on the second link",
    ),
    Entry(
        "base_wrench", ("time", "wrench"), "N, N m",
        "force and moment of the ground on the mechanism", by_column=WRENCH,
    ),
    Entry("energy/kinetic", ("time",), "J", "kinetic energy"),
    Entry("energy/potential", ("time",), "J", "potential energy"),
    Entry("energy/total", ("time",), "J", "kinetic and potential energy"),
    Entry("energy/work", ("time",), "J", "work done on the system by non-conservative forces since the start"),
    *CONTROL,
    *FEED_FORWARD,
    Entry("signals/NAME", ("time",), "1", "signal of `outputs.signals`, in the unit that the scene states"),
    Entry("forces/potential", ("time", "force"), "J", "potential energy of each entry of `forces`"),
    Entry("forces/power", ("time", "force"), "W", "power of each entry of `forces` beside its potential energy"),
    Entry("points/NAME", ("time", "axis"), "m", "position of a point in the world frame", XYZ),
    Entry("flights/PAYLOAD/time", ("PAYLOAD_flight",), "s", "times of a flight, from the release on"),
    Entry("flights/PAYLOAD/position", ("PAYLOAD_flight", "axis"), "m", "its place in the world frame", XYZ),
    Entry("flights/PAYLOAD/velocity", ("PAYLOAD_flight", "axis"), "m/s", "velocity of that place", XYZ),
    Entry(
        "flights/PAYLOAD/quaternion", ("PAYLOAD_flight", "quaternion"), "1",
        "unit quaternion from the axes of its data to the world frame, scalar first", ("w", "x", "y", "z"),
    ),
    Entry(
        "flights/PAYLOAD/angular_velocity", ("PAYLOAD_flight", "axis"), "rad/s",
        "its angular velocity in the world frame", XYZ,
    ),
    Entry(
        "pieces", ("piece", "coefficient"), "s, rad or m, and per s^N",
        "a motion in the least time as a table of pieces: begin, and coefficients of each joint by powers of "
        "the time since then",
    ),
    Entry("limits/use", ("time", "limit"), "1", "part of each limit that a motion in the least time uses"),
    Entry("limits/binding", ("time",), "1", "column of limits/use that binds, -1 where none does"),
    Entry("drives/load", ("time", "drive"), "N m or N", "torque or force of the gears on the mechanism"),
    Entry("drives/speed", ("time", "drive"), "rad/s", "speed of each motor of the joint's drive"),
    Entry("drives/torque", ("time", "drive"), "N m", "torque at the shaft of each motor, its rotor's included"),
    Entry("drives/use", ("time", "drive"), "1", "part of the motor's envelope that is used"),
    Entry("drives/current", ("time", "electric_drive"), "A", "current of each motor"),
    Entry("drives/winding_temperature", ("time", "warm_drive"), "degC", "windings, steady periodic state"),
    *(
        Entry(f"motorisation/{kind}_{side}", ("time", "motorised"), "N m or N", f"{meaning}, {kind}")
        for kind in ("static", "dynamic")
        for side, meaning in (("available", "torque less what stands outside"), ("resistance", "factored"))
    ),
    Entry(
        "candidates/JOINT", ("combination", "quantity"), "1 or kg",
        "combinations of motors and gears: their numbers, cost, mass, margin of the limit that decides",
        tuple(CANDIDATE), CANDIDATE,
    ),
    *(
        Entry(
            f"envelopes/{kind}/JOINT",
            ("vertex", "quantity"),
            "rad/s, N m",
            f"corners of the motor's envelope: {meaning}",
            tuple(CORNER),
            CORNER,
        )
        for kind, meaning in (
            ("driving", "while it drives"),
            ("braking", "while it brakes"),
            ("continuous", "what it bears for ever"),
        )
    ),
    Entry("targets/NAME", ("time", "axis"), "m", "position asked of a point in the world frame", XYZ),
    Entry(
        "point_velocities/NAME", ("time", "axis"), "m/s",
        "velocity of a point in the world frame (`kinematics`, `simulate`, `deploy`)", XYZ,
    ),
    Entry(
        "point_accelerations/NAME", ("time", "axis"), "m/s^2",
        "acceleration of a point in the world frame (`kinematics`, `simulate`, `deploy`)", XYZ,
    ),
    Entry("transmission_angle", ("time",), "rad", "angle at the second of three points of the transmission"),
    Entry("poles/PAIR", ("time", "axis"), "m", "pole of two links in the world, nan at infinity", XYZ, has_gaps=True),
    Entry("centrodes/fixed/PAIR", ("time", "axis"), "m", "pole in the axes of the second link", XYZ, has_gaps=True),
    Entry("centrodes/moving/PAIR", ("time", "axis"), "m", "pole in the axes of the first link", XYZ, has_gaps=True),
    Entry(
        "acceleration_poles/PAIR", ("time", "axis"), "m",
        "point of the first link that the second sees without acceleration, in the world", XYZ, has_gaps=True,
    ),
    Entry("relative_rates/PAIR", ("time",), "rad/s", "rate at which the first of two links turns against the second"),
    Entry("curvatures/NAME", ("time",), "1/m", "curvature of the path of a point, nan at rest", has_gaps=True),
    Entry("ratios/PAIR", ("time",), "1", "rate over rate, nan where the second passes zero", has_gaps=True),
    Entry(
        "pressure_angles/PAIR", ("time",), "rad",
        "angle from a force along AB to the way of B, continued beyond a right angle",
    ),
    Entry(
        "four_bars/LOOP", ("dead_point", "corner", "axis"), "m",
        "pins of a chain of four links in the world, first in the first pose, then in dead points of its "
        "driver", XYZ,
    ),
    Entry(
        "shaking", ("time", "wrench"), "N, N m",
        "force and moment that the inertia of the links exerts on the base", by_column=WRENCH,
    ),
    Entry("flywheel/torque", ("time",), "N m", "torque that keeps the rate of the flywheel's joint constant"),
    Entry("flywheel/energy", ("time",), "J", "what the flywheel gives: work of the torque less that of its mean"),
    Entry("frames/NAME/position", ("time", "axis"), "m", "origin of a frame in the world frame", XYZ),
    Entry(
        "frames/NAME/quaternion", ("time", "quaternion"), "1",
        "unit quaternion from the frame to the world frame, scalar first", ("w", "x", "y", "z"),
    ),
    Entry(
        "frames/NAME/twist", ("time", "twist"), "rad/s, m/s",
        "angular velocity, then velocity of the origin, in the world frame", tuple(TWIST), TWIST,
    ),
    Entry("singularity/psi", ("time", "singular_value"), "1", "singular values of the constraint Jacobian Psi"),
    Entry(
        "singularity/passive", ("time", "passive_singular_value"), "1",
        "singular values of the block of Psi that belongs to the passive coordinates",
    ),
    Entry("singularity/determinant", ("time",), "1", "determinant of the passive block of Psi"),
    Entry(
        "branches/q", ("branch", "joint"), "rad or m",
        "joint positions of the ways in which the loops close, or which reach the pose",
    ),
    Entry("branches/determinant", ("branch",), "1", "determinant of the block of Psi of the coordinates solved for"),
    Entry("branch_skeleton/LINK", ("branch", "vertex", "axis"), "m", "corners of a link's outline, by branch", XYZ),
    Entry("skeleton/LINK", ("time", "vertex", "axis"), "m", "corners of a link's outline in the world frame", XYZ),
)  # fmt: skip

EVENT_ENTRIES: tuple[Entry, ...] = (
    Entry("events/time", ("event",), "s", "time of the event"),
    Entry("events/name", ("event",), "1", "name of the event"),
    Entry("events/kind", ("event",), "1", "kind of the event"),
    Entry("events/details", ("event",), "1", "further facts about the event, JSON"),
)


@record
class Attribute:
    """One root attribute; ``kind`` is ``text``, ``integer`` or ``JSON`` (stored as text)."""

    name: str
    kind: str
    meaning: str


ATTRIBUTES: tuple[Attribute, ...] = (
    Attribute("filetype", "text", "always `robodyn.result`"),
    Attribute("format_version", "integer", "version of this format, 1"),
    Attribute("robodyn_version", "text", "version of robodyn that wrote the file"),
    Attribute(
        "robodyn_code_sha256", "text", "SHA-256 of the installed files of robodyn: its code at that version"
    ),
    Attribute("command", "text", "command that was run: `inverse`, `simulate`, `deploy`, ..."),
    Attribute("title", "text", "title of the scene"),
    Attribute("status", "text", "`ok`, `locked`, `no_lock`, `overload`, `undersized`, `missed` or `failed`"),
    Attribute("scene", "text", "the scene as it was run: includes and `--set` resolved"),
    Attribute("scene_sha256", "text", "SHA-256 of `scene`, hexadecimal"),
    Attribute("versions", "JSON", "versions of Python, the libraries in use and the operating system"),
    Attribute("cpu", "text", "name of the processor"),
    Attribute("seed", "integer", "seed of the random numbers; -1 where none were drawn"),
    Attribute("integrator", "text", "integrator that was used; `none` where nothing was integrated"),
    Attribute("termination", "JSON", "why and when the run ended: `reason`, `time`, ..."),
    Attribute("counters", "JSON", "steps, evaluations and so on"),
    Attribute("wall_time_s", "JSON", "wall time by stage, in seconds"),
    Attribute("run_id", "text", "the run that wrote the file; `summary.json` beside it has the same"),
    Attribute(
        "summary",
        "JSON",
        "the content of `summary.json` without `scene_file`, `run_id`, `baseline` and the list of outputs",
    ),
)

# what commands write beside the datasets of motions, by command
NUMERICS = (
    Entry(
        "work_precision/runs", ("run", "quantity"), "1, s, rad or m", "runs in the order of `summary.runs`",
        by_column=TIMED,
    ),
    Entry("crosscheck/q", ("time", "position"), "rad or m", "positions in the other engine"),
    Entry("crosscheck/qd", ("time", "joint"), "rad/s or m/s", "its velocities"),
    Entry(
        "crosscheck/qdd", ("time", "joint"), "rad/s^2 or m/s^2", "accelerations that it has at the begin of a step"
    ),
    Entry(
        "crosscheck/exact_qdd", ("time", "joint"), "rad/s^2 or m/s^2", "exact accelerations at its states"
    ),
    Entry(
        "crosscheck/acceleration_error", ("time",), "1",
        "largest difference of the two, over the largest acceleration of the motion here",
    ),
    Entry("crosscheck/gap", ("time", "closure"), "m or rad", "how far it opens each closure"),
    Entry("crosscheck/gap_here", ("time", "closure"), "m or rad", "how far the motion here does"),
    Entry(
        "crosscheck/energy_made", ("time",), "J", "energy that it makes, less the work of torques and dampers"
    ),
    Entry(
        "crosscheck/energy_error", ("time",), "1",
        "its magnitude over the largest kinetic energy of the motion here",
    ),
    Entry("crosscheck/offset", ("time", "joint"), "rad or m", "its positions less those of the motion here"),
    Entry("stability/time", ("instant",), "s", "instants of the spectrum"),
    *(
        Entry(
            f"stability/eigenvalues_{part}", ("instant", "eigenvalue"), "1/s",
            f"{part} parts of the eigenvalues of the linearised equations of motion",
        )
        for part in ("real", "imaginary")
    ),
    Entry("stability/stiffness_ratio", ("instant",), "1", "fastest decay over the slowest rate of the run"),
    Entry("stability/step_limit", ("instant", "method"), "s", "largest stable step"),
    Entry(
        "stability/methods", ("trial", "quantity"), "1, s, rad or m",
        "what each method did, in the order of `summary.methods`", tuple(TRIAL), TRIAL,
    ),
    Entry("energy_growth/METHOD/periods", ("METHOD_sample",), "1", "time in periods"),
    Entry(
        "energy_growth/METHOD/error", ("METHOD_sample",), "1",
        "error of the energy balance over the energy exchanged",
    ),
    Entry("baumgarte/RUN/gain", ("alpha",), "1/s", "values of alpha and of beta; `RUN` is `own` or `fixed`"),
    Entry(
        "baumgarte/RUN/drift", ("alpha", "beta"), "rad or m",
        "largest distance of the positions from the constraints",
    ),
    Entry("baumgarte/RUN/error", ("alpha", "beta"), "rad or m", "largest error of any q"),
    Entry("baumgarte/RUN/steps", ("alpha", "beta"), "1", "steps taken"),
    Entry(
        "suite/relative_error", ("case", "method"), "1",
        "largest error over the range of its quantity; cases in the order of `summary.cases`",
    ),
)  # fmt: skip
STUDY = (
    Entry("inputs/KEY", ("run",), "that of the key", "value of a key that varies"),
    Entry("outputs/KEY", ("run",), "that of the output", "output; nan where a run has none"),
    Entry("errors/KEY", ("run",), "that of the output", "its estimated error; nan where the run tells none"),
    Entry("runs/exit_code", ("run",), "1", "exit code of each run"),
    Entry(
        "runs/series",
        ("run",),
        "1",
        "order of the Taylor series that made a run side by side with others; 0: the method that the command takes "
        "did; only where there are such runs",
    ),
    Entry(
        "runs/holds", ("run",), "1", "1 where all that the scene expects holds; of a search its constraints"
    ),
    Entry(
        "runs/start", ("run",), "1", "of a search: the start whose solver came there first; -1 beside its way"
    ),
    Entry("runs/best", ("run",), "1", "of a search: 1 for the run of the result"),
)
SLOPES = (
    Entry("keys/value", ("key",), "that of each key", "value of each key in the scene as it stands"),
    Entry(
        "derivatives/OUTPUT", ("key",), "that of the output over that of each key",
        "derivative of an output by each key; nan where there is none",
    ),
    Entry(
        "derivative_errors/OUTPUT", ("key",), "that of the output over that of each key",
        "estimated error of the derivative of an output by each key",
    ),
    Entry(
        "normalised/OUTPUT", ("key",), "1",
        "derivative of an output by each key times the key over the output; nan where either is zero",
    ),
    Entry("exact/OUTPUT", ("key",), "1", "1 where the derivative is exact, 0 where it is by differences"),
)  # fmt: skip
# the tables of docs/hdf5.md
GROUPS = {
    "run": (*RUN, *EVENT_ENTRIES), "numerics": NUMERICS, "linear": LINEAR, "study": STUDY, "slopes": SLOPES
}  # fmt: skip
ENTRIES = (*RUN, *NUMERICS, *LINEAR, *STUDY, *SLOPES)


def _fits(path: str, pattern: str) -> bool:
    """Tell whether a path is a pattern's, whose parts in capitals are placeholders."""
    parts, wanted = path.split("/"), pattern.split("/")
    return len(parts) == len(wanted) and all(
        b == a or (len(b) > 1 and b.isupper() and bool(a)) for a, b in zip(parts, wanted)
    )


# by what stands for no name: the first part, and how many more there are
_ALIKE: dict[tuple[str, int], list[Entry]] = {}
for _entry in ENTRIES:
    _ALIKE.setdefault((_entry.path.split("/", 1)[0], _entry.path.count("/")), []).append(_entry)


def lookup(path: str) -> Entry | None:
    """Return the entry that ``path`` belongs to, or None for a path the format does not know."""
    path = path.strip("/")
    alike = _ALIKE.get((path.split("/", 1)[0], path.count("/")), [])
    for entry in alike:
        if entry.path == path:
            return entry
    for entry in alike:
        if _fits(path, entry.path):
            return entry
    return None
