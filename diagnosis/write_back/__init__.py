"""The corrected simulation: a copy of the user's own file in which what the diagnosis found is changed."""
