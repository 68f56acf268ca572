"""Are the errors that runs print their true errors? Random scenes against equations of Pinocchio and closed forms."""
