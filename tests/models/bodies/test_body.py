"""A planar body: its file, its numbers, their priors."""

import math
import re
from dataclasses import replace
from fractions import Fraction
from importlib.resources import files

import numpy as np
import pyro
import pyro.distributions as dist
import pytest
import torch
from bench_arm import ARM

from invdyn.models.bodies.body import Body, planar_body
from invdyn.models.bodies.link import Link
from invdyn.models.bodies.scalars import BodyError, Learned, in_normal_units, prior


def arm(**upper):
    upper = {"length": 0.3, "mass": 1.5} | upper
    return planar_body(
        "arm",
        [
            Link("upper_arm", "shoulder", "elbow", **upper),
            Link("forearm", "elbow", "wrist", length=0.25, mass=1.0, com=0.1, inertia=0.004),
        ],
        uncertainty={"mass": 0.05},
    )


# --- files ----------------------------------------------------------------------------------------


def test_a_file_is_read(write):
    body = Body.from_toml(write(ARM))
    assert (body.name, body.num_joints) == ("bench arm", 2)
    assert (body.joint_names, body.keypoint_names) == (("shoulder", "elbow"), ("elbow", "wrist"))
    assert body.base_keypoint == "shoulder"
    assert (body.gravity, body.base) == ((0.0, -9.81), (0.1, 0.2))
    assert body.uncertainty == {"mass": 0.05}
    p = body.parameters()
    assert p.length.tolist() == [0.30, 0.25]
    assert p.mass.tolist() == [1.5, 1.0]
    assert p.com.tolist() == [0.15, 0.1]
    assert p.inertia.tolist() == pytest.approx([1.5 * 0.3**2 / 12, 0.004])
    assert p.gravity.tolist() == [0.0, -9.81]
    assert p.base.tolist() == [0.1, 0.2]


def test_a_file_may_say_that_it_is_exact(write, tmp_path):
    text = 'exact = true\n[[links]]\nname="a"\njoint="b"\ntip="c"\nlength=1\nmass=2\n'
    body = Body.from_toml(write(text))
    assert body.exact
    body.to_toml(tmp_path / "again.toml")
    assert Body.from_toml(tmp_path / "again.toml").exact
    assert not Body.from_toml(write(text.replace("true", "false"))).exact
    replace(body, uncertainty={"mass": 0.1}).to_toml(tmp_path / "again.toml")
    assert "exact" not in (tmp_path / "again.toml").read_text()
    with pytest.raises(BodyError, match="expected exact = true or false, got 'yes'"):
        Body.from_toml(write(text.replace("true", '"yes"')))


def test_gravity_base_and_name_have_defaults(write):
    body = Body.from_toml(write('[[links]]\nname="a"\njoint="b"\ntip="c"\nlength=1\nmass=2\n'))
    assert (body.name, body.gravity, body.base) == ("arm", (0.0, -9.81), (0.0, 0.0))
    assert isinstance(body.links[0].length, float)  # TOML's integers are numbers too


def test_what_is_written_is_read_back(tmp_path):
    body = planar_body(
        'an "arm" ☂',
        [
            Link("a", "shoulder", "elbow", 0.1 + 0.2, Learned(1.5), com=-0.1, inertia=0.0),
            Link("b", "elbow", "wrist", 1 / 3, 1.0),
        ],
        gravity=(0.5, 0.0),
        uncertainty={"length": 0.01},
    )
    body.to_toml(tmp_path / "out.toml")
    assert Body.from_toml(tmp_path / "out.toml") == body
    assert [file.name for file in tmp_path.iterdir()] == ["out.toml"]


def test_priors_are_written_by_mean_and_sd(tmp_path):
    body = arm(mass=dist.LogNormal(torch.tensor(0.3).double(), torch.tensor(0.2).double())).with_uncertainty()
    body.to_toml(tmp_path / "out.toml")
    again = Body.from_toml(tmp_path / "out.toml")
    for link, copy in zip(body.links, again.links, strict=True):
        assert copy.mass.loc.item() == pytest.approx(link.mass.loc.item(), abs=1e-12)
        assert copy.mass.scale.item() == pytest.approx(link.mass.scale.item(), rel=1e-9)
    with pytest.raises(BodyError, match="log-normal priors, but mass has a Gamma"):
        arm(mass=dist.Gamma(2.0, 2.0)).to_toml(tmp_path / "gamma.toml")
    assert not (tmp_path / "gamma.toml").exists()


@pytest.mark.parametrize("name", ["paper_planar_arm", "human_arm_on_table", "dfki_design_a0"])
def test_the_bodies_that_come_along(name):
    body = Body.from_toml(files("invdyn.models") / "bodies" / f"{name}.toml")
    assert body.joint_names == ("shoulder", "elbow")
    assert body.keypoint_names == ("elbow", "wrist")
    p = body.parameters()
    if name == "paper_planar_arm":
        assert p.length.tolist() == [1, 1]
        assert p.mass.tolist() == [0.5, 0.3]
        assert p.gravity.tolist() == [0, -1]
    elif name == "human_arm_on_table":
        assert p.gravity.tolist() == [0, 0]
        assert p.mass.tolist() == [1.5, 1.5]
    else:
        about_joint = p.inertia + p.mass * p.com**2
        assert about_joint.tolist() == pytest.approx([0.053470810264216295, 0.02392374528789766], rel=1e-12)
        assert p.length.tolist() == [0.3, 0.2]


