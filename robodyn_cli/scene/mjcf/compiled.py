"""MuJoCo's compiler: the model's arrays, and which element of the file each of its parts is from.

Geometry that gives no inertia is left out before it compiles, so that meshes need not be there; those that give some
are read within bounds here. It is tried in a process of its own first, for it may crash, or loop forever. Whatever the
compiler refuses is told at its element.
"""

from __future__ import annotations

import contextlib
import importlib.util
import os
import re
import threading
import warnings
from collections.abc import Iterator
from importlib.metadata import version
from typing import Any

from robodyn_cli.errors import SceneError
from robodyn_cli.foreign import survive
from robodyn_cli.record import record
from robodyn_cli.scene.mesh.files import MeshError, mesh_bytes
from robodyn_cli.scene.mjcf.source import MjcfText
from robodyn_cli.scene.text.nodes import Faults
from robodyn_cli.scene.urdf.xml import XmlElement

PACKAGE = "mujoco"
_ALONE = threading.Lock()  # warnings of Python and of MuJoCo go to one place of the process
EXTRA = "a robot in MJCF needs the package mujoco{}: pip install 'robodyn[mjcf]'"
OLDEST = "3.3.7"
COMPILER = "MuJoCo's compiler"
SECONDS = 30.0  # that it may take; the most bodies and elements take some three
_OF_TENDONS = ("stiffness", "damping", "frictionloss", "armature")
_SURFACES = ("mjGEOM_PLANE", "mjGEOM_HFIELD", "mjGEOM_SDF")  # without a volume, or one that needs a plugin
_MESHES = (".stl", ".obj")
_TARGETS = ("tendon", "site", "body", "cranksite", "slidersite", "joint", "jointinparent")
# what is left out, see ``MjcfModel``
ACTUATORS, TENDONS = "actuators that are no torques", "tendons"
LIMITS, COLLIDING = "limits of tendons", "contacts of the geoms of"
UNWEIGHED = "the mass of meshes of what stands still"
INACTIVE = "equalities that are not active"
SWITCHED_OFF = "switched off by <flag>"
HELD = "joints held by equalities"
WARNED = f"{COMPILER} warns"


@record
class MjcfModel:
    """A model's arrays; ``elements`` : the element of each body, joint, site, equality, tendon, actuator and geom.

    left : names by what is left out of them. files : of meshes.
    """

    source: MjcfText
    model: Any
    elements: dict[str, dict[int, XmlElement]]
    left: dict[str, list[str]]
    files: tuple[str, ...]

    def name(self, kind: str, number: int) -> str:
        """Return the name of a part, empty without one."""
        return str(getattr(self.model, kind)(number).name)


def compiled(source: MjcfText, faults: Faults) -> MjcfModel | None:
    """Return the model of a file, None where something in it is refused, which is reported.

    Raises
    ------
    SceneError : the package is missing; the compiler refuses the file.
    """
    if importlib.util.find_spec(PACKAGE) is None:
        raise source.root.error(EXTRA.format(""))
    if tuple(map(int, re.findall("[0-9]+", version(PACKAGE))[:3])) < tuple(map(int, OLDEST.split("."))):
        raise source.root.error(EXTRA.format(f" {OLDEST} or newer (here {version(PACKAGE)})"))
    try:
        survive(_Compiler(source, faults).compiled, SECONDS, COMPILER)
    except (TimeoutError, RuntimeError) as error:
        raise source.root.error(f"{COMPILER}: {error}") from None
    return _Compiler(source, faults).compiled()


