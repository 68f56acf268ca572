"""The terms of the general problem, one by one: kept or left out, why, and what that is worth.

A kept term is counted by what leaving it out would save, a term left out by what it would add in general
form. Terms share work (a sine serves them all), so the counts do not add up to the total, and a term whose
work the others need as well counts as 0.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

from robodyn_cli.equations import plan_variants as variants
from robodyn_cli.equations.plan_facts import (
    Facts,
    force_joints,
    is_zero,
    joints_with,
    listed,
    listed_data,
    plural,
)
from robodyn_cli.equations.problem import Problem
from robodyn_cli.equations.variant import Variant
from robodyn_cli.expr.graph import count_operations
from robodyn_cli.model.model import BASE, Model
from robodyn_cli.record import mutable_record

Entry = dict[str, Any]
LOOPS = 4  # up to which loops have entries of their own


@mutable_record
class Ledger:
    """Kept and left out, as they are found.

    scene : the variant that is the scene itself. count : operations of a variant's main program.
    counted : whether single terms are counted (variants of large models take too long to build).
    """

    scene: Variant
    facts: Facts
    count: Callable[[Variant], int]
    total: int
    counted: bool = True
    kept: list[Entry] = dataclasses.field(default_factory=list)
    left_out: list[Entry] = dataclasses.field(default_factory=list)

    @property
    def model(self) -> Model:
        return self.scene.model

    def operations(self, variant: Variant) -> int | None:
        """Return a variant's operations, None where they cannot be counted."""
        if not self.counted:
            return None
        try:
            return self.count(variant)
        except ZeroDivisionError:  # general places contradict each other: a structurally singular system
            return None

    def keep(
        self, term: str, reason: str, without: Variant | None = None, operations: int | None = None
    ) -> None:
        """Enter a kept term; ``without`` is the scene less that term."""
        if without is not None:
            less = self.operations(without)
            operations = None if less is None else max(0, self.total - less)
        share = None if operations is None or not self.total else round(operations / self.total, 4)
        self.kept.append({"term": term, "reason": reason, "operations": operations, "share": share})

    def leave(self, term: str, reason: str, general: Variant | None = None, saved: int | None = None) -> None:
        """Enter a term left out; ``general`` is the scene with that term in general form."""
        if general is not None:
            more = self.operations(general)
            saved = None if more is None else max(0, more - self.total)
        self.left_out.append({"term": term, "reason": reason, "operations_saved": saved})

    def choose(
        self,
        present: bool,
        term: str,
        why: str,
        why_not: str,
        without: Callable[[Variant], Variant],
        general: Callable[[Variant], Variant],
    ) -> None:
        """Enter a term as kept or left out."""
        if present:
            self.keep(term, why, without(self.scene))
        else:
            self.leave(term, why_not, general(self.scene))


def rigid_body_terms(ledger: Ledger, problem: Problem) -> None:
    """Enter velocity terms, gravity and rotors."""
    scene, model, facts = ledger.scene, ledger.model, ledger.facts
    parts = problem.rigid_terms()
    if not is_zero(parts["coriolis"]):
        ledger.keep(
            "centrifugal and Coriolis forces",
            "the mass matrix depends on the pose",
            variants.without_velocity_terms(scene),
        )
    else:
        spatial = variants.general_directions(variants.general_inertia(scene))
        more, less = ledger.operations(spatial), ledger.operations(variants.without_velocity_terms(spatial))
        ledger.leave(
            "centrifugal and Coriolis forces",
            "they vanish identically: "
            + ("one joint alone has none" if model.nv == 1 else "the mass matrix is the same in every pose"),
            saved=None if more is None or less is None else more - less,
        )
    g = facts.gravity
    if not g.any():
        ledger.leave("gravity", "gravity is zero", variants.general_gravity(scene))
    elif is_zero(parts["gravity"]):
        ledger.leave(
            "gravity",
            "gravity loads no joint: it is parallel to the joint axes"
            if facts.planar
            else "gravity loads no joint in any pose",
            variants.general_gravity(scene),
        )
    else:
        ledger.keep("gravity", facts.gravity_text(), variants.without_gravity(scene))
        zero = [name for name, x in zip("xyz", g) if x == 0.0]
        if zero:
            ledger.leave(
                "gravity in other directions",
                f"{listed(zero)} of gravity {'is' if len(zero) == 1 else 'are'} zero in the base's axes",
                variants.general_gravity(scene),
            )
    rotors = joints_with(model, lambda b: b.armature != 0.0)
    ledger.choose(
        bool(rotors),
        "rotor inertia",
        f"rotors of {listed(rotors)}: reflected by the square of the gear ratio, constant on the diagonal",
        "no rotor has inertia",
        variants.without_rotors,
        variants.general_rotors,
    )
    geared = joints_with(model, lambda b: b.gear_ratio != 1.0)
    if geared:
        ledger.keep(
            "gears",
            f"ratios of {listed(geared)} are folded into inertia and friction beforehand",
            operations=0,
        )
    else:
        ledger.leave("gears", "every motor turns with its joint", saved=0)


