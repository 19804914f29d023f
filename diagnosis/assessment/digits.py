"""To how many digits a number is worth saying: the Particle Data Group's rule.

Two digits of the uncertainty where it begins with 1 or 2, else one.
"""

import math


def decimals(uncertainty: float) -> int:
    """Decimal places that a standard deviation supports; negative: whole tens, hundreds …"""
    exponent = math.floor(math.log10(uncertainty))
    return (1 if uncertainty / 10.0**exponent < 2.95 else 0) - exponent
