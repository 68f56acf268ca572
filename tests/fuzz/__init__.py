"""Mutated inputs against the promise that whatever comes is done right or refused: ``python -m tests.fuzz``."""
