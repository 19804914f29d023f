"""From a recording and a body to a problem, and from draws to InferenceData."""
