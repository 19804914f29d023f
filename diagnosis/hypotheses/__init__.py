"""From screened effects to causes: added to one another, dropped, swapped for neighbours; each with its own path."""
