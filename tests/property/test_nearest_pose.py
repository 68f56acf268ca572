"""The closed pose that `assemble` takes without a start, beside one that shares no code with it: own kinematics of
random mechanisms, and SciPy's SLSQP, which minimises the distance from q = 0 under the conditions of the loops."""

from __future__ import annotations

import dataclasses
import functools
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import minimize

from robodyn_cli import load_scene_text
from robodyn_cli.works.assemble import assemble
from tests.oracle.test_urdf_loops import MASS, matrix, origin, words

STARTS = 9  # of SLSQP for each mechanism
MECHANISMS = 5  # of each family
SHARE = 0.8  # of the mechanisms whose pose is at least as near as the nearest of SLSQP
CLOSED = 1e-9
PLANAR = {"revolute": 2, "fixed": 3}  # rows of loops in a plane
SPATIAL = {"revolute": 5, "planar": 3, "fixed": 6, "prismatic": 5}
SPREADS = (0.3, 1.0, 3.0)
AXES, ALL = [(0, 2), (1, 2)], [(0, 1), (1, 2), (2, 0)]
SINES = {"revolute": AXES, "planar": AXES, "fixed": ALL, "prismatic": ALL}  # between axes of the two ends


@dataclasses.dataclass
class Loop:
    """Frames on the ends of two branches: links, their places there, and what is held along the axis z."""

    kind: str
    links: tuple[int, int]
    frames: tuple[np.ndarray, np.ndarray]


