"""Parameters by marginal likelihood, against the Kalman filter's own on linear models."""

import math
from dataclasses import replace

import numpy as np
import oracles
import pytest
import torch
from pyro.distributions import Normal
from scipy.optimize import minimize
from stiff_arm import arm

from invdyn.inference import Free, fit
from invdyn.inference.fitting import objective
from invdyn.inference.fitting.objective import FRESH, HEAVY_MIN_GAIN, LEFT, STEP, Objective
from invdyn.inference.smoothing import posterior_linearisation
from invdyn.inference.smoothing.gauss_newton import gauss_newton
from invdyn.inputs import load_body
from invdyn.models import Keypoints, Observation, StateSpaceModel
from invdyn.models.divergence import Diverged
from invdyn.simulate import paper_arm, record

F64 = torch.float64
FREE = [Free("transition_root", tied=True), Free("emission_root", tied=True, sd=0.7)]
STEPS = 60


@pytest.fixture(scope="module")
def chain():
    return oracles.random_chain(seed=6)


@pytest.fixture(scope="module")
def y(chain):
    return oracles.with_gaps(chain.simulate(STEPS, seed=6)[1])


def negative_log_posterior(chain, y):
    """Of φ, by the Kalman filter: factors of e^φ on the roots, e^2φ on the covariances."""

    def value(phi):
        scaled = replace(chain, Q=chain.Q * math.exp(2 * phi[0]), R=chain.R * math.exp(2 * phi[1]))
        prior = -0.5 * ((phi[0] / 2.0) ** 2 + (phi[1] / 0.7) ** 2)
        return -(oracles.kalman(scaled, y)[0] + prior)

    return value


def differences(function, phi, h=1e-3):
    """Gradient and Hessian by central differences."""
    eye = h * np.eye(len(phi))
    gradient = np.array([function(phi + e) - function(phi - e) for e in eye]) / (2 * h)
    hessian = np.array(
        [
            [function(phi + e + f) - function(phi + e - f) - function(phi - e + f) + function(phi - e - f) for f in eye]
            for e in eye
        ]
    ) / (4 * h**2)
    return gradient, hessian


@pytest.mark.parametrize("phi", [[0.0, 0.0], [0.4, -0.3], [-0.7, 0.5]])
def test_value_gradient_and_hessian_are_the_kalman_filters(chain, y, phi, monkeypatch):
    phi = np.array(phi)
    objective = Objective(chain.model(STEPS), torch.as_tensor(y), FREE, None)
    exact = negative_log_posterior(chain, y)
    gradient, hessian = differences(exact, phi)
    assert objective.value(phi) == pytest.approx(exact(phi), abs=1e-6)
    # its own differences are 0.03 wide: an error of their square, and of their first power across
    scale = np.abs(hessian).max()
    assert objective.gradient(phi) == pytest.approx(gradient, abs=5e-3 * scale)
    assert objective.hessian(phi) == pytest.approx(hessian, abs=0.15 * scale)
    monkeypatch.setattr(Objective, "_shifted", None)  # of few parameters it was whole
    np.testing.assert_array_equal(objective.curvature(phi), objective.hessian(phi))


def test_it_finds_the_kalman_filters_optimum(chain, y):
    model = chain.model(STEPS)
    start = model.replace(
        transition_root=3.0 * model.parameters["transition_root"],
        emission_root=0.4 * model.parameters["emission_root"],
    )
    wide = [Free(f.name, tied=True, sd=50.0) for f in FREE]
    reported = []
    found = fit(start, torch.as_tensor(y), wide, progress=lambda *n: reported.append(n))

    def value(phi):
        scaled = replace(chain, Q=chain.Q * math.exp(2 * phi[0]), R=chain.R * math.exp(2 * phi[1]))
        return -oracles.kalman(scaled, y)[0]

    best = minimize(value, np.zeros(2), method="Nelder-Mead", options={"xatol": 1e-6, "fatol": 1e-8})
    assert found.converged
    # it stops where no more than a fraction of a nat is to be gained
    assert found.log_evidence == pytest.approx(-best.fun, abs=0.1)
    reached = [
        math.log(found.model.parameters[name][0, 0] / model.parameters[name][0, 0])
        for name in ("transition_root", "emission_root")
    ]
    _, hessian = differences(value, best.x)
    sd = np.sqrt(np.diag(np.linalg.inv(hessian)))
    assert (np.abs(np.array(reached) - best.x) < 0.5 * sd).all()
    for name, expected in zip(("transition_root", "emission_root"), sd, strict=True):
        assert found.log_sd[name] == pytest.approx([expected], rel=0.25)
    assert reported
    assert all(done <= total for done, total in reported)
    path, _ = oracles.rts(replace(chain, Q=chain.Q * math.exp(2 * reached[0]), R=chain.R * math.exp(2 * reached[1])), y)
    # the last step's path is by its slope
    assert found.path.numpy() == pytest.approx(path, abs=1.5e-4)


