"""The answers speak the catalogue's language: names, units, sides, places and conventions, effect by effect."""

import numpy as np
import pytest
import torch
from variants import nonideal

from invdyn.blindcheck.effects import EFFECTS as INJECTED
from invdyn.blindcheck.effects import OBSERVATIONS
from invdyn.blindcheck.injected_effects import CATALOGUE, Present, named
from invdyn.blindcheck.motion import random_body
from invdyn.diagnosis.catalogue import CATALOGUE as DIAGNOSED
from invdyn.models import planar_dynamics
from invdyn.models.effects import EFFECTS, BaseMotion, Scale, TorqueRipple

BODY = random_body(np.random.default_rng(1), 3, False)
SCALE = Scale(
    planar_dynamics(BODY.num_joints),
    BODY.parameters(),
    torch.arange(0, 3, 0.01, dtype=torch.float64),
    torch.ones(300, 3, dtype=torch.float64),
)


def reported(effect):
    """Names and units of what a diagnosis says of an effect."""
    parameters = effect.parameters(SCALE)
    values = {p.name: torch.full((1,), float(p.prior.mean), dtype=torch.float64) for p in parameters}
    return {key: unit for key, (_, unit) in DIAGNOSED.of(effect).reported(effect, values).items()} or {
        p.name: p.unit for p in parameters
    }


def forms(effect):
    """The effect, its non-ideal form, the next one, and so on."""
    while effect is not None:
        yield effect
        effect = nonideal(effect)


def test_the_same_effects():
    lacking = sorted(set(EFFECTS) ^ set(CATALOGUE))
    assert not lacking, f"{lacking} in one catalogue alone: an effect has a function in blindcheck/effects/, too"


@pytest.mark.parametrize("name", CATALOGUE)
def test_names_units_side_and_place(name):
    kind = EFFECTS[name]
    # reality plays one form of each, the catalogue's first
    effect = [e for e in kind.everywhere(BODY, BODY.keypoint_names) if e.form is None][-1].bound(BODY)
    ideal, *softer = (reported(form) for form in forms(effect))
    units = INJECTED[name].units
    # and of some a variant, whose parameters are those of the ideal one and more
    assert INJECTED[name].units == ideal or (
        INJECTED[name].units in softer and ideal.items() < INJECTED[name].units.items()
    )
    assert (units != ideal) == (name in ("stribeck_friction", "soft_tissue", "camera_yaw", "lens_distortion"))
    assert (bool(kind.sensor)) == (name in OBSERVATIONS)
    site = INJECTED[name].site
    assert {"pair": "joint", "keypoints": "keypoint", "stop": "joint"}.get(kind.site, kind.site) == site
    place = None if site == "arm" else 2
    entry = named(Present(name, place, dict.fromkeys(units, 1.0)), BODY)
    told = {str(entry[key]) for key in ("joint", "link", "keypoint", "partner", "stop") if key in entry}
    assert told == set(effect.where) or (name == "joint_limit" and told < {*effect.where, "upper"})


@pytest.mark.parametrize("seed", range(4))
def test_the_base_moves_as_the_catalogue_writes_it(seed):
    rng = np.random.default_rng(seed)
    given = dict(zip(("amplitude_x", "amplitude_y", "frequency", "phase"), rng.uniform(-3, 3, 4), strict=True))
    answer = named(Present("base_motion", None, given), BODY)["parameters"]
    parts = {
        f"{part}_{axis}": given[f"amplitude_{axis}"] * function(given["phase"])
        for part, function in (("sine", np.cos), ("cosine", np.sin))
        for axis in "xy"
    }
    values = {key: torch.tensor([value]) for key, value in (parts | {"frequency": given["frequency"]}).items()}
    for key, (value, _) in DIAGNOSED["base_motion"].reported(BaseMotion(), values).items():
        assert answer[key]["value"] == pytest.approx(value.item(), abs=1e-6)


def test_a_ripple_is_what_the_catalogue_writes():
    given = {"amplitude": 0.3, "periods": 6.0, "phase": 5.5}
    answer = named(Present("torque_ripple", 1, given), BODY)["parameters"]
    values = {"sine": 0.3 * np.cos(5.5), "cosine": 0.3 * np.sin(5.5), "periods": 6.0}
    given_parts = {key: torch.tensor([value]) for key, value in values.items()}
    described = DIAGNOSED["torque_ripple"].reported(TorqueRipple("base"), given_parts)
    for key, (value, _) in described.items():
        assert answer[key]["value"] == pytest.approx(value.item(), abs=1e-6)
