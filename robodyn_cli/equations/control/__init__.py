"""A controller in the equations: its law, its model, its sensors and its reference as expressions."""
