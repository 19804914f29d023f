"""An arm without contact by MuJoCo's Runge–Kutta, against the arm model: one posterior, by two engines."""

import numpy as np
import pytest
import torch

from invdyn.inference import SMCOptions, gaussian_smoother
from invdyn.inference.filters.filtering import run_filters
from invdyn.models import ArmModel, Body, EngineModel, Keypoints, Observation

ARM = """<mujoco model="arm"><option timestep="0.01" integrator="RK4"/><worldbody><body name="upper" pos="0 0 1">
  <joint name="shoulder" axis="0 1 0" damping=".1"/><site name="elbow" pos="0 0 -.3"/>
  <geom type="capsule" fromto="0 0 0 0 0 -.3" size=".02" mass="1.2" contype="0" conaffinity="0"/>
  <body name="fore" pos="0 0 -.3"><joint name="elbow" axis="{axis}" armature=".01"/>
  <geom type="capsule" fromto="0 0 0 0 0 -.25" size=".02" mass=".8" contype="0" conaffinity="0"/>
  <site name="wrist" pos="0 0 -.25"/><site name="thumb" pos=".05 .03 -.2"/></body></body></worldbody></mujoco>"""
KNOWN = {
    "emission.keypoint_scale": 0.003,
    "torque.scale": 6.0,
    "noise.angle": 1e-4,
    "noise.velocity": 1e-3,
    "initial.angle_scale": 0.5,
    "initial.velocity_scale": 1.0,
}


@pytest.mark.parametrize("axis", ["0 1 0", pytest.param("1 0 0", marks=pytest.mark.long)])
def test_one_posterior_by_two_engines(axis, tmp_path):
    """Evidence within .05 nats, torques within the posterior's own error; in space with crossed hinges, too."""
    path = tmp_path / "arm.xml"
    path.write_text(ARM.format(axis=axis))
    time = np.arange(40) * 0.02
    seen = Observation(Keypoints(["elbow", "wrist", "thumb"]))
    fast = ArmModel(Body.load(path, dimensions=3), time, seen, substeps=2, parameters=KNOWN)
    engine = EngineModel(path, time, seen, parameters=KNOWN)
    _, rows = fast.simulate(seed=0)
    assert not engine.nonsmooth

    ours, theirs = gaussian_smoother(fast, rows), gaussian_smoother(engine, rows)
    assert theirs.log_evidence.item() == pytest.approx(ours.log_evidence.item(), abs=0.05)
    sd = ours.covariance().diagonal(dim1=-2, dim2=-1).sqrt()
    assert float(((ours.path - theirs.path).abs() / sd).max()) < 0.05
    torch.manual_seed(1)
    evidence = [
        run_filters(model, rows, SMCOptions(num_filters=4, num_particles=100), smoother=smoother).log_evidence
        for model, smoother in ((fast, ours), (engine, theirs))
    ]
    assert float(evidence[1].mean()) == pytest.approx(float(evidence[0].mean()), abs=0.05)
