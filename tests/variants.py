"""Non-ideal variants of effects, as the catalogue has them."""

from invdyn.diagnosis.catalogue import CATALOGUE

nonideal = CATALOGUE.nonideal
