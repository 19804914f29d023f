"""The articulated body as a state-space model: time grid, drive, step, observation."""
