"""Diagnosis of any file that MuJoCo loads: effects are numbers of the compiled model, simulated by MuJoCo itself."""
