"""Losses between predicted and drawn grasp maps."""

from graspmap.losses.grasp import Base, GraspLoss, GraspLossTerms, Positional

__all__ = ["Base", "GraspLoss", "GraspLossTerms", "Positional"]
