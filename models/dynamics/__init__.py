"""Equations of motion and their integrators."""
