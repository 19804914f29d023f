"""Springs, stops and gears of joints, and links that bend."""

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from invdyn.diagnosis.catalogue.entry import CatalogueEntry, Numbers, Variant
from invdyn.diagnosis.rules import FIXED
from invdyn.models.effects.backlash import Backlash
from invdyn.models.effects.base import STOPS, Effect, Scale, Values
from invdyn.models.effects.joints import JointCoupling, JointLimit, JointStiffness, TorqueRipple, regularised_stop
from invdyn.models.effects.link_flexibility import HALF, LinkFlexibility

Shown = dict[str, tuple[Tensor, str]]

CONSTANT = "such a spring is a constant torque, as of a servo's encoder that is off; the catalogue has none"
"""What a rest angle means that is as large as may be reported."""


def rest_angle(values: Values) -> Tensor:
    """θ₀ = T₀/k, rad, cut at two revolutions."""
    return (values["torque"] / values["stiffness"].clamp_min(1e-12)).clamp(-FIXED.max_rest_angle, FIXED.max_rest_angle)


def spring(effect: Effect, values: Values) -> Shown:
    """Stiffness k, N·m/rad, and rest angle θ₀."""
    return {"stiffness": (values["stiffness"], "N·m/rad"), "rest_angle": (rest_angle(values), "rad")}


def rest_angle_within_a_revolution(effect: Effect, mean: Numbers, sd: Numbers, scale: Scale) -> bool:
    """A rest angle within a revolution; one farther away shows as a constant torque.

    Springs of simulated cases rested at 2.5 rad at most.
    """
    return abs(mean["torque"]) <= 2 * math.pi * (mean["stiffness"] + FIXED.credible_sds * sd["stiffness"])


def coupling(effect: Effect, values: Values) -> Shown:
    """Stiffness k, N·m/rad, ratio r, and θ₀, rad, of θ_i − r θ_j where the spring is slack."""
    return {
        "stiffness": (values["stiffness"], "N·m/rad"),
        "ratio": (values["ratio"], "1"),
        "rest_angle": (rest_angle(values), "rad"),
    }


def couples(effect: Effect, mean: Numbers, sd: Numbers, scale: Scale) -> bool:
    """A spring of both joints that is slack within a revolution of each."""
    turns = 1 + abs(mean["ratio"]) + FIXED.credible_sds * sd["ratio"]
    slack = abs(mean["torque"]) <= 2 * math.pi * turns * (mean["stiffness"] + FIXED.credible_sds * sd["stiffness"])
    return slack and abs(mean["ratio"]) + FIXED.credible_sds * sd["ratio"] > FIXED.min_lever_ratio


def stop(effect: Effect, values: Values) -> Shown:
    """The parameters, and the side: 1 above the angle, −1 below it."""
    units = {"angle": "rad", "stiffness": "N·m/rad", "damping": "N·m·s/rad"}
    units |= {"softness": "1"} if effect.variant else {}
    side = values["angle"].new_full(values["angle"].shape, _sign(effect))
    return {**{name: (values[name], unit) for name, unit in units.items()}, "side": (side, "1")}


def stops(effect: Effect, mean: Numbers, sd: Numbers, scale: Scale) -> bool:
    """A stop that pushes back, and that the joint has been seen free of."""
    j = effect.place[0]
    stiffness = mean["stiffness"] + FIXED.credible_sds * sd["stiffness"]
    pushes = mean["damping"] <= FIXED.max_stop_damping * 2 * math.sqrt(stiffness * scale.inertia[j])
    if scale.range is None:
        return pushes
    lowest, highest = scale.range[j].tolist()
    free = mean["angle"] - lowest if _sign(effect) > 0 else highest - mean["angle"]
    return pushes and free > FIXED.min_free_range * (highest - lowest)


