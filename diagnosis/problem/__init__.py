"""What is asked: the simulation on the recording's rows, with a residual torque; causes, their priors and unknowns."""