def geometry_terms(ledger: Ledger, idle: list[str], spare: list[str]) -> None:
    """Enter what the directions of the axes, the lever arms and the bodies' inertia decide."""
    scene, facts = ledger.scene, ledger.facts
    if facts.planar:
        ledger.leave("motion out of the plane", facts.plane_reason(), variants.general_directions(scene))
    else:
        ledger.keep("motion out of the plane", facts.spatial_reason(), variants.parallel_axes(scene))
        exact, entries = facts.exact_entries()
        if exact:
            ledger.leave(
                "oblique directions of joints",
                f"{exact} of the {entries} entries of the rotations between bodies are exactly 0 or +-1",
                variants.general_directions(scene),
            )
    zero, components = facts.zero_levers()
    if zero:
        # in a plane, general places of the joints stay in it: a loop could not close otherwise
        normals = [facts.normal_in(b.parent) for b in ledger.model.bodies]
        ledger.leave(
            "lever arms along all axes",
            f"{zero} of the {components} components of the joints' places on their bodies are zero",
            variants.planar_levers(scene, normals) if facts.planar else variants.general_levers(scene),
        )
    if zero < components and not ledger.model.loops:
        ledger.keep(
            "lever arms between joints",
            "joint axes do not all meet in one point",
            variants.without_levers(scene),
        )
    reasons = []
    if idle:
        reasons.append(f"given, but without effect here: {listed_data(idle)}")
    if spare:
        reasons.append(f"not given and not needed: {listed_data(spare)}")
    if facts.planar:
        reasons.insert(0, "in the plane a body has its mass, a centre of mass in it and one moment")
        ledger.leave("full inertia of bodies", "; ".join(reasons), variants.general_inertia(scene))
    else:
        ledger.keep(
            "full inertia of bodies", "bodies turn about more than one axis", variants.planar_inertia(scene)
        )
        reasons.insert(0, "components that are zero or have no effect")
        ledger.leave("other components of inertia", "; ".join(reasons), variants.general_inertia(scene))


def fixed_links(ledger: Ledger, problem: Problem) -> None:
    """Enter the links on fixed joints, which are merged into their parents."""
    if all(joint.type != "fixed" for joint in ledger.scene.scene.robot.joints):
        return
    apart = variants.unmerged(ledger.scene)
    other = apart.problem()
    places = {other.model.body_of(name).v for name in apart.still}
    bias = [x for k, x in enumerate(other.bias) if k not in places]
    ledger.leave(
        "links on fixed joints",
        f"the links on {listed(apart.still)} are merged into what carries them; counted: in h(q, qd)",
        saved=count_operations(bias) - count_operations(list(problem.bias)),
    )


def force_terms(ledger: Ledger) -> None:
    """Enter friction, springs and dampers."""
    model = ledger.model

    def enter(
        term: str, has: Callable[[Any], bool], change: Callable[[Any], Any],
        general: Callable[[Variant], Variant], nothing: str,
    ) -> None:  # fmt: skip
        names = force_joints(model, has)
        ledger.choose(
            bool(names), term, f"in {plural(len(names), 'joint')}: {listed(names)}", nothing,
            lambda v: variants.without_force(v, change), general,
        )  # fmt: skip

    def friction(e: Any) -> bool:
        return e.term == "friction"

    enter(
        "viscous friction", lambda e: friction(e) and e.viscous != 0.0,
        lambda e: dataclasses.replace(e, viscous=0.0) if friction(e) else e,
        variants.general_viscous, "no joint has any",
    )  # fmt: skip
    enter(
        "Coulomb friction", lambda e: friction(e) and e.levels() != (0.0, 0.0),
        lambda e: dataclasses.replace(e, coulomb=0.0, static=None, stribeck_speed=None) if friction(e) else e,
        variants.general_coulomb, "no joint has any",
    )  # fmt: skip

    def spring(e: Any) -> bool:
        return e.term == "passive" and not e.dissipative

    def damper(e: Any) -> bool:
        return e.term == "passive" and e.dissipative

    enter(
        "joint springs", spring, lambda e: None if spring(e) else e,
        variants.general_springs, "no joint has one",
    )  # fmt: skip
    enter(
        "joint dampers", damper, lambda e: None if damper(e) else e,
        variants.general_dampers, "no joint has one",
    )  # fmt: skip

    losses = force_joints(model, lambda e: e.term == "gear")
    if losses:
        ledger.keep(
            "gear losses", f"in {plural(len(losses), 'joint')}: {listed(losses)}",
            variants.without_force(ledger.scene, lambda e: None if e.term == "gear" else e),
        )  # fmt: skip
    else:
        ledger.leave("gear losses", "no gear has an efficiency", saved=0)

    def stop(e: Any) -> bool:
        return bool(e.term == "stops")

    enter(
        "joint stops", stop, lambda e: None if stop(e) else e, variants.general_stops, "no joint has any",
    )  # fmt: skip


