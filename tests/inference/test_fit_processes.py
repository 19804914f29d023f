"""Where fits begin: on the middle of a long recording, and where another torque process ended."""

from dataclasses import dataclass

import numpy as np
import pytest
import torch

from invdyn.inference import fit, fit_processes
from invdyn.inference.free_parameters import at_start, free_parameters
from invdyn.inference.posterior.initialise import arm_problem
from invdyn.models import Link, Matern32, OrnsteinUhlenbeck, planar_body
from invdyn.recordings import InputError, Recording

ROWS, FROM, PILOT = 81, 60, 20
KNOWN = {"emission.keypoint_scale": 0.002}


@pytest.fixture(scope="module")
def recording():
    """A swinging rod."""
    time = 0.02 * np.arange(ROWS)
    angle = 0.8 * np.sin(4 * time)
    points = 0.5 * np.stack([np.cos(angle), np.sin(angle)], -1)[:, None]
    return Recording(time, points + 0.002 * np.random.default_rng(0).standard_normal(points.shape), ("tip",))


def bound(part, process=None):
    body = planar_body("rod", [Link("rod", "hinge", "tip", length=0.5, mass=1.0)])
    return arm_problem(part, body, torque=process or OrnsteinUhlenbeck(), parameters=KNOWN, substeps=1)


@pytest.fixture
def short_pilots(monkeypatch):
    monkeypatch.setattr(fit_processes, "PILOT_ROWS", PILOT)
    monkeypatch.setattr(fit_processes, "PILOT_FROM", FROM)


def test_a_long_recording_is_fitted_on_its_middle_first(recording, short_pilots, monkeypatch):
    free, parts, begun = free_parameters(bound(recording), tuple(KNOWN)), [], []

    def seen(part):
        parts.append(part)
        return bound(part)

    def kept(*given, begin):
        begun.append(begin)
        return fit(*given, begin=begin)

    monkeypatch.setattr(fit_processes, "fit", kept)
    known = {"torque.scale": torch.tensor([0.3], dtype=torch.float64)}
    found = fit_processes.fitted_on_the_middle(recording, seen, free, known)
    assert begun == [known]
    np.testing.assert_array_equal(parts[0].time, recording.time[30:50])
    problem = bound(recording.select(30, 50))
    expected = fit(at_start(problem, free), problem.observations, free, begin=known).model.parameters
    assert set(found) == {each.name for each in free}
    assert all(torch.equal(found[name], expected[name]) for name in found)


def test_what_has_no_such_middle_begins_as_it_is(recording, short_pilots):
    free = free_parameters(bound(recording), tuple(KNOWN))

    @dataclass(frozen=True)
    class Other(Recording):
        """Rows that a part of it would not have."""

    def refused(part):
        raise InputError("the arm is not seen there")

    assert not fit_processes.fitted_on_the_middle(recording.select(0, FROM - 1), bound, free, {})
    assert not fit_processes.fitted_on_the_middle(recording, refused, free, {})
    other = Other(recording.time, recording.keypoints, recording.keypoint_names)
    assert not fit_processes.fitted_on_the_middle(other, bound, free, {})


def test_another_process_begins_at_the_torques_and_motion_that_were_found(recording, monkeypatch):
    problems = [bound(recording, process) for process in (Matern32(), OrnsteinUhlenbeck())]
    given = []

    def over_gaps(model, rows, free, report, origin, **like):
        given.append(like)
        return fit(model, rows, free, **like), []

    monkeypatch.setattr(fit_processes, "fit_over_gaps", over_gaps)
    frees = [free_parameters(each, tuple(KNOWN)) for each in problems]
    own = {"torque.decay": torch.tensor([3.0], dtype=torch.float64)}
    fits, _ = fit_processes.fit_processes(problems, frees, lambda number, known: own if number else {}, None, None)
    first, like = fits[0], given[1]
    assert first.path.shape[-1] == 4  # τ, its slope, angle and velocity
    torch.testing.assert_close(like["start"], first.path[:, [0, 2, 3]], rtol=0, atol=0)
    assert torch.equal(like["begin"]["torque.scale"], first.model.parameters["torque.scale"])
    assert like["begin"]["torque.decay"] is own["torque.decay"]
    assert "torque.lengthscale" not in like["begin"]
    assert given[0] == {"begin": {}}
