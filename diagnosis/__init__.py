"""Where simulation and recording part, why, and by how much less once the cause is added."""

from invdyn.diagnosis.assessment.result import Diagnosis
from invdyn.diagnosis.catalogue import CATALOGUE, CatalogueEntry
from invdyn.diagnosis.check.before import check_before
from invdyn.diagnosis.diagnose import diagnose, save
from invdyn.diagnosis.hypotheses.search import search
from invdyn.diagnosis.problem.diagnosis_problem import DiagnosisProblem, diagnosis_problem
from invdyn.diagnosis.rules import Rules

__all__ = [
    "CATALOGUE",
    "CatalogueEntry",
    "Diagnosis",
    "DiagnosisProblem",
    "Rules",
    "check_before",
    "diagnose",
    "diagnosis_problem",
    "save",
    "search",
]
