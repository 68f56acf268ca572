"""From space to the plane of a drawing: one projection for all painters, and where to look from."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from robodyn_cli.record import record
from robodyn_cli.report.drawing.record import Drawing
from robodyn_cli.spatial.algebra import Array

AXES = ("x", "y", "z")
ELEVATION = math.radians(22.0)
AZIMUTHS = 12  # directions to look from that are compared
DISTANCE = 2.6  # of the eye, over the largest extent


@record
class Camera:
    """Where a drawing is seen from.

    right, up, back : (3,) unit vectors; back points to the eye. target : (3,) the centre [m]. distance : of the eye
    from the target [m]; infinite without perspective. labels : of the axes of a view along a world's axis, else None.
    """

    right: Array
    up: Array
    back: Array
    target: Array
    distance: float = math.inf
    labels: tuple[str, str] | None = None

    def project(self, points: Array) -> Array:
        """Return places on the plane through the target [m] and depth towards the eye [m], from points (..., 3).

        x = s d.right, y = s d.up, d = p - target, s = D / (D - d.back); s = 1 without perspective. A view along a
        world's axis keeps the world's coordinates. What lies behind the eye is not a number.
        """
        d = points - self.target
        with np.errstate(all="ignore"):
            depth = d @ self.back
            scale = np.ones_like(depth)
            if math.isfinite(self.distance):
                gap = self.distance - depth
                scale = np.where(gap > 0.05 * self.distance, self.distance / gap, np.nan)
            x, y = scale * (d @ self.right), scale * (d @ self.up)
        if self.labels is not None:
            x, y = x + self.target @ self.right, y + self.target @ self.up
        return np.stack([x, y, depth], axis=-1)

    def aimed_at(self, target: Array) -> Camera:
        """Return the camera moved so that it looks at another place; the world's coordinates are lost by that."""
        return dataclasses.replace(self, target=target, labels=None)


def along_axis(axis: int) -> Camera:
    """Return the view along a world's axis, with the other two to the right and upwards, z always upwards."""
    eye = np.eye(3)
    right, up = {0: (1, 2), 1: (0, 2), 2: (0, 1)}[axis]
    back = np.cross(eye[right], eye[up])
    return Camera(eye[right], eye[up], back, np.zeros(3), labels=(f"{AXES[right]} [m]", f"{AXES[up]} [m]"))


def default_camera(drawing: Drawing) -> Camera:
    """Return the view of a drawing: flat of a planar mechanism, else in perspective, against gravity upwards.

    Of some directions around, that one is taken from which the shadow of everything is largest.
    """
    if drawing.flat is not None:
        return along_axis(drawing.flat)
    points = drawing.everything
    if not len(points):
        return along_axis(2)
    low, high = points.min(axis=0), points.max(axis=0)
    target = 0.5 * (low + high)
    up = drawing.up
    first = _across(up)
    second = np.cross(up, first)
    cameras = []
    for k in range(AZIMUTHS):
        angle = 2.0 * math.pi * k / AZIMUTHS - math.pi / 3.0
        flat = math.cos(angle) * first + math.sin(angle) * second
        back = math.cos(ELEVATION) * flat + math.sin(ELEVATION) * up
        right = np.cross(up, flat)
        cameras.append(Camera(right, np.cross(back, right), back, target, DISTANCE * drawing.size))
    sample = (points - target)[:: max(1, len(points) // 2000)]
    # the first is the usual one, and it is kept unless another shows clearly more
    shadows = [_shadow(camera, sample) * (1.0 if k else 1.3) for k, camera in enumerate(cameras)]
    return cameras[int(np.argmax(shadows))]


def _across(up: Array) -> Array:
    """Return a unit vector across ``up``: the world's x where that is possible."""
    for axis in np.eye(3):
        rest = axis - (axis @ up) * up
        if np.linalg.norm(rest) > 0.5:
            return np.asarray(rest / np.linalg.norm(rest))
    raise AssertionError("one of three axes is always across")


def _shadow(camera: Camera, points: Array) -> float:
    """Return the determinant of the covariance of points (N, 3), seen from far: how much of a shadow they cast."""
    x, y = points @ camera.right, points @ camera.up
    xx, yy, xy = float(np.mean(x * x)), float(np.mean(y * y)), float(np.mean(x * y))
    return xx * yy - xy * xy
