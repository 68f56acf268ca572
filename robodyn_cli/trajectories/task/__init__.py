"""Paths of frames: the segments of a path, arc length, how the frame is turned along it."""
