"""Arithmetic traced as straight-line programs, run by torch or as machine code."""
