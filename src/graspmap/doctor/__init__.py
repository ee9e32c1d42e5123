"""The doctor: what is in a folder of scenes, meshes or weights, and what is broken."""

from graspmap.doctor.examine import EXAMINERS, Examiner, examine
from graspmap.doctor.report import Problem, Report
from graspmap.doctor.sheet import contact_sheet_of

__all__ = ["EXAMINERS", "Examiner", "Problem", "Report", "contact_sheet_of", "examine"]
