"""What acts in the joints of a compiled MJCF: limits, motors, friction, springs and reflected inertia."""

from __future__ import annotations

import math
from typing import Any

from robodyn_cli.scene.mjcf.compiled import ACTUATORS, SWITCHED_OFF, MjcfModel
from robodyn_cli.scene.urdf.xml import XmlElement

KINDS = ("free", "ball", "slide", "hinge")  # by the compiler's numbers
SINGLE = ("slide", "hinge")
CONES = "limits of ball joints"


class Acting:
    """The forces in the joints of a model; ``types`` : of its joints. motors, actuators : on each, by number.

    elsewhere : whether there are actuators on other parts than joints, or muscles.
    """

    def __init__(self, compiled: MjcfModel) -> None:
        self.compiled, self.m = compiled, compiled.model
        self.types = [KINDS[int(kind)] for kind in self.m.jnt_type]
        self.motors: dict[int, list[int]] = {}
        self.actuators: dict[int, list[int]] = {}
        self.elsewhere = ACTUATORS in compiled.left
        for a in range(len(self.m.actuator_trntype)):
            j = int(self.m.actuator_trnid[a][0])
            self.actuators.setdefault(j, []).append(a)
            if self.types[j] in SINGLE and self.is_torque(a):
                self.motors.setdefault(j, []).append(a)
            else:
                element = compiled.elements["actuator"][a]
                name = compiled.name("actuator", a) or "(no name)"
                compiled.left.setdefault(ACTUATORS, []).append(f"{name} ({element.tag})")

    def is_torque(self, a: int) -> bool:
        """Tell whether an actuator is a factor times its control, without states, bias or delay."""
        m = self.m
        numbers = (m.actuator_gaintype[a], m.actuator_biastype[a], m.actuator_dyntype[a])
        return not any(numbers) and not _has(m, "actuator_delay", a)

    def is_on(self, part: str, *flags: str) -> bool:
        """Tell whether no <flag> of the file switches a part of the equations off; one that is off is listed."""
        import mujoco

        off = self.m.opt.disableflags
        on = not any(off & int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{flag}", 0)) for flag in flags)
        if not on:
            self.compiled.left.setdefault(SWITCHED_OFF, []).append(part)
        return on

    def of(self, j: int, element: XmlElement, remarks: list[str]) -> dict[str, Any]:
        """Return the keys of a joint's forces.

        Raises
        ------
        SceneError : one of them is of a kind that is not read.
        """
        self.refuse(j, element)
        m, v, p = self.m, int(self.m.jnt_dofadr[j]), int(self.m.jnt_qposadr[j])
        damping, armature = float(m.dof_damping[v]), float(m.dof_armature[v])
        for a in self.actuators.get(j, ()):  # with or without control
            gear = float(m.actuator_gear[a][0]) ** 2
            damping += gear * _first(m, "actuator_damping", a)
            armature += gear * _first(m, "actuator_armature", a)
        friction: dict[str, Any] = {}
        if damping and self.is_on("dampers", "DAMPER"):
            friction["viscous"] = damping
        if m.dof_frictionloss[v] and self.is_on("friction", "FRICTIONLOSS", "CONSTRAINT"):
            friction |= {"coulomb": float(m.dof_frictionloss[v]), "law": "set_valued"}
        spring: dict[str, Any] = {}
        if m.jnt_stiffness[j] and self.is_on("springs", "SPRING"):
            spring["stiffness"] = float(m.jnt_stiffness[j])
            if self.types[j] in SINGLE:
                spring["rest"] = float(m.qpos_spring[p] - m.qpos0[p])
        parts = {"limits": self.limits(j, remarks), "friction": friction, "spring": spring}
        parts = {key: part for key, part in parts.items() if part}
        if self.types[j] == "free":
            parts = {key: dict.fromkeys(("translation", "rotation"), part) for key, part in parts.items()}
        return {"rotor_inertia": armature, **parts} if armature else parts

    def refuse(self, j: int, element: XmlElement) -> None:
        """Raise the error of a joint with a force of a kind that is not read."""
        v, kind = int(self.m.jnt_dofadr[j]), self.types[j]
        on = self.actuators.get(j, ())
        curved = [("jnt_stiffnesspoly", j), ("jnt_springyield", j), ("dof_dampingpoly", v)]
        curved += [("actuator_dampingpoly", a) for a in on]
        parts = [(*part, "is a curve; allowed: one number") for part in curved]
        if kind not in SINGLE:
            single = [("dof_frictionloss", v), *([("dof_armature", v)] if kind == "free" else [])]
            single += [(f"actuator_{key}", a) for key in ("armature", "damping") for a in on]
            parts += [
                (*part, f"is that of a {kind} joint; allowed: of joints with one axis") for part in single
            ]
        for key, number, why in parts:
            if _has(self.m, key, number):
                name = key.partition("_")[2].removesuffix("poly")
                raise element.error(f"joint {self.compiled.name('joint', j)!r}: its {name} {why}")

    def limits(self, j: int, remarks: list[str]) -> dict[str, Any]:
        """Return limits of q and of the torque; nothing of joints with several coordinates."""
        m = self.m
        if self.types[j] not in SINGLE:
            if m.jnt_limited[j]:
                self.compiled.left.setdefault(CONES, []).append(self.compiled.name("joint", j))
            return {}
        limits: dict[str, Any] = {}
        if m.jnt_limited[j] and self.is_on("limits", "LIMIT", "CONSTRAINT"):
            ref = m.qpos0[m.jnt_qposadr[j]]
            limits = {key: float(x - ref) for key, x in zip(("lower", "upper"), m.jnt_range[j])}
        low = high = math.inf
        if j in self.motors:
            ranges = [self.range(a) for a in self.motors[j]]
            low, high = sum(x for x, _ in ranges), sum(x for _, x in ranges)
        if m.jnt_actfrclimited[j]:
            least, most = (float(x) for x in m.jnt_actfrcrange[j])
            low, high = (max(low, least), min(high, most)) if j in self.motors else (least, most)
        if low < high and math.isfinite(high - low):
            limits["effort"] = high if low == -high else (low, high)
        elif math.isfinite(high - low):
            remarks.append(f"its motors give {low:g} to {high:g}: taken as not stated")
        return limits

    def range(self, a: int) -> tuple[float, float]:
        """Return the least and the largest torque of a motor on its joint."""
        m = self.m
        gain, gear = float(m.actuator_gainprm[a][0]), float(m.actuator_gear[a][0])
        low, high = -math.inf, math.inf
        if m.actuator_ctrllimited[a] and gain:
            low, high = sorted(gain * float(x) for x in m.actuator_ctrlrange[a])
        if m.actuator_forcelimited[a]:
            least, most = (float(x) for x in m.actuator_forcerange[a])
            low, high = min(max(low, least), most), max(min(high, most), least)
        if not gear:
            return 0.0, 0.0
        ends = sorted((gear * low, gear * high))
        return ends[0], ends[1]


def _has(model: Any, key: str, number: int) -> bool:
    """Tell whether a row of an array is not all zero; older compilers do not have some arrays."""
    rows = getattr(model, key, None)
    return rows is not None and bool(rows[number].any())


def _first(model: Any, key: str, number: int) -> float:
    """Return the first number of a row of an array, 0 where the compiler does not have it."""
    rows = getattr(model, key, None)
    return 0.0 if rows is None else float(rows[number].flat[0])
