"""`python -m invdyn` is `invdyn`."""

from .cli import app

app(prog_name="invdyn")
