"""Where simulation and recording part, why, and by how much less once the cause is added."""

from invdyn.diagnosis.answer.result import Diagnosis
from invdyn.diagnosis.diagnose import diagnose, save
from invdyn.diagnosis.question.setting import Setting, setting
from invdyn.diagnosis.searching.search import search

__all__ = ["Diagnosis", "Setting", "diagnose", "save", "search", "setting"]
