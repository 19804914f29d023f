"""Backlash through impacts: against scipy's event location, and by the order of convergence."""

from functools import cache

import numpy as np
import pytest
import torch
from rod import F64
from scipy.integrate import solve_ivp

from invdyn.models import ArmModel, Keypoints, Link, Observation, planar_body, planar_dynamics
from invdyn.models.effects import Backlash

LINKS = [Link("upper", "shoulder", "elbow", 0.3, 1.5), Link("fore", "elbow", "wrist", 0.25, 1.0)]
BODY = planar_body("arm", LINKS, gravity=(0.0, -9.81))
WIDTH, DURATION, START = 0.06, 1.2, (0.5, 1.2, 0.0, -2.0)  # rad, s; angles and rates
PLAY = Backlash("elbow").bound(BODY)


def swung(step, duration=DURATION):
    """(ψ, ψ̇, q, q̇) (T, 6) of the model, swinging from the gap's lower end."""
    rows = round(duration / step) + 1
    model = ArmModel(BODY, step * np.arange(rows), Observation(Keypoints([0, 1]))).with_effects(PLAY)
    model = model.replace(**{f"effect.{PLAY.key}.width": torch.tensor([WIDTH], dtype=F64)})
    path = [torch.tensor([0.0, 0.0, -WIDTH / 2, 0.0, *START], dtype=F64)]
    for t in range(1, rows):
        path.append(model.transition_mean(path[-1], t))
    return torch.stack(path)[:, 2:].numpy()


@cache
def exact():
    """The same every .01 s, by scipy: rigid while the stop pushes, three hinges while none does; and impacts' times."""
    body = ArmModel(BODY, np.arange(2.0), Observation(Keypoints([0, 1]))).body_parameters()
    links, whole, rigid = PLAY.chain({}, body), planar_dynamics(3), planar_dynamics(2)

    def held(_, x):
        q, qd = torch.as_tensor(x).split(2)
        return torch.cat([qd, rigid.forward(q, qd, torch.zeros(2, dtype=F64), body)]).numpy()

    def free(_, x):
        angles, rates = torch.as_tensor(x).split(3)
        return torch.cat([rates, whole.forward(angles, rates, torch.zeros(3, dtype=F64), links)]).numpy()

    def wide(values, gap):
        return PLAY.all_hinges(torch.as_tensor(values), torch.tensor([gap], dtype=F64))

    def push(_, x):
        """Of the stop on the gap, N·m."""
        motion = [wide(part, gap) for part, gap in ((x[:2], psi), (x[2:], 0.0), (held(0, x)[2:], 0.0))]
        return float(whole.inverse(*motion, links)[2])

    def at_stop(_, x):
        return abs(x[2]) - WIDTH / 2

    push.terminal = at_stop.terminal = True
    at_stop.direction = 1
    times, rows, impacts = 0.01 * np.arange(round(DURATION / 0.01) + 1), [], []
    now, psi, x, rate = 0.0, -WIDTH / 2, np.array(START), 0.0
    touching = push(0, x) * psi < 0
    while now < DURATION:
        begun = x if touching else torch.cat([wide(x[:2], psi), wide(x[2:], rate)]).numpy()
        event = push if touching else at_stop
        run = solve_ivp(
            held if touching else free,
            (now, DURATION),
            begun,
            events=event,
            dense_output=True,
            rtol=1e-10,
            atol=1e-12,
            max_step=0.005,
        )
        for t in times[(times >= now - 1e-12) & (times < run.t[-1])]:
            y = torch.as_tensor(run.sol(t))
            (q, gap), (qd, rate) = ((y[:2], psi), (y[2:], 0.0)) if touching else map(PLAY.gathered, y.split(3))
            rows.append([float(gap), float(rate), *q, *qd])
        now, y = run.t[-1], run.y[:, -1]
        if touching:
            x, rate, touching = y, 0.0, False
        else:
            angles, rates = torch.as_tensor(y[:3]), torch.as_tensor(y[3:])
            psi = float(np.copysign(WIDTH / 2, y[2]))
            unit = torch.tensor([0.0, 0.0, 1.0], dtype=F64)
            answer = whole.response(angles, unit, links)
            back = np.exp(-2) if abs(rates[2]) > 0.05 else 0.0
            rates = rates - (1 + back) * answer / answer[2] * rates[2]
            x, rate = np.r_[PLAY.gathered(angles)[0].numpy(), PLAY.gathered(rates)[0].numpy()], float(rates[2])
            touching = not back and push(0, x) * psi < 0
            impacts.append(now)
    return times[: len(rows)], np.array(rows), impacts


def off(step, duration=DURATION):
    """Largest errors (6,) of the model against that, in steps of ``step`` s or every .01 s."""
    _, rows, _ = exact()
    every, other = max(round(0.01 / step), 1), max(round(step / 0.01), 1)
    mine, theirs = swung(step, duration)[::every], rows[::other]
    both = min(len(mine), len(theirs))
    return np.abs(mine[:both] - theirs[:both]).max(0)


@pytest.mark.long
def test_contacts_within_rows_are_followed():
    """Twenty-one impacts in 1.2 s, four within a hundredth, and the stops let go between them."""
    _, rows, impacts = exact()
    assert len(impacts) >= 20
    assert np.abs(rows[:, 5]).max() > 20
    angles, rates = [0, 2, 3], [4, 5]
    assert off(0.02)[angles].max() < 2e-3
    assert off(0.01)[angles].max() < 2e-4
    assert off(0.01)[rates].max() < 3e-3


@pytest.mark.long
def test_errors_fall_with_the_fourth_power_through_contacts_too():
    coarse, fine, finest = (off(step, 0.6) for step in (0.005, 0.0025, 0.00125))
    assert (coarse / fine > 10).all()
    assert (fine / finest > 8).all()


def test_a_row_is_the_same_in_any_batch():
    """To the bit: how often others touch changes nothing."""
    rows = 31
    model = ArmModel(BODY, 0.02 * np.arange(rows), Observation(Keypoints([0, 1]))).with_effects(PLAY)
    model = model.replace(**{f"effect.{PLAY.key}.width": torch.tensor([WIDTH], dtype=F64)})
    path = torch.cat([torch.zeros(rows, 2, dtype=F64), torch.as_tensor(swung(0.02, 0.6))], -1)
    together = model.transition_mean(path[:-1], torch.arange(1, rows))
    for t in range(1, rows):
        alone = model.transition_mean(path[t - 1 : t], torch.tensor([t]))
        assert torch.equal(alone[0], together[t - 1])
