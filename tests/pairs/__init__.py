"""Small scenes in which every pair of features meets, run by every command; ``python -m tests.pairs --help``."""
