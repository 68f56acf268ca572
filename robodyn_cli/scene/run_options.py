"""Options of the commands that a scene sets: one section for each command."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from robodyn_cli.integration_methods import METHODS
from robodyn_cli.record import record
from robodyn_cli.schema.fields import (
    Boolean,
    Choice,
    Either,
    Integer,
    LaterSection,
    ListOf,
    MapOf,
    Number,
    Section,
    Text,
    key,
)

if TYPE_CHECKING:
    from robodyn_cli.scene import nested_options as nested


@record
class InverseOptions:
    samples: int = key(
        Integer(minimum=2, maximum=100_000_000), default=1001, doc="Number of uniform samples."
    )
    period: float | None = key(
        Number(minimum=0.0, exclusive=True),
        default=None,
        unit="s",
        doc="Period of a controller: the motion and its torques are tabled at its multiples too (`/feed_forward`).",
    )
    shaking: str | None = key(
        Text(), default=None, doc="Point of the base about which the shaking force and moment are told."
    )
    flywheel: nested.Flywheel | None = key(
        LaterSection("scene.nested_options:Flywheel"),
        default=None,
        doc="Inertia of the flywheel that keeps the rate of a joint within a coefficient of fluctuation.",
    )


@record
class Baumgarte:
    alpha: float = key(Number(minimum=0.0), unit="1/s", doc="Rate gain (the term 2 alpha eta-dot).")
    beta: float = key(Number(minimum=0.0), unit="1/s", doc="Position gain (the term beta^2 eta).")


@record
class SimulateOptions:
    duration: float = key(
        Number(minimum=0.0, exclusive=True), default=10.0, unit="s", doc="Length of the run."
    )
    samples: int = key(
        Integer(minimum=2, maximum=100_000_000), default=1001, doc="Number of uniform samples."
    )
    integrator: str = key(Choice(("auto", *METHODS)), default="auto", doc="Method of integration.")
    rtol: float = key(Number(minimum=1e-15, maximum=0.1), default=1e-10, unit="1", doc="Relative tolerance.")
    atol: float = key(Number(minimum=0.0), default=1e-12, unit="rad, m", doc="Absolute tolerance.")
    step: float | None = key(
        Number(minimum=0.0, exclusive=True), default=None, unit="s", doc="Step of the methods with a fixed step."
    )  # fmt: skip
    max_step: float | None = key(
        Number(minimum=0.0, exclusive=True), default=None, unit="s",
        doc="Longest step of the methods that choose their own.",
    )  # fmt: skip
    max_steps: int = key(Integer(minimum=1), default=10_000_000, doc="Steps after which the run is stopped.")
    stabilisation: Any = key(
        Either((Choice(("projection", "independent", "baumgarte", "none")), Section(Baumgarte))),
        default="projection",
        doc="How loops stay closed: `projection`, `independent` coordinates, `none`, Baumgarte's {alpha, beta}, or "
        "`baumgarte` with gains that the run chooses.",
    )
    singular: str = key(
        Choice(("stop", "pass")),
        default="stop",
        doc="What `simulate` does where the loops' constraints lose rank: stop (exit code 4) or "
        "pass through.",
    )
    error_estimate: bool = key(
        Boolean(), default=True, doc="Estimate the global error by a second, tighter integration."
    )
    fluctuation: tuple[str, ...] = key(
        ListOf(Text()), default=(), doc="Joints whose coefficient of fluctuation of speed is told."
    )


@record
class DeployOptions:
    criterion: str = key(
        Choice(("dead_point", "multipliers", "either", "latch")), default="dead_point",
        doc="Criterion of the lock; `latch`: the position at which the latch closes.",
    )  # fmt: skip
    growth: float = key(
        Number(minimum=1.0, exclusive=True), default=1000.0, unit="1",
        doc="The norm of the multipliers passes this times its running median on a 1 ms grid.",
    )  # fmt: skip
    limit: float | None = key(
        Number(minimum=0.0, exclusive=True), default=None, unit="N", doc="Or: the norm passes this value."
    )
    latch: nested.Latch | None = key(
        LaterSection("scene.nested_options:Latch", several="latches"), default=None,
        doc="Links that lock to each other.",
    )  # fmt: skip
    latches: tuple[nested.DeployLatch, ...] = key(
        ListOf(LaterSection("scene.nested_options:DeployLatch")), default=(),
        doc="Or several latches, in place of `criterion` and `latch`: the motion goes on behind each.",
    )  # fmt: skip
    until: str = key(
        Text(), default="all",
        doc="With `latches`: the run ends when `all` are closed, or one by its name, or at its `end`.",
    )  # fmt: skip
    after: str = key(
        Choice(("stop", "continue")), default="stop",
        doc="Motion after the lock: nothing, or the locked structure until the end of the duration.",
    )  # fmt: skip
    loads: dict[str, nested.LoadLimit] = key(
        MapOf(LaterSection("scene.nested_options:LoadLimit"), of="joint"), default=None,
        doc="Largest loads of joints, closures and the `latch`; more is an overload.",
    )  # fmt: skip


@record
class KinematicsOptions:
    """Options of ``kinematics``."""

    sweep: nested.Sweep | None = key(
        LaterSection("scene.nested_options:Sweep"),
        default=None,
        doc="Motion of one joint; without it, `trajectory` or `prescribed` moves.",
    )
    samples: int = key(Integer(minimum=2, maximum=100_000_000), default=361, doc="Number of uniform samples.")
    at: tuple[float, ...] = key(
        ListOf(Number(minimum=0.0)), default=(), unit="s", doc="Times at which the summary locates points."
    )
    transmission: tuple[str, ...] | None = key(
        ListOf(Text(), minimum=3, maximum=3),
        default=None,
        doc="Three points A, B, C: the transmission angle is the one at B between BA and BC.",
    )
    design: nested.KinematicDesign | None = key(
        LaterSection("scene.nested_options:KinematicDesign"),
        default=None,
        doc="Figures of kinematic design: Grashof, dead points, poles, curvature, velocity ratios, pressure angles.",
    )

    @property
    def places(self) -> tuple[str, ...]:
        """References to the points that are asked for."""
        design = self.design
        more = (
            ()
            if design is None
            else (*design.curves, *(x for pair in design.pressure.values() for x in pair))
        )
        return (*(self.transmission or ()), *more)


@record
class AssembleOptions:
    """Options of ``assemble``."""

    branches: bool = key(Boolean(), default=False, doc="Find all the ways in which the loops close.")
    starts: int = key(
        Integer(minimum=1, maximum=1_000_000), default=400, doc="Starts of the search for branches, at most."
    )


@record
class StaticsOptions:
    """Options of ``statics``."""

    find: str = key(
        Choice(("balance", "hold")),
        default="balance",
        doc="`balance`: the configuration in which all forces balance; `hold`: the torques that hold the given one.",
    )
