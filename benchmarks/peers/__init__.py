"""The cases that engines are compared on, and each engine driven in its fastest way: one file an engine."""
