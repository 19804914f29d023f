"""Clocks that run ahead are found from the motion, to a small part of a frame."""

import numpy as np
import pytest
from scenes import ring, swinging

from invdyn.recordings import InputError, Recording
from invdyn.recordings.cameras.projection import project
from invdyn.recordings.cameras.scene import reconstruct
from invdyn.recordings.cameras.synchronise import find_offsets
from invdyn.recordings.cameras.views import at_one_time

RATE = 60.0
TRUE = {"cam2": 0.020, "cam3": -0.031}
NAMES = ("shoulder", "elbow", "wrist")


def tracks(calibration, frames=60, noise=1.0, moving=True):
    """Each camera's tracks under its own clock: stamps are the moment plus the offset."""
    fine = swinging(100 * frames)  # 100 moments a frame
    rng, found = np.random.default_rng(0), {}
    time = np.arange(10, frames - 10) / RATE
    for camera in calibration:
        moment = time - TRUE.get(camera.name, 0.0)
        points = fine[np.rint(100 * RATE * moment).astype(int)] if moving else np.tile(fine[:1], (len(time), 1, 1))
        pixels = project(camera, points)
        found[camera.name] = Recording(time, pixels + noise * rng.standard_normal(pixels.shape), NAMES)
    return found


@pytest.mark.long
def test_offsets_are_found():
    calibration = ring(3)
    given = tracks(calibration)
    steps = []
    clocks = find_offsets(given, calibration, 0.1, lambda *step: steps.append(step))
    assert all(clock.significant for clock in clocks.values())
    found = {name: clock.seconds for name, clock in clocks.items()}
    # 1 px is 3 mm, 3 ms of a limb at 1 m/s; over the root of some hundred pixels, and as much again to spare, and
    # twice that because steady motion tells nothing.
    assert found == pytest.approx(TRUE, abs=2e-3)
    for name, clock in clocks.items():
        assert abs(clock.seconds - TRUE[name]) < 3 * clock.sd, name
        assert clock.sd < 2e-3
    assert steps == [(1, 2, "offsets"), (2, 2, "offsets")]
    scene = reconstruct(at_one_time(given, calibration, found))
    assert scene.scale < 1.3
    assert reconstruct(at_one_time(given, calibration)).scale > 2 * scene.scale


def test_lasting_errors_are_no_clock():
    """Each keypoint of one view is set off by 15 px, which is taken away; or they wander by as much, which is told."""
    calibration = ring(3)
    given = tracks(calibration)
    rng = np.random.default_rng(2)
    first, late = given["cam1"], given["cam3"]
    time = late.time - TRUE["cam3"]
    still = 15 * rng.standard_normal((3, 2))
    wandering = 3 * np.sin(8 * time[:, None, None] + rng.uniform(0, 6, (3, 2)))
    films = {"cam1": first, "cam3": Recording(time, late.keypoints + still + wandering, NAMES)}
    (clock,) = find_offsets(films, calibration, 0.05).values()
    assert 1.5e-3 < clock.sd < 4e-3
    assert not clock.significant
    far = Recording(time, late.keypoints + 10 * wandering, NAMES)
    with pytest.raises(InputError, match="the tracker errs too much"):
        find_offsets({"cam1": first, "cam3": far}, calibration, 0.05)


@pytest.mark.long
def test_what_cannot_be_found_is_told():
    calibration = ring(2)
    with pytest.raises(InputError, match="nothing moves enough"):
        find_offsets(tracks(calibration, moving=False), calibration, 0.1)
    late = tracks(calibration)
    late["cam2"] = Recording(late["cam2"].time + 0.1, late["cam2"].keypoints, NAMES)
    with pytest.raises(InputError, match=r"'cam2' seems to be off by more than 0\.07 s"):
        find_offsets(late, calibration, 0.07)
    for reach in (np.nan, np.inf, 1e9, 0.66, 0.0):  # of a film of 39 intervals, .65 s
        with pytest.raises(InputError, match=r"up to the film's length, 0\.65 s"):
            find_offsets(tracks(calibration), calibration, reach)
