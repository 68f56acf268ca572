"""Robots from URDF files: XML read with places and bounds, its elements, the robot's tree, and readable YAML."""
