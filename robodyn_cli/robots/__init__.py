"""Robots and mechanisms as scenes, with the source of every constant in their comments."""
