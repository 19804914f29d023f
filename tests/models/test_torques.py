"""Torque processes against their closed forms; the Matérn ones against the kernel itself."""

import math

import numpy as np
import pytest
import torch
from scipy.special import gamma, kv

from invdyn.models import (
    TORQUE_PROCESSES,
    ArmModel,
    Link,
    Matern32,
    Matern52,
    OrnsteinUhlenbeck,
    RandomWalk,
    Recurrent,
    SmoothAndRough,
    planar_body,
)

F64 = torch.float64
SCALE = torch.tensor([3.0, 0.4], dtype=F64)
EVERY = pytest.mark.parametrize("name", TORQUE_PROCESSES)


@EVERY
def test_two_alike_say_the_same_of_themselves(name):
    """What checkpoints compare: not where a process is in memory."""
    own, other = TORQUE_PROCESSES[name](), TORQUE_PROCESSES[name]()
    assert repr(own) == repr(other)
    assert str(vars(own)) == str(vars(other))


def test_others_say_other_numbers_of_themselves():
    assert repr(SmoothAndRough(0.2)) != repr(SmoothAndRough(0.3))


def step(process, dt, parameters, dtype=F64):
    """Matrix (Z, Z) and covariance (Z, Z) of one step, from the process's own mean and noise."""
    dt = torch.tensor([dt], dtype=dtype)
    size = process.size(len(parameters["torque.scale"]))
    columns = process.mean(torch.eye(size, dtype=dtype), dt, parameters)
    return columns.mT.numpy(), covariance(process, process.noise(dt, parameters))


def covariance(process, root):
    root = torch.diag_embed(root) if process.diagonal else root
    return (root @ root.mT).numpy()


# -- Ornstein–Uhlenbeck ----------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("scaling", "factor", "variance"),
    [
        ("printed", lambda x: 1 - x, lambda x, dt: dt**2),
        ("wiener", lambda x: 1 - x, lambda x, dt: dt),
        ("exact", lambda x: math.exp(-x), lambda x, dt: dt * (1 - math.exp(-2 * x)) / (2 * x)),
    ],
)
@pytest.mark.parametrize("dt", [0.001, 0.03, 0.3])
def test_ornstein_uhlenbeck_moments(scaling, factor, variance, dt):
    process = OrnsteinUhlenbeck(scaling)
    decay = torch.tensor([4.0, 0.5], dtype=F64)
    parameters = {"torque.decay": decay, "torque.scale": SCALE}
    matrix, cov = step(process, dt, parameters)
    x = [rate * dt for rate in decay.tolist()]
    assert matrix == pytest.approx(np.diag([factor(v) for v in x]), rel=1e-12)
    assert cov == pytest.approx(
        np.diag([s**2 * variance(v, dt) for s, v in zip(SCALE.tolist(), x, strict=True)]), rel=1e-9
    )
    stationary = covariance(process, process.stationary(torch.tensor([dt], dtype=F64), parameters))
    assert matrix @ stationary @ matrix.T + cov == pytest.approx(stationary, rel=1e-9)


@pytest.mark.parametrize("name", ["exact", "matern32", "matern52", "smooth_and_rough"])
def test_two_half_steps_are_one_step(name):
    process = OrnsteinUhlenbeck("exact") if name == "exact" else TORQUE_PROCESSES[name](0.1)
    parameters = process.defaults(SCALE)
    whole, whole_cov = step(process, 0.07, parameters)
    first, first_cov = step(process, 0.02, parameters)
    second, second_cov = step(process, 0.05, parameters)
    assert second @ first == pytest.approx(whole, rel=1e-9, abs=1e-12)
    scale = np.sqrt(np.outer(np.diag(whole_cov), np.diag(whole_cov)))
    assert (second @ first_cov @ second.T + second_cov) / scale == pytest.approx(whole_cov / scale, abs=1e-10)


def test_the_scalings_agree_as_steps_become_short():
    process, exact = OrnsteinUhlenbeck("wiener"), OrnsteinUhlenbeck("exact")
    parameters = process.defaults(SCALE)
    for mine, theirs in zip(step(process, 1e-6, parameters), step(exact, 1e-6, parameters), strict=True):
        assert mine == pytest.approx(theirs, rel=1e-4, abs=1e-15)


def test_default_scale_is_the_stationary_sd():
    for process in (OrnsteinUhlenbeck("exact"), Matern32(), Matern52()):
        root = process.stationary(torch.tensor([0.01], dtype=F64), process.defaults(SCALE))
        assert np.sqrt(np.diag(covariance(process, root))[:2]) == pytest.approx(SCALE.numpy())