def have_room(found: Sequence[tuple[Effect, Numbers]], scale: Scale) -> bool:
    """Whether every joint moves freely between its stops, if it has two; effects with their values."""
    ends: dict[int, dict[float, float]] = {}
    for effect, values in found:
        ends.setdefault(effect.place[0], {})[_sign(effect)] = values["angle"]
    pairs = {j: angles[1.0] - angles[-1.0] for j, angles in ends.items() if len(angles) == len(STOPS)}
    seen = {j: 0.0 if scale.range is None else float(scale.range[j][1] - scale.range[j][0]) for j in pairs}
    return all(room > FIXED.min_stop_room * seen[j] for j, room in pairs.items())


def _sign(effect: Effect) -> float:
    return 1.0 if effect.where[-1] == STOPS[0] else -1.0


def waves(effect: Effect, values: Values) -> Shown:
    """Amplitude A, N·m, phase φ, rad, and periods N; amplitude and phase of the second harmonic."""
    first = _wave(values["sine"], values["cosine"])
    second = _wave(values["second_sine"], values["second_cosine"], "second_") if effect.variant else {}
    return {**first, "periods": (values["periods"], "1"), **second}


def _wave(sine: Tensor, cosine: Tensor, which: str = "") -> Shown:
    return {
        f"{which}amplitude": (torch.hypot(sine, cosine), "N·m"),
        f"{which}phase": (torch.atan2(cosine, sine), "rad"),
    }


def repeats(effect: Effect, mean: Numbers, sd: Numbers, scale: Scale) -> bool:
    """No fewer periods than a motor has: slower waves are springs and weights, not a motor's build."""
    return mean["periods"] + FIXED.credible_sds * sd["periods"] >= FIXED.min_ripple_periods


ENTRIES = (
    CatalogueEntry(
        JointStiffness,
        phrase="joint stiffness",
        meaning="a spring that pulls the joint to a rest angle",
        shown_by="holding still in several postures",
        credible=rest_angle_within_a_revolution,
        reported=spring,
        limits={"rest_angle": (FIXED.max_rest_angle, CONSTANT)},
        body_file_fields={"stiffness": "stiffness"},
        file_change="spring",
    ),
    CatalogueEntry(
        JointCoupling,
        phrase="joint coupling",
        meaning="a spring between two joints",
        shown_by="moving one joint while the other is held",
        credible=couples,
        reported=coupling,
        limits={"rest_angle": (FIXED.max_rest_angle, CONSTANT)},
    ),
    CatalogueEntry(
        JointLimit,
        phrase="a joint limit",
        meaning="a stop that the joint runs into",
        shown_by="repeated slow sweeps into the end of the range",
        # a steady torque τ presses it as deep: e = τ / k of the ideal law, τ R / k of the regularised one
        variants=(
            Variant(
                {"softness": "regularised, it gives way to any load that presses the joint into it"},
                {"softness": FIXED.start_softness},
                factors={"stiffness": FIXED.start_softness},
                of=regularised_stop,
            ),
        ),
        credible=stops,
        credible_together=have_room,
        reported=stop,
    ),
    CatalogueEntry(
        Backlash,
        phrase="backlash",
        meaning="play between motor and joint",
        shown_by="slow reversals of the load",
    ),
    CatalogueEntry(
        LinkFlexibility,
        phrase="link flexibility",
        meaning="a link that bends and swings",
        shown_by="a command that sweeps past the link's resonance",
        variants=(Variant({"position": "not in its middle, but at this share of its length"}, {"position": HALF}),),
    ),
    CatalogueEntry(
        TorqueRipple,
        phrase="torque ripple",
        meaning="a torque that repeats with the joint's angle",
        shown_by="a slow sweep through the whole range",
        variants=(
            Variant(
                {"second_amplitude": "no pure sine, it has a second wave of twice as many periods"},
                {"second_sine": 0.0, "second_cosine": 0.0},
            ),
        ),
        credible=repeats,
        reported=waves,
    ),
)
