"""Every method over small arms: one layout; and over a linear arm, whose posterior is known exactly."""

from dataclasses import replace

import arviz as az
import numpy as np
import pytest
import torch
from oracles import Chain, kalman, rts

from invdyn.inference import (
    METHODS,
    SMCOptions,
    arm_problem,
    load_posterior,
    mechanics,
    pooled,
    save_posterior,
)
from invdyn.inference.methods.registry import WITHOUT_EVIDENCE
from invdyn.models import (
    FAMILIES,
    INTEGRATORS,
    TORQUE_PROCESSES,
    Link,
    Matern32,
    Matern52,
    OrnsteinUhlenbeck,
    RandomWalk,
    Recurrent,
    SmoothAndRough,
    planar_body,
    planar_dynamics,
)
from invdyn.recordings import InputError, Recording

T = 20
TIME = 0.03 * np.arange(T)
TIPS, JOINTS = ("elbow", "wrist"), ("shoulder", "elbow")
GAP = slice(9, 12)
SIZES = SMCOptions(num_filters=4, num_particles=30, num_draws=3)
QUICK = {
    "nuts": {"chains": 2, "warmup": 3},
    "particle-gibbs": {"warmup": 2, "thin": 2},
    "svi": {"max_steps": 10},
    "svi-markov": {"max_steps": 10},
    "vsmc": {"steps": 2},
}
"""Layout needs no convergence."""


def body(joints, gravity=(0.0, -9.81)):
    links = [Link(f"link{k}", JOINTS[k], TIPS[k], length=(0.35, 0.3)[k], mass=(1.5, 1.0)[k]) for k in range(joints)]
    return planar_body("arm", links, gravity=gravity)


def problem(joints):
    """One joint: torque unknown. Two joints: commanded, and the wrist lost for three frames."""
    arm = body(joints)
    rng = np.random.default_rng(joints)
    angle = np.array([-1.2, 0.8])[:joints] + 0.5 * np.sin(np.array([2.0, 3.0])[:joints] * TIME[:, None])
    tips = planar_dynamics(joints).keypoints(torch.as_tensor(angle), arm.parameters()).numpy()
    tips = tips + 0.01 * rng.normal(size=tips.shape)
    commanded = joints == 2
    if commanded:
        tips[GAP, 1] = np.nan
    recording = Recording(
        time=TIME,
        keypoints=tips,
        keypoint_names=TIPS[:joints],
        torques=rng.normal(size=(T, joints)) if commanded else None,
        joint_names=JOINTS[:joints] if commanded else (),
    )
    known = {"torque.scale": 4.0, "emission.keypoint_scale": 0.01, "noise.velocity": 0.02}
    return arm_problem(recording, arm, parameters=known, substeps=1)


@pytest.fixture(scope="module", params=[1, 2])
def case(request):
    return problem(request.param)


@pytest.mark.quick("1-*")
@pytest.mark.parametrize("method", METHODS)
def test_every_method_gives_the_documented_posterior(case, method, tmp_path):
    def run(seed):
        return METHODS[method](case, options=SIZES, seed=seed, settings={"a": 1}, **QUICK.get(method, {}))

    torch.manual_seed(5)
    expected = torch.rand(2)
    torch.manual_seed(5)
    idata = run(3)
    assert torch.equal(torch.rand(2), expected)  # the caller's random numbers are left alone

    joints = case.model.body.num_joints
    posterior, stats = idata["posterior"], idata["sample_stats"]
    frame = ("chain", "draw", "time", "joint")
    units = {"torque": "N·m", "angle": "rad", "velocity": "rad/s"}
    for name, unit in units.items():
        assert posterior[name].dims == frame
        assert posterior[name].shape[2:] == (T, joints)
        assert posterior[name].attrs["units"] == unit
    assert posterior["position"].dims == ("chain", "draw", "time", "keypoint", "space")
    assert posterior["position"].attrs["units"] == "m"
    assert list(posterior["joint"].values) == list(JOINTS[:joints])
    command = 0.0 if case.model.command is None else case.model.command.numpy()
    if joints == 2:
        assert (posterior["torque"] - posterior["residual_torque"]).values == pytest.approx(
            np.broadcast_to(command, posterior["torque"].shape), nan_ok=True
        )

    torque = posterior["torque"].values
    seen = np.ones(T, dtype=bool)
    if method == "differentiate":  # it may give up in a gap
        seen[GAP] = False
    assert np.isfinite(torque[:, :, seen]).all()
    # What it found is what the arm did: angles to a few times the 0.01 m of noise.
    off = (posterior["position"].mean(("chain", "draw")) - idata["observed_data"]["position"]).values
    if method != "bootstrap":  # which gets lost with 30 particles
        assert np.sqrt(np.nanmean(off**2)) < 0.03

    assert stats["log_evidence"].dims == stats["log_weight"].dims == ("filter",)
    assert np.exp(stats["log_weight"].values).sum() == pytest.approx(1)
    assert stats.attrs["method"] == idata.attrs["method"] == method
    assert stats.attrs["bound"] == int(method in ("svi", "svi-markov"))
    assert 0 < stats.attrs["seconds"] < 100
    has_evidence = method not in WITHOUT_EVIDENCE
    assert np.isfinite(stats["log_evidence"]).all() == np.isfinite(idata.attrs["log_evidence"]) == has_evidence

    again, other = run(3), run(4)
    for group in idata.groups():
        for name in idata[group].data_vars:
            assert idata[group][name].values.tobytes() == again[group][name].values.tobytes(), name
    if method != "differentiate":  # which is no random draw
        assert not np.array_equal(torque, other["posterior"]["torque"].values)

    save_posterior(idata, tmp_path / "x.nc")
    back = load_posterior(tmp_path / "x.nc")
    for group in idata.groups():
        assert idata[group].equals(back[group])
    assert back["sample_stats"].attrs == pytest.approx(stats.attrs, nan_ok=True)
    assert back.attrs["settings"] == idata.attrs["settings"]

    assert pooled(idata).sizes["sample"] == posterior.sizes["chain"] * posterior.sizes["draw"]
    assert mechanics(idata)["power"].shape == torque.shape
    if method != "differentiate":
        assert len(az.summary(idata, var_names=["torque"])) == T * joints