def test_a_torque_that_is_underway_is_known_less_at_its_beginning():
    dt, more = torch.tensor([0.01], dtype=F64), {"torque.initial_scale": torch.tensor([0.3, 0.0], dtype=F64)}
    plain, underway = OrnsteinUhlenbeck(), OrnsteinUhlenbeck(underway=True)
    values = underway.defaults(SCALE) | more
    first = underway.stationary(dt, values)
    assert first.square().tolist() == pytest.approx([SCALE[0].item() ** 2 + 0.09, SCALE[1].item() ** 2])
    torch.testing.assert_close(underway.noise(dt, values), plain.noise(dt, plain.defaults(SCALE)))
    assert "torque.initial_scale" not in plain.defaults(SCALE)


def test_random_walk():
    parameters = RandomWalk().defaults(SCALE)
    matrix, cov = step(RandomWalk("wiener"), 0.04, parameters)
    assert matrix == pytest.approx(np.eye(2))
    assert cov == pytest.approx(np.diag((parameters["torque.scale"] ** 2 * 0.04).numpy()))
    assert step(RandomWalk("printed"), 0.04, parameters)[1] == pytest.approx(
        np.diag((parameters["torque.scale"] * 0.04).numpy() ** 2)
    )
    # a fifth of a second moves it by its typical size
    assert 0.2 * parameters["torque.scale"].numpy() ** 2 == pytest.approx(SCALE.numpy() ** 2)
    assert torch.equal(RandomWalk().stationary(torch.ones(1), parameters), SCALE)


@pytest.mark.parametrize("kind", [OrnsteinUhlenbeck, RandomWalk])
def test_an_unknown_scaling_is_refused(kind):
    with pytest.raises(ValueError, match=r"printed, wiener.*got 'ito'"):
        kind("ito")


# -- Matérn ----------------------------------------------------------------------------------------
def matern_kernel(lag, scale, lengthscale, nu):
    """The kernel in its general form, with the Bessel function of the second kind."""
    r = np.sqrt(2 * nu) * np.abs(lag) / lengthscale
    with np.errstate(invalid="ignore"):
        value = 2 ** (1 - nu) / gamma(nu) * r**nu * kv(nu, r)
    return scale**2 * np.where(r == 0, 1.0, value)


GRIDS = {
    "regular": np.linspace(0, 1, 12),
    "irregular": np.cumsum([0, 0.01, 0.3, 0.001, 0.05, 0.2, 0.02]),
    "fine": np.arange(10) * 1e-3,
    "long gaps": np.cumsum([0, 0.02, 3.0, 0.02, 40.0]),
}


def joint_covariance(process, parameters, time):
    """Of two joints' torques at all times, (T, 2, T, 2), by the process's own steps."""
    cov = covariance(process, process.stationary(torch.tensor([0.1], dtype=F64), parameters))
    found = np.zeros((len(time), 2, len(time), 2))
    for s in range(len(time)):
        across = cov
        for t in range(s, len(time)):
            if t > s:
                matrix, _ = step(process, time[t] - time[t - 1], parameters)
                across = matrix @ across
            found[t, :, s] = across[:2, :2]
            found[s, :, t] = across[:2, :2].T
        if s + 1 < len(time):
            matrix, noise = step(process, time[s + 1] - time[s], parameters)
            cov = matrix @ cov @ matrix.T + noise
    return found


LENGTHS = torch.tensor([0.15, 0.6], dtype=F64)


@pytest.mark.parametrize("rough", [(0.3, 0.01), (-0.3, 0.0)])
@pytest.mark.parametrize("grid", GRIDS)
def test_a_smooth_and_a_rough_torque_have_the_sum_of_their_kernels(grid, rough):
    """The rough part's size counts without its sign, and may be zero."""
    time = GRIDS[grid]
    rough, decay = torch.tensor(rough, dtype=F64), torch.tensor([20.0, 3.0], dtype=F64)
    parameters = {"torque.scale": SCALE, "torque.lengthscale": LENGTHS}
    parameters |= {"torque.rough_scale": rough, "torque.rough_decay": decay}
    found = joint_covariance(SmoothAndRough(), parameters, time)
    lag = time[:, None] - time[None, :]
    for i in range(2):
        expected = matern_kernel(lag, SCALE[i].item(), LENGTHS[i].item(), 2.5)
        expected += rough[i].item() ** 2 * np.exp(-decay[i].item() * np.abs(lag))
        assert found[:, i, :, i] == pytest.approx(expected, abs=1e-10 * SCALE[i].item() ** 2)
    assert found[:, 0, :, 1] == pytest.approx(0, abs=1e-14)


