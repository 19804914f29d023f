"""Files of others that cost more than they should: bombs, ways out of a bag's folder, hangs and odd types.

Each input is made by a function of an empty folder and a random generator, which draws its sizes and values, and says
what must come of it: a refusal, a reading (of an honest file that looks odd), or either (of random damage).
"""

from . import bag_paths, bags, bodies_and_arrays, mcap_records, odd_types, parquet_tables
from .kit import ALL, BOMB, EITHER, ODD, PATH, READ, REFUSE

PARTS = (mcap_records, parquet_tables, bags, bodies_and_arrays, bag_paths, odd_types)
"""Importing each adds its inputs to ``ALL``."""

__all__ = ["ALL", "BOMB", "EITHER", "ODD", "PATH", "READ", "REFUSE"]
