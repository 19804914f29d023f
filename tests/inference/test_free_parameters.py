"""What is fitted of a rod of two links, whose numbers are known, have priors, or are to be learned."""

import numpy as np
import pytest
import torch
from pyro.distributions import LogNormal, Normal, Uniform

from invdyn.inference import Free
from invdyn.inference.free_parameters import DROP, MIN_DROP, at_start, free_parameters, known_in_part, of_priors
from invdyn.inference.posterior.initialise import arm_problem
from invdyn.models import Link, OrnsteinUhlenbeck, planar_body
from invdyn.models.bodies.scalars import Learned
from invdyn.recordings import Recording


def number(value):
    return torch.tensor(value, dtype=torch.float64)


LIKE = [LogNormal(number(middle), number(0.2)) for middle in (0.1, -0.3)]
COM = Normal(number(-0.1), number(0.05))


def body(**more):
    upper = Link("upper", "shoulder", "elbow", length=Learned(0.4), mass=LIKE[0], com=COM)
    return planar_body("rod", [upper, Link("fore", "wrist", "tip", length=0.5, mass=LIKE[1], **more)])


def problem():
    """Of a swing whose points are equally good however sure they are."""
    time = 0.05 * np.arange(20)
    angle = 0.3 * np.sin(4 * time)
    elbow = 0.4 * np.stack([np.cos(angle), np.sin(angle)], -1)
    points = np.stack([elbow, 2.25 * elbow], 1)
    rng = np.random.default_rng(0)
    confidence = rng.uniform(0.4, 1.0, points.shape[:2])
    seen = Recording(time, points + 0.003 * rng.standard_normal(points.shape), ("elbow", "tip"), confidence)
    return arm_problem(seen, body(), torque=OrnsteinUhlenbeck(), substeps=1)


def test_noise_torques_and_what_is_not_quite_known_are_fitted():
    own = problem()
    free = free_parameters(own, given=("torque.decay",))
    seen = [name for name in own.model.parameters if name.startswith("emission.")]
    assert DROP in seen
    expected = [Free("torque.scale"), *(Free(name, tied=True) for name in seen)]
    expected += [Free("body.mass", sd=pytest.approx(0.2), entries=(0, 1))]
    expected += [Free("body.com", sd=1.0, entries=(0,), unit=pytest.approx(0.05))]
    found = {each.name: each for each in free}
    assert found == {each.name: each for each in expected} | {"body.length": Free("body.length", sd=0.3, entries=(0,))}
    every = {each.name: each for each in free_parameters(own, learn_lengths=True)}
    assert every["body.length"].entries == (0, 1)
    assert every["torque.decay"] == Free("torque.decay", sd=1.0)


def test_a_fit_begins_at_the_middles_of_priors_and_where_a_logarithm_is():
    own = problem()
    own.model.parameters[DROP][:] = 0.0
    start = at_start(own, free_parameters(own)).parameters
    assert start["body.mass"].tolist() == pytest.approx(np.exp([0.1, -0.3]))
    assert start["body.com"][0].item() == pytest.approx(-0.1)
    assert (start[DROP] == MIN_DROP).all()
    given = at_start(own, free_parameters(own, given=("body.mass", DROP))).parameters
    assert torch.equal(given["body.mass"], own.model.parameters["body.mass"])
    assert not given[DROP].any()


def test_only_entries_with_priors_are_numbers_of_priors():
    mine = of_priors(body())
    assert mine(Free("body.mass", entries=(0, 1)))
    assert mine(Free("body.mass", entries=(1,)))
    assert not mine(Free("body.length", entries=(0,)))
    assert not mine(Free("body.com", entries=(0, 1)))
    assert not mine(Free("body.mass"))


def test_a_prior_of_another_family_is_said_to_be_replaced():
    with pytest.warns(UserWarning, match=r"body.com\[1\]: the prior Uniform is replaced"):
        alike = known_in_part(body(com=Uniform(number(0.1), number(0.2))))
    assert sum(len(entries) for _, _, _, entries in alike) == 4
