"""Controllers: each kind a file with its keys and its law."""
