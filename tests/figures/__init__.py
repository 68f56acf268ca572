"""Every figure with its error: the same scene with other samples and tolerances."""
