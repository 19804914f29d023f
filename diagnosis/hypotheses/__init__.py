"""From screened effects to causes: refined with a path of their own, added to one another, exchanged for relatives."""
