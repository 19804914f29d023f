"""Many trials at once: parameters that a session shares, tables, averages, differences between conditions."""
