"""Motors, gears and brakes of drives: their data, what they bear, and what they lose."""
