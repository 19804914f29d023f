"""Inference methods by name: each takes a problem and gives InferenceData."""
