"""The drawing of a result as data for the browser, which projects and paints it from any side."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np

from robodyn_cli.report.drawing.bodies import TracedBody, traced_bodies
from robodyn_cli.report.drawing.build import make_drawing, thinned
from robodyn_cli.report.drawing.camera import Camera, View, along_axis, default_camera
from robodyn_cli.report.drawing.places import nearest
from robodyn_cli.report.drawing.record import Drawing, DrawnLatch, DrawnPart, Trail
from robodyn_cli.report.movie.frames import usual_speed
from robodyn_cli.report.numbers import number, unit
from robodyn_cli.report.page.charts import Arrays
from robodyn_cli.results.moments import Moment, moments
from robodyn_cli.results.result import Result, evenly
from robodyn_cli.scene.mesh.surfaces import CUBE, Surface
from robodyn_cli.spatial.algebra import Array

MOST_POSES = 1500
BODY_NUMBERS = 300_000  # of what bodies do, of all poses; many of them never change
OF_BODY = 9  # place, attitude, speeds
SAME = 1e-9  # of the drawing's size: places that are one
NUMBERS = 200_000  # of vertices, axes and forces of all poses: 0.8 MB, and a third more as text
FEWEST_POSES = 100
TRAILS = 4000  # places of all paths
MOST_MOMENTS = 300  # whose samples are kept in any case
SIDES = {"x-y": 2, "x-z": 1, "y-z": 0}  # views along the world's axes, by what is seen


def motion_data(result: Result, arrays: Arrays, share: float = 1.0) -> dict[str, Any]:
    """Return the drawing of a result that can be drawn, thinned to some poses; its arrays go into ``arrays``.

    share : how much of the room that one drawing may take there is, of one among many.
    """
    happened = moments(result)
    samples = chosen_samples(result.time, happened, math.ceil(share * MOST_POSES))
    drawing = make_drawing(result, samples)
    few = BODY_NUMBERS // (OF_BODY * max(1, len(drawing.links)))
    most = math.ceil(share * max(FEWEST_POSES, min(few, NUMBERS // _numbers_of_pose(drawing))))
    if most < len(samples):
        thinner = chosen_samples(result.time, happened, most)
        kept = np.searchsorted(samples, np.intersect1d(thinner, samples))
        drawing, samples = drawing.at(kept.tolist()), samples[kept]
    view = View(drawing, default_camera(drawing))
    strongest = drawing.strongest
    duration = float(result.time[-1] - result.time[0])
    return {
        **_drawing(drawing, arrays, math.ceil(share * TRAILS)),
        **_view(view),
        "bodies": [_body(body, drawing, arrays) for body in traced_bodies(result, samples)],
        "caption": f"Longest arrow {number(strongest)} N." if strongest > 0.0 else "",
        "speed": usual_speed(duration) if duration > 0.0 else 1.0,
        "poses": len(drawing.times),
        "samples": len(result.time),
    }


def chosen_samples(times: Array, happened: list[Moment], most: int) -> Array:
    """Return at most ``most`` samples evenly apart, and those at moments and before them, in order."""
    if len(times) <= most or not happened:
        return evenly(len(times), most)
    at = nearest(times, np.array([moment.time for moment in happened[:MOST_MOMENTS]]))
    kept = np.concatenate([np.maximum(at - 1, 0), at])[: most // 2]
    return np.union1d(evenly(len(times), most - len(kept)), kept)


def _numbers_of_pose(drawing: Drawing) -> int:
    return 3 * (drawing.vertices.shape[1] + drawing.axes.shape[1] + len(drawing.arrows)) or 1


def _drawing(drawing: Drawing, arrays: Arrays, places: int) -> dict[str, Any]:
    """Return what there is to draw; places : of all paths."""
    share = places // max(1, len(drawing.trails))
    return {
        "times": arrays.put(drawing.times, double=True),
        "vertices": arrays.put(drawing.vertices),
        # most axes never turn
        "axes": arrays.put(drawing.axes if np.ptp(drawing.axes, axis=0).any() else drawing.axes[:1]),
        "parts": [_part(part, arrays) for part in drawing.parts],
        "pins": [_fields(pin) for pin in drawing.pins],
        "masses": drawing.masses,
        "bobs": drawing.bobs,
        "arrows": [{**_fields(arrow), "force": arrays.put(arrow.force)} for arrow in drawing.arrows],
        "trails": [_trail(trail, share, arrays) for trail in drawing.trails],
        "latches": [_latch(latch) for latch in drawing.latches],
        "up": drawing.up.tolist(),
        "size": drawing.size,
        "centre": _centre(drawing),
        "falls": bool(np.any(drawing.gravity)),
    }


def _centre(drawing: Drawing) -> list[float]:
    """Return the middle of everything (3,) [m]."""
    points = drawing.everything
    return (0.5 * (points.min(axis=0) + points.max(axis=0))).tolist() if len(points) else [0.0, 0.0, 0.0]


def _body(body: TracedBody, drawing: Drawing, arrays: Arrays) -> dict[str, Any]:
    """Return what is told of a body; of its place, attitude and speeds a number where one never changes, else an array
    in a list; the number of a vertex where its place is that of one.
    """
    place, attitude, rate, spin = np.split(body.tracks, [3, 7, 10], axis=1)
    torque = None
    if body.torque is not None:
        torque = {"values": [arrays.put(body.torque[0])], "unit": unit(body.torque[1])}
    return {
        "name": body.name,
        "mass": body.mass,
        "centre": None if body.centre is None else body.centre.tolist(),
        "joint": body.joint,
        "loads": list(body.loads),
        "torque": torque,
        "vertex": _vertex(place, drawing),
        "place": [_track(column, arrays) for column in place.T] if _vertex(place, drawing) is None else None,
        "attitude": [_track(column, arrays) for column in attitude.T],
        "speeds": [_track(np.linalg.norm(part, axis=1), arrays) for part in (rate, spin)],
    }


def _vertex(place: Array, drawing: Drawing) -> int | None:
    """Return the number of the vertex that is always at a place (T, 3)."""
    off = np.abs(drawing.vertices - place[:, None]).max(axis=(0, 2))
    near = np.flatnonzero(off < SAME * drawing.size)
    return int(near[0]) if len(near) else None


def _track(column: Array, arrays: Arrays) -> Any:
    if not np.isfinite(column).any():
        return None
    return float(column[0]) if np.ptp(column) == 0.0 else [arrays.put(column)]


def _part(part: DrawnPart, arrays: Arrays) -> dict[str, Any]:
    surface = part.surface or (CUBE if part.kind in ("solid", "payload") else None)
    return {**_fields(part), "surface": None if surface is None else _surface(surface, arrays)}


def _surface(surface: Surface, arrays: Arrays) -> dict[str, Any]:
    return {**_fields(surface), "points": arrays.put(surface.points)}


def _latch(latch: DrawnLatch) -> dict[str, Any]:
    closed = [[start, end if math.isfinite(end) else None] for start, end in latch.closed]
    return {"vertices": latch.vertices, "closed": closed}


def _trail(trail: Trail, most: int, arrays: Arrays) -> dict[str, Any]:
    times, points = thinned(trail.times, trail.points, most)
    return {**_fields(trail), "times": arrays.put(times, double=True), "points": arrays.put(points)}


def _view(view: View) -> dict[str, Any]:
    """Return from where the drawing is seen first, and the lengths that its marks are scaled by."""
    names = [None] if view.numbered else [None, *SIDES]
    cameras = [view.camera if name is None else along_axis(SIDES[name]) for name in names]
    floor = view.floor
    return {
        "cameras": [_camera(name, camera, view) for name, camera in zip(names, cameras)],
        "length": view.length,
        "arrow": view.scale,
        "level": view.level,
        "floor": None if floor is None else [part.tolist() for part in floor],
    }


def _camera(name: str | None, camera: Camera, first: View) -> dict[str, Any]:
    view = first if name is None else View(first.drawing, camera)
    return {
        "name": name or _name(camera),
        "right": camera.right.tolist(),
        "up": camera.up.tolist(),
        "back": camera.back.tolist(),
        "target": camera.target.tolist(),
        "distance": camera.distance if math.isfinite(camera.distance) else None,
        "extent": [corner.tolist() for corner in view.extent],
    }


def _name(camera: Camera) -> str:
    """Return what the first view of a drawing is called."""
    if camera.labels is not None:
        return "-".join(label[0] for label in camera.labels) + " plane"
    return "in space" if math.isfinite(camera.distance) else "face on"


def _fields(record: Any) -> dict[str, Any]:
    """Return the fields of a record that are no arrays."""
    fields = {f.name: getattr(record, f.name) for f in dataclasses.fields(record)}
    return {name: value for name, value in fields.items() if not isinstance(value, np.ndarray)}
