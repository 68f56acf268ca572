"""Every path that a result file may hold, with its dimensions, units and meaning.

The writer takes defaults from here, and ``docs/hdf5.md`` is tested against it. A word in
capitals is a placeholder for a name from the scene.
"""

from __future__ import annotations

from robodyn_cli.record import record


@record
class Entry:
    """One path of the format; ``names`` label the last dimension where they are always the same."""

    path: str
    dims: tuple[str, ...]
    units: str
    long_name: str
    names: tuple[str, ...] = ()


XYZ = ("x", "y", "z")

# limits of joints under ``joint_limits/`` by the dataset that they bound, with the signs of the sides on which they do
JOINT_LIMITS: dict[str, dict[str, tuple[float, ...]]] = {
    "q": {"lower": (1.0,), "upper": (1.0,)},
    "qd": {"speed": (1.0, -1.0)},
    "qdd": {"acceleration": (1.0, -1.0)},
    "tau": {"effort": (1.0, -1.0)},
}

ENTRIES: tuple[Entry, ...] = (
    Entry("time", ("time",), "s", "time"),
    Entry("q", ("time", "joint"), "rad or m", "joint position"),
    Entry("qd", ("time", "joint"), "rad/s or m/s", "joint velocity"),
    Entry("qdd", ("time", "joint"), "rad/s^2 or m/s^2", "joint acceleration"),
    Entry("tau", ("time", "joint"), "N m or N", "actuator torque or force"),
    Entry(
        "joint_limits/LIMIT",
        ("LIMIT_limit",),
        "of what it limits",
        "limits (`lower`, `upper`, `speed`, `acceleration`, `effort`) of the joints that have one",
    ),
    Entry("torque_terms/TERM", ("time", "joint"), "N m or N", "part of the actuator torque"),
    Entry(
        "constraints/multipliers",
        ("time", "constraint"),
        "N or N m",
        "Lagrange multipliers of the loop closures",
    ),
    Entry(
        "constraints/position_residual",
        ("time", "constraint"),
        "m or rad",
        "residual of the loop closures, position",
    ),
    Entry(
        "constraints/velocity_residual",
        ("time", "constraint"),
        "m/s or rad/s",
        "residual of the loop closures, velocity",
    ),
    Entry(
        "reactions/JOINT",
        ("time", "wrench"),
        "N, N m",
        "force and moment of the parent on the link in a joint",
    ),
    Entry(
        "loop_reactions/LOOP", ("time", "wrench"), "N, N m", "force and moment of a closure on its first link"
    ),
    Entry("base_wrench", ("time", "wrench"), "N, N m", "force and moment of the ground on the mechanism"),
    Entry("energy/kinetic", ("time",), "J", "kinetic energy"),
    Entry("energy/potential", ("time",), "J", "potential energy"),
    Entry("energy/total", ("time",), "J", "kinetic and potential energy"),
    Entry(
        "energy/work", ("time",), "J", "work done on the system by non-conservative forces since the start"
    ),
    Entry("control/reference", ("time", "tracked"), "rad or m", "what the controller follows"),
    Entry("control/error", ("time", "tracked"), "rad or m", "reference less motion"),
    Entry("control/torque", ("time", "driven"), "N m or N", "torque or force of the controller"),
    Entry("control/states", ("time", "control_state"), "1", "states of the controller"),
    Entry("signals/NAME", ("time",), "1", "signal of `outputs.signals`, in the unit that the scene states"),
    Entry("forces/potential", ("time", "force"), "J", "potential energy of each entry of `forces`"),
    Entry(
        "forces/power", ("time", "force"), "W", "power of each entry of `forces` beside its potential energy"
    ),
    Entry("points/NAME", ("time", "axis"), "m", "position of a point in the world frame", XYZ),
    Entry("limits/use", ("time", "limit"), "1", "part of each limit that a motion in the least time uses"),
    Entry("limits/binding", ("time",), "1", "column of limits/use that binds, -1 where none does"),
    Entry("drives/load", ("time", "drive"), "N m or N", "torque or force of the gears on the mechanism"),
    Entry("drives/speed", ("time", "drive"), "rad/s", "speed of each motor of the joint's drive"),
    Entry(
        "drives/torque", ("time", "drive"), "N m", "torque at the shaft of each motor, its rotor's included"
    ),
    Entry("drives/use", ("time", "drive"), "1", "part of the motor's envelope that is used"),
    Entry("drives/current", ("time", "electric_drive"), "A", "current of each motor"),
    Entry(
        "drives/winding_temperature",
        ("time", "warm_drive"),
        "degC",
        "temperature of the windings in the steady periodic state",
    ),
    Entry(
        "candidates/JOINT",
        ("combination", "quantity"),
        "1 or kg",
        "combinations of motors and gears: their numbers, cost, mass, margin of the limit that decides",
        ("motor", "gear", "cost", "mass", "margin"),
    ),
    *(
        Entry(
            f"envelopes/{kind}/JOINT",
            ("vertex", "quantity"),
            "rad/s, N m",
            f"corners of the motor's envelope: {meaning}",
            ("speed", "torque"),
        )
        for kind, meaning in (
            ("driving", "while it drives"),
            ("braking", "while it brakes"),
            ("continuous", "what it bears for ever"),
        )
    ),
    Entry("targets/NAME", ("time", "axis"), "m", "position asked of a point in the world frame", XYZ),
    Entry(
        "point_velocities/NAME",
        ("time", "axis"),
        "m/s",
        "velocity of a point in the world frame (`kinematics`, `simulate`, `deploy`)",
        XYZ,
    ),
    Entry(
        "point_accelerations/NAME",
        ("time", "axis"),
        "m/s^2",
        "acceleration of a point in the world frame (`kinematics`, `simulate`, `deploy`)",
        XYZ,
    ),
    Entry("transmission_angle", ("time",), "rad", "angle at the second of three points of the transmission"),
    Entry("frames/NAME/position", ("time", "axis"), "m", "origin of a frame in the world frame", XYZ),
    Entry(
        "frames/NAME/quaternion",
        ("time", "quaternion"),
        "1",
        "unit quaternion from the frame to the world frame, scalar first",
        ("w", "x", "y", "z"),
    ),
    Entry(
        "frames/NAME/twist",
        ("time", "twist"),
        "rad/s, m/s",
        "angular velocity, then velocity of the origin, in the world frame",
        ("wx", "wy", "wz", "vx", "vy", "vz"),
    ),
    Entry(
        "singularity/psi", ("time", "singular_value"), "1", "singular values of the constraint Jacobian Psi"
    ),
    Entry(
        "singularity/passive",
        ("time", "passive_singular_value"),
        "1",
        "singular values of the block of Psi that belongs to the passive coordinates",
    ),
    Entry("singularity/determinant", ("time",), "1", "determinant of the passive block of Psi"),
    Entry(
        "branches/q",
        ("branch", "joint"),
        "rad or m",
        "joint positions of the ways in which the loops close, or which reach the pose",
    ),
    Entry(
        "branches/determinant",
        ("branch",),
        "1",
        "determinant of the block of Psi of the coordinates solved for",
    ),
    Entry(
        "branch_skeleton/LINK",
        ("branch", "vertex", "axis"),
        "m",
        "corners of a link's outline, by branch",
        XYZ,
    ),
    Entry(
        "skeleton/LINK",
        ("time", "vertex", "axis"),
        "m",
        "corners of a link's outline in the world frame",
        XYZ,
    ),
)

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
    Attribute("status", "text", "`ok`, `locked`, `no_lock`, `overload`, `undersized` or `failed`"),
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


def _fits(path: str, pattern: str) -> bool:
    """Tell whether a path is a pattern's, whose parts in capitals are placeholders."""
    parts, wanted = path.split("/"), pattern.split("/")
    return len(parts) == len(wanted) and all(
        b == a or (b.isupper() and bool(a)) for a, b in zip(parts, wanted)
    )


def lookup(path: str) -> Entry | None:
    """Return the entry that ``path`` belongs to, or None for a path the format does not know."""
    path = path.strip("/")
    for entry in ENTRIES:
        if entry.path == path:
            return entry
    for entry in ENTRIES:
        if _fits(path, entry.path):
            return entry
    return None
