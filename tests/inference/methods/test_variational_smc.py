"""VSMC as a method: what it learns about parameters, against exact posteriors."""

import json

import numpy as np
import pyro
import pytest
import torch
from oracles import random_chain
from pyro.distributions import Normal

from invdyn.inference import Free, ParticleFilter, SMCOptions, arm_problem, gauss_newton, pooled
from invdyn.inference.fitting.identifiability import unidentified
from invdyn.inference.fitting.log_parameters import LogParameters
from invdyn.inference.methods.variational_smc import vsmc
from invdyn.inference.variational.affine import Corrected
from invdyn.inference.variational.parameter_guide import SITE, Uncertain
from invdyn.models import Link, planar_body
from invdyn.recordings import Recording

T = 30
TIME = 0.04 * np.arange(T)


def linear_arm():
    """One joint without gravity, watched by its encoder: linear and Gaussian, its evidence exact."""
    rng = np.random.default_rng(0)
    angle = 0.4 * np.sin(5 * TIME)[:, None] + 0.01 * rng.normal(size=(T, 1))
    angle[8] = np.nan
    recording = Recording(
        time=TIME, keypoints=np.zeros((T, 0, 2)), keypoint_names=(), angles=angle, joint_names=("pivot",)
    )
    body = planar_body("arm", [Link("rod", "pivot", "tip", length=0.5, mass=1.0)], gravity=(0.0, 0.0))
    known = {"torque.scale": 1.0, "emission.angle_scale": 0.01, "noise.velocity": 0.05, "noise.angle": 0.005}
    return arm_problem(recording, body, parameters=known, substeps=1)


def test_log_parameters_put_every_entry_where_it_belongs():
    model = linear_arm().model
    free = [Free("noise.angle"), Free("initial.velocity_scale", sd=0.5)]
    parameters = LogParameters(model, free)
    assert parameters.labels == ["noise.angle", "initial.velocity_scale"]
    assert parameters.sd.tolist() == [2.0, 0.5]
    one = parameters.at(torch.tensor([0.5, -1.0]))
    assert one.parameters["noise.angle"].item() == pytest.approx(0.005 * np.exp(0.5))
    many = parameters.at(torch.tensor([[0.5, -1.0], [0.0, 0.0]]))
    assert many.parameters["noise.angle"].shape == (2, 1, 1)
    assert torch.equal(many.parameters["initial.velocity_scale"][1, 0], model.parameters["initial.velocity_scale"])
    two = random_chain(0).model(4)
    tied = LogParameters(two, [Free("emission_root", tied=True), Free("root", entries=(0, 4))])
    assert tied.labels == ["emission_root", "root[0]", "root[4]"]
    found = tied.at(torch.tensor([0.1, 0.2, 0.3])).parameters
    torch.testing.assert_close(found["emission_root"], two.parameters["emission_root"] * np.exp(0.1))
    factor = torch.ones(3, 3, dtype=torch.float64)
    factor[0, 0], factor[1, 1] = np.exp(0.2), np.exp(0.3)
    torch.testing.assert_close(found["root"], two.parameters["root"] * factor, rtol=1e-6, atol=0)
    apart = LogParameters(two, [Free("root", entries=(0,)), Free("root", entries=(4,), unit=0.5)])
    own = apart.at(torch.tensor([[0.2, 0.3], [0.0, 0.0]])).parameters["root"][:, 0]
    factor[1, 1] = 1.0
    wanted = two.parameters["root"] * factor
    wanted[1, 1] += 0.15
    torch.testing.assert_close(own, torch.stack([wanted, two.parameters["root"]]), rtol=1e-6, atol=1e-9)


def test_the_prior_is_the_same_in_whitened_coordinates():
    model = random_chain(0).model(4)
    parameters = LogParameters(model, [Free("emission_root", tied=True, sd=0.7), Free("root", entries=(0, 4))])
    root = torch.tensor([[0.3, 0, 0], [0.1, 0.2, 0], [-0.1, 0.1, 0.5]], dtype=torch.float64)
    centre = torch.tensor([0.5, -0.2, 0.1], dtype=torch.float64)
    target = Uncertain(parameters, centre, root)
    u = torch.randn(5, 3, dtype=torch.float64)
    plain = Normal(0.0, torch.as_tensor(parameters.sd)).log_prob(target.phi(u)).sum(-1)
    torch.testing.assert_close(target.prior.log_prob(u), plain + torch.logdet(root))
    trace = pyro.poutine.trace(target.sampled).get_trace()
    drawn = trace.nodes["_RETURN"]["value"].parameters["emission_root"]
    phi = target.phi(trace.nodes[SITE]["value"])
    torch.testing.assert_close(drawn, model.parameters["emission_root"] * phi[0].exp())


def test_a_stacked_guide_is_exact_for_each_of_its_parameter_sets():
    chain = random_chain(3)
    y = torch.as_tensor(chain.simulate(10, 0)[1])
    model = chain.model(10)
    parameters = LogParameters(model, [Free("emission_root", tied=True), Free("transition_root", tied=True)])
    phi = 0.5 * torch.randn(4, 2, dtype=torch.float64)
    one_by_one = [parameters.at(one) for one in phi]
    guides = [Corrected(each, y) for each in one_by_one]
    many = parameters.at(phi)
    found = ParticleFilter(many, Corrected.stacked(guides, many), 7, num_filters=4).run(y).log_evidence
    exact = torch.stack([gauss_newton(each, y).log_evidence for each in one_by_one])
    torch.testing.assert_close(found, exact)


