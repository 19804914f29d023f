"""What every effect of the catalogue would change in the recording, and its evidence, linearised about one path."""
