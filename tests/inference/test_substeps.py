"""Sub-steps: as many as their error asks for."""

import pytest
import torch

from invdyn.inference.substeps import SUBSTEPS, sufficient_substeps
from invdyn.models import ArmModel, Body, Emission, Link
from invdyn.models.arm_start import link_angle_sd

TIME = 0.02 * torch.arange(100, dtype=torch.float64)


def swinging(speed: float, integrator: str = "rk4") -> tuple[ArmModel, torch.Tensor]:
    links = [Link(f"link{k}", f"joint{k}", f"tip{k}", length=0.3, mass=1.0) for k in range(2)]
    body = Body("arm", links, gravity=(0.0, -9.81))
    parameters = {"emission.keypoint_scale": 0.002, "noise.angle": 1e-4, "noise.velocity": 3e-4}
    model = ArmModel(body, TIME.numpy(), Emission([0, 1]), integrator=integrator, parameters=parameters)
    angles = torch.stack([torch.sin(speed * TIME), 0.7 * torch.cos(0.9 * speed * TIME)], -1)
    return model, model.dynamics.keypoints(angles, model.body_parameters()).flatten(-2)


def errors(model: ArmModel, tips: torch.Tensor, count: int) -> torch.Tensor:
    """(T - 1, 4) of angles and velocities, against twice as many."""
    paths, ends = model.initial_paths(tips), []
    for model.substeps in (count, 2 * count):
        with torch.no_grad():
            ends.append(model.transition_mean(paths[len(paths) // 2][:-1], torch.arange(1, 100))[:, -4:])
    return ends[0] - ends[1]


@pytest.mark.parametrize("integrator", ["rk4", "semi_implicit"])
@pytest.mark.parametrize("speed", [2.0, 12.0, 18.0, 30.0])
def test_as_many_substeps_as_are_needed_and_no_more(integrator, speed):
    """Their error, to twice as many, is a tenth of what can be noticed at most, and that of fewer ones is not."""
    model, tips = swinging(speed, integrator)
    chosen = sufficient_substeps(model, tips)
    assert model.substeps == 1
    limit = 0.1 * (
        model.parameters["noise.angle"] + 0.1 * torch.as_tensor(link_angle_sd(model, model.body_parameters()))
    )

    def suffices(count):
        return bool((torch.quantile(errors(model, tips, count)[:, :2].abs(), 0.99, dim=0) <= limit).all())

    assert suffices(chosen) or chosen == SUBSTEPS[-1]
    assert not any(suffices(count) for count in SUBSTEPS[: SUBSTEPS.index(chosen)])
    if integrator == "rk4":
        assert chosen == {2.0: 1, 12.0: 2, 18.0: 3, 30.0: 4}[speed]


@pytest.mark.parametrize("speed", [2.0, 6.0, 12.0])
def test_errors_that_no_row_shows_may_not_add_up(speed):
    """What a recording loses by them stays under so many nats, and that of fewer sub-steps does not."""
    model, tips = swinging(speed)
    noise = torch.cat([model.parameters["noise.angle"], model.parameters["noise.velocity"]])

    def lost(count):
        each = 0.5 * (errors(model, tips, count) / noise).square().sum(-1)
        return float(each.sort().values[:-1].sum())  # the worst of 99 rows may be wild

    usual, chosen = sufficient_substeps(model, tips), sufficient_substeps(model, tips, 1.0)
    assert chosen >= usual
    assert lost(chosen) <= 1.0 or chosen == SUBSTEPS[-1]
    fewer = [lost(count) for count in SUBSTEPS[: SUBSTEPS.index(chosen)] if count >= usual]
    assert all(each > 1.0 for each in fewer)
    assert sufficient_substeps(model, tips, 1e-3) >= chosen
    assert chosen > usual or speed < 12.0


def test_explicit_euler_keeps_one():
    assert sufficient_substeps(*swinging(30.0, "euler"), 1e-6) == 1
