"""A scene in another engine: Pinocchio or MuJoCo."""
