"""Diagnosis of any file that MuJoCo loads: effects are numbers of the compiled model, played by MuJoCo itself."""
