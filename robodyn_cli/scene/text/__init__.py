"""The text of a scene: YAML to a tree whose nodes know their place, other files brought in, and back to YAML."""
