"""The arm: the paper's transition by hand, held commands, body priors, and what it refuses."""

import math

import numpy as np
import pyro
import pyro.distributions as dist
import pytest
import torch
from pyro import poutine

from invdyn.models import ArmModel, Keypoints, Learned, Link, Observation, OrnsteinUhlenbeck, RandomWalk, planar_body
from invdyn.models.articulated.defaults import WrongValue

F64 = torch.float64


def two_links(**scalars):
    return planar_body(
        "arm",
        [
            Link("upper", "shoulder", "elbow", **{"length": 1.0, "mass": 0.5, **scalars}),
            Link("fore", "elbow", "wrist", length=0.8, mass=0.3),
        ],
        gravity=(0.0, -1.0),
    )


def by_hand(q, qd, tau):
    """θ̈ of a two-link arm of uniform rods, the textbook's expressions in relative angles."""
    l1, l2, m1, m2, g = 1.0, 0.8, 0.5, 0.3, 1.0
    c1, c2 = l1 / 2, l2 / 2
    i1, i2 = m1 * l1**2 / 12, m2 * l2**2 / 12
    cos2, sin2 = math.cos(q[1]), math.sin(q[1])
    inertia = np.array(
        [
            [
                i1 + i2 + m1 * c1**2 + m2 * (l1**2 + c2**2 + 2 * l1 * c2 * cos2),
                i2 + m2 * (c2**2 + l1 * c2 * cos2),
            ],
            [i2 + m2 * (c2**2 + l1 * c2 * cos2), i2 + m2 * c2**2],
        ]
    )
    coriolis = m2 * l1 * c2 * sin2 * np.array([-(2 * qd[0] * qd[1] + qd[1] ** 2), qd[0] ** 2])
    outer = m2 * c2 * g * math.cos(q[0] + q[1])
    gravity = np.array([(m1 * c1 + m2 * l1) * g * math.cos(q[0]) + outer, outer])
    return np.linalg.solve(inertia, tau - coriolis - gravity)


def test_the_papers_printed_transition():
    """x_t = x_{t−1} + δ ẋ_{t−1}, covariance diag(δ² σ_τ² I, ε I, ε I), and its emission."""
    delta, decay, sigma, eps = 0.03, 6.0, 20.0, 0.1
    model = ArmModel(
        two_links(),
        delta * np.arange(5),
        torque=OrnsteinUhlenbeck("printed"),
        integrator="euler",
        parameters={
            "torque.decay": decay,
            "torque.scale": sigma,
            "noise.angle": eps,
            "noise.velocity": eps,
            "emission.keypoint_scale": math.sqrt(0.05),
        },
    )
    rng = np.random.default_rng(0)
    for _ in range(5):
        tau, q, qd = rng.normal(size=2), rng.uniform(-3, 3, size=2), rng.normal(size=2)
        step = model.transition(torch.as_tensor(np.concatenate([tau, q, qd])), 3)
        rate = np.concatenate([-decay * tau, qd, by_hand(q, qd, tau)])
        assert step.mean.numpy() == pytest.approx(np.concatenate([tau, q, qd]) + delta * rate, rel=1e-10)
        assert step.base_dist.scale.numpy() == pytest.approx([delta * sigma] * 2 + [eps] * 4)
        seen = model.emission(torch.as_tensor(np.concatenate([tau, q, qd])), 3)
        elbow = np.array([math.cos(q[0]), math.sin(q[0])])
        wrist = elbow + 0.8 * np.array([math.cos(q.sum()), math.sin(q.sum())])
        assert seen.mean.numpy() == pytest.approx(np.concatenate([elbow, wrist]), rel=1e-10)
        assert seen.variance.numpy() == pytest.approx([0.05] * 4)


def test_the_initial_distribution():
    model = ArmModel(
        two_links(),
        [0.0, 0.1, 0.15],
        torque=OrnsteinUhlenbeck("exact", decay=2.0),
        parameters={"torque.scale": 3.0, "initial.angle": [0.5, -1.0], "initial.velocity_scale": 0.7},
    )
    first = model.initial()
    assert first.mean.tolist() == pytest.approx([0, 0, 0.5, -1.0, 0, 0])
    assert first.stddev.tolist() == pytest.approx([3 / 2, 3 / 2, 1, 1, 0.7, 0.7])


def test_each_row_has_its_own_time_step():
    time = [0.0, 0.1, 0.15, 0.4]
    model = ArmModel(two_links(), time, torque=RandomWalk(), integrator="euler")
    x = torch.tensor([0.3, -0.2, 0.1, 0.2, 1.0, -1.0], dtype=F64)
    for t in (1, 2, 3):
        dt = time[t] - time[t - 1]
        step = model.transition(x, t)
        assert (step.mean - x)[2:4].tolist() == pytest.approx([dt, -dt])
        assert step.stddev[0].item() == pytest.approx(model.parameters["torque.scale"][0].item() * dt**0.5)


