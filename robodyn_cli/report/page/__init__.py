"""Results as one page for a browser: the mechanism moving, plots that follow it, tables, the scene."""
