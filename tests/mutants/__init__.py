"""Deliberate faults in the modules that make figures, and whether the quick tests see them; ``python -m tests.mutants --help``."""
