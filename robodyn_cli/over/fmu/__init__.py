"""Simulations that leave as units of FMI 3.0."""
