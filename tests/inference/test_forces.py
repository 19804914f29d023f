"""Known forces on a body: what is left is the joints' own torque, by closed forms."""

import json

import numpy as np
import pytest
import torch

from invdyn.inference import infer, load_posterior, pooled
from invdyn.models import Link, OrnsteinUhlenbeck, dynamics_for, planar_body
from invdyn.models.articulated.applied_force import AppliedForce
from invdyn.recordings import InputError, Recording, SiteForce, read_forces, write_keypoint_csv

TIME = 5.0 + np.arange(60) / 30
CLOCK = np.linspace(4.9, 7.1, 300)
LENGTHS = 0.3, 0.26
ARM = planar_body("arm", [Link("u", "shoulder", "elbow", 0.3, 2.0), Link("f", "elbow", "wrist", 0.26, 1.5)])
KNOWN = {"method": "laplace", "num_filters": 4, "num_draws": 20, "torque": OrnsteinUhlenbeck()}


def pull(time):
    """N, on the wrist."""
    return np.stack([12 * np.sin(2.0 * time), -20 + 8 * np.cos(3.0 * time)], -1)


def motion():
    """Angles (T, 2), their rates and accelerations."""
    t = torch.tensor(TIME - TIME[0], requires_grad=True)
    angles = torch.stack([-1.0 + 0.4 * torch.sin(2 * t), 0.8 + 0.3 * torch.sin(3 * t + 1)], -1)
    rates = torch.stack([0.8 * torch.cos(2 * t), 0.9 * torch.cos(3 * t + 1)], -1)
    more = torch.stack([-1.6 * torch.sin(2 * t), -2.7 * torch.sin(3 * t + 1)], -1)
    return [each.detach() for each in (angles, rates, more)]


def of_force(angles, force):
    """Jᵀ F (T, 2) of a force (T, 2) on the wrist, written out."""
    whole = np.cumsum(angles, -1)
    steps = [length * np.stack([-np.sin(a), np.cos(a)], -1) for length, a in zip(LENGTHS, whole.T, strict=True)]
    columns = [steps[0] + steps[1], steps[1]]
    return np.stack([(column * force).sum(-1) for column in columns], -1)


@pytest.fixture(scope="module")
def pulled():
    """A recording of an arm that somebody pulls, and its true torques (T, 2)."""
    q, qd, qdd = motion()
    dynamics, numbers = dynamics_for(ARM), ARM.parameters()
    points = dynamics.keypoints(q, numbers).numpy()
    points = points + 0.001 * np.random.default_rng(0).standard_normal(points.shape)
    torque = dynamics.inverse(q, qd, qdd, numbers).numpy() - of_force(q.numpy(), pull(TIME))
    return Recording(TIME, points, ("elbow", "wrist"), name="pulled"), torque


def error(idata, torque):
    return np.sqrt(((pooled(idata)["torque"].values.mean(0) - torque)[5:-5] ** 2).mean(0))


def test_a_known_force_leaves_the_joints_own_torque(pulled):
    recording, torque = pulled
    force = SiteForce("wrist", CLOCK, pull(CLOCK))
    known, unknown = (infer(recording, ARM, forces=forces, **KNOWN) for forces in ([force], []))
    size = np.sqrt((of_force(motion()[0].numpy(), pull(TIME)) ** 2).mean(0))
    assert (error(known, torque) < 0.1 * size).all()
    np.testing.assert_allclose(error(unknown, torque), size, rtol=0.2)


def test_a_force_on_a_site_between_rows_is_a_straight_line():
    effect = AppliedForce("wrist", [0.0, 1.0, 3.0], [[0.0, 1.0], [2.0, 1.0], [2.0, 5.0]])
    found = effect.at(torch.tensor([[-1.0], [0.25], [2.0], [9.0]]))
    torch.testing.assert_close(found, torch.tensor([[0.0, 1.0], [0.5, 1.0], [2.0, 3.0], [2.0, 5.0]]))


def test_forces_come_from_a_file_with_its_own_clock(pulled, tmp_path, monkeypatch):
    from typer.testing import CliRunner

    from invdyn.cli import app

    recording, torque = pulled
    rows = [f"{t:.6f},{x:.6f},{y:.6f}" for t, (x, y) in zip(CLOCK, pull(CLOCK), strict=True)]
    (tmp_path / "handle.csv").write_text("time,wrist_fx,wrist_fy\n" + "\n".join(rows) + "\n")
    (force,) = read_forces(tmp_path / "handle.csv")
    np.testing.assert_allclose(force.force, pull(CLOCK), atol=1e-6)
    monkeypatch.chdir(tmp_path)
    write_keypoint_csv(recording, tmp_path / "rec.csv")
    ARM.to_toml(tmp_path / "arm.toml")
    line = (
        "infer rec.csv --body arm.toml --set forces=handle.csv --torque ornstein_uhlenbeck --method laplace --out p.nc"
    )
    outcome = CliRunner().invoke(app, line.split())
    assert outcome.exit_code == 0, outcome.output
    idata = load_posterior(tmp_path / "p.nc")
    assert (error(idata, torque) < 0.5).all()
    assert json.loads(idata.attrs["settings"])["forces"] == ["wrist"]


@pytest.mark.parametrize(
    ("force", "message"),
    [
        (SiteForce("hand", CLOCK, pull(CLOCK)), "no keypoint of the body, which has elbow, wrist"),
        (SiteForce("wrist", CLOCK, np.zeros((300, 3))), "expected 2 components, got 3"),
        (SiteForce("wrist", CLOCK - 1, pull(CLOCK)), "check both clocks"),
    ],
)
def test_a_force_that_does_not_fit_is_refused(pulled, force, message):
    with pytest.raises(InputError, match=message):
        infer(pulled[0], ARM, forces=[force], **KNOWN)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time,wrist_x,wrist_y\n0,1,2\n1,1,2\n", "columns <keypoint>_fx, _fy and _fz, got 'wrist_x'"),
        ("time,wrist_fx,elbow_fy\n0,1,2\n1,1,2\n", "force on wrist: expected fx, fy"),
        ("time,wrist_fx,wrist_fy\n0,1,\n1,1,2\n", "got an empty one: write 0"),
        ("wrist_fx,wrist_fy\n1,2\n1,2\n", "expected columns time"),
    ],
)
def test_a_file_of_no_forces_is_refused(text, message, tmp_path):
    (tmp_path / "f.csv").write_text(text)
    with pytest.raises(InputError, match=message):
        read_forces(tmp_path / "f.csv")