@pytest.fixture(scope="module")
def by_grid():
    """Posterior of log σ_τ under its N(0, 1.5²) prior, and the log-evidence, by quadrature over exact evidences."""
    given = linear_arm()
    free = [Free("torque.scale", sd=1.5)]
    grid = torch.linspace(-5, 6, 221, dtype=torch.float64).unsqueeze(-1)
    many = LogParameters(given.model, free).at(grid)
    start = gauss_newton(given.model, given.observations).path.expand(len(grid), -1, -1)
    evidence = gauss_newton(many, given.observations, start=start).log_evidence
    joint = evidence + Normal(0.0, 1.5).log_prob(grid[:, 0])
    weights = torch.softmax(joint, 0)
    mean = (weights * grid[:, 0]).sum()
    sd = (weights * (grid[:, 0] - mean) ** 2).sum().sqrt()
    return given, free, mean.item(), sd.item(), (joint.logsumexp(0) + np.log(11 / 220)).item()


@pytest.mark.long
@pytest.mark.parametrize("steps", [0, 15])
def test_parameters_have_their_exact_posterior(by_grid, steps):
    given, free, mean, sd, evidence = by_grid
    options = SMCOptions(num_filters=80, num_particles=10, num_draws=1)
    store = dict(pyro.get_param_store().items())
    idata = vsmc(given, free=free, options=options, seed=1, steps=steps)
    assert dict(pyro.get_param_store().items()) == store
    scale = idata["posterior"]["torque.scale"]
    assert scale.dims == ("chain", "draw", "joint")
    phi = np.log(scale.values[..., 0].ravel())
    effective = idata.attrs["outer_ess"]
    assert effective > 55  # t's heavier tails alone cost a few percent
    found = phi.mean()
    assert found == pytest.approx(mean, abs=4 * sd / np.sqrt(effective))
    assert phi.std() == pytest.approx(sd, rel=4 / np.sqrt(2 * effective) + 0.05)
    assert idata.attrs["log_evidence"] == pytest.approx(evidence, abs=4 * idata.attrs["log_evidence_sd"])
    stats = idata["sample_stats"].attrs
    assert stats["vsmc_bound"] < evidence + 4 * stats["vsmc_bound_sd"]
    assert stats["vsmc_gain"] >= 0
    assert json.loads(stats["unidentified"]) == []
    assert stats["usable"] == 1


@pytest.mark.long
def test_torque_scale_trades_with_mass_and_the_posterior_says_so():
    """Without gravity the motion knows torque over inertia alone."""
    free = [Free("body.mass"), Free("torque.scale")]
    options = SMCOptions(num_filters=64, num_particles=10, num_draws=2)
    idata = vsmc(linear_arm(), free=free, options=options, seed=0, steps=0)
    (found,) = json.loads(idata["sample_stats"].attrs["unidentified"])
    assert found["relation"] in ("body.mass ∝ torque.scale", "torque.scale ∝ body.mass")
    assert found["direction"]["body.mass"] == pytest.approx(found["direction"]["torque.scale"], rel=0.25)
    assert found["variance_share"] > 0.4
    draws = pooled(idata)
    ratio = np.log(draws["torque.scale"].values[:, 0] / draws["mass"].values[:, 0])
    assert ratio.std() < 0.3 * np.log(draws["mass"].values).std()
    assert idata["posterior"]["mass"].attrs["units"] == "kg"
    # the torque that is found is of its mass
    torque = draws["torque"].values[:, 10, 0]
    assert np.corrcoef(np.abs(torque), draws["mass"].values[:, 0])[0, 1] > 0.5


def test_directions_are_found_by_name():
    rng = torch.Generator().manual_seed(0)
    model = random_chain(0).model(4)
    parameters = LogParameters(model, [Free("root", entries=(0, 4, 8)), Free("emission_root", tied=True, sd=1.0)])
    common = torch.randn(4000, 1, generator=rng, dtype=torch.float64)
    sharp = 0.01 * torch.randn(4000, 4, generator=rng, dtype=torch.float64)
    phi = sharp + common * torch.tensor([2.0, -2.0, 0.0, 0.0], dtype=torch.float64)
    even = torch.zeros(4000)
    (found,) = unidentified(parameters, phi, even)
    assert set(found["direction"]) == {"root[0]", "root[4]"}
    assert found["relation"] in ("root[0] ∝ 1/root[4]", "1/root[0] ∝ root[4]")
    assert sorted(found["direction"].values()) == pytest.approx([-1, 1], abs=0.05)
    assert found["variance_share"] == pytest.approx(2, abs=0.2)
    assert unidentified(parameters, sharp, even) == []
    # only draws that weigh anything count
    narrow = torch.where(phi[:, 0].abs() < 0.2, 0.0, -torch.inf)
    assert unidentified(parameters, phi, narrow) == []


def test_filters_of_which_one_carries_all_are_not_usable(by_grid):
    given, free, *_ = by_grid
    options = SMCOptions(num_filters=1, num_particles=10, num_draws=2)
    stats = vsmc(given, free=free, options=options, steps=0)["sample_stats"].attrs
    assert stats["usable"] == 0
    assert "one filter gives no standard error" in stats["doubt"]


def test_the_guide_alone_is_trained_when_all_parameters_are_known():
    given = linear_arm()
    options = SMCOptions(num_filters=8, num_particles=10, num_draws=2)
    exact = gauss_newton(given.model, given.observations).log_evidence.item()
    idata = vsmc(given, options=options, seed=3, steps=3)
    # The guide is exact before training, and what training costs is undone.
    assert idata["sample_stats"]["log_evidence"].values == pytest.approx(exact, abs=1e-5)
    assert idata["sample_stats"].attrs["vsmc_gain"] == 0


def test_an_unknown_parameter_is_named():
    with pytest.raises(KeyError, match=r"torque\.size"):
        vsmc(linear_arm(), free=[Free("torque.size")], options=SMCOptions(4, 5, 1))
