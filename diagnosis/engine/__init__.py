"""Diagnosis of whatever MuJoCo loads: effects are numbers of the compiled model, played by MuJoCo itself."""
