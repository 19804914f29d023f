"""The main job in small: from a recording and a body to torques."""

import json
from dataclasses import replace

import numpy as np
import pyro.distributions as dist
import pytest
import torch

from invdyn.inference import METHODS, SMCOptions, arm_problem, free_parameters, infer, pooled, prepare
from invdyn.inference.fitting.parameter_draws import given_the_rest, parameter_draws
from invdyn.models import ArmModel, Learned, Link, Matern32, planar_body
from invdyn.models.bodies.scalars import prior
from invdyn.recordings import InputError, Recording, Truth

SMALL = {"num_filters": 8, "num_particles": 30, "num_draws": 3}
KNOWN = {
    "torque.scale": 2.0,
    "torque.decay": 5.0,
    "emission.keypoint_scale": 0.005,
    "noise.velocity": 0.01,
}
JOINTS = ("shoulder", "elbow")


def body(**links):
    values = {"length": (0.35, 0.3), "mass": (1.5, 1.0), **links}
    return planar_body(
        "arm",
        [
            Link(f"link{k}", joint, tip, length=values["length"][k], mass=values["mass"][k])
            for k, (joint, tip) in enumerate(zip(JOINTS, ("elbow", "wrist"), strict=True))
        ],
    )


def motion(time):
    """Angles, velocities and accelerations (T, 2) that a limb could make."""
    t = time[:, None]
    rates, sizes, centres = np.array([2.0, 3.0]), np.array([0.5, 0.6]), np.array([-1.2, 0.8])
    phase = rates * t
    return (
        centres + sizes * np.sin(phase),
        sizes * rates * np.cos(phase),
        -sizes * rates**2 * np.sin(phase),
    )


def record(time, noise=0.005, seed=0, **changes):
    """A recording and its truth, by inverse dynamics of the given motion."""
    model = ArmModel(body(), time)
    q, qd, qdd = (torch.as_tensor(x) for x in motion(time))
    p = model.body_parameters()
    torque = model.dynamics.inverse(q, qd, qdd, p).numpy()
    rng = np.random.default_rng(seed)
    tips = model.dynamics.keypoints(q, p).numpy()
    recording = Recording(
        time=time,
        keypoints=tips + noise * rng.normal(size=tips.shape),
        keypoint_names=("elbow", "wrist"),
        name="swing",
    )
    return replace(recording, **changes), Truth(time, q.numpy(), qd.numpy(), torque, JOINTS)


TIME = 0.02 * np.arange(50)


def rms(x):
    return np.sqrt(np.mean(np.square(x)))


def assert_close_to_truth(idata, truth, tolerance, inner=slice(5, -8)):
    """The mean torque against the true one, away from the ends; in units of what the truth varies by."""
    torque = pooled(idata)["torque"].mean("sample").values
    off = rms((torque - truth.torque)[inner]) / rms(truth.torque)
    assert off < tolerance
    return off


@pytest.fixture(scope="module")
def known():
    recording, truth = record(TIME)
    return recording, truth, infer(recording, body(), settings=KNOWN, truth=truth, seed=1, **SMALL)


def test_torques_are_found_and_covered(known):
    _, truth, idata = known
    assert_close_to_truth(idata, truth, 0.3)
    draws = pooled(idata)["torque"].values
    low, high = np.quantile(draws, [0.05, 0.95], axis=0)
    inside = ((low <= truth.torque) & (truth.torque <= high))[5:-5].mean()
    # 24 draws of correlated torques: wide margins, but no band of nothing or everything
    assert 0.6 < inside <= 1.0
    assert (high - low).mean() < 2 * rms(truth.torque)
    assert idata.attrs["outer_ess"] > 6
    angle = pooled(idata)["angle"].mean("sample").values
    assert rms(angle - truth.angle) < 0.03


def test_the_same_seed_gives_the_same_bytes(known):
    recording, truth, idata = known
    again = infer(recording, body(), settings=KNOWN, truth=truth, seed=1, **SMALL)
    other = infer(recording, body(), settings=KNOWN, truth=truth, seed=2, **SMALL)
    for group in idata.groups():
        for name in idata[group].data_vars:
            assert idata[group][name].values.tobytes() == again[group][name].values.tobytes(), name
    assert json.loads(again.attrs["settings"]) == json.loads(idata.attrs["settings"])
    assert not np.array_equal(idata["posterior"]["torque"], other["posterior"]["torque"])


def test_it_leaves_the_callers_random_numbers_alone():
    recording, _ = record(TIME[:15])
    torch.manual_seed(7)
    before = torch.rand(3)
    torch.manual_seed(7)
    infer(recording, body(), settings=KNOWN, seed=1, **SMALL)
    assert torch.equal(torch.rand(3), before)


