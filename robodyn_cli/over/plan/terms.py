"""The terms of the general problem, one by one: kept or left out, why, and the equations to compare with.

The count of a kept term is the saving if it were left out; that of a term left out is the addition in general form.
Terms share work (a sine serves them all), so the counts do not add up to the total, and a term whose work the others
need as well counts as 0.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping

from robodyn_cli.equations.problem import Problem
from robodyn_cli.expr.graph import count_operations, is_nonzero
from robodyn_cli.forces.registry import joint_forces
from robodyn_cli.model.build import build_model
from robodyn_cli.model.model import Body, Model
from robodyn_cli.over.plan import variants
from robodyn_cli.over.plan.plane import Plane, direction
from robodyn_cli.over.plan.text import listed, listed_data, plural
from robodyn_cli.over.plan.variants import Variant
from robodyn_cli.record import record
from robodyn_cli.spatial.algebra import Transform, identity, zeros
from robodyn_cli.summaries.checks import Kept, LeftOut

LOOPS = 4  # so many loops at most have entries of their own


@record
class Term:
    """A part of the general problem that the equations contain (``kept``), or not, with the reason.

    operations : the saving if it were left out, or the addition; or two variants (more, less) whose difference it is.
    """

    name: str
    kept: bool
    reason: str
    operations: int | tuple[Variant, Variant] = 0


@record
class PlanEquations:
    """The input of the terms: the equations as the command builds them, and ``here``, the same as a variant.

    idle : given data without effect. spare : data neither given nor needed. apart : operations of other equations, by
    term. acting : which of ``coriolis`` and ``gravity`` load a joint in any pose.
    """

    here: Variant
    problem: Problem
    plane: Plane
    idle: tuple[str, ...]
    spare: tuple[str, ...]
    apart: Mapping[str, int]
    acting: frozenset[str]

    @property
    def model(self) -> Model:
        return self.here.model

    def kept(self, name: str, reason: str, without: Variant) -> Term:
        """Return a term that the equations contain; ``without`` : the equations without it."""
        return Term(name, True, reason, (self.here, without))

    def left_out(self, name: str, reason: str, general: Variant) -> Term:
        """Return a term that the equations do not contain; ``general`` : the equations with it in general form."""
        return Term(name, False, reason, (general, self.here))

    def either(
        self, name: str, present: object, why: str, why_not: str, without: Variant, general: Variant
    ) -> Term:
        """Return a term that is kept where it is ``present``, left out where it is not."""
        return self.kept(name, why, without) if present else self.left_out(name, why_not, general)

    def joints(self, has: Callable[[Body], bool]) -> list[str]:
        """Return the names of the joints of bodies with a property."""
        return [b.joint_name for b in self.model.bodies if has(b)]


Terms = Iterator[Term]


def velocity_terms(e: PlanEquations) -> Terms:
    name = "centrifugal and Coriolis forces"
    if "coriolis" in e.acting:
        yield e.kept(
            name, "the mass matrix depends on the pose", dataclasses.replace(e.here, velocity_terms=False)
        )
        return
    why = "one joint alone has none" if e.model.nv == 1 else "the mass matrix is the same in every pose"
    spatial = variants.general_directions(variants.general_inertia(e.here))
    pair = spatial, dataclasses.replace(spatial, velocity_terms=False)
    yield Term(name, False, f"they vanish identically: {why}", pair)


def gravity(e: PlanEquations) -> Terms:
    g = e.plane.gravity
    general = variants.general_gravity(e.here)
    if "gravity" not in e.acting:
        reason = f"gravity of ({', '.join(f'{x:.4g}' for x in g)}) m/s^2 loads no joint in any pose"
        yield e.left_out("gravity", reason if any(g) else "gravity is zero", general)
        return
    size = float(g @ g) ** 0.5
    reason = f"gravity of {size:.4g} m/s^2 points along {direction(g / size)} of the base"
    yield e.kept("gravity", reason, e.here.with_model(gravity=zeros(3)))
    if zero := [name for name, x in zip("xyz", g) if x == 0.0]:
        reason = f"{listed(zero)} of gravity {'is' if len(zero) == 1 else 'are'} zero in the base's axes"
        yield e.left_out("gravity in other directions", reason, general)


def rotors(e: PlanEquations) -> Terms:
    names = e.joints(lambda b: any(is_nonzero(x) for x in b.rotors))
    why = f"rotors of {listed(names)}: reflected by the square of the gear ratio, constant on the diagonal"
    without = e.here.with_bodies(armature=lambda b: 0.0)
    general = variants.general_rotors(e.here)
    yield e.either("rotor inertia", names, why, "no rotor has inertia", without, general)


def gears(e: PlanEquations) -> Terms:
    names = e.joints(lambda b: any(x != 1.0 for x in b.gear_ratios))
    why = f"ratios of {listed(names)} are folded into inertia and friction beforehand"
    yield Term("gears", bool(names), why if names else "every motor turns with its joint")


def joint_directions(e: PlanEquations) -> Terms:
    general = variants.general_directions(e.here)
    if e.plane.normal is not None:
        yield e.left_out("motion out of the plane", e.plane.reason(), general)
        return
    parallel = e.here.with_bodies(X_tree=lambda b: Transform(identity(), b.X_tree.r))
    yield e.kept("motion out of the plane", e.plane.reason(), parallel)
    entries = [float(x) for b in e.model.bodies for x in b.X_tree.E.flat]
    if exact := sum(x in (0.0, 1.0, -1.0) for x in entries):
        reason = f"{exact} of the {len(entries)} entries of the rotations between bodies are exactly 0 or +-1"
        yield e.left_out("oblique directions of joints", reason, general)


def lever_arms(e: PlanEquations) -> Terms:
    components = [float(x) for b in e.model.bodies for x in b.X_tree.r]
    zero = components.count(0.0)
    if zero:
        yield e.left_out(
            "lever arms along all axes",
            f"{zero} of the {len(components)} components of the joints' places on their bodies are zero",
            # in a plane, general places of the joints stay in it: a loop could not close otherwise
            variants.general_levers(e.here, e.plane if e.plane.normal is not None else None),
        )
    if zero < len(components) and not e.model.loops:
        reason = "joint axes do not all meet in one point"
        without = e.here.with_bodies(X_tree=lambda b: Transform(b.X_tree.E, zeros(3)))
        yield e.kept("lever arms between joints", reason, without)


def inertia(e: PlanEquations) -> Terms:
    name, reason = (
        "full inertia of bodies",
        "in the plane a body has its mass, a centre of mass in it and one moment",
    )
    if not e.plane.turns:
        reason = "nothing turns: of each body only the mass matters"
    elif e.plane.normal is None:
        flat = e.here.with_bodies(inertia=variants.planar_inertia)
        yield e.kept(name, "bodies turn about more than one axis", flat)
        name, reason = "other components of inertia", "components that are zero or have no effect"
    notes = [f"given, but without effect here: {listed_data(e.idle)}"] if e.idle else []
    notes += [f"not given and not needed: {listed_data(e.spare)}"] if e.spare else []
    yield e.left_out(name, "; ".join([reason, *notes]), variants.general_inertia(e.here))


def fixed_links(e: PlanEquations) -> Terms:
    """Links on fixed joints are merged into their parents; counted in h(q, qd) only."""
    names = [joint.name for joint in e.here.scene.robot.joints if joint.type == "fixed"]
    if names:
        apart = Problem(e.here.scene, model=build_model(e.here.scene, merge=False))
        work = count_operations(list(apart.bias)) - count_operations(list(e.problem.bias))
        why = f"the links on {listed(names)} are merged into their carriers; counted: in h(q, qd)"
        yield Term("links on fixed joints", False, why, max(0, work))


def loops(e: PlanEquations) -> Terms:
    """Loop closures and the rows that vanish; where there are many, all in one entry."""
    names = [loop.name for loop in e.model.loops]
    for group in [[name] for name in names] if len(names) <= LOOPS else [names]:
        title = f"loop {group[0]}" if len(group) == 1 else plural(len(group), "loop")
        constraints = e.problem.constraints
        rows = [n for n in constraints.names if n.rsplit(".", 1)[0] in group]
        reason = f"{plural(len(rows), 'row')} of equation (36): {listed(rows)}"
        yield e.kept(f"{title} with multipliers", reason, variants.without_loops(e.here, group))
        dropped = [n for n in constraints.dropped if n.rsplit(".", 1)[0] in group]
        if dropped:
            space = variants.general_loops(variants.general_directions(e.here))
            others = tuple(n for n in (*constraints.names, *constraints.dropped) if n not in dropped)
            planar = e.plane.normal is not None
            where = "both sides stay in one plane" if planar else "no joint moves along them"
            yield Term(
                f"{title}: {plural(len(dropped), 'row')} {listed(dropped)}",
                False,
                f"{where}, so these rows vanish identically; counted: their operations in space",
                (space, dataclasses.replace(space, rows=others)),
            )


def couplers(e: PlanEquations) -> Terms:
    names = e.model.couplers
    why = f"{listed(names)}: a row each, between joint coordinates"
    without = e.here.with_scene(couplers=())
    yield e.either("couplers", names, why, "no joint coordinates are coupled", without, e.here)


def joint_elements(e: PlanEquations) -> Terms:
    """Friction, springs, dampers, stops in the joints: every kind in the registry."""
    known = {element.kind for element in variants.ELEMENTS}
    more = [variants.Element(f"joint forces: {kind}", kind) for kind in joint_forces if kind not in known]
    for part in (*variants.ELEMENTS, *more):
        names = e.joints(part.acts_on)
        why = f"in {plural(len(names), 'joint')}: {listed(names)}"
        general = e.here if part.general is None else variants.with_element(e.here, part)
        yield e.either(part.name, names, why, part.nothing, variants.without_element(e.here, part), general)


def elements(e: PlanEquations) -> Terms:
    """Forces on points and between bodies, kind by kind."""
    forces = e.model.forces
    for kind in dict.fromkeys(force.element.type for force in forces):
        names = [force.name for force in forces if force.element.type == kind]
        reason = f"{listed(names)}: carried along the tree between the bodies they act on"
        less = e.here.with_model(forces=tuple(force for force in forces if force.name not in names))
        yield e.kept(f"forces: {kind.replace('_', ' ')}", reason, less)
    if not forces:
        reason = "the scene has none; counted: a spring between the last body and the base"
        more = variants.one_spring(e.here, e.plane)
        yield e.left_out("forces on points and between bodies", reason, more)


# terms of every command's equations; a command adds those of its stages
MECHANISM = (
    velocity_terms, gravity, rotors, gears, joint_directions, lever_arms, inertia, fixed_links, loops,
    couplers, joint_elements, elements,
)  # fmt: skip


class Ledger:
    """Counts terms and sorts them into kept and left out.

    count : operations of a variant's main program. total : those of ``here``. counted : whether single terms are
    counted; variants of large models take too long to build.
    """

    def __init__(self, here: Variant, total: int, count: Callable[[Variant], int], counted: bool) -> None:
        self.here, self.total, self.counted = here, total, counted
        self._count = count
        self.kept: list[Kept] = []
        self.left_out: list[LeftOut] = []

    def operations(self, variant: Variant) -> int | None:
        """Return a variant's operations, None where they cannot be counted."""
        if variant is self.here:
            return self.total
        if not self.counted:
            return None
        try:
            return self._count(variant)
        except ZeroDivisionError:  # general places contradict each other: a structurally singular system
            return None

    def enter(self, term: Term) -> None:
        """Put a term into its list."""
        if isinstance(term.operations, int):
            operations: int | None = term.operations
        else:
            more, less = map(self.operations, term.operations)
            operations = None if more is None or less is None else max(0, more - less)
        if term.kept:
            share = None if operations is None or not self.total else round(operations / self.total, 4)
            self.kept.append(Kept(term.name, term.reason, operations, share))
        else:
            self.left_out.append(LeftOut(term.name, term.reason, operations))
