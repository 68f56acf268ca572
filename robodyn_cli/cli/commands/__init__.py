"""The commands: one file each, whose function ``command`` is what the table in ``robodyn_cli/commands.py`` offers."""
