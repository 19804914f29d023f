"""A simulation that runs away is named as such, and what was observed is not blamed for it."""

import numpy as np
import pytest
import torch
from pyro.distributions import Normal
from pyro.infer.smcfilter import SMCFailed
from trees import paper_arm

from invdyn.inference import SMCOptions, run_filters
from invdyn.inference.smoothing.gauss_newton import gauss_newton
from invdyn.models import ArmModel, OrnsteinUhlenbeck, StateSpaceModel
from invdyn.models.divergence import Diverged
from invdyn.simulate import record

ROWS = torch.zeros(12, 1, dtype=torch.float64)
SIZES = SMCOptions(num_filters=2, num_particles=10, refits=0)


class Explosion(StateSpaceModel):
    """x' = 10 x⁹ + noise: no number after a few rows, from anywhere but near zero."""

    state_dim = observation_dim = 1
    num_steps = len(ROWS)

    def initial(self):
        return Normal(self.parameters["start"].expand(1), 1e-3, validate_args=False).to_event(1)

    def transition(self, state, t):
        return Normal(10 * state**9 * (1 + 0 * state.exp()), 1e-3, validate_args=False).to_event(1)

    def emission(self, state, t):
        return Normal(0.1 * state.clamp(-1, 1), 1.0, validate_args=False).to_event(1)


def explosion(start):
    return Explosion({"start": torch.tensor(start, dtype=torch.float64)})


def test_filters_name_it_with_its_row():
    with torch.random.fork_rng(), pytest.raises(SMCFailed, match=r"ran away: its state is no number at row [1-9]"):
        run_filters(explosion(2.0), ROWS, SIZES, guide="bootstrap")


def test_filters_still_name_an_observation_out_of_reach():
    rows = ROWS.clone()
    rows[5] = 1e200
    with torch.random.fork_rng(), pytest.raises(SMCFailed, match="row 5: the observation is out of"):
        run_filters(explosion(0.0), rows, SIZES, guide="bootstrap")


def test_a_smoother_names_it():
    with pytest.raises(Diverged, match="ran away: its state is no number at row 1;"):
        gauss_newton(explosion(0.0), ROWS, start=torch.full((12, 1), 1e40, dtype=torch.float64))


def test_thin_rods_that_cross_a_pitch_of_90_degrees_run_away():
    """There nothing resists the yaw: the paper's own simulator gives no numbers."""
    model = ArmModel(
        paper_arm(),
        0.01 * np.arange(200),
        torque=OrnsteinUhlenbeck("printed", decay=2.0),
        integrator="euler",
        parameters={
            "torque.scale": 2.0,
            "initial.angle": [0.0, 1.4, 0.0, 0.0],
            "initial.angle_scale": 0.0,
            "initial.velocity": [0.0, 3.0, 0.0, 0.0],
            "initial.velocity_scale": 0.0,
        },
    )
    with pytest.raises(Diverged, match="a pitch of 90°"):
        record(model)