def test_a_file_that_is_not_there_is_an_os_error(tmp_path):
    with pytest.raises(FileNotFoundError):
        Body.from_toml(tmp_path / "none.toml")
    with pytest.raises(OSError, match=re.escape("nowhere")):
        arm().to_toml(tmp_path / "nowhere" / "arm.toml")


# --- parameters -----------------------------------------------------------------------------------


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_parameters_have_the_dtype_asked_for(dtype):
    for p in (arm().parameters(dtype), arm(mass=Learned(1.0)).with_uncertainty().sample(dtype=dtype)):
        assert {value.dtype for value in p} == {dtype}
        assert p.mass.shape == p.length.shape == p.com.shape == p.inertia.shape == (2,)
    assert {value.dtype for value in arm().parameters().to(dtype)} == {dtype}


def test_defaults_follow_what_is_given():
    length = torch.rand(4, 1, 2, dtype=torch.float64, requires_grad=True)
    p = arm().parameters(length=length)
    assert torch.equal(p.length, length)
    assert torch.equal(p.com[..., 0], length[..., 0] / 2)
    assert torch.equal(p.com[..., 1], torch.full((4, 1), 0.1, dtype=torch.float64))  # a given com stays
    torch.testing.assert_close(p.inertia[..., 0], 1.5 * length[..., 0] ** 2 / 12)
    assert p.mass.shape == (2,)
    p.inertia.sum().backward()
    torch.testing.assert_close(length.grad[..., 0], 1.5 * length.detach()[..., 0] / 6)
    with pytest.raises(BodyError, match=r"length of shape \(\.\.\., 2\), got \(3,\)"):
        arm().parameters(length=torch.ones(3))
    with pytest.raises(BodyError, match="did you mean 'length'"):
        arm().parameters(lenght=torch.ones(2))


def test_with_values_changes_scalars():
    body = arm().with_values(length=[0.4, 0.2], mass=[Learned(1.0), 2])
    assert body.parameters().length.tolist() == [0.4, 0.2]
    assert body.links[0].mass == Learned(1.0)
    assert body.parameters().com.tolist() == [0.2, 0.1]
    with pytest.raises(BodyError, match="2 values of mass, one for each link, got 1"):
        arm().with_values(mass=[1.0])
    with pytest.raises(BodyError, match="positive number, got 0"):
        arm().with_values(mass=[1.0, 0.0])


# --- priors and learning --------------------------------------------------------------------------


def test_a_prior_has_the_mean_and_sd_of_the_file(write):
    body = Body.from_toml(write(ARM.replace("mass = 1.5", "mass = {mean = 1.5, sd = 0.4}")))
    mass = body.links[0].mass
    assert isinstance(mass, dist.LogNormal)
    assert mass.mean.item() == pytest.approx(1.5)
    assert mass.stddev.item() == pytest.approx(0.4)
    assert body.parameters().mass.tolist() == pytest.approx([1.5, 1.0])


def test_a_com_behind_its_joint_has_a_normal_prior(write):
    body = Body.from_toml(write(ARM.replace("com = 0.1", "com = {mean = -0.05, sd = 0.02}")))
    assert isinstance(body.links[1].com, dist.Normal)
    assert body.parameters().com.tolist() == pytest.approx([0.15, -0.05])


def test_sample_draws_priors_and_defaults_follow_them():
    body = arm(length=dist.LogNormal(-1.0, 0.1)).with_uncertainty()
    trace = pyro.poutine.trace(lambda: body.sample("arm.")).get_trace()
    assert set(trace.stochastic_nodes) == {"arm.upper_arm.length", "arm.upper_arm.mass", "arm.forearm.mass"}
    p = trace.nodes["_RETURN"]["value"]
    assert p.com[0] == p.length[0] / 2
    torch.testing.assert_close(p.inertia[0], p.mass[0] * p.length[0] ** 2 / 12)
    assert p.length.tolist()[1] == 0.25
    torch.testing.assert_close(p.length[0].double(), trace.nodes["arm.upper_arm.length"]["value"].double())


def test_sample_in_a_plate_gives_many_bodies():
    body = arm(length=dist.LogNormal(-1.0, 0.1))
    with pyro.plate("filters", 5, dim=-2):
        p = body.sample()
    assert p.length.shape == p.com.shape == p.inertia.shape == (5, 1, 2)
    assert p.mass.shape == (2,)
    assert p.length[:, 0, 0].unique().numel() == 5