def test_a_fit_that_begins_elsewhere_ends_at_the_same_optimum(chain, y):
    """From parameters of another fit, by name; the prior's centre stays."""
    model, rows = chain.model(STEPS), torch.as_tensor(y)
    plain = fit(model, rows, FREE)
    begin = {each.name: 1.5 * plain.model.parameters[each.name] for each in FREE}
    other = fit(model, rows, FREE, begin=begin)
    sd = np.sqrt(np.diagonal(plain.covariance))
    assert np.abs(other.phi - plain.phi).max() < 0.2 * sd.min()
    assert other.log_marginal == pytest.approx(plain.log_marginal, abs=0.02)
    objective = Objective(model, rows, FREE, None)
    assert objective.parameters.of(plain.model.parameters) == pytest.approx(plain.phi, abs=1e-9)


@pytest.mark.parametrize("uphill", [False, True])
def test_a_last_step_that_gains_much_is_looked_at(monkeypatch, chain, y, uphill):
    """Its gain is what is found there, and not what was foreseen; where that is worse, the fit stays."""
    step = Objective.last_step

    def far(self, phi):
        found = step(self, phi)
        return None if found is None else (found[0] - 5.0 * uphill, found[1] + 1.0)

    monkeypatch.setattr(Objective, "last_step", far)
    rows = torch.as_tensor(y)
    found = fit(chain.model(STEPS), rows, FREE)
    there = Objective(chain.model(STEPS), rows, FREE, None)
    exact = -there.value(found.phi) + 0.5 * ((found.phi / there.sd) ** 2).sum()
    assert found.log_evidence == pytest.approx(exact, abs=1e-6)
    assert np.abs(found.phi).max() < 5.0


def test_entries_apart():
    """Every entry of a parameter that is not tied has its own factor."""
    one = np.eye(2)
    chain = oracles.Chain(0.8 * one, 0.2 * one, one, np.diag([0.04, 1.0]), np.zeros(2), one)
    y = torch.as_tensor(chain.simulate(400, seed=0)[1])
    model = chain.model(400)
    start = model.replace(emission_root=0.3 * torch.eye(2, dtype=F64))
    found = fit(start, y, [Free("emission_root")])
    root = found.model.parameters["emission_root"]
    assert torch.diagonal(root).tolist() == pytest.approx([0.2, 1.0], rel=0.25)
    assert root[0, 1] == root[1, 0] == 0


def test_the_marginal_is_the_integral_over_the_prior(chain, y):
    """By quadrature of the Kalman filter's evidence, over sixty frames whose posterior is nearly Gaussian."""
    found = fit(chain.model(STEPS), torch.as_tensor(y), FREE)
    exact, sd = negative_log_posterior(chain, y), np.sqrt(np.diagonal(found.covariance))
    nodes, weights = np.polynomial.hermite_e.hermegauss(9)
    terms = [
        np.log(w * v) + 0.5 * (a**2 + b**2) - exact(found.phi + sd * (a, b))
        for a, w in zip(nodes, weights, strict=True)
        for b, v in zip(nodes, weights, strict=True)
    ]
    integral = np.logaddexp.reduce(terms) + np.log(sd).sum() - math.log(2 * math.pi * 2.0 * 0.7)
    assert found.log_marginal == pytest.approx(integral, abs=0.15)
    assert found.log_marginal < found.log_evidence - 1  # two parameters cost something