class _Compiler:
    def __init__(self, source: MjcfText, faults: Faults) -> None:
        import mujoco

        self.source, self.faults, self.mujoco = source, faults, mujoco
        self.left: dict[str, list[str]] = {}
        self.warnings: list[str] = []
        self.files: list[str] = []

    def compiled(self) -> MjcfModel | None:
        with self.telling():
            spec = self.mujoco.MjSpec.from_string(self.source.text)
        self.left_actuators(spec)
        self.left_tendons(spec)
        self.left_geometry(spec)
        if self.faults.found:
            return None
        compiler = spec.compiler
        compiler.fusestatic, compiler.discardvisual, compiler.usethread = False, False, False
        compiler.LRopt.mode = self.mujoco.mjtLRMode.mjLRMODE_NONE  # for muscles, by simulations
        with self.telling():
            spec.assets = self.meshes(spec)
            model = spec.compile()
        kinds = {
            "body": spec.bodies, "joint": spec.joints, "site": spec.sites, "equality": spec.equalities,
            "tendon": spec.tendons, "actuator": spec.actuators, "geom": spec.geoms,
        }  # fmt: skip
        elements = {kind: {x.id: self.source.of(x.info) for x in parts} for kind, parts in kinds.items()}
        if self.warnings:
            self.left[WARNED] = list(dict.fromkeys(" ".join(said.split()) for said in self.warnings))
        return MjcfModel(self.source, model, elements, self.left, tuple(self.files))

    @contextlib.contextmanager
    def telling(self) -> Iterator[None]:
        """Raise what the compiler refuses as the error of the element that it names; what it warns of is kept."""
        mujoco = self.mujoco
        with _ALONE, warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            mujoco.set_mju_user_warning(self.warnings.append)  # else it writes a file
            try:
                yield
            except (ValueError, RuntimeError, mujoco.FatalError) as error:
                if isinstance(error, SceneError):
                    raise
                raise self.error(str(error)) from None
            finally:
                mujoco.set_mju_user_warning(None)
        self.warnings += [str(warning.message) for warning in said]

    def error(self, said: str) -> SceneError:
        lines = [line for line in said.splitlines() if line.strip()]
        text = re.sub("^(XML )?(Error: )*", "", lines[0]) if lines else "it refuses the file"
        return self.source.of(said).error(f"{COMPILER}: {text}")

    def leave(self, title: str, name: str) -> None:
        self.left.setdefault(title, []).append(name)

    # -- what is left out -------------------------------------------------------------------------------
    def left_actuators(self, spec: Any) -> None:
        """Leave out actuators that do not act on one joint, and muscles, of which the compiler makes simulations."""
        trn, gain = self.mujoco.mjtTrn, self.mujoco.mjtGain
        for actuator in list(spec.actuators):
            element = self.source.of(actuator.info)
            on_joint = actuator.trntype in (trn.mjTRN_JOINT, trn.mjTRN_JOINTINPARENT)
            if on_joint and actuator.gaintype != gain.mjGAIN_MUSCLE:
                continue
            with self.faults:
                for key in ("damping", "armature"):
                    if _any(actuator, key):
                        raise element.error(
                            f"<{element.tag}> {actuator.name!r}: its {key} acts on the motion, and is not read; "
                            f"allowed: that of joints"
                        )
            kind = next((key for key in _TARGETS if key in element.attributes), "by its class")
            self.leave(ACTUATORS, f"{actuator.name or '(no name)'} ({element.tag}, {kind})")
            spec.delete(actuator)

    def left_tendons(self, spec: Any) -> None:
        """Leave out tendons that only lead actuators, or that have limits; those with forces are refused."""
        for tendon in list(spec.tendons):
            element = self.source.of(tendon.info)
            acting = [key for key in _OF_TENDONS if _any(tendon, key)]
            with self.faults:
                if acting:
                    raise element.error(
                        f"tendon {tendon.name!r}: its {acting[0]} acts on the motion, and is not read; "
                        "allowed: 'forces' in the scene"
                    )
            limits = self.mujoco.mjtLimited
            by_range = tendon.limited == limits.mjLIMITED_AUTO and tendon.range[0] < tendon.range[1]
            if by_range or tendon.limited == limits.mjLIMITED_TRUE:
                self.leave(LIMITS, tendon.name)
            if element.tag == "spatial":  # fixed ones may stand in equalities
                self.leave(TENDONS, tendon.name)
                self.left_equalities(spec, tendon.name)
                spec.delete(tendon)

    def left_equalities(self, spec: Any, tendon: str) -> None:
        """Leave out equalities of a spatial tendon that are not active; others are refused."""
        kind = self.mujoco.mjtEq.mjEQ_TENDON
        for equality in [x for x in spec.equalities if x.type == kind and tendon in (x.name1, x.name2)]:
            element = self.source.of(equality.info)
            with self.faults:
                if equality.active:
                    raise element.error(
                        f"<tendon> {equality.name!r}: tendon {tendon!r} is spatial; allowed: fixed ones, sums of joints"
                    )
            self.leave(INACTIVE, equality.name or "(no name)")
            spec.delete(equality)

    def left_geometry(self, spec: Any) -> None:
        """Leave out geometry that gives no inertia that counts and is not drawn, and meshes that none is left of."""
        kinds, compiler = self.mujoco.mjtGeom, spec.compiler
        rule, groups = self.mujoco.mjtInertiaFromGeom, compiler.inertiagrouprange
        used = set()
        for body, still in _bodies(spec):
            given = body.explicitinertial and compiler.inertiafromgeom != rule.mjINERTIAFROMGEOM_TRUE
            given = given or compiler.inertiafromgeom == rule.mjINERTIAFROMGEOM_FALSE
            for geom in list(body.geoms):
                if geom.contype or geom.conaffinity:
                    self.leave(COLLIDING, body.name or "(no name)")
                weightless = geom.mass == 0.0 or (geom.mass != geom.mass and geom.density == 0.0)
                weighed = not (given or weightless) and groups[0] <= geom.group <= groups[1]
                if geom.meshname and weighed and still:
                    self.leave(UNWEIGHED, body.name or "(no name)")
                if geom.type in [getattr(kinds, name) for name in _SURFACES] or (
                    geom.meshname and (still or not weighed)
                ):
                    spec.delete(geom)
                elif geom.meshname:
                    geom.contype = geom.conaffinity = 0  # contacts need hulls, which take long
                    used.add(geom.meshname)
        for mesh in list(spec.meshes):
            if mesh.name not in used:
                spec.delete(mesh)

    def meshes(self, spec: Any) -> dict[str, bytes]:
        """Return the files of the meshes that give inertia, under the names that the compiler is told.

        Raises
        ------
        SceneError : one cannot be read, or is in another format.
        """
        folder = os.path.join(self.source.root.place.source.directory, spec.compiler.meshdir)
        spec.compiler.meshdir = ""
        assets = {}
        for number, mesh in enumerate(spec.meshes):
            if not mesh.file:
                continue
            name = os.path.basename(mesh.file.replace("\\", "/")) if spec.strippath else mesh.file
            path = os.path.normpath(os.path.join(folder, name))
            kind = os.path.splitext(path)[1].lower()
            own = f"mesh{number}{kind}"
            try:
                if kind not in _MESHES:
                    raise MeshError(f"allowed: {', '.join(_MESHES)}")
                assets[own] = mesh_bytes(path, checked=True)
            except MeshError as error:
                raise self.source.of(mesh.info).error(
                    f"mesh {mesh.name!r} gives a body its inertia, and {path!r} cannot be read: {error}; "
                    "allowed: an <inertial> in each body that moves, or the file there"
                ) from None
            mesh.file = own
            self.files.append(path)
        return assets


def _any(part: Any, key: str) -> bool:
    """Tell whether numbers of a part are not all zero; older compilers do not know some of them."""
    import numpy as np

    return bool(np.any(getattr(part, key, 0.0)))


def _bodies(spec: Any) -> Iterator[tuple[Any, bool]]:
    """Yield all bodies, each with whether it stands still."""
    pending = [(spec.worldbody, True)]
    while pending:
        body, above = pending.pop()
        still = above and not body.joints
        yield body, still
        pending += ((child, still) for child in body.bodies)