# -- every model -------------------------------------------------------------------------------------
SHORT = 10
MODELS = {
    "printed": (OrnsteinUhlenbeck("printed"), "euler", "gaussian", 1),
    "ornstein_uhlenbeck": (OrnsteinUhlenbeck(), "rk4", "student_t", 2),
    "random_walk": (RandomWalk(), "semi_implicit", "gaussian", 1),
    "matern32": (Matern32(), "rk4", "gaussian", 2),
    "matern52": (Matern52(), "euler", "multivariate_t", 1),
    "recurrent": (Recurrent(), "semi_implicit", "student_t", 1),
    "smooth_and_rough": (SmoothAndRough(), "rk4", "gaussian", 1),
}
"""Torque process, integrator, family of the noise, joints: each occurs."""
SHORTEST = {
    "nuts": {"chains": 1, "warmup": 2},
    "particle-gibbs": {"warmup": 1, "thin": 1},
    "svi": {"max_steps": 3},
    "svi-markov": {"max_steps": 3},
    "vsmc": {"steps": 1},
}


def test_the_list_of_models_is_complete():
    assert {type(process) for process, *_ in MODELS.values()} == set(TORQUE_PROCESSES.values())
    assert {integrator for _, integrator, *_ in MODELS.values()} == set(INTEGRATORS)
    assert {family for _, _, family, _ in MODELS.values()} == set(FAMILIES)


@pytest.mark.quick("laplace-*", "*-random_walk")
@pytest.mark.parametrize(
    ("method", "kind"),
    [
        (method, kind)
        for method in METHODS
        for kind in (MODELS if method == "laplace" else ("random_walk", "matern52", "recurrent"))
    ],
)
def test_every_method_runs_on_models_of_all_sorts(method, kind):
    process, integrator, family, joints = MODELS[kind]
    given = problem(joints)
    given = arm_problem(
        given.recording.select(0, SHORT),
        body(joints),
        torque=process,
        integrator=integrator,
        family=family,
        substeps=1,
        parameters={"noise.velocity": 0.05},
    )
    sizes = SMCOptions(num_filters=2, num_particles=20, num_draws=4, refits=0)
    idata = METHODS[method](given, options=sizes, seed=0, **SHORTEST.get(method, {}))
    torque = idata["posterior"]["torque"]
    assert torque.sizes["time"] == SHORT
    assert torque.sizes["joint"] == joints
    seen = slice(None, GAP.start if method == "differentiate" else None)
    assert np.isfinite(torque.values[:, :, seen]).all()
    assert np.isfinite(idata.attrs["log_evidence"]) == (method not in WITHOUT_EVIDENCE)


@pytest.mark.quick("1")
def test_a_method_reports_its_progress(case):
    for method in ("svi", "vsmc", "particle-gibbs", "differentiate"):
        reported = []
        METHODS[method](
            case, options=SIZES, progress=lambda *now, reported=reported: reported.append(now), **QUICK.get(method, {})
        )
        for what in {w for _, _, w in reported}:
            done = [d for d, _, w in reported if w == what]
            assert done == sorted(done)
        assert reported[-1][0] <= reported[-1][1]
        assert done[-1] > 0


