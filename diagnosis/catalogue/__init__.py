"""What a diagnosis knows of each effect, as data: one entry an effect, one file a family."""

from invdyn.diagnosis.catalogue.catalogue import CATALOGUE
from invdyn.diagnosis.catalogue.entry import Catalogue, CatalogueEntry, Variant

__all__ = ["CATALOGUE", "Catalogue", "CatalogueEntry", "Variant"]
