"""The equalities of a compiled MJCF as loops and couplers: hard ones, for ``solref`` and ``solimp`` are left out.

- connect: the anchor is in the frame of the first body, and the other body's point where it is at ``qpos0``;
- weld: the anchor is in the frame of the second body, and ``relpose`` says where it is in that of the first;
- of sites: these coincide, wherever they are at ``qpos0``;
- joint, and tendons that are sums of joints: y - y0 = a0 + a1 (x - x0), from the values at ``qpos0``. Where one joint
  is left in such a relation, it is held.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from typing import Any

from robodyn_cli.record import record
from robodyn_cli.scene.mjcf.acting import Acting
from robodyn_cli.scene.mjcf.compiled import HELD, INACTIVE, MjcfModel
from robodyn_cli.scene.text.nodes import Faults, located
from robodyn_cli.scene.ties import Closure, Coupling, LoopEnd, Ties
from robodyn_cli.scene.urdf.elements import UrdfPose
from robodyn_cli.scene.urdf.xml import XmlElement
from robodyn_cli.spatial.algebra import Array

_ROUNDING = 1e-12


@record
class MjcfEnds:
    """What equalities join; ``bodies`` : their names. seats : where the origins of their links are in their frames.

    joints : names in the scene.
    """

    bodies: list[str]
    seats: list[Array]
    joints: list[str]

    def of(self, body: int, at: Any, quaternion: Any = None) -> LoopEnd:
        """Return the end of a loop at a place in a body's frame."""
        turned = None if quaternion is None else tuple(float(x) for x in quaternion)
        xyz = tuple(float(x) + 0.0 for x in at - self.seats[body])
        return LoopEnd(self.bodies[body], UrdfPose(xyz, quaternion=turned))


def ties_of(
    compiled: MjcfModel, acting: Acting, ends: MjcfEnds, faults: Faults
) -> tuple[Ties, dict[str, float]]:
    """Return the loops and couplers of a model, and where joints are held; those that are not read are reported."""
    m = compiled.model
    reader = _EqualityReader(compiled, ends)
    closures: list[Closure] = []
    couplings: list[Coupling] = []
    for e in range(m.neq if m.neq and acting.is_on("equalities", "EQUALITY", "CONSTRAINT") else 0):
        element = compiled.elements["equality"][e]
        name = compiled.name("equality", e) or f"{element.tag}{e + 1}"
        if not m.eq_active0[e]:
            compiled.left.setdefault(INACTIVE, []).append(name)
            continue
        with faults:
            if element.tag in ("connect", "weld"):
                closures.append(reader.closure(e, element, name))
            else:
                couplings.append(reader.coupling(e, element, name))
    held: dict[str, float] = {}
    with faults:
        couplings = _without_held(couplings, held)
    if held:
        compiled.left[HELD] = [f"{name} at {value:g}" for name, value in held.items()]
    driven = [ends.joints[j] for j in sorted(acting.actuators) if ends.joints[j] not in held]
    motors = tuple(driven) if driven and not acting.elsewhere else None
    return Ties(tuple(closures), tuple(couplings), motors), held


def _without_held(couplings: list[Coupling], held: dict[str, float]) -> list[Coupling]:
    """Return the couplings between joints that move; the others say where joints are ``held``, which is filled."""
    terms = [dict(one.terms) for one in couplings]
    values = [one.value for one in couplings]
    of: defaultdict[str, list[int]] = defaultdict(list)
    for k, own in enumerate(terms):
        for joint in own:
            of[joint].append(k)
    pending = [k for k, own in enumerate(terms) if len(own) == 1]
    while pending:
        if not terms[k := pending.pop()]:
            continue
        ((joint, factor),) = terms[k].items()
        held[joint] = values[k] / factor
        for other in of[joint]:
            values[other] -= terms[other].pop(joint) * held[joint]
            if len(terms[other]) == 1:
                pending.append(other)
            elif not terms[other] and abs(values[other]) > _ROUNDING * max(1.0, abs(held[joint])):
                problem = (
                    f"{couplings[other].name!r} asks for another position of {joint!r} than {held[joint]:g}"
                )
                raise located(couplings[other].place, "", problem)
    return [
        Coupling(one.place, one.name, own, value) for one, own, value in zip(couplings, terms, values) if own
    ]


class _EqualityReader:
    def __init__(self, compiled: MjcfModel, ends: MjcfEnds) -> None:
        self.m, self.ends = compiled.model, ends

    def closure(self, e: int, element: XmlElement, name: str) -> Closure:
        import mujoco

        m, data = self.m, self.m.eq_data[e]
        pair = (int(m.eq_obj1id[e]), int(m.eq_obj2id[e]))
        kind = "fixed" if element.tag == "weld" and data[10] else "spherical"
        if m.eq_objtype[e] == mujoco.mjtObj.mjOBJ_SITE:
            first, second = (self.ends.of(m.site_bodyid[s], m.site_pos[s], m.site_quat[s]) for s in pair)
        elif element.tag == "weld":
            first = self.ends.of(pair[0], data[3:6], data[6:10])
            second = self.ends.of(pair[1], data[0:3])
        else:
            first, second = (self.ends.of(b, data[k : k + 3]) for b, k in zip(pair, (0, 3)))
        return Closure(element.place, name, kind, (first, second))

    def coupling(self, e: int, element: XmlElement, name: str) -> Coupling:
        """Return y - a1 x = a0.

        Raises
        ------
        SceneError : it is curved, or relates nothing that moves.
        """
        m, data = self.m, self.m.eq_data[e]
        second = int(m.eq_obj2id[e])
        if second >= 0 and any(data[2:5]):
            raise element.error(
                f"<{element.tag}> {name!r}: polycoef is {_words(data[:5])}, which is no straight line; allowed: two "
                "numbers and zeros"
            )
        terms: dict[str, float] = {}
        pairs = [(int(m.eq_obj1id[e]), 1.0), (second, -float(data[1]))]
        for number, factor in pairs if second >= 0 else pairs[:1]:
            for j, coefficient in self.joints(element.tag, number):
                joint = self.ends.joints[j]
                terms[joint] = terms.get(joint, 0.0) + factor * coefficient
        terms = {joint: x for joint, x in terms.items() if x}
        if not terms:
            raise element.error(
                f"<{element.tag}> {name!r} relates no joints; allowed: factors that are not zero"
            )
        return Coupling(element.place, name, terms, float(data[0]))

    def joints(self, tag: str, number: int) -> list[tuple[int, float]]:
        """Return the joints of one side, with their factors."""
        m = self.m
        if tag == "joint":
            return [(number, 1.0)]
        start = int(m.tendon_adr[number])
        parts = range(start, start + int(m.tendon_num[number]))
        return [(int(m.wrap_objid[k]), float(m.wrap_prm[k])) for k in parts]


def _words(numbers: Sequence[float]) -> str:
    return " ".join(f"{float(x):g}" for x in numbers)
