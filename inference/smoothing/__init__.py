"""Linear-Gaussian smoothing, and Gauss–Newton and posterior linearisation on top of it."""