def test_known_settings_stay_and_the_rest_is_fitted():
    recording, truth = record(TIME)
    settings = {"torque.decay": 5.0}
    idata = infer(recording, body(), settings=settings, seed=1, **SMALL)
    fitted = json.loads(idata.attrs["settings"])["fitted"]
    assert "torque.decay" not in fitted
    assert {"torque.scale", "emission.keypoint_scale"} <= set(fitted)
    # 200 residuals tell the camera's noise to a tenth or so
    assert fitted["emission.keypoint_scale"] == pytest.approx([0.005, 0.005], rel=0.4)
    assert_close_to_truth(idata, truth, 0.35)


def test_progress_is_reported_for_every_stage():
    recording, _ = record(TIME[:15])
    reported = []
    infer(
        recording,
        body(),
        settings=KNOWN,
        progress=lambda done, total, what: reported.append((what, done, total)),
        **SMALL,
    )
    stages = {what for what, _, _ in reported}
    assert "filter and smooth" in stages
    for stage in stages:
        done = [d for what, d, _ in reported if what == stage]
        total = {t for what, _, t in reported if what == stage}
        assert done == sorted(done)
        assert len(total) == 1
        assert max(done) == total.pop()


def test_bootstrap_is_a_method_too():
    recording, _ = record(TIME[:20], noise=0.05)
    settings = {**KNOWN, "emission.keypoint_scale": 0.05}
    idata = infer(recording, body(), method="bootstrap", settings=settings, num_filters=4, num_particles=400)
    assert idata.attrs["method"] == "bootstrap"
    assert idata["posterior"].sizes["chain"] == 4


def test_encoders_only():
    _, truth = record(TIME)
    rng = np.random.default_rng(0)
    recording = Recording(
        time=TIME,
        keypoints=np.zeros((len(TIME), 0, 2)),
        keypoint_names=(),
        angles=truth.angle + 1e-3 * rng.normal(size=truth.angle.shape),
        joint_names=JOINTS,
    )
    settings = {name: value for name, value in KNOWN.items() if "keypoint" not in name}
    idata = infer(recording, body(), settings={**settings, "emission.angle_scale": 1e-3}, seed=1, **SMALL)
    assert_close_to_truth(idata, truth, 0.2)
    assert "position" not in idata["observed_data"]
    assert idata["observed_data"]["angle"].dims == ("time", "joint")


def test_joints_in_another_order_than_the_bodys():
    _, truth = record(TIME[:20])
    options = {"time": TIME[:20], "keypoints": np.zeros((20, 0, 2)), "keypoint_names": ()}
    straight = Recording(**options, angles=truth.angle, joint_names=JOINTS)
    swapped = Recording(**options, angles=truth.angle[:, ::-1], joint_names=JOINTS[::-1])
    problems = [arm_problem(r, body()) for r in (straight, swapped)]
    assert torch.equal(problems[0].observations, problems[1].observations)


def test_a_stretch_without_a_keypoint():
    recording, truth = record(TIME)
    keypoints = recording.keypoints.copy()
    keypoints[20:28, 1] = np.nan
    keypoints[35] = np.nan
    idata = infer(replace(recording, keypoints=keypoints), body(), settings=KNOWN, seed=1, **SMALL)
    assert_close_to_truth(idata, truth, 0.5)
    scatter = pooled(idata)["angle"].std("sample").values[:, 1]
    assert scatter[22:26].mean() > 1.5 * scatter[8:18].mean()
    observed = idata["observed_data"]["position"].values
    assert np.array_equal(np.isnan(observed), np.isnan(keypoints))


def test_irregular_time():
    rng = np.random.default_rng(3)
    time = np.cumsum(rng.uniform(0.008, 0.035, size=50))
    recording, truth = record(time)
    idata = infer(recording, body(), settings=KNOWN, seed=1, **SMALL)
    assert_close_to_truth(idata, truth, 0.3)
    assert np.array_equal(idata["posterior"]["time"].values, time)


def test_a_command_leaves_only_the_rest_to_be_found():
    """Three quarters of the torque are commanded: the rest is inferred, and both add up."""
    recording, truth = record(TIME)
    commanded = replace(recording, torques=0.75 * truth.torque, joint_names=JOINTS)
    settings = {**KNOWN, "torque.scale": 1.0}
    idata = infer(commanded, body(), settings=settings, truth=truth, seed=1, **SMALL)
    assert_close_to_truth(idata, truth, 0.2)
    rest = idata["posterior"]["residual_torque"]
    total = idata["posterior"]["torque"]
    assert (total - rest).values == pytest.approx(np.broadcast_to(0.75 * truth.torque, total.shape), abs=1e-9)
    assert idata["constant_data"]["command"].values == pytest.approx(0.75 * truth.torque)
    hidden = infer(commanded, body(), settings=KNOWN, hide_torque=True, seed=1, **SMALL)
    assert "residual_torque" not in hidden["posterior"]
    passive = arm_problem(recording, body(), passive=True)
    assert torch.equal(passive.model.command, torch.zeros(50, 2, dtype=torch.float64))


