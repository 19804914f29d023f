"""Where and how work runs: seeds, workers, checkpoints."""
