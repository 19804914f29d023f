"""Effects with a coordinate that nobody sees: energy, modes, momentum, stops."""

import math

import numpy as np
import pytest
import torch
from rod import F64, rod
from variants import nonideal

from invdyn.models import ArmModel, Encoders, Keypoints, Link, Observation, planar_body, planar_dynamics
from invdyn.models.effects import Backlash, BaseMotion, ExternalPush, JointStiffness, LinkFlexibility

STEP = 0.0025  # s


def rolled(model, hidden, q, qd):
    K = len(q)
    path = [torch.cat([torch.tensor(part, dtype=F64) for part in ([0.0] * K, hidden, q, qd)])]
    for t in range(1, model.num_steps):
        path.append(model.transition_mean(path[-1], t))
    return torch.stack(path)[:, K:].numpy()  # ψ, ψ̇, q, q̇


@pytest.mark.parametrize("position", [None, 0.1, 0.3, 0.8])
@pytest.mark.parametrize("link", [0, 1])
def test_the_parts_are_the_link(link, position, arm, having, states):
    """Straight, they have its mass, centre, inertia and tips: the same energies and keypoints at any posture."""
    ideal = arm(2)
    effect = LinkFlexibility(f"link{link}").bound(ideal.body)
    body = ideal.body_parameters()
    p = {} if position is None else {"position": torch.tensor([position], dtype=F64)}
    links, whole = effect.chain(p, body), planar_dynamics(3)
    x = states(ideal, 8)
    q, qd = x[:, 2:4], x[:, 4:]
    none = torch.zeros(8, 1, dtype=F64)
    wide, rates = effect.all_hinges(q, none), effect.all_hinges(qd, none)
    torch.testing.assert_close(whole.kinetic_energy(wide, rates, links), ideal.dynamics.kinetic_energy(q, qd, body))
    torch.testing.assert_close(whole.potential_energy(wide, links), ideal.dynamics.potential_energy(q, body))
    torch.testing.assert_close(effect.tips(p, q, torch.zeros(8, 2, dtype=F64), body), ideal.dynamics.keypoints(q, body))
    assert bool((links.inertia > 0).all())
    back, hinge = effect.gathered(wide + 0.1)
    torch.testing.assert_close(effect.all_hinges(back, hinge), wide + 0.1)


def test_a_rod_that_bends_anywhere_is_two_rods():
    body = rod(2, STEP).body_parameters()
    parts = nonideal(LinkFlexibility("link")).bound(rod(2, STEP).body).chain({"position": torch.tensor([0.3])}, body)
    length, mass = body.length.item() * np.array([0.3, 0.7]), body.mass.item() * np.array([0.3, 0.7])
    assert parts.length.numpy() == pytest.approx(length)
    assert parts.mass.numpy() == pytest.approx(mass)
    assert parts.com.numpy() == pytest.approx(length / 2)
    assert parts.inertia.numpy() == pytest.approx(mass * length**2 / 12)


def test_a_flexible_rod_swings_at_its_mode(having):
    """A free hinge and a spring: ψ at ω² = k (M⁻¹)_ψψ, M of the straight chain; momentum about the joint stays."""
    model = having(rod(161, STEP), LinkFlexibility("link"), stiffness=8.0, damping=0.0)
    path = rolled(model, [1e-4, 0.0], [0.0], [0.0])
    m, l = 0.75, 0.15  # halves: uniform rods
    inner, outer = m * l**2 / 3, m * l**2 / 3
    M = np.array([[inner + m * l**2 + outer + m * l * l, outer + m * l * l / 2], [0.0, outer]])
    M[1, 0] = M[0, 1]
    omega = math.sqrt(8.0 * np.linalg.inv(M)[1, 1])
    assert path[:, 0] == pytest.approx(1e-4 * np.cos(omega * 0.0025 * np.arange(161)), abs=2e-6)
    assert M[0, 0] * path[:, 3] + M[0, 1] * path[:, 1] == pytest.approx(0.0, abs=1e-9)