@dataclasses.dataclass
class Mechanism:
    """Branches of joints on the ground: each has a parent (-1: ground), an origin, an axis, and turns or slides."""

    parents: list[int]
    origins: list[np.ndarray]
    axes: np.ndarray
    turns: list[bool]
    loops: list[Loop] = dataclasses.field(default_factory=list)

    @classmethod
    def random(cls, rng: np.random.Generator, planar: bool) -> Mechanism:
        """Return branches with one or two loops between their ends, which close at some random pose."""
        rows = PLANAR if planar else SPATIAL
        kinds = [str(kind) for kind in rng.choice(list(rows), rng.integers(1, 3))]
        joints, branches = sum(rows[kind] for kind in kinds) + int(rng.integers(1, 4)), len(kinds) + 1
        parents, origins, axes, turns, ends = [], [], [], [], []
        for branch in range(branches):
            for k in range((joints + branch) // branches):
                parents.append(len(parents) - 1 if k else -1)
                turns.append(bool(rng.random() < 0.85))
                xyz, rpy, axis = rng.uniform(-0.5, 0.5, 3), rng.uniform(-1.5, 1.5, 3), rng.normal(size=3)
                if planar:
                    xyz[2], rpy[:2], axis[:] = 0.0, 0.0, (0, 0, 1) if turns[-1] else (1, 0, 0)
                origins.append(matrix(xyz, rpy))
                axes.append(axis / np.linalg.norm(axis))
            ends.append(len(parents) - 1)
        mechanism = cls(parents, origins, np.array(axes), turns)
        T = mechanism.poses(rng.uniform(-2.0, 2.0, joints) * np.where(turns, 1.0, 0.3))
        for kind, first, second in zip(kinds, ends, ends[1:]):
            flat = np.array([1.0, 1.0, 0.0]) if planar else np.ones(3)
            frame = matrix(rng.uniform(-0.3, 0.3, 3) * flat, rng.uniform(-3, 3, 3) * (1.0 - planar * flat))
            meeting = np.linalg.inv(T[second]) @ T[first] @ frame
            mechanism.loops.append(Loop(kind, (first, second), (frame, meeting)))
        return mechanism

    @property
    def lengths(self) -> np.ndarray:
        """Return 1 for angles, and the size of the mechanism for what slides."""
        ends = [np.linalg.norm(frame[:3, 3]) for loop in self.loops for frame in loop.frames]
        size = max([sum(np.linalg.norm(T[:3, 3]) for T in self.origins), *ends])
        return np.where(self.turns, 1.0, size)

    def poses(self, q: np.ndarray) -> list[np.ndarray]:
        """Return the pose of each link."""
        T: list[np.ndarray] = []
        for k, parent in enumerate(self.parents):
            own = np.eye(4)
            if self.turns[k]:
                K = np.cross(np.eye(3), self.axes[k])
                own[:3, :3] += np.sin(q[k]) * K + (1.0 - np.cos(q[k])) * K @ K
            else:
                own[:3, 3] = q[k] * self.axes[k]
            T.append((T[parent] if parent >= 0 else np.eye(4)) @ self.origins[k] @ own)
        return T

    def motion(self, T: list[np.ndarray], link: int, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the Jacobians (3, n) of a point's velocity and of a link's angular velocity."""
        Jv, Jw = np.zeros((3, len(T))), np.zeros((3, len(T)))
        while link >= 0:
            axis = T[link][:3, :3] @ self.axes[link]
            if self.turns[link]:
                Jw[:, link], Jv[:, link] = axis, np.cross(axis, at - T[link][:3, 3])
            else:
                Jv[:, link] = axis
            link = self.parents[link]
        return Jv, Jw

    def at(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """Return what the loops are off by (m,), its derivative (m, n), and the least cosine of the turns held."""
        T, F, J, cosine = self.poses(q), [], [], 1.0
        for loop in self.loops:
            A, B = (T[link] @ frame for link, frame in zip(loop.links, loop.frames))
            (Av, Aw), (Bv, Bw) = (self.motion(T, link, X[:3, 3]) for link, X in zip(loop.links, (A, B)))
            gap, e, f = B[:3, 3] - A[:3, 3], A[:3, :3], B[:3, :3]
            for k in {"planar": (2,), "prismatic": (0, 1)}.get(loop.kind, (0, 1, 2)):
                F.append(e[:, k] @ gap)
                J.append(e[:, k] @ (Bv - Av) + np.cross(e[:, k], gap) @ Aw)
            for i, j in SINES[loop.kind]:
                F.append(e[:, i] @ f[:, j])
                J.append(np.cross(f[:, j], e[:, i]) @ (Bw - Aw))
            along = e[:, 2] @ f[:, 2]
            cosine = min(cosine, along if SINES[loop.kind] is AXES else (np.trace(e.T @ f) - 1.0) / 2.0)
        return np.array(F), np.array(J), float(cosine)

    def nearest(self, rng: np.random.Generator) -> float:
        """Return the least distance from q = 0 of the closed poses that SLSQP comes to."""
        L, best = self.lengths, np.inf
        any_pose = [self.at(L * rng.uniform(-1.0, 1.0, len(L)))[1] for _ in range(3)]
        rows = np.abs(any_pose).max(axis=(0, 2)) > 1e-12  # SLSQP takes none that vanish

        @functools.lru_cache(2)
        def at(bits: bytes) -> tuple[np.ndarray, np.ndarray]:
            F, J, _ = self.at(L * np.frombuffer(bits))
            return F[rows], J[rows] * L

        for k in range(STARTS):
            end = minimize(
                lambda x: (0.5 * x @ x, x), SPREADS[k % len(SPREADS)] * rng.uniform(-1.0, 1.0, len(L)), jac=True,
                method="SLSQP", options={"maxiter": 100, "ftol": 1e-14},
                constraints={"type": "eq", "fun": lambda x: at(x.tobytes())[0], "jac": lambda x: at(x.tobytes())[1]},
            ).x  # fmt: skip
            off, _, cosine = self.at(L * end)
            if np.abs(off).max() < CLOSED and cosine > 0.5:
                best = min(best, float(np.linalg.norm(end)))
        return best

    @property
    def urdf(self) -> str:
        text = '<link name="ground"/>'
        for k, parent in enumerate(self.parents):
            kind = "continuous" if self.turns[k] else "prismatic"
            limit = "" if self.turns[k] else '<limit lower="-9" upper="9" effort="1" velocity="1"/>'
            text += (
                f'<link name="link{k}">{MASS}</link><joint name="j{k}" type="{kind}">{limit}'
                f'<parent link="{f"link{parent}" if parent >= 0 else "ground"}"/><child link="link{k}"/>'
                f'{origin(self.origins[k])}<axis xyz="{words(self.axes[k])}"/></joint>'
            )
        for k, loop in enumerate(self.loops):
            ends = (
                f'<{end} link="link{link}">{origin(frame)}</{end}>'
                for end, link, frame in zip(("predecessor", "successor"), loop.links, loop.frames)
            )
            text += f'<loop name="l{k}" type="{loop.kind}">{"".join(ends)}<axis xyz="0 0 1"/></loop>'
        return f'<robot name="r">{text}</robot>'


@pytest.mark.parametrize("planar", [True, False])
def test_no_closed_pose_nearer_is_known(tmp_path: Path, planar: bool) -> None:
    as_near, tried = 0, 0
    for seed in range(MECHANISMS):
        rng = np.random.default_rng([seed, planar])
        mechanism = Mechanism.random(rng, planar)
        path = tmp_path / f"{seed}.urdf"
        path.write_text(mechanism.urdf, encoding="utf-8")
        result = assemble(load_scene_text(f"schema: 1\ngravity: [0, 0, -9.81]\nrobot: {path}\n"))
        q = np.array([result.summary["configuration"][f"j{k}"] for k in range(len(mechanism.parents))])
        off, _, cosine = mechanism.at(q)
        assert np.abs(off).max() < 1e-10 and cosine > 0.999999
        distance = float(np.linalg.norm(q / mechanism.lengths))
        assert distance == pytest.approx(result.summary["nearest"]["distance"], rel=1e-9)
        tried += 1
        as_near += distance < mechanism.nearest(rng) + 1e-6
    assert as_near >= SHARE * tried
