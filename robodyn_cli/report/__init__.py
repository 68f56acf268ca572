"""Drawings of results; matplotlib is imported when something is drawn and not before."""

from robodyn_cli.report.registry import draw, draw_all, plot_files

__all__ = ["draw", "draw_all", "plot_files"]
