"""Regimes: what is known of torques, which sizes of a residual that allows, and what it hides."""

import numpy as np
import pytest
from pendulum import ARM

from invdyn.diagnosis.problem.regime import COMMANDED, PASSIVE, REGIMES, UNKNOWN_TORQUE, regime_of
from invdyn.diagnosis.rules import DEFAULT
from invdyn.models.effects import EFFECTS

TORQUES = np.array([[np.nan, np.nan], [0.1, np.nan]])


@pytest.mark.parametrize(
    ("torques", "passive", "regime"),
    [
        (TORQUES, False, COMMANDED),
        (TORQUES, True, PASSIVE),
        (None, True, PASSIVE),
        (None, False, UNKNOWN_TORQUE),
        (np.full((2, 2), np.nan), False, UNKNOWN_TORQUE),
    ],
)
def test_a_recordings_torques_say_which(torques, passive, regime):
    assert regime_of(torques, passive) == regime
    assert REGIMES[regime.name] is regime


@pytest.mark.parametrize("regime", REGIMES.values(), ids=REGIMES)
def test_sizes_have_a_prior_of_which_a_spike_has_half(regime):
    weight = np.exp(regime.log_prior)
    assert weight.sum() == pytest.approx(1.0)
    assert np.all(np.diff(regime.sizes) > 0)
    assert (regime.sizes[0] == DEFAULT.residual.spike_size) == regime.knows_torque
    assert weight[0] == pytest.approx(0.5 if regime.knows_torque else 1 / len(weight))


@pytest.mark.parametrize(
    ("name", "hidden"),
    [
        ("payload", True),
        ("viscous_friction", True),
        ("camera_latency", True),
        ("clock_rate", True),
        ("base_motion", False),
        ("camera_roll", False),
        ("varying_noise", False),
    ],
)
def test_an_unknown_torque_may_do_what_moves_the_arm(name, hidden):
    place = ("elbow",) if name == "viscous_friction" else ()
    effect = EFFECTS[name](*place).bound(ARM)
    assert UNKNOWN_TORQUE.hides(effect) is hidden
    assert not COMMANDED.hides(effect)
    assert not PASSIVE.hides(effect)
