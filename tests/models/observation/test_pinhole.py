"""The torch projection against the readers' own in numpy and OpenCV's, and what it does where nothing is seen."""

import numpy as np
import pytest
import torch
from scenes import looking, ring, swinging

from invdyn.models.observation.pinhole import PinholeCameras, project
from invdyn.recordings.cameras import projection
from invdyn.recordings.cameras.camera import Calibration

FISHEYE = looking("fish", (2.0, -2.0, 1.2), distortion=(0.03, -0.01, 0.004, -0.001), fisheye=True)


def tensors(calibration):
    """Plain tensors of cameras, float64."""
    fish = torch.tensor([camera.fisheye for camera in calibration])
    columns = {
        "focal": [camera.focal for camera in calibration],
        "center": [camera.center for camera in calibration],
        "distortion": [np.resize(np.append(camera.distortion, 0.0), 5) for camera in calibration],
        "rotation": [camera.rotation for camera in calibration],
        "translation": [camera.translation for camera in calibration],
        "limit": [projection.Lens.of(camera).limit for camera in calibration],
    }
    columns = {name: torch.tensor(np.stack(values)) for name, values in columns.items()}
    return PinholeCameras(**columns, fisheye=fish if fish.any() else None)


@pytest.mark.parametrize("fisheye", [False, True])
def test_both_rooms_project_alike(fisheye):
    calibration = ring(3)
    if fisheye:
        calibration = Calibration((*calibration.cameras, FISHEYE), metric=True)
    points = swinging(10)
    pixels, seen = project(tensors(calibration), torch.tensor(points))
    assert pixels.shape == (10, len(calibration), 3, 2)
    assert seen.all()
    for c, camera in enumerate(calibration):
        # The two sum in another order: some roundings of 1000 px.
        np.testing.assert_allclose(pixels[:, c], projection.project(camera, points), rtol=0, atol=1e-10)


def test_the_same_as_opencv():
    cv2 = pytest.importorskip("cv2")
    (camera, *_) = ring(1)
    points = swinging(20).reshape(-1, 3)
    expected, _ = cv2.projectPoints(
        points, cv2.Rodrigues(camera.rotation)[0], camera.translation, camera.matrix, camera.distortion
    )
    ours, _ = project(tensors(Calibration((camera,), True)), torch.tensor(points))
    np.testing.assert_allclose(ours[0], expected[:, 0], rtol=0, atol=1e-10)


def test_gradients_are_those_of_differences():
    cameras = tensors(Calibration((*ring(2).cameras, FISHEYE), metric=True))
    points = torch.tensor(swinging(2)).requires_grad_()
    assert torch.autograd.gradcheck(lambda x: project(cameras, x)[0], points)


def test_on_the_axis_of_a_fisheye_lens_the_gradient_is_finite():
    cameras = tensors(Calibration((FISHEYE,), metric=True))
    point = torch.tensor(FISHEYE.position + 2 * FISHEYE.rotation[2]).requires_grad_()
    pixels, _ = project(cameras, point[None])
    pixels.sum().backward()
    np.testing.assert_allclose(pixels.detach()[0, 0], FISHEYE.center, atol=1e-9)
    assert torch.isfinite(point.grad).all()


def test_what_is_not_seen_is_nan_told_and_pulls_at_nothing():
    camera = looking("one", (3.0, 0.0, 1.0))
    points = torch.tensor([[0.0, 0.1, 1.0], [6.0, 0.1, 1.0], list(camera.position)]).requires_grad_()
    pixels, seen = project(tensors(Calibration((camera,), metric=True)), points)
    assert seen.tolist() == [[True, False, False]]
    assert torch.isfinite(pixels).all(-1).tolist() == seen.tolist()
    torch.where(seen[..., None], pixels, 0.0).sum().backward()
    assert torch.isfinite(points.grad).all()
    assert points.grad[0].abs().sum() > 0
    assert (points.grad[1:] == 0).all()


def test_batches_and_single_precision():
    cameras = tensors(ring(2))
    points = torch.tensor(swinging(6)).reshape(2, 3, 3, 3)
    whole, _ = project(cameras, points)
    torch.testing.assert_close(project(cameras, points[1, 2])[0], whole[1, 2])
    single = PinholeCameras(*(None if each is None else each.float() for each in cameras))
    # 1000 px in 24 bits: 1e-4 px a rounding.
    torch.testing.assert_close(project(single, points.float())[0].double(), whole, rtol=0, atol=5e-3)