def test_learned_scalars_are_pyro_parameters():
    body = arm(length=Learned(0.35), com=Learned(-0.02))
    assert body.parameters().length.tolist() == [0.35, 0.25]
    p = body.sample()
    assert set(pyro.get_param_store()) == {"upper_arm.length", "upper_arm.com"}
    assert p.length.tolist() == pytest.approx([0.35, 0.25])
    assert p.com.tolist() == pytest.approx([-0.02, 0.1])
    p.inertia.sum().backward()
    unconstrained = pyro.get_param_store()["upper_arm.length"].unconstrained()
    # ∂/∂log L of m L²/12
    assert unconstrained.grad.item() == pytest.approx(1.5 * 0.35**2 / 6)


def test_uncertainty_becomes_priors_around_the_nominal_values():
    body = planar_body("arm", arm().links, uncertainty={"mass": 0.05, "com": 0.1, "length": 0.0})
    uncertain = body.with_uncertainty()
    assert uncertain.uncertainty == {}
    assert [link.length for link in uncertain.links] == [0.3, 0.25]
    for link, mass, com in zip(uncertain.links, (1.5, 1.0), (0.15, 0.1), strict=True):
        assert link.mass.mean.item() == pytest.approx(mass)
        assert link.mass.stddev.item() == pytest.approx(0.05 * mass)
        assert link.com.mean.item() == pytest.approx(com)
        assert link.com.stddev.item() == pytest.approx(0.1 * com)
    own = dist.LogNormal(0.0, 1.0)
    assert arm(mass=own).with_uncertainty().links[0].mass is own
    assert arm(mass=Learned(1.0)).with_uncertainty().links[0].mass == Learned(1.0)
    with pytest.raises(BodyError, match="com is 0"):
        planar_body("arm", arm(com=0.0).links, uncertainty={"com": 0.1}).with_uncertainty()


@pytest.mark.parametrize(
    ("scalar", "message"),
    [
        (dist.Normal(1.0, 0.1), "allows negative values; use a LogNormal"),
        (dist.Uniform(-0.5, 1.0), "allows negative values"),
        (dist.LogNormal(torch.zeros(2), 0.1), r"scalar prior, got one of shape \(2,\)"),
        (Learned(-1.0), "no negative number, got -1"),
        (Learned("one"), "expected a finite number, got 'one'"),
        (math.nan, "expected a finite number, got nan"),
        (None, "expected a finite number, got None"),
    ],
)
def test_scalars_that_a_link_refuses(scalar, message):
    with pytest.raises(BodyError, match=f"link 'upper_arm': mass in kg: .*{message}"):
        arm(mass=scalar)


@pytest.mark.parametrize("number", [np.float32(0.125), np.float64(0.125), Fraction(1, 8)], ids=type)
def test_numbers_of_any_kind_are_taken(number):
    link = arm(com=number, inertia=number).links[0]
    assert (link.com, link.inertia) == (0.125, 0.125)
    assert type(link.com) is float


@pytest.mark.parametrize("made", [np.array, torch.tensor])
def test_an_array_of_one_number_is_none(made):
    with pytest.raises(BodyError, match=r"link 'upper_arm': com in m: expected a finite number, got (array|tensor)"):
        arm(com=made(0.1))


def test_a_joint_is_a_joint_or_its_name():
    with pytest.raises(BodyError, match="link 'a': expected a joint or its name, got 5"):
        Link("a", 5, "b", length=0.3, mass=1.0)


def test_a_file_may_say_that_it_is_planar(write):
    assert Body.from_toml(write(f"dimensions = 2\n{ARM}")) == Body.from_toml(write(ARM))


def test_priors_that_a_link_takes():
    arm(mass=dist.Uniform(0.5, 1.0), com=dist.Normal(0.1, 0.1), inertia=dist.Gamma(2.0, 100.0))
    arm(com=0.0, inertia=0.01)
    arm(com=-0.85)  # a counterweight, at almost three lengths


def test_priors_in_normal_units():
    """θ₀ exp(s z) or θ₀ + u z has the prior's quantiles; a Gamma counts as a log-normal of its mean and sd."""
    z = dist.Normal(0.0, 1.0).icdf(torch.tensor([0.05, 0.5, 0.95], dtype=torch.float64))
    for own in (prior(1.5, 0.3), prior(-0.2, 0.05)):
        middle, sd, unit = in_normal_units(own)
        mapped = middle * (sd * z).exp() if unit is None else middle + unit * sd * z
        torch.testing.assert_close(mapped, own.icdf(dist.Normal(0.0, 1.0).cdf(z)))
    gamma = dist.Gamma(torch.tensor(25.0), torch.tensor(10.0))
    assert in_normal_units(gamma)[:2] == pytest.approx(in_normal_units(prior(2.5, 0.5))[:2], rel=1e-6)


def test_a_prior_without_a_width_is_refused():
    with pytest.raises(BodyError, match=r"link 'upper_arm': com in m: .* where the number is known, write it alone"):
        arm(com=dist.Delta(torch.tensor(0.1)))


def test_priors_stand_at_their_entries():
    body = arm(mass=prior(1.5, 0.3)).with_values(com=[prior(0.1, 0.01), 0.1])
    assert {key: set(own) for key, own in body.priors.items()} == {"mass": {0}, "com": {0}}
    assert body.has_priors
    assert not arm().has_priors
