"""The simulation on a recording's rows, with a residual torque; causes, their priors and unknowns."""
