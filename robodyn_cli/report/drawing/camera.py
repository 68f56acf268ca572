"""From space to the plane of a drawing: one projection for all painters, and where to look from.

A drawing before a camera: projected once, then taken apart into strokes for any of its instants.
"""

from __future__ import annotations

import dataclasses
import math
from functools import cached_property

import numpy as np

from robodyn_cli.record import record
from robodyn_cli.report.drawing.record import Drawing
from robodyn_cli.results.result import evenly
from robodyn_cli.spatial.algebra import Array

AXES = ("x", "y", "z")
AZIMUTHS = 24  # directions to look from that are compared, at each of the elevations
ELEVATIONS = tuple(math.radians(x) for x in (22.0, 12.0, 35.0))
PLACES, INSTANTS = 80, 9  # of joints and links at most, and at how many instants, that are to be seen apart
APART = 0.08  # of the size, at which two places count as apart
USUAL = 1.1  # by how much another direction must be better than the usual one
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
    """Return the view of a drawing: face on of a planar mechanism, else in perspective, against gravity upwards.

    Of directions around and above, that one is taken from which joints and links lie apart over the whole motion, and
    the shadow of everything is large.
    """
    if drawing.flat is not None:
        return along_axis(drawing.flat)
    points = drawing.everything
    if not len(points):
        return along_axis(2)
    low, high = points.min(axis=0), points.max(axis=0)
    target = 0.5 * (low + high)
    if drawing.normal is not None:
        return face_on(drawing.normal, drawing.up, target)
    cameras = _around(drawing.up, target, DISTANCE * drawing.size)
    sample = (points - target)[:: max(1, len(points) // 2000)]
    shadows = np.array([_shadow(camera, sample) for camera in cameras])
    seen = np.sqrt(np.sqrt(np.maximum(shadows, 0.0) / max(float(shadows.max()), 1e-300)))
    places = _to_tell_apart(drawing)
    if places.shape[1] > 1:
        seen = 0.5 * seen + [_apart(camera, places, APART * drawing.size) for camera in cameras]
    seen[0] *= USUAL
    return cameras[int(np.argmax(seen))]


def face_on(normal: Array, up: Array, target: Array) -> Camera:
    """Return the view along the normal of a plane, without perspective, against gravity upwards where it has a part in
    the plane."""
    level = up - (up @ normal) * normal
    size = float(np.linalg.norm(level))
    high = level / size if size > 0.1 else np.cross(normal, _across(normal))
    # of both sides of the plane the one that shows the world's axes as they are drawn: x to the right, y away or up
    side = normal if np.cross(high, normal).sum() >= 0.0 else -normal
    return Camera(np.cross(high, side), high, side, target)


def _around(up: Array, target: Array, distance: float) -> list[Camera]:
    """Return cameras around a place and above it, the usual one first."""
    first = _across(up)
    second = np.cross(up, first)
    cameras = []
    for elevation in ELEVATIONS:
        for k in range(AZIMUTHS):
            angle = 2.0 * math.pi * k / AZIMUTHS - math.pi / 3.0
            flat = math.cos(angle) * first + math.sin(angle) * second
            back = math.cos(elevation) * flat + math.sin(elevation) * up
            right = np.cross(up, flat)
            cameras.append(Camera(right, np.cross(back, right), back, target, distance))
    return cameras


def _to_tell_apart(drawing: Drawing) -> Array:
    """Return places (K, N, 3) of joints, of the ends of links and of their middles, at some instants."""
    few = drawing.vertices[evenly(len(drawing.vertices), INSTANTS)]
    ends = sorted({vertex for part in drawing.links for vertex in part.vertices})
    joints = sorted({pin.vertex for pin in drawing.pins} - set(ends))
    middles = [few[:, list(part.vertices)].mean(axis=1) for part in drawing.links if len(part.vertices) > 1]
    places = np.concatenate([few[:, [*ends, *joints]], *(middle[:, None] for middle in middles)], axis=1)
    places = places[:, np.isfinite(places).all(axis=(0, 2))]
    return np.asarray(places[:, evenly(places.shape[1], PLACES)])


def _apart(camera: Camera, places: Array, enough: float) -> float:
    """Return how far places (K, N, 3) that are apart in space are seen apart: 1 if all of them by ``enough`` [m]."""
    seen = np.stack([places @ camera.right, places @ camera.up], axis=-1)
    first, second = np.triu_indices(places.shape[1], 1)
    gaps, lengths = (
        np.minimum(np.linalg.norm(x[:, first] - x[:, second], axis=-1), enough) for x in (seen, places)
    )
    # places that are nearly one tell nothing
    return float(np.sum(gaps * lengths) / max(float(np.sum(lengths * lengths)), 1e-300))


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


WIDEST, NARROWEST = 9.0, 1.0  # of a link [pt]
USUAL_WIDTH = 2.2  # of links [pt], below which marks and lines of joints are smaller as links are
LARGEST = 4.0  # radius of a joint [pt]
MARGIN = 0.07  # around the drawing, of its extent
ARROW = 0.22  # length of the largest arrow, of the drawing's size
PITCHES = (1.0, 2.0, 5.0, 10.0)
MOST_LINES = 400  # of a grid


class View:
    """A drawing as it is seen by a camera.

    Parameters
    ----------
    follow : (T, 3), where the camera looks at each instant; by default always at its target. near : whether what is
    shown leaves out how far payloads fly.

    ``corners`` : (T, N, 3), the vertices' places and depths. ``low``, ``high`` : (2,), of the plane that is shown, and
    ``pt``, the length of a printer's point in it, once ``fit`` has been told the room.
    """

    def __init__(
        self, drawing: Drawing, camera: Camera, follow: Array | None = None, near: bool = False
    ) -> None:
        self.drawing, self.camera, self.follow, self.near = drawing, camera, follow, near
        if follow is None:
            self.corners = camera.project(drawing.vertices)
        else:
            self.corners = np.stack([self.project(v, k) for k, v in enumerate(drawing.vertices)])
        self.scale = _arrow_scale(drawing)
        up, points = drawing.up, drawing.everything
        self.level = float((points @ up).min()) if len(points) else 0.0
        self.extent = self._extent()
        self.low, self.high = self.extent
        self.pt = float((self.high - self.low).max()) / 300.0

    @property
    def link_width(self) -> float:
        """Width of links [pt]: less where they are short."""
        return float(np.clip(0.11 * self.length / self.pt, NARROWEST, WIDEST)) if self.length else 6.0

    @property
    def finer(self) -> float:
        """Factor of marks and their lines: below 1 where links are so short that they would hide them."""
        return min(1.0, self.link_width / USUAL_WIDTH)

    @property
    def radius(self) -> float:
        """Radius of joints [pt]: as large as links are wide, and never larger than they are long."""
        return float(min(0.36 * max(self.link_width, USUAL_WIDTH) + 0.9, LARGEST)) * self.finer

    @cached_property
    def length(self) -> float:
        """Median length of links as they are seen first [m], 0 where none has any."""
        lengths = []
        for part in self.drawing.links:
            points = self.corners[0, list(part.vertices), :2]
            points = points[np.isfinite(points).all(axis=1)]
            lengths += [float(np.ptp(points, axis=0).max())] if len(points) > 1 else []
        lengths = [length for length in lengths if length > 0.0]
        return float(np.median(lengths)) if lengths else 0.0

    @property
    def flat(self) -> bool:
        """Whether the view is without perspective: along a world's axis or across the plane of a mechanism."""
        return not math.isfinite(self.camera.distance)

    @property
    def numbered(self) -> bool:
        """Whether the view is along one of the world's axes, and keeps its coordinates."""
        return self.camera.labels is not None

    @property
    def nearer(self) -> float:
        """How much nearer to the eye marks are painted [m]: bodies in front hide a mark, its own does not.

        Where links have shapes of their own, a mark inside them is hidden.
        """
        return 0.0 if self.drawing.shaped else 0.02 * self.drawing.size

    def project(self, points: Array, k: int) -> Array:
        """Return places and depths (..., 3) of points at the k-th instant."""
        camera = self.camera if self.follow is None else self.camera.aimed_at(self.follow[k])
        return camera.project(points)

    def fit(self, width: float, height: float) -> None:
        """Choose what is shown in a room of so many printer's points: everything, at equal scales."""
        low, high = self.extent
        centre, extent = 0.5 * (low + high), (high - low) * (1.0 + 2.0 * MARGIN)
        # room for the marks of joints at the rim
        room = np.maximum([width - 30.0, height - 30.0], 10.0)
        self.pt = max(float((extent / room).max()), 1e-12)
        half = 0.5 * self.pt * np.array([width, height])
        self.low, self.high = centre - half, centre + half

    def on_ground(self, points: Array) -> Array:
        """Return points (..., 3) put down on the ground, along gravity."""
        up = self.drawing.up
        return np.asarray(points - ((points @ up) - self.level)[..., None] * up)

    def tips(self, k: int) -> list[tuple[Array, Array]]:
        """Return tail and vector (2,) of each arrow at an instant."""
        drawn = []
        for arrow in self.drawing.arrows:
            tail = self.drawing.vertices[k, arrow.vertex]
            tip = tail + self.scale * arrow.force[k]
            a, b = self.project(np.stack([tail, tip]), k)[:, :2]
            drawn.append((a, b - a))
        return drawn

    def _extent(self) -> tuple[Array, Array]:
        """Return the corners (2,) of what is to be seen."""
        out = self.drawing.carried if self.near else set()
        kept = [k for k in range(self.corners.shape[1]) if k not in out]
        trails = [trail for trail in self.drawing.trails if not (self.near and trail.flight)]
        clouds = [self.corners[:, kept, :2].reshape(-1, 2)]
        if self.follow is None:
            clouds += [self.camera.project(trail.points)[:, :2] for trail in trails]
            clouds += [np.array([a + v for a, v in self.tips(k)]).reshape(-1, 2) for k in self._some()]
        points = np.concatenate(clouds)
        points = points[np.isfinite(points).all(axis=1) & (np.abs(points) < 1e100).all(axis=1)]
        if not len(points):
            return np.full(2, -1.0), np.full(2, 1.0)
        low, high = points.min(axis=0), points.max(axis=0)
        size = float((high - low).max())
        # a mechanism that is but a line still has room around it
        least = 0.3 * size if size > 0.0 else 1.0
        short = np.maximum(least - (high - low), 0.0)
        return low - 0.5 * short, high + 0.5 * short

    def _some(self) -> range:
        count = len(self.drawing.times)
        return range(0, count, max(1, count // 100))

    @property
    def pitch(self) -> float:
        """Distance of the lines of a grid [m]: a round number, some eight across."""
        span = float((self.high - self.low).max()) / 8.0
        power = 10.0 ** math.floor(math.log10(span))
        return power * next(p for p in PITCHES if p * power >= span * (1.0 - 1e-9))

    def grid(self, k: int) -> list[Array]:
        """Return the lines of a grid, (2, 2) each: in the plane of a flat view, else on the ground below everything."""
        pitch = self.pitch
        if self.flat:
            shift = np.zeros(2) if self.follow is None else self._shift(k)
            return [
                line
                for axis in (0, 1)
                for line in _lines(self.low + shift, self.high + shift, pitch, axis, shift)
            ]
        if self.floor is None:
            return []
        axes, low, high = self.floor
        low, high = (np.floor(low / pitch) - 1.0) * pitch, (np.ceil(high / pitch) + 1.0) * pitch
        lines = [line for axis in (0, 1) for line in _lines(low, high, pitch, axis, np.zeros(2))]
        placed = [line @ axes + self.level * self.drawing.up for line in lines]
        return [self.project(line, k)[:, :2] for line in placed]

    @cached_property
    def floor(self) -> tuple[Array, Array, Array] | None:
        """Two level directions (2, 3), and how far everything reaches along them, (2,) each."""
        points = self.drawing.everything
        if not len(points):
            return None
        axes = _level_axes(self.drawing.up)
        return axes, (points @ axes.T).min(axis=0), (points @ axes.T).max(axis=0)

    def _shift(self, k: int) -> Array:
        assert self.follow is not None
        return np.array([self.follow[k] @ self.camera.right, self.follow[k] @ self.camera.up])


def _level_axes(up: Array) -> Array:
    """Return two unit vectors (2, 3) across ``up``."""
    helper = np.eye(3)[int(np.argmin(np.abs(up)))]
    first = np.cross(helper, up)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(up, first)])


def _lines(low: Array, high: Array, pitch: float, axis: int, shift: Array) -> list[Array]:
    """Return lines across one axis at whole multiples of the pitch, moved back by ``shift``."""
    marks = np.arange(math.ceil(low[axis] / pitch), math.floor(high[axis] / pitch) + 1)[:MOST_LINES]
    lines = []
    for mark in marks:
        line = np.array([low, high], dtype=float)
        line[:, axis] = mark * pitch
        lines.append(line - shift)
    return lines


def _arrow_scale(drawing: Drawing) -> float:
    """Return the length of an arrow over its force [m/N]."""
    return ARROW * drawing.size / drawing.strongest if 0.0 < drawing.strongest < math.inf else 0.0
