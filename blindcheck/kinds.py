"""Kinds of cases, as data: how many effects, how large, and what else is true of a case; and how many of each kind.

commanded         one effect, under known commands
passive           one effect, no torque
none              no effect; a fifth passive, a fifth with unknown torque
weak              one effect of a quarter of the usual size
two               two effects at once
unknown_torque    one effect, and the command is not given
outside           an effect that the catalogue lacks
leave_one_out     one effect, to be struck from the catalogue with all that can make the very same recording: of
these no method could say that one is missing
as_real           a robot's log: friction and rotors at all joints, errors of all links, and one or two odd effects
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from invdyn.recordings import InputError


@dataclass(frozen=True)
class Kind:
    """One kind.

    Attributes:
        share: of the default mix.
        numbers: of effects that a case draws, each as often.
        regimes: how torques are known, with probabilities.
        strength: of the effects, 1 where they are typical.
        lacks: what no case has; effects with this need (`effects.Injected.needs`) are left out.
        needs: what every case has.
        barred: further effects that are left out.
        everywhere: effects at all joints or links in addition, with their strength.
        robot: whether the recording has encoders alone, and is diagnosed as a robot's log.
    """

    share: float
    numbers: tuple[int, ...] = (1,)
    regimes: Mapping[str, float] = field(default_factory=lambda: {"commanded": 1.0})
    strength: float = 1.0
    lacks: str = ""
    needs: tuple[str, ...] = ()
    barred: tuple[str, ...] = ()
    everywhere: Mapping[str, float] = field(default_factory=dict)
    robot: bool = False


KINDS = {
    "commanded": Kind(0.40),
    "passive": Kind(0.10, regimes={"passive": 1.0}, lacks="command"),
    "none": Kind(0.15, (0,), {"commanded": 0.6, "passive": 0.2, "unknown_torque": 0.2}),
    "weak": Kind(0.10, strength=0.25),
    "two": Kind(0.08, (2,), barred=("clock_rate",)),
    "unknown_torque": Kind(0.09, regimes={"unknown_torque": 1.0}, lacks="clock"),
    "outside": Kind(0.05),
    "leave_one_out": Kind(0.03),
    "as_real": Kind(
        0.05,
        (1, 2),
        needs=("two joints",),
        barred=("clock_rate", "payload"),  # a payload is an error of the last link
        everywhere={"viscous_friction": 1.0, "coulomb_friction": 1.0, "armature": 1.0, "inertial_error": 0.4},
        robot=True,
    ),
}
"""By name."""
MAX_CASES = 100_000
"""Cases, which take a minute each to diagnose: more is a slip of the keyboard."""


def counted(kinds: str | None, cases: int) -> dict[str, int]:
    """Cases by kind: "commanded=200,none=40" as it says; else `cases` shared over those named, or over all.

    Raises InputError for another kind, or a number that is none.
    """
    if cases > MAX_CASES:
        raise InputError(f"expected {MAX_CASES} cases at most, got more")
    given = [part.strip().partition("=") for part in (kinds or ",".join(KINDS)).split(",") if part.strip()]
    for kind, sign, number in given:
        if kind not in KINDS:
            raise InputError(f"expected kinds among {', '.join(KINDS)}, got {kind!r}")
        if sign and not (number.isdecimal() and len(number) <= len(str(MAX_CASES)) and 0 < int(number) <= MAX_CASES):
            raise InputError(f"expected a number of cases of kind {kind} from 1 to {MAX_CASES}, got {number!r:.60}")
    if len({kind for kind, *_ in given}) < len(given) or not given:
        raise InputError(f"expected each kind once, got {kinds!r}")
    fixed = {kind: int(number) for kind, sign, number in given if sign}
    if fixed and len(fixed) < len(given):
        raise InputError(f"expected a number for every kind or for none, got {kinds!r}")
    return fixed or shared_out(cases, {kind: KINDS[kind].share for kind, *_ in given})


def shared_out(cases: int, shares: dict[str, float]) -> dict[str, int]:
    """`cases` by shares, by largest remainders; kinds without a case are left out."""
    exact = {kind: cases * share / sum(shares.values()) for kind, share in shares.items()}
    whole = {kind: math.floor(value + 1e-9) for kind, value in exact.items()}
    rest = sorted(exact, key=lambda kind: whole[kind] - exact[kind])[: cases - sum(whole.values())]
    return {kind: count + (kind in rest) for kind, count in whole.items() if count + (kind in rest)}
