"""A mechanism as a drawing: what there is to draw, and how it looks from a camera. Painters show what this says."""
