"""Checks of a scene that look at more than one key."""
