"""Motion along a path in the least time."""
