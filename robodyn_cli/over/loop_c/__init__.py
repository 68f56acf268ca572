"""Simulations that leave as C: the stepping loop of a scene, its closing of loops, and the rules of its errors."""
