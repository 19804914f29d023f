"""What cameras and encoders see."""

from dataclasses import dataclass, field

import numpy as np
import pytest
import torch
from scipy.stats import norm, t

from invdyn.models import Encoders, Keypoints, Link, NoisySensor, Observation, Sensor, planar_body
from invdyn.models.observation.observation import REQUIRED
from invdyn.models.observation.view import View

F64 = torch.float64
TIPS = torch.tensor([[0.3, 0.1], [0.5, -0.2], [0.9, 0.4]], dtype=F64)
ANGLES = torch.tensor([0.1, -0.7, 2.0], dtype=F64)


LINKS = [Link(f"link{k}", f"joint{k}", f"tip{k}", length=1.0, mass=1.0) for k in range(3)]
BODY = planar_body("arm", LINKS)


def seen(tips, angles, **more):
    """What there is to see of these tips and angles."""
    nothing = dict.fromkeys(("body", "dynamics", "acceleration", "angles_after", "ahead", "clock"))
    return View(angles, torch.zeros_like(angles), tips, angles, **nothing, **more)


def parameters(emission, **given):
    values = {**emission.defaults(1.0), **{f"emission.{name}": value for name, value in given.items()}}
    return {name: torch.as_tensor(value, dtype=F64) for name, value in values.items()}


@pytest.mark.parametrize("family", ["gaussian", "student_t"])
def test_density_of_a_row(family):
    emission = Observation(Keypoints([2, 0]), Encoders(), family=family).bound(BODY)
    p = parameters(emission, keypoint_scale=[0.01, 0.03], angle_scale=[0.1, 0.2, 0.3])
    assert emission.size == 7
    y = torch.randn(7, dtype=F64)
    mean = np.concatenate([TIPS[2], TIPS[0], ANGLES])  # in the recording's order of tips
    scale = np.array([0.01, 0.01, 0.03, 0.03, 0.1, 0.2, 0.3])
    law = norm if family == "gaussian" else t(4.0)
    expected = (law.logpdf((y.numpy() - mean) / scale) - np.log(scale)).sum()
    found = emission.predict(seen(TIPS, ANGLES), 0, p).log_prob(y)
    assert found.item() == pytest.approx(expected, rel=1e-9)


def confident(confidence, slope=(1.5, 0.5), drop=(0.0, 0.0)):
    emission = Observation(Keypoints([0, 1], confidence=np.asarray(confidence))).bound(BODY)
    p = parameters(emission, keypoint_scale=[0.01, 0.02], confidence_slope=slope, confidence_drop=drop)
    rows = torch.arange(len(confidence))
    law = emission.predict(seen(TIPS.expand(len(rows), 3, 2), ANGLES.expand(len(rows), 3)), rows, p)
    return law.base_dist.scale.numpy()


CONFIDENCE = np.array([[0.9, 0.2], [0.5, 0.8], [0.99, 0.8], [0.1, 0.3]])


def test_noise_falls_with_confidence():
    scale = confident(CONFIDENCE)
    for point, columns in ((0, scale[:, 0]), (1, scale[:, 2])):
        order = np.argsort(CONFIDENCE[:, point], kind="stable")
        assert (np.diff(columns[order]) <= 0).all()
        assert columns[order[0]] > columns[order[-1]]
    assert np.array_equal(scale[:, ::2], scale[:, 1::2])  # x and y alike
    # the surest ones have the plain noise, and equal ones are equal
    assert scale[2, 0] == pytest.approx(0.01)
    assert scale[1, 2] == scale[2, 2] == pytest.approx(0.02)
    # γ (1 − rank): the least sure of four, rank ¼
    assert scale[3, 0] == pytest.approx(0.01 * np.exp(1.5 * 0.75))


@pytest.mark.parametrize("change", [lambda c: c**3, lambda c: 100 * c - 7, lambda c: np.log(c)])
def test_only_the_order_of_confidences_matters_to_the_slope(change):
    assert np.array_equal(confident(change(CONFIDENCE)), confident(CONFIDENCE))