def test_nothing_to_fit_is_the_evidence(chain, y):
    found = fit(chain.model(STEPS), torch.as_tensor(y), [])
    assert found.log_evidence == found.log_marginal == pytest.approx(oracles.kalman(chain, y)[0], abs=1e-6)
    assert found.converged


def test_the_prior_holds_what_the_data_do_not_tell(chain):
    y = np.full((STEPS, 2), np.nan)
    y[0, 0] = 0.0
    found = fit(chain.model(STEPS), torch.as_tensor(y), [Free("transition_root", tied=True, sd=0.5)])
    root = found.model.parameters["transition_root"]
    assert (root / chain.model(STEPS).parameters["transition_root"])[0, 0].item() == pytest.approx(1, abs=0.05)
    assert found.log_sd["transition_root"] == pytest.approx([0.5], rel=0.05)


def test_where_the_evidence_is_not_convex_no_parameter_is_wider_than_its_prior(chain, y):
    """Stopped far from the optimum: each parameter has a prior of its own width."""
    start = chain.model(STEPS)
    start = start.replace(emission_root=start.parameters["emission_root"] / 40)
    prior = {"transition_root": 2.0, "emission_root": 0.3}
    free = [Free(name, tied=True, sd=sd) for name, sd in prior.items()]
    found = fit(start, torch.as_tensor(y), free, max_iterations=1)
    hessian = Objective(start, torch.as_tensor(y), free, found.path).hessian(found.phi)
    assert np.linalg.eigvalsh(hessian).min() < 1 / 0.3**2
    assert all(found.log_sd[name] <= sd * (1 + 1e-9) for name, sd in prior.items())


def test_means_that_no_parameter_moves_are_fitted_once_and_nothing_else_changes(monkeypatch):
    """Scales move no mean, λ and masses the transitions', lengths all: of 45 sets of eight φ, so many are different."""
    model = paper_arm(load_body("paper_planar_arm"), num_frames=12)
    recording, _ = record(model, 0)
    rows = torch.as_tensor(recording.keypoints.reshape(12, -1))
    free = [Free("torque.scale"), Free("torque.decay"), Free("emission.keypoint_scale", tied=True)]
    free += [Free("body.mass", entries=(1,)), Free("body.length")]
    phi = 0.1 * np.arange(8.0)
    fitted = []
    regress = posterior_linearisation.regress

    def counted(mean, centre, *others):
        fitted.append(len(centre) if centre.ndim == 3 else 0)
        return regress(mean, centre, *others)

    monkeypatch.setattr(posterior_linearisation, "regress", counted)
    monkeypatch.setattr(objective, "SETS_AT_ONCE", 64)  # all sets at once
    shared = Objective(model, rows, free, None)._evaluate(phi)
    assert fitted[-2:] == [1 + 2 * 5 + 10, 1 + 2 * 2 + 1]
    before = len(fitted)
    monkeypatch.setattr(objective, "SETS_AT_ONCE", 1)  # as of a long recording
    alone = Objective(model, rows, free, None)._evaluate(phi)
    assert sum(fitted[before:]) == sum(fitted[:before])
    monkeypatch.setattr(objective, "SETS_AT_ONCE", 64)
    monkeypatch.setattr(Objective, "_slopes_of_means", lambda *_: [np.ones(8)] * 2)
    for one, by_one, other in zip(shared, alone, Objective(model, rows, free, None)._evaluate(phi), strict=True):
        # sums of other lengths may be rounded otherwise, which differences over STEP² blow up
        np.testing.assert_allclose(one, other, rtol=1e-6, atol=1e-6 * np.abs(other).max())
        np.testing.assert_allclose(by_one, other, rtol=1e-6, atol=1e-6 * np.abs(other).max())


def test_other_parameters_are_looked_at_over_the_same_posterior():
    """Of an arm, whose mode obeys the dynamics and is not the posterior's mean."""
    model = paper_arm(load_body("paper_planar_arm"), num_frames=12)
    rows = torch.as_tensor(record(model, 0)[0].keypoints.reshape(12, -1))
    one, phi = Objective(model, rows, [Free("body.length")], None), np.array([0.02, -0.01])
    one.value(phi)
    mode = gauss_newton(one.at(phi), rows, start=None).path
    assert torch.equal(one.path, mode)
    assert not torch.allclose(one._known.over[0], mode, rtol=0, atol=1e-9)
    others = np.stack([phi, phi + STEP * np.eye(2)[0]])
    evidence, paths = one.around(phi, others)
    middle, up, _ = one._known.alone
    np.testing.assert_allclose(evidence, [middle[0], up[0]], rtol=0, atol=1e-6)
    np.testing.assert_allclose((paths[1] - paths[0]) / STEP, one.moved(np.eye(2)[0]), rtol=0.02, atol=0.02)


