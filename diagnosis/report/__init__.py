"""The report of a diagnosis: one self-contained page."""

from invdyn.diagnosis.report.report import render, write_report

__all__ = ["render", "write_report"]