def test_a_rough_part_that_is_next_to_nothing_keeps_its_size():
    """The root has it to full precision: of τ given s, ṡ and s̈ nothing is left but the rough part."""
    parameters = SmoothAndRough(share=1e-6).defaults(SCALE)
    root = SmoothAndRough().noise(torch.tensor([0.01], dtype=F64), parameters)
    assert torch.equal(root, root.tril())
    precision = torch.linalg.inv(root).square().sum(0)  # diagonal of (L Lᵀ)⁻¹
    left = 1e-6 * SCALE * math.sqrt(1 - math.exp(-2 * 20 * 0.01))
    assert (1 / precision[:2]).sqrt().tolist() == pytest.approx(left.tolist(), rel=1e-6)


@pytest.mark.parametrize("grid", GRIDS)
@pytest.mark.parametrize(("kind", "nu"), [(Matern32, 1.5), (Matern52, 2.5)])
def test_matern_torques_have_the_kernels_joint_covariance(kind, nu, grid):
    time = GRIDS[grid]
    found = joint_covariance(kind(), {"torque.scale": SCALE, "torque.lengthscale": LENGTHS}, time)
    lag = time[:, None] - time[None, :]
    for i in range(2):
        scale, length = SCALE[i].item(), LENGTHS[i].item()
        expected = matern_kernel(lag, scale, length, nu)
        assert found[:, i, :, i] / scale**2 == pytest.approx(expected / scale**2, abs=1e-10)
    assert found[:, 0, :, 1] == pytest.approx(0, abs=1e-14)


@pytest.mark.parametrize(("kind", "order"), [(Matern32, 2), (Matern52, 3)])
@pytest.mark.parametrize("ratio", [1e-7, 1e-4, 1e-2, 1.0, 5.0, 30.0, 1e3])
def test_matern_noise_keeps_its_relative_accuracy(kind, order, ratio):
    """Q(δ) against its limit as κδ → 0, and the stationary covariance as κδ → ∞; float32 too."""
    dt = 0.01
    rate = ratio / dt
    length = math.sqrt(2 * order - 1) / rate
    process = kind()
    for dtype, rtol in ((F64, 1e-9), (torch.float32, 2e-4)):
        parameters = {
            "torque.scale": torch.tensor([2.0], dtype=dtype),
            "torque.lengthscale": torch.tensor([length], dtype=dtype),
        }
        root = process.noise(torch.tensor([dt], dtype=dtype), parameters)
        assert (root.diagonal() > 0).all()
        assert torch.equal(root, root.tril())
        found = covariance(process, root.double())
        if ratio <= 1e-4:  # a chain of integrators driven by white noise
            q = (4 * rate**3 if order == 2 else 16 / 3 * rate**5) * 4
            powers = order - 1 - np.arange(order)
            factorial = np.array([math.factorial(p) for p in powers])
            total = powers[:, None] + powers[None, :] + 1
            expected = q * dt**total / total / np.outer(factorial, factorial)
            sd = np.sqrt(np.diag(expected))
            assert found / np.outer(sd, sd) == pytest.approx(expected / np.outer(sd, sd), abs=max(rtol, 10 * ratio))
        if ratio >= 30:
            stationary = covariance(process, process.stationary(torch.ones(1), parameters).double())
            sd = np.sqrt(np.diag(stationary))
            assert found / np.outer(sd, sd) == pytest.approx(stationary / np.outer(sd, sd), abs=rtol)
        stationary = covariance(process, process.stationary(torch.ones(1), parameters).double())
        if ratio >= 1e-2 and dtype == F64:
            matrix, cov = step(process, dt, parameters)
            sd = np.sqrt(np.diag(stationary))
            assert (matrix @ stationary @ matrix.T + cov) / np.outer(sd, sd) == pytest.approx(
                stationary / np.outer(sd, sd), abs=1e-10
            )


@pytest.mark.parametrize("kind", [Matern32, Matern52])
def test_matern_noise_is_differentiable(kind):
    process, dt = kind(), torch.tensor([0.03], dtype=F64)

    def root(scale, length, dt):
        return process.noise(dt, {"torque.scale": scale, "torque.lengthscale": length})

    leaves = [SCALE, torch.tensor([0.2, 0.5], dtype=F64), dt]
    assert torch.autograd.gradcheck(root, [x.clone().requires_grad_() for x in leaves], atol=1e-4)


