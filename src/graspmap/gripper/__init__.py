"""Grippers: what a parallel-jaw gripper is to graspmap, and the profiles that ship."""

from graspmap.gripper.gripper import Gripper
from graspmap.gripper.shipped import load_gripper, profile_names, profile_path

__all__ = ["Gripper", "load_gripper", "profile_names", "profile_path"]
