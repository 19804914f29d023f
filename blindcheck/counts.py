"""How many cases of each kind: four in ten commanded, where the whole catalogue takes turns."""

import math

from invdyn.recordings import InputError

SHARES = {
    "commanded": 0.40,
    "none": 0.15,
    "passive": 0.10,
    "weak": 0.10,
    "two": 0.08,
    "unknown_torque": 0.09,
    "outside": 0.05,
    "leave_one_out": 0.03,
}
"""Of the default mix."""
MAX_CASES = 100_000
"""Cases, which take a minute each to diagnose: more is a slip of the keyboard."""


def counted(kinds: str | None, cases: int) -> dict[str, int]:
    """Cases by kind: "commanded=200,none=40" as it says; else `cases` shared by `SHARES` over those named, or all.

    Raises InputError for another kind, or a number that is none.
    """
    if cases > MAX_CASES:
        raise InputError(f"expected {MAX_CASES} cases at most, got more")
    given = [part.strip().partition("=") for part in (kinds or ",".join(SHARES)).split(",") if part.strip()]
    for kind, sign, number in given:
        if kind not in SHARES:
            raise InputError(f"expected kinds among {', '.join(SHARES)}, got {kind!r}")
        if sign and not (number.isdecimal() and len(number) <= len(str(MAX_CASES)) and 0 < int(number) <= MAX_CASES):
            raise InputError(f"expected a number of cases of kind {kind} from 1 to {MAX_CASES}, got {number!r:.60}")
    if len({kind for kind, *_ in given}) < len(given) or not given:
        raise InputError(f"expected each kind once, got {kinds!r}")
    fixed = {kind: int(number) for kind, sign, number in given if sign}
    if fixed and len(fixed) < len(given):
        raise InputError(f"expected a number for every kind or for none, got {kinds!r}")
    return fixed or shared_out(cases, {kind: SHARES[kind] for kind, *_ in given})


def shared_out(cases: int, shares: dict[str, float]) -> dict[str, int]:
    """`cases` by shares, by largest remainders; kinds without a case are left out."""
    exact = {kind: cases * share / sum(shares.values()) for kind, share in shares.items()}
    whole = {kind: math.floor(value + 1e-9) for kind, value in exact.items()}
    rest = sorted(exact, key=lambda kind: whole[kind] - exact[kind])[: cases - sum(whole.values())]
    return {kind: count + (kind in rest) for kind, count in whole.items() if count + (kind in rest)}
