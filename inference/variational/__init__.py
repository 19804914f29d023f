"""Variational SMC: its bound, learned guides and training."""