def test_lengths_are_learned():
    recording, _ = record(TIME, noise=0.002)
    wrong = body(length=(0.5, 0.2))
    settings = {**KNOWN, "emission.keypoint_scale": 0.002}
    idata = infer(recording, wrong, settings=settings, learn_lengths=True, seed=1, **SMALL)
    assert idata["constant_data"]["length"].values == pytest.approx([0.35, 0.3], abs=2e-3)


@pytest.mark.long
def test_other_torque_processes_and_families():
    recording, truth = record(TIME[:40])
    matern = {"emission.keypoint_scale": 0.005, "torque.scale": 3.0, "torque.lengthscale": 0.2}
    for options in (
        {"torque": Matern32(), "settings": matern},
        {"family": "student_t", "settings": {**KNOWN, "emission.df": 4.0}},
        {"integrator": "semi_implicit", "substeps": 2, "settings": KNOWN},
    ):
        idata = infer(recording, body(), seed=1, **options, **SMALL)
        assert_close_to_truth(idata, truth, 0.4, slice(5, -8))


# -- the problem -------------------------------------------------------------------------------------
def test_what_is_to_be_fitted():
    recording, _ = record(TIME)
    problem = arm_problem(recording, body(mass=(Learned(1.5), 1.0)))
    names = {f.name: f for f in free_parameters(problem)}
    assert {"torque.scale", "torque.decay", "emission.keypoint_scale"} <= set(names)
    assert names["body.mass"].entries == (0,)
    assert "body.length" not in names
    assert "body.length" in {f.name for f in free_parameters(problem, learn_lengths=True)}
    assert "torque.decay" not in {f.name for f in free_parameters(problem, given=("torque.decay",))}


def test_a_learned_number_beside_one_with_a_prior_is_used_as_fitted():
    """Differentiation takes the prior's mean alone."""
    recording, _ = record(TIME)
    uncertain = body(mass=(prior(1.5, 0.1), Learned(1.0)))
    task = prepare(recording, uncertain, options=SMCOptions(3, 2, 2), seed=0, settings=KNOWN)
    learned = task.problem.model.parameters["body.mass"][1].item()
    assert learned != 1.0
    mass = task.run("differentiate")["constant_data"]["mass"].values
    assert mass == pytest.approx([1.5, learned], rel=1e-6)


def test_a_prior_of_another_kind_is_said_to_be_replaced():
    recording, _ = record(TIME)
    uniform = arm_problem(recording, body(mass=(dist.Uniform(0.9, 1.1), 1.0)))
    with pytest.warns(UserWarning, match=r"^body.mass\[0\]: the prior Uniform is replaced by a \(log-\)normal"):
        free_parameters(uniform)


@pytest.mark.parametrize("learn_lengths", [True, False])
def test_draws_of_an_uncertain_body_keep_what_was_fitted_or_given(learn_lengths):
    recording, _ = record(TIME)
    uncertain = body(mass=(prior(1.5, 0.1), Learned(1.0)))
    length = torch.tensor([0.34, 0.31], dtype=torch.float64)
    settings = KNOWN if learn_lengths else {**KNOWN, "body.length": length}
    task = prepare(
        recording, uncertain, options=SMCOptions(3, 2, 2), seed=0, learn_lengths=learn_lengths, settings=settings
    )
    start = task.candidates[0].model.parameters["body.mass"]
    assert start[0] == uncertain.links[0].mass.loc.exp()  # φ = 0 is the prior's median, not its mean
    fitted = task.problem.model.body_parameters()
    assert torch.equal(fitted.length, length) != learn_lengths
    own = given_the_rest(task.candidates[0], lambda free: free.entries == (0,) and free.name == "body.mass")
    numbers = [each.model.body_parameters() for each in parameter_draws([own], task.problem.observations, 3)]
    for each in numbers:
        torch.testing.assert_close(each.length, fitted.length)
        torch.testing.assert_close(each.mass[1], fitted.mass[1])
    masses = torch.stack([each.mass[0] for each in numbers])
    assert len(masses.unique()) == 3
    assert bool(((masses / 1.5).log().abs() < 4 * 0.1 / 1.5).all())


