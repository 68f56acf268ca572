"""The plots, those of one subject in a file."""

import sys

import matplotlib.artist

if "robodyn_cli.cli.main" in sys.modules:
    # Nobody asks a command for help on matplotlib, whose tables of properties take a third of its import.
    matplotlib.artist.kwdoc = lambda artist: ""