@pytest.mark.parametrize("integrator", ["euler", "rk4"])
def test_commands_are_held_until_the_next_row(integrator):
    """Row t's command acts from t to t+1, beside the torque in x."""
    command = np.array([[1.0, 0.0], [0.0, 2.0], [-3.0, 0.5], [9.0, 9.0]])
    options = {"integrator": integrator, "torque": RandomWalk()}
    time = 0.02 * np.arange(4)
    model = ArmModel(two_links(), time, command=command, **options)
    free = ArmModel(two_links(), time, **options)
    x = torch.tensor([0.3, -0.2, 0.1, 0.2, 1.0, -1.0], dtype=F64)
    for t in (1, 2, 3):
        pushed = x.clone()
        pushed[:2] += torch.as_tensor(command[t - 1])
        torch.testing.assert_close(model.transition(x, t).mean[2:], free.transition(pushed, t).mean[2:])
        torch.testing.assert_close(model.transition(x, t).mean[:2], x[:2])
    path = x.expand(3, 4, 6)
    torch.testing.assert_close(model.net_torque(path), path[..., :2] + torch.as_tensor(command))
    assert torch.equal(free.net_torque(path), path[..., :2])


def test_substeps_approach_a_fine_integration():
    x = torch.tensor([0.3, -0.2, 0.1, 0.2, 4.0, -3.0], dtype=F64)
    ends = [ArmModel(two_links(), [0.0, 0.1], substeps=n).transition(x, 1).mean for n in (1, 2, 4, 64)]
    errors = [(end - ends[-1]).abs().max().item() for end in ends[:-1]]
    assert errors[0] > 6 * errors[1] > 36 * errors[2]  # order four: towards 16


def test_the_torque_moves_on_a_straight_line_within_a_step():
    """A body without gravity that a ramp of torque turns: θ̇ gains the ramp's mean, θ its double integral."""
    rod = planar_body("rod", [Link("rod", "pivot", "end", length=1.0, mass=3.0)], gravity=(0, 0))  # inertia 1
    model = ArmModel(rod, [0.0, 0.5], torque=OrnsteinUhlenbeck("wiener", decay=0.8))
    start, end = 2.0, 2.0 * (1 - 0.8 * 0.5)
    found = model.transition(torch.tensor([start, 0.0, 0.0], dtype=F64), 1).mean
    speed = 0.5 * (start + end) / 2
    angle = 0.5**2 * (start / 2 + (end - start) / 6)
    assert found.tolist() == pytest.approx([end, angle, speed], rel=1e-12)


# -- bodies with priors ------------------------------------------------------------------------------
def test_body_priors_and_learned_scalars_are_sites_of_the_sequence():
    body = two_links(length=dist.LogNormal(0.0, 0.1), mass=Learned(0.6))
    model = ArmModel(body, 0.1 * np.arange(3))
    # a plain number may have been replaced, by a fit for example: it stands
    model = model.replace(**{"body.length": torch.tensor([1.0, 0.9], dtype=F64)})
    _, observations = model.simulate()
    drawn = torch.tensor(1.2, dtype=F64)
    conditioned = poutine.condition(model.sequence, {"upper.length": drawn})
    trace = poutine.trace(conditioned).get_trace(observations)
    assert "upper.mass" in pyro.get_param_store()
    path = trace.nodes["_RETURN"]["value"]
    used = model.replace(
        **{
            "body.length": torch.tensor([1.2, 0.9], dtype=F64),
            "body.mass": torch.tensor([0.6, 0.3], dtype=F64),
        }
    )
    body = used.body_parameters()
    assert body.com.tolist() == pytest.approx([0.6, 0.45])  # follows the length
    assert body.inertia.tolist() == pytest.approx([0.6 * 1.2**2 / 12, 0.3 * 0.9**2 / 12])
    expected = used.log_joint(path, observations) + dist.LogNormal(0.0, 0.1).log_prob(drawn)
    torch.testing.assert_close(trace.log_prob_sum(), expected, rtol=1e-6, atol=1e-6)


def test_priors_of_the_whole_column():
    model = ArmModel(two_links(), 0.1 * np.arange(3))
    prior = dist.LogNormal(torch.zeros(2, dtype=F64), 0.1).to_event(1)
    trace = poutine.trace(model.with_priors(**{"body.length": prior}).sequence).get_trace()
    assert trace.nodes["body.length"]["value"].shape == (2,)


def test_a_given_centre_of_mass_does_not_follow():
    body = two_links(com=0.2)
    model = ArmModel(body, [0.0, 0.1]).replace(**{"body.length": torch.tensor([2.0, 1.0], dtype=F64)})
    assert model.body_parameters().com.tolist() == pytest.approx([0.2, 0.5])


