"""A body in space by every method, torque process, integrator and noise family; and its mechanics, frame by frame."""

from functools import cache

import numpy as np
import pytest
import torch
from trees import MuJoCo

from invdyn.inference import (
    METHODS,
    SMCOptions,
    arm_problem,
    infer,
    load_posterior,
    mechanics,
    pooled,
    save_posterior,
)
from invdyn.inference.smoothing.gauss_newton import gauss_newton
from invdyn.models import FAMILIES, INTEGRATORS, TORQUE_PROCESSES, Body, Joint, Link, OrnsteinUhlenbeck, dynamics_for
from invdyn.recordings import Recording

T, NOISE = 14, 0.005
TIME = 0.03 * np.arange(T)
GAP = slice(6, 8)
SIZES = SMCOptions(num_filters=3, num_particles=20, num_draws=2)
QUICK = {
    "nuts": {"chains": 1, "warmup": 3},
    "particle-gibbs": {"warmup": 2, "thin": 2},
    "svi": {"max_steps": 5},
    "svi-markov": {"max_steps": 5},
    "vsmc": {"steps": 2},
}
KNOWN = {"torque.scale": 4.0, "emission.keypoint_scale": NOISE, "noise.velocity": 0.02}


def arm():
    """A shoulder with yaw and pitch, an elbow that bends about a level axis; a fin makes the links no thin rods."""
    return Body(
        "arm",
        [
            Link(
                "upper",
                Joint("shoulder", "universal"),
                length=0.35,
                tip="elbow",
                mass=1.5,
                inertia=(0.002, 0.015, 0.015, 0, 0, 0),
            ),
            Link(
                "fore",
                Joint("elbow", axis=(0.0, 1.0, 0.0)),
                parent="upper",
                mass=1.0,
                com=(0.15, 0.0, 0.01),
                inertia=(0.001, 0.008, 0.008, 0.0, 0.0, 0.0),
                sites={"wrist": (0.3, 0.0, 0.0), "fin": (0.2, 0.0, 0.05)},
            ),
        ],
        gravity=(0.0, -9.81, 0.0),
    )


@cache
def problem(family="gaussian", **options):
    """A smooth motion seen with noise; the fin is lost for two frames."""
    body = arm()
    q = np.array([-1.3, 0.2, 0.6]) + np.array([0.5, 0.3, 0.4]) * np.sin(np.array([4.0, 5.0, 6.0]) * TIME[:, None])
    points = dynamics_for(body).keypoints(torch.as_tensor(q), body.parameters()).numpy()
    points = points + NOISE * np.random.default_rng(0).normal(size=points.shape)
    points[GAP, 2] = np.nan
    recording = Recording(time=TIME, keypoints=points, keypoint_names=("elbow", "wrist", "fin"))
    options = {name: value() for name, value in options.items()} if "torque" in options else options
    known = KNOWN if "torque" not in options else {"emission.keypoint_scale": NOISE}
    return arm_problem(recording, body, family=family, parameters=known, substeps=1, **options)


@pytest.mark.quick("laplace", "smc", "vsmc")
@pytest.mark.parametrize("method", METHODS)
def test_every_method_gives_the_documented_posterior(method, tmp_path):
    idata = METHODS[method](problem(), options=SIZES, seed=3, **QUICK.get(method, {}))
    posterior = idata["posterior"]
    assert list(posterior["joint"].values) == ["shoulder_yaw", "shoulder_pitch", "elbow"]
    assert posterior["position"].sizes["space"] == 3
    seen = np.ones(T, dtype=bool)
    if method == "differentiate":  # it gives up in a gap
        seen[GAP] = False
    assert np.isfinite(posterior["torque"].values[:, :, seen]).all()
    off = (posterior["position"].mean(("chain", "draw")) - idata["observed_data"]["position"]).values[seen]
    if method != "bootstrap":  # which gets lost with 20 particles
        assert np.sqrt(np.nanmean(off**2)) < 3 * NOISE
    save_posterior(idata, tmp_path / "x.nc")
    if method != "differentiate":
        assert load_posterior(tmp_path / "x.nc")["posterior"].equals(posterior)


@pytest.mark.quick("random_walk", "smooth_and_rough")
@pytest.mark.parametrize("torque", TORQUE_PROCESSES)
def test_every_torque_process_has_a_mode(torque):
    own = problem(torque=TORQUE_PROCESSES[torque])
    smoother = gauss_newton(own.model, own.observations)
    assert np.isfinite(smoother.log_evidence.item())
    _, q, _ = own.model.split(smoother.path)
    points = own.model.dynamics.keypoints(q, own.model.body_parameters()).flatten(-2) - own.observations
    assert points.nan_to_num().square().mean().sqrt() < 3 * NOISE


@pytest.mark.quick("gaussian-semi_implicit", "student_t-rk4")
@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize("family", FAMILIES)
def test_every_integrator_and_noise_family(integrator, family):
    own = problem(family, integrator=integrator)
    idata = METHODS["laplace"](own, options=SIZES, seed=1)
    assert np.isfinite(idata.attrs["log_evidence"])
    assert np.isfinite(pooled(idata)["torque"]).all()


def test_mechanics_frame_by_frame_are_those_of_another_engine():
    idata = METHODS["laplace"](problem(), options=SIZES, seed=0)
    table, engine = mechanics(idata, arm()), MuJoCo(arm())
    for draw, t in ((0, 0), (1, 9)):
        frame = {"chain": 1, "draw": draw, "time": t}
        here, state = table.isel(frame), idata["posterior"].isel(frame)
        q, qd = state["angle"].values, state["velocity"].values
        at_rest, moving = engine(q, 0 * qd, 0 * q), engine(q, qd, here["acceleration"].values)
        assert here["inertia_matrix"].values == pytest.approx(moving["inertia_matrix"], abs=1e-9)
        assert here["gravity_load"].values == pytest.approx(at_rest["bias"], abs=1e-9)
        assert here["coriolis"].values == pytest.approx(moving["bias"] - at_rest["bias"], abs=1e-9)
        assert float(here["kinetic_energy"]) == pytest.approx(moving["kinetic_energy"], abs=1e-9)
        assert float(here["potential_energy"]) == pytest.approx(moving["potential_energy"], abs=1e-9)
        assert state["torque"].values == pytest.approx(moving["inverse"], abs=1e-8)
        assert here["power"].values == pytest.approx(state["torque"].values * qd)


def test_from_a_recording_to_torques_with_nothing_known():
    sizes = {"num_filters": 4, "num_particles": 50, "num_draws": 4}
    idata = infer(problem().recording, arm(), seed=0, torque=OrnsteinUhlenbeck(), **sizes)
    assert idata.attrs["outer_ess"] > 3.5