def test_a_damped_flexible_rod_loses_energy_and_only_it(having):
    ideal = rod(201, STEP, (0.0, -9.81))
    effect = LinkFlexibility("link").bound(ideal.body)
    body, whole = ideal.body_parameters(), planar_dynamics(2)
    links = effect.chain({}, body)

    def energy(path):
        angles, rates = torch.as_tensor(path[:, [2, 0]]), torch.as_tensor(path[:, [3, 1]])
        motion = whole.kinetic_energy(angles, rates, links) + whole.potential_energy(angles, links)
        return (motion + 4.0 * angles[:, 1] ** 2).numpy()

    def swung(damping):
        model = having(ideal, LinkFlexibility("link"), stiffness=8.0, damping=damping)
        return energy(rolled(model, [0.2, 0.0], [0.0], [0.0]))

    spring = 4.0 * 0.2**2
    assert np.ptp(swung(0.0)) < 0.01 * spring
    lossy = swung(0.02)
    assert (np.diff(lossy) < 1e-4 * spring).all()
    assert lossy[0] - lossy[-1] > 0.5 * spring


@pytest.mark.quick("0.01-*")
@pytest.mark.parametrize("stiffness", [1e4, 1e9])
@pytest.mark.parametrize("step", [0.01, 0.04])
def test_a_spring_stiffer_than_the_steps_is_stable(stiffness, step, having):
    model = rod(rows=60, step=step, gravity=(0.0, -9.81))
    flexible = rolled(
        having(model, LinkFlexibility("link"), stiffness=stiffness, damping=0.1), [0.0, 0.0], [0.0], [0.0]
    )
    rigid = rolled(having(model, LinkFlexibility("link"), stiffness=math.inf), [0.0, 0.0], [0.0], [0.0])
    assert np.abs(flexible[:, 0]).max() < 0.02
    assert flexible[: int(0.5 / step), 2] == pytest.approx(rigid[: int(0.5 / step), 2], abs=0.05)


def halves(rows, step):
    """The rod in two hinged halves."""
    links = [Link(f"half{k}", f"joint{k}", f"tip{k}", 0.15, 0.75, 0.075, 0.75 * 0.15**2 / 12) for k in range(2)]
    return ArmModel(
        planar_body("halves", links, gravity=(0.0, -9.81)),
        step * np.arange(rows),
        Observation(Keypoints([0, 1]), Encoders()),
    )


@pytest.mark.quick("push")
@pytest.mark.parametrize(
    ("effect", "other", "values", "rows"),
    [
        (
            ExternalPush("tip"),
            ExternalPush("tip1"),
            {"impulse_x": 0.05, "impulse_y": 0.2, "moment": 0.1, "duration": 0.08},
            101,
        ),
        (
            BaseMotion(),
            BaseMotion(),
            {"sine_x": 0.01, "cosine_x": 0.0, "sine_y": 0.0, "cosine_y": 0.02, "frequency": 3.0},
            201,
        ),
    ],
    ids=["push", "base motion"],
)
def test_what_pulls_at_a_link_bends_it(effect, other, values, rows, having):
    """A flexible rod is two halves with a spring between them, whatever pulls at them."""
    step = 0.0025
    whole = having(
        having(rod(rows, step, (0.0, -9.81)), LinkFlexibility("link"), stiffness=8.0, damping=0.0), effect, **values
    )
    split = having(having(halves(rows, step), JointStiffness("joint1"), stiffness=8.0, torque=0.0), other, **values)
    bent = rolled(whole, [0.05, 0.3], [-1.0], [0.5])
    swung = rolled(split, [], [-1.0, 0.05], [0.5, 0.3])
    np.testing.assert_allclose(bent[:, [2, 0, 3, 1]], swung, atol=2e-4)
    straight = rolled(
        having(rod(rows, step, (0.0, -9.81)), LinkFlexibility("link"), stiffness=8.0, damping=0.0),
        [0.05, 0.3],
        [-1.0],
        [0.5],
    )
    assert np.abs(bent[:, 0] - straight[:, 0]).max() > 0.02


