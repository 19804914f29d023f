"""One trial of a study, and what every trial of it is inferred with."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from invdyn.inference.filters.filtering import SMCOptions
from invdyn.models import ArticulatedBody
from invdyn.recordings import InputError, Recording

TAKEN = frozenset(
    {
        *("trial", "subject", "session", "joint", "quantity", "unit", "mean", "sd", "q05", "median", "q95", "reason"),
        *("time", "trials", "trial_q05", "trial_q95", "first", "second", "direction", "found"),
        *("torque", "angle", "velocity", "draw", "row"),
    }
)
"""Columns and variables of a study's files: no factor may have the name of one."""


@dataclass(frozen=True)
class Trial:
    """A recording and where it stands in a study.

    Attributes:
        name: of the trial, unlike any other's.
        recording, body: as :func:`.infer.infer` takes them; None where the recording could not be read.
        subject, session: who, and on which occasion; sessions of two subjects differ even if they share a name.
        factors: value of each factor, such as {"condition": "load"}.
        events: time of each event by name, s, by the recording's clock; NaN where it did not happen.
        unread: why the recording could not be read; empty where it was.

    Raises InputError for an infinite time, a factor or an event without a name, or a factor of a name in :data:`TAKEN`.
    """

    name: str
    recording: Recording | None
    body: ArticulatedBody | None
    subject: str = "1"
    session: str = "1"
    factors: Mapping[str, str] = field(default_factory=dict)
    events: Mapping[str, float] = field(default_factory=dict)
    unread: str = ""

    def __post_init__(self) -> None:
        if "" in (*self.factors, *self.events):
            raise InputError(f"{self.name}: expected a name of each factor and event, got an empty one")
        if taken := [name for name in self.factors if name in TAKEN or name.startswith("event_") or "/" in name]:
            raise InputError(f"{self.name}: expected another name of factor {taken[0]!r}: study files use it, or /")
        wrong = next((name for name, time in self.events.items() if np.isinf(time)), None)
        if wrong is not None:
            raise InputError(f"{self.name}: expected the time of event {wrong!r} in s, got {self.events[wrong]}")

    @property
    def labels(self) -> dict[str, str]:
        """Columns that say which trial a row is of."""
        return {"trial": self.name, "subject": self.subject, "session": self.session, **self.factors}


@dataclass(frozen=True)
class How:
    """How trials are inferred, the same for all.

    Attributes:
        method: a key of ``METHODS``.
        sizes: of its filters, particles and draws.
        seed: of the study; each trial has a seed derived from it and its place.
        learn_lengths: learn the links' lengths, which then are a session's.
        settings: parameters by dotted name that are known.
        binding: further options of :func:`.arm_problem`: integrator, family, passive …
        stored: draws of each trial that are kept.
    """

    method: str = "laplace"
    sizes: SMCOptions = field(default_factory=SMCOptions)
    seed: int = 0
    learn_lengths: bool = False
    settings: Mapping[str, object] | None = None
    binding: Mapping[str, Any] = field(default_factory=dict)
    stored: int = 48
