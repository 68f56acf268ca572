"""Kernels of long chains and large trees, whose loops over bodies stay loops in the code."""