def element_terms(ledger: Ledger) -> None:
    """Enter the forces on points and between bodies, kind by kind."""
    forces = ledger.model.forces
    for kind in dict.fromkeys(force.element.type for force in forces):
        names = [force.name for force in forces if force.element.type == kind]
        ledger.keep(
            f"forces: {kind.replace('_', ' ')}",
            f"{listed(names)}: carried along the tree between the bodies they act on",
            variants.without_elements(ledger.scene, names),
        )
    if not forces:
        here, there = ledger.facts.normal_in(len(ledger.model.bodies) - 1), ledger.facts.normal_in(BASE)
        ledger.leave(
            "forces on points and between bodies",
            "the scene has none; counted: a spring between the last body and the base",
            variants.one_spring(ledger.scene, here, there),
        )


def drive_terms(ledger: Ledger, on_time: bool) -> None:
    """Enter actuator torques, prescribed motion and time itself (forward dynamics)."""
    scene = ledger.scene.scene
    driven = [name for name, torque in (scene.torques or {}).items()]
    ledger.choose(
        bool(driven), "actuator torques", f"given for {listed(driven)}", "no joint has one",
        lambda v: v.with_scene(torques={}), lambda v: dataclasses.replace(v, drives=True),
    )  # fmt: skip
    prescribed = list(scene.prescribed or {})
    ledger.choose(
        bool(prescribed), "prescribed motion",
        f"{listed(prescribed)} {'follows' if len(prescribed) == 1 else 'follow'} given motion, by a row each",
        "no joint's motion is prescribed",
        lambda v: v.with_scene(prescribed={}), lambda v: dataclasses.replace(v, driven_joint=True),
    )  # fmt: skip
    if on_time:
        ledger.keep("time as an input", "a torque or a prescribed motion depends on t", operations=0)
    else:
        ledger.leave("time as an input", "nothing depends on t explicitly", saved=0)


def loop_terms(ledger: Ledger, problem: Problem, forward: bool) -> None:
    """Enter loop closures and the rows that vanish."""
    scene, model = ledger.scene, ledger.model
    if not model.loops and not forward:
        ledger.leave(
            "closed loops and their multipliers",
            "the joints form an open chain or tree: every torque follows from the motion alone",
            saved=0,
        )
        return
    if not model.loops:
        here, there = ledger.facts.normal_in(len(model.bodies) - 1), ledger.facts.normal_in(BASE)
        ledger.leave(
            "closed loops and their multipliers",
            "the joints form an open chain or tree; counted: what a single pin from "
            f"{model.bodies[-1].name} to the base would add",
            variants.one_pin(scene, here, there),
        )
        return
    constraints = problem.constraints
    every = [loop.name for loop in model.loops]
    # each loop on its own, unless that are too many to be told apart in a table
    for group in [[name] for name in every] if len(every) <= LOOPS else [every]:
        title = f"loop {group[0]}" if len(group) == 1 else plural(len(group), "loop")
        names = [n for n in constraints.names if n.rsplit(".", 1)[0] in group]
        ledger.keep(
            f"{title} with multipliers",
            f"{plural(len(names), 'row')} of equation (36): {listed(names)}",
            variants.without_loops(scene, group),
        )
        dropped = [n for n in constraints.dropped if n.rsplit(".", 1)[0] in group]
        if dropped:
            space = variants.general_loops(variants.general_directions(scene))
            rows = tuple(n for n in (*constraints.names, *constraints.dropped) if n not in dropped)
            more, less = ledger.operations(space), ledger.operations(dataclasses.replace(space, rows=rows))
            where = "both sides stay in one plane" if ledger.facts.planar else "no joint moves along them"
            ledger.leave(
                f"{title}: {plural(len(dropped), 'row')} {listed(dropped)}",
                f"{where}, so these rows vanish identically; counted: what they would add in space",
                saved=None if more is None or less is None else max(0, more - less),
            )
