"""Shapes of links for pictures: their surfaces; meshes, read from files and made small."""