# -- backlash ------------------------------------------------------------------------------------------
@pytest.fixture
def pushed(having):
    """A weightless rod with backlash under a torque that turns over after half of the time."""

    def run(width, rows=401, step=0.0025, level=0.2):
        command = np.where(np.arange(rows) < rows // 2, level, -level)[:, None]
        model = having(rod(rows, step, command=command), Backlash("hinge"), width=width)
        return rolled(model, [-width / 2, 0.0], [0.0], [0.0])

    return run


@pytest.mark.long
def test_the_gap_stays_within_its_stops_and_turns_over_with_the_load(pushed):
    path = pushed(0.02)
    assert np.abs(path[:, 0]).max() <= 0.01 + 1e-12
    assert (path[:190, 0] == -0.01).all()
    assert path[-1, 0] == pytest.approx(0.01)


def test_a_push_on_a_loose_link_leaves_the_rotor_where_it_is(having):
    """ψ̇ = J l / I, I the link's inertia about the joint but for the rotor's share."""
    model = having(rod(41, STEP), Backlash("hinge"), width=1.0)
    values = {"impulse_x": 0.0, "impulse_y": 0.01, "moment": 0.05, "duration": 0.04}
    path = rolled(having(model, ExternalPush("tip"), **values), [0.0, 0.0], [0.0], [0.0])
    rotor = 0.5 * 1.5 * 0.3**2 / 12
    assert path[:, 2] - path[:, 0] == pytest.approx(0.0, abs=1e-9)
    assert path[-1, 1] == pytest.approx(0.01 * 0.3 / (1.5 * 0.3**2 / 3 - rotor), rel=1e-3)


@pytest.mark.parametrize("step", [0.005, 0.0173, 0.05])
def test_an_impact_within_a_step_moves_no_centre_of_inertia(step, having):
    """Rotor J catches up with its link I and takes it along: J θ_rotor + I θ_link moves as the torque says."""
    width, level, rotor, total = 0.1, 0.2, 0.5 * 1.5 * 0.3**2 / 12, 1.5 * 0.3**2 / 3
    rows = round(0.4 / step)
    model = having(rod(rows, step, command=np.full((rows, 1), level)), Backlash("hinge"), width=width)
    psi, _, q, _ = rolled(model, [width / 2, 0.0], [0.0], [0.0]).T
    time = step * np.arange(rows)
    assert psi[-1] == -width / 2
    expected = level * time**2 / 2 - rotor * width / 2
    assert rotor * (q - psi) + (total - rotor) * q == pytest.approx(expected, abs=1e-12)


@pytest.mark.long
def test_in_the_gap_the_link_coasts_for_as_long_as_the_rotor_needs(pushed):
    """The rotor, of inertia J = I_com/2, crosses the width in √(2 w J/τ); after it the impulse is as without backlash.

    It comes back from the stop at e of the speed it struck at, and strikes again 2e times that later; then for 2e².
    """
    width, level, total = 0.02, 0.2, 1.5 * 0.3**2 / 3
    path = pushed(width, rows=1001, step=5e-4)
    ideal = pushed(0.0, rows=1001, step=5e-4)
    coasting = np.flatnonzero(np.abs(path[:, 0]) < width / 2 - 1e-9)
    crossing = math.sqrt(2 * width * (1.5 * 0.3**2 / 12 / 2) / level)
    back = math.exp(-2)
    assert len(coasting) * 5e-4 == pytest.approx(crossing * (1 + 2 * back + 2 * back**2), rel=0.03)
    assert np.ptp(path[coasting[: int(crossing / 5e-4)], 3]) < 1e-9
    # no momentum is lost: the impact hands on what the rotor gathered
    assert path[-1, 3] == pytest.approx(ideal[-1, 3], abs=1e-3)
    assert total * path[500, 3] == pytest.approx(level * 500 * 5e-4, rel=1e-3)


@pytest.mark.quick("0.01")
@pytest.mark.parametrize("step", [0.01, 0.033])
def test_coarse_steps_keep_the_momentum_too(step, pushed):
    path, ideal = pushed(0.02, rows=60, step=step), pushed(0.0, rows=60, step=step)
    assert path[-1, 3] == pytest.approx(ideal[-1, 3], abs=0.05 * np.abs(ideal[:, 3]).max())


def test_the_rotor_comes_out_of_the_link(arm, states):
    """With the gap at rest the energies are those of the arm without it."""
    ideal = arm(2)
    x = states(ideal, 8)
    body = ideal.body_parameters()
    for joint in range(2):
        effect = Backlash(f"joint{joint}").bound(ideal.body)
        links, whole = effect.chain({}, body), planar_dynamics(3)
        none = torch.zeros(8, 1, dtype=F64)
        wide, rates = effect.all_hinges(x[:, 2:4], none), effect.all_hinges(x[:, 4:], none)
        found = whole.kinetic_energy(wide, rates, links)
        torch.testing.assert_close(found, ideal.dynamics.kinetic_energy(x[:, 2:4], x[:, 4:], body))
        gap = torch.full((8, 1), 0.01, dtype=F64)
        tips = effect.tips({}, x[:, 2:4], torch.cat([gap, none], -1), body)
        torch.testing.assert_close(tips, ideal.dynamics.keypoints(x[:, 2:4], body))  # the link's angle is what is seen