# -- exactness ---------------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def linear():
    """One joint without gravity, watched by its encoder: linear and Gaussian. Problem, and the exact answers."""
    rng = np.random.default_rng(0)
    angle = 0.4 * np.sin(4 * TIME)[:, None] + 0.02 * rng.normal(size=(T, 1))
    angle[8] = np.nan
    recording = Recording(
        time=TIME, keypoints=np.zeros((T, 0, 2)), keypoint_names=(), angles=angle, joint_names=JOINTS[:1]
    )
    known = {"torque.scale": 1.0, "emission.angle_scale": 0.02, "noise.velocity": 0.05, "noise.angle": 0.01}
    given = arm_problem(recording, body(1, gravity=(0.0, 0.0)), parameters=known, substeps=1)
    model = given.model
    first, then = model.initial(), model.transition(torch.eye(3, dtype=torch.float64), 1)
    noise = then.base_dist.scale[0].numpy()
    chain = Chain(
        A=then.base_dist.loc.numpy().T,
        Q=np.diag(noise**2),
        C=np.array([[0.0, 1.0, 0.0]]),
        R=np.array([[0.02**2]]),
        m=first.base_dist.loc.numpy(),
        P=np.diag(first.base_dist.scale.numpy() ** 2),
    )
    y = given.observations.numpy()
    means, covariances = rts(chain, y)
    return given, chain, kalman(chain, y)[0], means[:, 0], np.sqrt(covariances[:, 0, 0])


def precision(chain, y):
    """Of the whole path, dense (3T, 3T)."""
    dim = len(chain.m)
    Q, R = np.linalg.inv(chain.Q), np.linalg.inv(chain.R)
    out = np.zeros((T * dim, T * dim))
    for t in range(T):
        here = slice(t * dim, (t + 1) * dim)
        out[here, here] += np.linalg.inv(chain.P) if t == 0 else Q
        if np.isfinite(y[t]).all():
            out[here, here] += chain.C.T @ R @ chain.C
        if t + 1 < T:
            later = slice((t + 1) * dim, (t + 2) * dim)
            out[here, here] += chain.A.T @ Q @ chain.A
            out[here, later] -= chain.A.T @ Q
            out[later, here] -= Q @ chain.A
    return out


MANY = SMCOptions(num_filters=40, num_particles=50, num_draws=10, dtype=torch.float64)


@pytest.mark.quick("laplace", "smc", "vsmc")
@pytest.mark.parametrize(
    "method", ["laplace", "smc", "vsmc", "svi-markov", pytest.param("nuts", marks=pytest.mark.slow), "particle-gibbs"]
)
def test_exact_methods_agree_with_the_kalman_smoother(linear, method):
    given, _, evidence, mean, sd = linear
    few = {
        "nuts": {"chains": 2, "warmup": 60, "options": replace(MANY, num_filters=20)},
        "vsmc": {"steps": 3},
    }.get(method, {})
    idata = METHODS[method](given, **{"options": MANY, "seed": 1, **few})
    draws = pooled(idata)["torque"].values[..., 0]
    size = min(idata["sample_stats"].attrs.get("ess_bulk", np.inf), len(draws))
    assert size > 60
    # largest of 20 correlated standardised errors
    assert np.abs((draws.mean(0) - mean) / sd).max() < 4 / np.sqrt(size)
    assert np.abs(draws.std(0) / sd - 1).max() < 4 / np.sqrt(2 * size)
    found = idata.attrs["log_evidence"]
    if method in ("laplace", "smc", "vsmc"):
        assert found == pytest.approx(evidence, abs=1e-6)
    if method == "svi-markov":
        error = idata.attrs["log_evidence_sd"]
        assert evidence - 0.2 < found < evidence + 4 * error + 1e-6
    if method in ("nuts", "particle-gibbs"):
        assert idata["sample_stats"].attrs["r_hat"] < 1.1
    if method == "nuts":
        assert idata["sample_stats"].attrs["divergences"] == 0


@pytest.mark.long
def test_mean_field_is_too_sure_by_as_much_as_theory_says(linear):
    """Its best variances are one over the precision's diagonal, and its bound lies below by ½ log |D| − ½ log |Λ|."""
    given, chain, evidence, mean, sd = linear
    idata = METHODS["svi"](given, options=MANY, seed=1)
    draws = pooled(idata)["torque"].values[..., 0]
    exact = precision(chain, given.observations.numpy())
    diagonal = np.diag(exact)
    own = 1 / np.sqrt(diagonal.reshape(T, 3)[:, 0])
    assert draws.std(0) == pytest.approx(own, rel=4 / np.sqrt(2 * len(draws)) + 0.05)
    assert (own < 0.6 * sd).mean() > 0.9
    assert np.abs((draws.mean(0) - mean) / sd).max() < 0.3
    gap = 0.5 * (np.log(diagonal).sum() - np.linalg.slogdet(exact)[1])
    assert gap > 5
    assert idata.attrs["log_evidence"] == pytest.approx(evidence - gap, abs=4 * idata.attrs["log_evidence_sd"] + 0.3)


def test_nuts_refuses_long_series():
    long = 101
    recording = Recording(
        time=0.03 * np.arange(long),
        keypoints=np.zeros((long, 0, 2)),
        keypoint_names=(),
        angles=np.zeros((long, 1)),
        joint_names=JOINTS[:1],
    )
    with pytest.raises(InputError, match="at most 100 frames, got 101"):
        METHODS["nuts"](arm_problem(recording, body(1)), options=SIZES)
