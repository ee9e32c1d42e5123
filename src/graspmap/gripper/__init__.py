"""Grippers: what a parallel-jaw gripper is to graspmap, and the profiles that ship."""

from graspmap.gripper.gripper import Gripper, check_gripper
from graspmap.gripper.shipped import load_gripper, profile_names, profile_path

__all__ = ["Gripper", "check_gripper", "load_gripper", "profile_names", "profile_path"]