# -- recurrent network -----------------------------------------------------------------------------
def test_recurrent_without_output_is_ornstein_uhlenbeck():
    process, plain = Recurrent(hidden=3), OrnsteinUhlenbeck("wiener")
    parameters = process.defaults(SCALE)
    parameters["torque.output"] = torch.zeros(2, 3, dtype=F64)
    dt = torch.tensor([0.02], dtype=F64)
    z = torch.randn(7, 5, dtype=F64)
    torch.testing.assert_close(process.mean(z, dt, parameters)[:, :2], plain.mean(z[:, :2], dt, parameters))
    for method in ("noise", "stationary"):
        mine, theirs = getattr(process, method)(dt, parameters), getattr(plain, method)(dt, parameters)
        torch.testing.assert_close(mine[:2], theirs)


def test_recurrent_mean_is_the_formula_at_its_top():
    process = Recurrent(hidden=3, seed=4)
    p = {name: value.numpy() for name, value in process.defaults(SCALE).items()}
    z = np.random.default_rng(0).normal(size=5)
    hidden = np.tanh(p["torque.recurrent"] @ z[2:] + p["torque.input"] @ (z[:2] / p["torque.size"]) + p["torque.bias"])
    pull = p["torque.decay"] * 0.02
    torque = (1 - pull) * z[:2] + pull * p["torque.size"] * (p["torque.output"] @ hidden)
    found = process.mean(torch.as_tensor(z), torch.tensor([0.02], dtype=F64), process.defaults(SCALE))
    assert found.numpy() == pytest.approx(np.concatenate([torque, hidden]), rel=1e-12)


def test_recurrent_weights_come_from_their_seed():
    one, same, other = (Recurrent(seed=s).defaults(SCALE)["torque.recurrent"] for s in (1, 1, 2))
    assert torch.equal(one, same)
    assert not torch.equal(one, other)


# -- all -------------------------------------------------------------------------------------------
@EVERY
def test_the_path_through_torques_begins_with_them(name):
    process = TORQUE_PROCESSES[name]()
    time = torch.tensor([0.0, 0.1, 0.15, 0.3, 0.32], dtype=F64)
    torque = torch.stack([time**2, 3 * time], -1)
    path = process.path(torque, time)
    assert path.shape == (5, process.size(2))
    assert torch.equal(path[:, :2], torque)
    if name.startswith("matern"):  # then their derivatives
        assert path[1:-1, 2:4].numpy() == pytest.approx(
            torch.stack([2 * time, 3 + 0 * time], -1)[1:-1].numpy(), abs=1e-9
        )


@pytest.mark.parametrize("name", ["matern32", "smooth_and_rough", "ornstein_uhlenbeck"])
def test_rows_of_one_length_share_their_matrices(name):
    """As where each row's are computed, for clocks that are equal but for rounding, and for many parameter sets."""
    body = planar_body("rod", [Link("rod", "hinge", "tip", length=0.5, mass=1.0)])
    even = 0.1 * np.arange(9)
    found = []
    for time in (even, even + 1e-7 * np.arange(9) ** 2):  # clocks that drift by .1 µs are of one length, by 2 µs not
        model = ArmModel(body, time, torque=TORQUE_PROCESSES[name]())
        many = model.replace(**{"torque.scale": torch.tensor([[[1.0]], [[3.0]]], dtype=F64)})
        state = torch.linspace(-1, 1, 8 * model.state_dim, dtype=F64).reshape(8, -1)
        for each in (model, many):
            law = each.transition(state, torch.arange(1, 9))
            row = each.transition(state[2], 3)
            assert law.mean.shape == (*each.parameters["torque.scale"].shape[:-2], 8, model.state_dim)
            torch.testing.assert_close(law.mean[..., 2, :], row.mean.squeeze(-2) if each is many else row.mean)
            found.append((law.mean, law.variance.expand(law.mean.shape)))
    for one, other in zip(found[:2], found[2:], strict=True):
        torch.testing.assert_close(one, other, rtol=1e-4, atol=1e-5)


def test_a_shared_matrix_has_a_gradient_where_its_parameters_have():
    body = planar_body("rod", [Link("rod", "hinge", "tip", length=0.5, mass=1.0)])
    scale = torch.tensor([2.0], dtype=F64, requires_grad=True)
    model = ArmModel(body, 0.1 * np.arange(4), torque=Matern32()).replace(**{"torque.scale": scale})
    state = torch.zeros(model.state_dim, dtype=F64)
    with torch.no_grad():
        model.transition(state, 1)
    for row in (1, 2):
        (slope,) = torch.autograd.grad(model.transition(state, row).variance[0], scale)
        assert slope.item() > 0
