"""Closing loops: from starts near and far, with what is told of those that do not close."""