class OneSided(StateSpaceModel):
    """A point that a spring pushes on one side of zero alone."""

    state_dim, observation_dim, num_steps = 1, 1, 60

    def initial(self):
        return Normal(torch.full((1,), 0.1, dtype=self.dtype), 0.1).to_event(1)

    def transition(self, state, t):
        return Normal(state + self.parameters["spring"] * torch.relu(-state), 0.1).to_event(1)

    def emission(self, state, t):
        return Normal(state, 0.4).to_event(1)


def test_a_parameter_that_acts_on_one_side_alone_is_fitted():
    """The path lies on the other side, less than a standard deviation of what one row tells away."""
    rows = 0.12 + 0.1 * torch.randn(60, 1, generator=torch.Generator().manual_seed(0)).double()
    found = fit(OneSided({"spring": torch.tensor([0.5]).double()}), rows, [Free("spring", sd=1.0)])
    assert found.phi[0] > 0.1  # the prior's is 0


def test_unknown_parameters_are_refused(chain, y):
    with pytest.raises(KeyError, match=r"no parameter torque\.scale"):
        fit(chain.model(STEPS), torch.as_tensor(y), [Free("torque.scale")])


def test_a_parameter_without_dimensions_is_reported(chain, y):
    """Many values of it at once would not broadcast against rows."""
    model = chain.model(len(y))
    model.parameters["strange"] = torch.tensor(1.0)
    with pytest.raises(ValueError, match="parameter strange: expected a tensor of one entry or more"):
        fit(model, torch.as_tensor(y), [Free("strange")])


def test_with_heavy_tails_the_curvature_is_that_of_evidences_each_at_its_own_mode():
    """That of rows in place of a Student-t's is an eighth too sharp here; before cameras it had the wrong sign."""
    torch.manual_seed(0)
    model = arm(60, 0.02, observation=Observation(Keypoints([0, 1]), family="student_t"))
    objective = Objective(model, model.simulate()[1], [Free("body.length", sd=0.3)], None)
    middle, steps = np.zeros(2), 0.01 * np.eye(2)
    objective.value(middle)
    values = [[objective.value(sign * step) for sign in (-1, 0, 1)] for step in steps]
    exact = [(low + high - 2 * here) / 0.01**2 for low, here, high in values]
    found = objective.curvature(middle)
    assert np.diagonal(found) == pytest.approx(exact, rel=0.03)
    np.testing.assert_array_equal(found, found.T)
    assert np.diagonal(objective.hessian(middle)) != pytest.approx(exact, rel=0.1)


def failing(monkeypatch, fails):
    """Have the expansion give a slope that is no number where ``fails`` holds of φ; returns where it was taken."""
    expand, taken = Objective._expand, []

    def expanded(self, phi):
        found = expand(self, phi)
        taken.append(phi)
        return replace(found, gradient=found.gradient * (np.nan if fails(phi) else 1.0))

    monkeypatch.setattr(Objective, "_expand", expanded)
    return taken


def test_a_slope_that_is_no_number_shrinks_the_trust_region(monkeypatch, chain, y):
    model = chain.model(STEPS)
    start = model.replace(emission_root=0.4 * model.parameters["emission_root"])
    expected = fit(start, torch.as_tensor(y), FREE)
    taken = failing(monkeypatch, lambda phi: np.abs(phi).max() > 0.3 and len(taken) < 3)
    found = fit(start, torch.as_tensor(y), FREE)
    assert np.abs(taken[1]).max() > 0.3  # the first step went there
    assert found.phi == pytest.approx(expected.phi, abs=0.05)