def test_the_drop_spans_from_sure_points_to_lost_ones_on_any_scale():
    """δ (c⁺ − c) / (c⁺ − c⁻): .9, .5, .99 and .1 lie .09, .49, 0 and .89 of .89 below the greatest."""
    scale = confident(CONFIDENCE, slope=(0.0, 0.0), drop=(6.0, 2.0))
    np.testing.assert_allclose(scale[:, 0], 0.01 * np.exp(6.0 * np.array([0.09, 0.49, 0.0, 0.89]) / 0.89))
    np.testing.assert_allclose(scale[:, 2], 0.02 * np.exp(2.0 * np.array([1.0, 0.0, 0.0, 5 / 6])))
    np.testing.assert_allclose(confident(80 + 30 * CONFIDENCE, slope=(0.0, 0.0), drop=(6.0, 2.0)), scale)
    constant = np.stack([np.full(4, 0.7), CONFIDENCE[:, 1]], axis=1)
    assert (confident(constant, slope=(0.0, 0.0), drop=(6.0, 2.0))[:, 0] == 0.01).all()


def test_a_missing_confidence_is_the_lowest():
    gappy = CONFIDENCE.copy()
    gappy[1, 0] = np.nan
    assert confident(gappy)[1, 0] == confident(gappy)[:, 0].max()


def test_a_row_as_an_int_and_as_a_tensor():
    emission = Observation(Keypoints([0, 1], confidence=CONFIDENCE)).bound(BODY)
    p = parameters(emission)
    rows = emission.predict(seen(TIPS.expand(4, 3, 2), ANGLES.expand(4, 3)), torch.arange(4), p)
    for i in range(4):
        one = emission.predict(seen(TIPS, ANGLES), i, p)
        assert torch.equal(one.base_dist.scale.expand(4), rows.base_dist.scale[i])


@pytest.mark.parametrize(
    ("sensors", "family", "message"),
    [
        ([Keypoints([0])], "cauchy", "gaussian, student_t, multivariate_t, got 'cauchy'"),
        ([], "gaussian", "at least one sensor"),
        ([Keypoints([])], "gaussian", "keypoints of at least one site"),
        ([Encoders(), Encoders()], "gaussian", "a name of its own for each sensor, got angle, angle"),
    ],
)
def test_nonsense_is_refused(sensors, family, message):
    with pytest.raises(ValueError, match=message):
        Observation(*sensors, family=family)


def test_what_is_no_sensor_is_refused_with_what_it_lacks():
    class Tilt:
        name, unit, shape = "tilt", "rad", (1,)

        def bound(self, body):
            return self

    with pytest.raises(TypeError, match=r"got Tilt, which lacks to, coords, defaults, started, predict$"):
        Observation(Keypoints([0]), Tilt())
    protocol = {name for name in vars(Sensor) if not name.startswith("_")}
    assert protocol == set(REQUIRED)


@dataclass(frozen=True)
class Level(NoisySensor):
    """The sum of all angles, with what a sensor of one's own may have wrong."""

    parameter: str = "emission.level_scale"
    scale: object = field(default_factory=lambda: torch.tensor([0.1]))
    coords: dict = field(default_factory=lambda: {"joint": ["sum"]})
    keepdim: bool = True
    name, unit, shape = "level", "rad", (1,)

    def bound(self, body):
        return self

    def defaults(self, reach):
        return {self.parameter: self.scale}

    def location_scale(self, view, t, parameters):
        return view.q.sum(-1, keepdim=self.keepdim), parameters[self.parameter]


@pytest.mark.parametrize(
    ("sensor", "message"),
    [
        (Level(parameter="level_scale"), "level: expected tensors named emission.<name>, got level_scale"),
        (Level(scale=0.1), "level: expected tensors named emission.<name>, got emission.level_scale"),
        (Level(coords={"joint": "ab"}), r"as many coords as its shape \(1,\) has, got \(2,\)"),
        (Level(keepdim=False), r"level: expected locations \(..., 1\), got \(4,\)"),
    ],
)
def test_mistakes_of_a_sensor_of_ones_own_are_said(sensor, message):
    observation = Observation(sensor)
    with pytest.raises(ValueError, match=message):
        observation.predict(seen(TIPS.expand(4, 3, 2), ANGLES.expand(4, 3)), 0, observation.defaults(1.0))


def test_a_site_that_the_body_does_not_have_is_refused():
    for site in (3, -1, "knee"):
        with pytest.raises(ValueError, match=f"expected keypoints among .*, got {site!r}"):
            Keypoints([site]).bound(BODY)
