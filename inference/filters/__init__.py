"""Particle filters and their proposals, resampling, and smoothing by backward simulation."""
