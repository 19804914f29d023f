"""What acts on the arm from outside."""

import math

import torch
from torch import Tensor

from invdyn.diagnosis.catalogue.entry import CatalogueEntry
from invdyn.models.effects.base import Effect, Values
from invdyn.models.effects.disturbances import MIN_DURATION, BaseMotion, ExternalPush
from invdyn.models.shapes import join


def push(effect: Effect, values: Values) -> dict[str, tuple[Tensor, str]]:
    """Force, N, and its first and last moment, s."""
    duration = values["duration"].clamp_min(MIN_DURATION)
    half = duration / 2
    return {
        "force_x": (values["impulse_x"] / duration, "N"),
        "force_y": (values["impulse_y"] / duration, "N"),
        "start": (values["moment"] - half, "s"),
        "stop": (values["moment"] + half, "s"),
    }


def shaking(effect: Effect, values: Values) -> dict[str, tuple[Tensor, str]]:
    """(A_x, A_y) sin(2πft + φ), the one that is closest; the larger of A_x and A_y is positive."""
    sine, cosine = (join(values[f"{part}_x"], values[f"{part}_y"]) for part in ("sine", "cosine"))
    phase = torch.atan2(2 * (sine * cosine).sum(-1), (sine**2 - cosine**2).sum(-1)) / 2
    amplitude = sine * phase.cos().unsqueeze(-1) + cosine * phase.sin().unsqueeze(-1)
    larger = amplitude.gather(-1, amplitude.abs().argmax(-1, keepdim=True))
    negative = larger.squeeze(-1) < 0
    amplitude = torch.where(negative.unsqueeze(-1), -amplitude, amplitude)
    phase = torch.where(negative, phase - math.pi * torch.sign(phase), phase)
    return {
        "amplitude_x": (amplitude[..., :1], "m"),
        "amplitude_y": (amplitude[..., 1:], "m"),
        "frequency": (values["frequency"], "Hz"),
        "phase": (phase.unsqueeze(-1), "rad"),
    }


ENTRIES = (
    CatalogueEntry(
        ExternalPush,
        phrase="an external push",
        meaning="a force from outside, for a short while",
        shown_by="the same motion again, untouched",
        per_recording=True,
        reported=push,
    ),
    CatalogueEntry(
        BaseMotion,
        phrase="base motion",
        meaning="a base that moves",
        shown_by="tracking the base and a point of the background",
        per_recording=True,
        reported=shaking,
    ),
)
