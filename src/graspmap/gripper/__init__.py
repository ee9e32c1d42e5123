"""Grippers: what a parallel-jaw gripper is to graspmap, and the profiles that ship."""

from graspmap.gripper.gripper import Gripper

__all__ = ["Gripper"]
