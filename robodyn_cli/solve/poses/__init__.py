"""Inverse kinematics of poses: closed forms by structure, damped steps as expressions for all other mechanisms."""
