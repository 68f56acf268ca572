"""MJCF, the format of MuJoCo, by the arrays of its compiler: a dialect of ``scene/dialects.py``."""
