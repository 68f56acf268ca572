"""Simulations that run elsewhere: code, data and rules of one structure."""
