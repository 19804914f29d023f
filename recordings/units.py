"""Units that a file's numbers are declared to have; they are never guessed (:mod:`.plausible` checks them)."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from .errors import InputError

METRES = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
RADIANS = {"rad": 1.0, "deg": np.pi / 180}
TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "days": 86400.0}
FRAMES = "frames"  # numbers of frames, for which the frame rate is needed
KINDS = {"length": (*METRES, "px"), "angle": tuple(RADIANS), "time": (*TIMES, FRAMES)}


@dataclass(frozen=True)
class Units:
    """The declared units of a file's numbers, of `KINDS`, None = not declared; and where they are declared.

    `mapping` is the file that declares them for a robot's log, None for the option `--units`.
    """

    length: str | None = None
    angle: str | None = None
    time: str | None = None
    mapping: str | None = None

    def put(self, unit: str, tracks: Sequence[str] = ("angle",)) -> str:
        """How to declare another ``unit`` for numbers of a mapping's ``tracks``: "pass --units deg"."""
        if self.mapping is None:
            return f"pass --units {unit}"
        if unit in TIMES:
            return f'write time_unit = "{unit}" in {self.mapping}'
        lines = " and ".join(f'"{track} = …"' for track in tracks)
        return f'write unit = "{unit}" in each line {lines} of {self.mapping}'

    def accepts(self, unit: str) -> str:
        """How to declare this ``unit`` regardless of the numbers' size: "--units rad"."""
        if self.mapping is None:
            return f"--units {unit}"
        return f'time_unit = "{unit}" in {self.mapping}' if unit in TIMES else f'unit = "{unit}" in {self.mapping}'


def parse_units(text: str | None) -> Units:
    """Read a comma-separated list such as "px" or "mm,deg".

    Raises InputError for a unit that is not known, or two of one kind.
    """
    units = Units()
    for word in (text or "").split(","):
        if not (unit := word.strip()):
            continue
        kind = next((kind for kind, known in KINDS.items() if unit in known), None)
        if kind is None:
            known = ", ".join(", ".join(each) for each in KINDS.values())
            raise InputError(f"unknown unit {unit!r} in --units {text}: known are {known}")
        if getattr(units, kind) is not None:
            raise InputError(f"--units {text} names two units of {kind}")
        units = replace(units, **{kind: unit})
    return units
