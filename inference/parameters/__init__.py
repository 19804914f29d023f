"""Posteriors of static parameters under their priors: PMMH, SMC² and tempered SMC, for any state-space model."""