def test_confidence_becomes_a_covariate_unless_it_says_nothing():
    recording, _ = record(TIME)
    rng = np.random.default_rng(0)
    varied = replace(recording, confidence=rng.uniform(size=(50, 2)))
    constant = replace(recording, confidence=np.ones((50, 2)))
    assert "emission.confidence_slope" in arm_problem(varied, body()).model.parameters
    assert "emission.confidence_slope" not in arm_problem(constant, body()).model.parameters


def test_start_values_are_of_the_right_size():
    recording, truth = record(TIME, noise=0.005)
    model = arm_problem(recording, body()).model
    assert model.parameters["emission.keypoint_scale"].numpy() == pytest.approx(0.005, rel=0.8)
    assert model.parameters["initial.angle"].numpy() == pytest.approx(truth.angle[0], abs=0.1)


# -- refusals ----------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"method": "magic"}, "expected a method among smc, bootstrap.*got 'magic'"),
        ({"settings": {"torque.scales": 1.0}}, "no parameter torque.scales.*torque.scale"),
        ({"settings": {"torque.scale": [1.0, 2.0, 3.0]}}, "torque.scale"),
    ],
)
def test_wrong_settings_are_input_errors(options, message):
    recording, _ = record(TIME[:10])
    with pytest.raises(InputError, match=message):
        infer(recording, body(), **options, **SMALL)


def test_recordings_that_do_not_fit_are_input_errors():
    recording, truth = record(TIME[:10])
    strange = replace(recording, keypoint_names=("elbow", "nose"))
    with pytest.raises(InputError, match=r"'nose' is not of body 'arm'.*shoulder, elbow, wrist"):
        arm_problem(strange, body())
    solid = replace(recording, keypoints=np.zeros((10, 2, 3)))
    with pytest.raises(InputError, match=r"3 coordinates.*plane"):
        arm_problem(solid, body())
    other = replace(recording, torques=truth.torque, joint_names=("hip", "knee"))
    with pytest.raises(InputError, match="joints hip, knee, but body 'arm' has shoulder, elbow"):
        arm_problem(other, body())
    command = truth.torque.copy()
    command[4, 1] = np.nan
    gappy = replace(recording, torques=command, joint_names=JOINTS)
    with pytest.raises(InputError, match="missing at frame 4"):
        arm_problem(gappy, body())
    base_only = replace(recording, keypoints=recording.keypoints[:, :1], keypoint_names=("shoulder",))
    with pytest.raises(InputError, match="neither a keypoint nor an angle"):
        arm_problem(base_only, body())


def test_vsmc_is_given_the_prior_and_not_what_was_fitted(monkeypatch):
    """Beside other methods it answers their question, at the fitted parameters."""
    given = {}
    monkeypatch.setitem(METHODS, "vsmc", lambda problem, **options: given.update(options, problem=problem))
    recording, _ = record(0.03 * np.arange(15))
    known = {"torque.decay": 5.0, "noise.velocity": 0.01}
    task = prepare(recording, body(), options=SMCOptions(**SMALL), seed=0, settings=known)
    task.run("vsmc", learn=True)
    assert [f.name for f in given["free"]] == ["torque.scale", "emission.keypoint_scale"]
    start, fitted = given["problem"].model.parameters, task.problem.model.parameters
    assert not torch.allclose(start["torque.scale"], fitted["torque.scale"])
    assert torch.equal(start["torque.decay"], fitted["torque.decay"])
    given.clear()
    task.run("vsmc")
    assert "free" not in given
    assert given["problem"] is task.problem


@pytest.mark.slow
def test_vsmc_learns_what_the_others_fit():
    recording, _ = record(0.03 * np.arange(40))
    learned_length = body(length=(Learned(0.35), 0.3))
    task = prepare(recording, learned_length, options=SMCOptions(8, 20, 2), seed=0)
    names = {f.name for f in task.free}
    assert {"torque.scale", "emission.keypoint_scale", "body.length"} <= names
    learned = task.run("vsmc", learn=True)["posterior"]
    for name in names - {"body.length"}:
        values = learned[name].values.reshape(8, -1)
        assert (values > 0).all()
        assert len(np.unique(values)) >= 8, name
        assert np.log(values).std() < 2.0  # narrower than the prior
    assert learned["length"].values.std() > 0
    fixed = task.run("vsmc")["posterior"]
    assert not names & set(fixed)


def test_the_old_name_of_a_method_has_the_same_answer_and_warns(known):
    recording, truth, new = known
    with pytest.warns(UserWarning, match="'nested' is now 'smc'"):
        old = infer(recording, body(), settings=KNOWN, truth=truth, seed=1, method="nested", **SMALL)
    assert old.attrs["method"] == "smc"
    assert old["posterior"].equals(new["posterior"])
