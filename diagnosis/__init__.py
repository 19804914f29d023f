"""Where simulation and recording part, why, and by how much less once the cause is added."""

from invdyn.diagnosis.diagnose import diagnose, save
from invdyn.diagnosis.result import Diagnosis
from invdyn.diagnosis.search import search
from invdyn.diagnosis.setting import Setting, setting

__all__ = ["Diagnosis", "Setting", "diagnose", "save", "search", "setting"]