@pytest.mark.parametrize("with_path", [False, True])
def test_a_start_without_finite_slopes_is_one_line(monkeypatch, chain, y, with_path):
    failing(monkeypatch, lambda phi: True)
    model = chain.model(STEPS)
    path = torch.zeros(STEPS, model.state_dim, dtype=F64) if with_path else None
    with pytest.raises(Diverged, match=r"^the fit cannot start: .* got none"):
        fit(model, torch.as_tensor(y), FREE, start=path)


def test_of_many_parameters_the_hessian_is_whole_where_the_search_ends(chain, y):
    """Till then it may lack correlations. Along a common factor it is what the same roots have, tied."""
    model, rows = chain.model(STEPS), torch.as_tensor(y)
    many = Objective(model, rows, [Free("transition_root"), Free("emission_root", sd=0.7)], None)
    phi = np.zeros(len(many.sd))
    assert len(phi) > 9
    assert np.count_nonzero(many.hessian(phi)) == len(phi)
    found, tied = many.curvature(phi), Objective(model, rows, FREE, None)
    together = np.stack([np.isin(np.arange(len(phi)), own) for own in many.slices], -1)
    expected = tied.hessian(np.zeros(2)) - np.diag(tied.sd**-2)
    along = together.T @ (found - np.diag(many.sd**-2)) @ together
    assert along == pytest.approx(expected, abs=0.02 * np.abs(expected).max())
    assert many.hessian(phi) == pytest.approx(found, abs=0)


def test_of_many_parameters_correlations_are_renewed_after_some_evaluations(chain, y):
    model, rows = chain.model(STEPS), torch.as_tensor(y)
    many = Objective(model, rows, [Free("transition_root"), Free("emission_root", sd=0.7)], None)
    places = [0.01 * k * np.ones(len(many.sd)) for k in range(FRESH + 2)]
    found = [many.hessian(each) for each in places]
    sd = [np.sqrt(np.abs(np.diagonal(each))) for each in found]
    correlations = [each / np.outer(own, own) for each, own in zip(found, sd, strict=True)]
    assert [np.count_nonzero(each) > len(each) for each in found] == [False] * FRESH + [True, True]
    off = ~np.eye(len(many.sd), dtype=bool)
    np.testing.assert_allclose(correlations[-1][off], correlations[-2][off], rtol=1e-9, atol=1e-12)
    assert not np.allclose(sd[-1], sd[-2], rtol=1e-6)


@pytest.mark.parametrize("fails", ["raises", "is infinite"])
def test_an_evaluation_that_fails_leaves_no_trace(chain, y, monkeypatch, fails):
    """The Hessian where the search ends is of what was evaluated there, and the path where it ended begins the next."""
    model, rows = chain.model(STEPS), torch.as_tensor(y)
    free = [Free("transition_root"), Free("emission_root", sd=0.7)]
    clean, tried = Objective(model, rows, free, None), Objective(model, rows, free, None)
    phi = np.zeros(len(clean.sd))
    shifted = Objective._shifted

    def failing(self, at, *given):
        evidence, paths = shifted(self, at, *given)
        if fails == "raises":
            raise Diverged("too far")
        return np.full_like(evidence, np.nan), paths

    tried.value(phi)
    with monkeypatch.context() as patch:
        patch.setattr(Objective, "_shifted", failing)
        for far in range(FRESH + 1):
            assert tried.value(phi + 0.3 * (1 + far)) == 1e10
    assert tried.curvature(phi) == pytest.approx(clean.curvature(phi), abs=0)
    assert tried.value(phi + 0.01) == pytest.approx(clean.value(phi + 0.01), abs=1e-9)
    assert tried.hessian(phi + 0.01) == pytest.approx(clean.hessian(phi + 0.01), rel=1e-6, abs=1e-6)


def known_to_be(objective, phi, gradient, hessian):
    """The objective as if it had just found these at φ."""
    objective.value(phi)
    objective._known = replace(objective._known, gradient=np.array(gradient), hessian=np.array(hessian))


