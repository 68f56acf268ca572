"""One plot a file; see ``report/registry.py``."""
