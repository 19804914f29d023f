"""`python -m invdyn` is `invdyn`."""

from .cli import app

if __name__ == "__main__":  # MPI's workers import this file too
    app(prog_name="invdyn")
