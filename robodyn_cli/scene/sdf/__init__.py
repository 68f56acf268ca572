"""SDFormat 1.5 to 1.12, a dialect of ``scene/dialects.py``."""
