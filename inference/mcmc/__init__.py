"""Markov chains of whole paths: particle Gibbs, NUTS, and how well they mix."""