def test_the_last_step_is_newtons_and_gains_what_a_quadratic_does(chain, y):
    objective, phi = Objective(chain.model(STEPS), torch.as_tensor(y), FREE, None), np.zeros(2)
    slope, bend = np.array([0.2, -0.1]), np.array([[4.0, 1.0], [1.0, 3.0]])
    known_to_be(objective, phi, slope, bend)
    step, gain = objective.last_step(phi)
    assert step == pytest.approx(-np.linalg.solve(bend, slope))
    assert gain == pytest.approx(-(slope @ step + step @ bend @ step / 2))
    assert objective.last_step(phi + 0.1) is None  # that is not where it looked
    smallest = np.sqrt(np.linalg.eigvalsh(bend)[0])
    for share, there in ((0.99, True), (1.01, False)):  # of the gain that is the last step's at most
        known_to_be(objective, phi, slope * np.sqrt(share * LEFT * smallest / gain), bend)
        assert (objective.last_step(phi) is not None) == there
    known_to_be(objective, phi, [0.0, 0.0], [[1.0, 2.0], [2.0, 1.0]])
    assert objective.last_step(phi) is None  # a saddle


def test_under_heavy_tails_no_step_is_left(chain, y):
    objective, phi = Objective(chain.model(STEPS), torch.as_tensor(y), FREE, None), np.zeros(2)
    objective.heavy = True
    for share, there in ((0.99, True), (1.01, False)):
        known_to_be(objective, phi, [np.sqrt(share * 2 * HEAVY_MIN_GAIN), 0.0], np.eye(2))
        last = objective.last_step(phi)
        assert (last is not None) == there
        assert last is None or (not last[0].any() and last[1] == 0)


@pytest.mark.parametrize("fails", [False, True])
def test_slopes_are_looked_at_within_the_prior_and_what_fails_leaves_the_search_its_own(chain, y, monkeypatch, fails):
    """A Hessian that says nothing would have the gradient at the largest step."""
    narrow = [replace(each, sd=sd) for each, sd in zip(FREE, (0.2, 0.04), strict=True)]
    objective, phi = Objective(chain.model(STEPS), torch.as_tensor(y), narrow, None), np.zeros(2)
    flat = np.array([[1e-9, 1e-10], [1e-10, 1e-9]])
    known_to_be(objective, phi, [0.0, 0.0], flat)
    objective.heavy, taken = True, []

    def expanded(self, at):
        taken.append(at)
        if fails:
            raise Diverged("too far")
        return replace(self._known, gradient=np.array([[3.0, 1.0], [1.0, 2.0]]) @ at)

    monkeypatch.setattr(Objective, "_expand", expanded)
    assert objective.curvature(phi) == pytest.approx(flat if fails else np.array([[3.0, 1.0], [1.0, 2.0]]))
    np.testing.assert_allclose(taken, np.diag([0.05, 0.01])[: len(taken)])


def test_where_an_evaluation_failed_the_curvature_is_one(chain, y, monkeypatch):
    objective, phi = Objective(chain.model(STEPS), torch.as_tensor(y), FREE, None), np.zeros(2)
    objective.value(phi)
    failing(monkeypatch, lambda at: np.abs(at).max() > 0.3)
    for objective.heavy in (False, True):
        np.testing.assert_array_equal(objective.curvature(phi + 0.5), np.eye(2))


def test_one_draw_of_the_parameters_is_off_by_what_means_and_variances_move(chain, y):
    """A mean that moves by m sds, and log-variances by g, with one factor; a state that is known exactly does not."""
    objective = Objective(chain.model(STEPS), torch.as_tensor(y), FREE, None)
    objective.value(np.zeros(2))
    m, g, covariance = np.array([0.3, -0.2]), np.array([0.5, 0.4]), np.array([[0.4, 0.1], [0.1, 0.2]])
    variance = np.stack([np.linspace(1, 3, STEPS), np.zeros(STEPS)], -1)
    way = np.sqrt(variance) * (-1.0) ** np.arange(STEPS)[:, None]
    slopes = np.stack([np.multiply.outer(each, way) for each in (m, g / 2)])
    objective._known = replace(objective._known, moves=(slopes, variance))
    expected = 2 * (m @ covariance @ m) ** 2 + g @ covariance @ g
    np.testing.assert_allclose(objective.scatter(covariance), [expected, 0.0])
    objective._known = replace(objective._known, moves=(slopes * np.nan, variance))
    assert objective.scatter(covariance)[0] == np.inf
