"""What residuals and rounding make of configurations at rest."""