# -- a start for linearisation -------------------------------------------------------------------------
@pytest.mark.parametrize("command", [False, True])
def test_initial_paths_obey_explicit_euler(command):
    """Forward differences and inverse dynamics satisfy the printed transition exactly, but for the torque."""
    time = 0.02 * np.arange(60)
    moved = np.stack([np.sin(time), np.cos(time)], -1) if command else None
    model = ArmModel(two_links(), time, integrator="euler", command=moved, torque=OrnsteinUhlenbeck("wiener"))
    q = torch.as_tensor(np.stack([0.3 * np.sin(3 * time), 0.5 * np.cos(2 * time)], -1))
    y = model.dynamics.keypoints(q, model.body_parameters()).flatten(-2)
    paths = model.initial_paths(y)
    assert paths.shape == (5, 60, 6)
    for path in paths:
        mean = model.transition(path[:-2], torch.arange(1, 59)).mean
        torch.testing.assert_close(mean[:, 2:], path[1:-1, 2:], rtol=1e-9, atol=1e-9)
    assert (paths[-1, :, 2:4] - q).abs().max() < 0.02


def test_unseen_links_start_from_the_prior():
    model = ArmModel(two_links(), 0.1 * np.arange(4), Observation(Keypoints([1])))
    paths = model.initial_paths(torch.zeros(4, 2, dtype=F64))
    assert paths.shape == (1, 4, 6)
    torch.testing.assert_close(paths[0], model.initial().mean.expand(4, 6))


def test_relaxed_models_have_looser_angles_and_end_at_the_model():
    model = ArmModel(two_links(), 0.1 * np.arange(4))
    loose, tight = model.relaxed(1.0), model.relaxed(1e-9)
    assert (loose.parameters["noise.angle"] > 0.29).all()
    for name in ("noise.angle", "noise.velocity"):
        torch.testing.assert_close(tight.parameters[name], model.parameters[name])
    assert loose.dtype == F64


# -- refusals ----------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"integrator": "leapfrog"}, ValueError, "rk4.*got 'leapfrog'"),
        ({"time": [0.0]}, ValueError, "at least two strictly increasing times"),
        ({"time": [0.0, 0.1, 0.1]}, ValueError, "strictly increasing"),
        ({"time": [[0.0, 0.1]]}, ValueError, "strictly increasing"),
        ({"command": np.zeros((4, 2))}, ValueError, r"command of shape \(3, 2\)"),
        ({"command": np.zeros((3, 1))}, ValueError, r"command of shape \(3, 2\)"),
        ({"parameters": {"torque.size": 1.0}}, KeyError, "no parameter torque.size.*torque.scale"),
        ({"parameters": {"torque.scale": [1.0, 2.0, 3.0]}}, WrongValue, r"torque.scale.*\(2,\).*\(3,\)"),
        ({"parameters": {"torque.scale": "large"}}, WrongValue, "torque.scale: expected numbers, got 'large'"),
        ({"parameters": {"torque.scale": [1.0, [2.0]]}}, WrongValue, "torque.scale: expected numbers"),
    ],
)
def test_what_cannot_be_meant_is_refused(options, error, message):
    arguments = {"time": [0.0, 0.1, 0.2], **options}
    with pytest.raises(error, match=message):
        ArmModel(two_links(), arguments.pop("time"), **arguments)


def test_parameters_take_a_number_or_one_for_each_joint():
    model = ArmModel(two_links(), [0.0, 0.1], parameters={"torque.scale": 2, "noise.angle": [0.1, 0.2]})
    assert model.parameters["torque.scale"].tolist() == [2.0, 2.0]
    assert model.parameters["noise.angle"].tolist() == [0.1, 0.2]
    assert model.dtype == F64


# -- several recordings one after another ----------------------------------------------------------
def test_where_an_arm_starts_anew_nothing_follows_from_before():
    """Two recordings as one: the density is the product of theirs, the second's first row drawn about its angle."""
    body = planar_body("arm", [Link("upper", "shoulder", "elbow", 0.3, 1.0), Link("fore", "elbow", "wrist", 0.25, 0.8)])
    time, angle = 0.02 * np.arange(9), torch.tensor([[0.4, -0.2]], dtype=torch.float64)
    whole = ArmModel(body, time, Observation(Keypoints([0, 1]))).restarted_at([5], angle)
    first, second = (ArmModel(body, time[rows], Observation(Keypoints([0, 1]))) for rows in (slice(0, 5), slice(5, 9)))
    torch.manual_seed(0)
    path = 0.1 * torch.randn(9, whole.state_dim, dtype=torch.float64)
    y = whole.emission(path, torch.arange(9)).sample()
    own = second.replace(
        **{"initial.angle": angle[0], "initial.angle_scale": torch.full((2,), torch.pi, dtype=torch.float64)}
    )
    expected = first.log_joint(path[:5], y[:5]) + own.log_joint(path[5:], y[5:])
    torch.testing.assert_close(whole.log_joint(path, y), expected)
    # Row by row, as a filter goes, it is the same as all at once.
    rows = torch.arange(1, 9)
    together = whole.transition(path[:-1], rows).log_prob(path[1:])
    alone = torch.stack([whole.transition(path[t - 1], t).log_prob(path[t]) for t in range(1, 9)])
    torch.testing.assert_close(together, alone)
