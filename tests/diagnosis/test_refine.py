"""Refined causes against exact Kalman evidence, quadrature, SMC and the truth; what they predict."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch
from oracles import Chain, kalman
from scipy.integrate import quad
from scipy.optimize import minimize
from scipy.stats import halfnorm

from invdyn.diagnosis.confirm import confirm, posterior
from invdyn.diagnosis.findings import finding, tempered_covariance
from invdyn.diagnosis.noise import log_spread
from invdyn.diagnosis.paths import FIRM, led, lifted
from invdyn.diagnosis.predict import Scores, replay, replay_rms, residual, scores, smoothed
from invdyn.diagnosis.refine import _distance, _within, key_of, refine, refine_searched
from invdyn.diagnosis.screen import log_prior, sizes
from invdyn.diagnosis.setting import DECAY, LOOSE, _calm, setting
from invdyn.diagnosis.shrinkage import closed, held_out_scores, split
from invdyn.diagnosis.unknowns import unknowns
from invdyn.inference.gauss_newton import gauss_newton
from invdyn.models import Body, Link
from invdyn.models.effects import EFFECTS
from invdyn.recordings import Recording
from invdyn.simulate import random_arm, record

ROD = Link("rod", "pivot", "tip", length=0.3, mass=1.0)
PENDULUM = Body("pendulum", [ROD], gravity=(0.0, -9.81))
FRICTION = EFFECTS["viscous_friction"]("pivot")
DAMPING = 0.05


def recorded(damping=0.0, seed=0, mass=1.0, rows=80):
    """A pendulum under known commands, filmed with 2 mm of noise."""
    body = PENDULUM.with_values(mass=[mass])
    arm = random_arm(body, duration=rows / 50, fps=50, noise=0.002, torque_scale=0.5, commanded=True, seed=seed)
    values = {"effect.viscous_friction.pivot.damping": torch.tensor([damping], dtype=torch.float64)}
    return record(arm.with_effects(FRICTION).replace(**values), seed)[0]


def path_of(here):
    return gauss_newton(here.with_residual(LOOSE), here.observations).path


@cache
def causes(damping=DAMPING):
    """The pendulum's setting, "no effect" and viscous friction."""
    here = setting(recorded(damping), PENDULUM)
    path = path_of(here)
    return here, refine(here, (), {}, path, LOOSE), refine(here, (FRICTION,), {}, path, LOOSE)


def test_jumps_are_no_fast_arm():
    """Exchanged labels and strays do not count as motion; a fast arm, and frames that were not seen, stay."""
    time = 0.02 * np.arange(200)
    arm = np.stack([np.sin(3 * time), np.cos(2 * time)], -1)
    arm += 1e-3 * np.random.default_rng(0).normal(size=arm.shape)
    seen = arm.copy()
    seen[[20, 90, 91, 150]] = arm[[20, 90, 91, 150], ::-1]
    seen[120] = np.nan
    calm = _calm(torch.as_tensor(seen)).numpy()
    jumped = np.abs(seen - arm) > 0.3
    assert np.isnan(calm[jumped]).all()
    kept = np.isfinite(calm)
    assert kept[~jumped & np.isfinite(seen)].mean() > 0.97
    np.testing.assert_array_equal(calm[kept], seen[kept])


# -- a chain whose answers are known -----------------------------------------------------------------------------
WHEEL = Body("wheel", [Link("rod", "pivot", "tip", length=0.3, mass=1.0, com=0.15, inertia=0.0075)], gravity=(0, 0))
INERTIA = 0.03  # about the pivot
BRAKE = 0.02


@cache
def wheel():
    """A wheel that turns freely but for viscous friction, seen by an encoder: a linear-Gaussian chain."""
    rng = np.random.default_rng(0)
    time = 0.02 * np.arange(60)
    angle = 0.3 + 2.0 * INERTIA / BRAKE * -np.expm1(-BRAKE / INERTIA * time) + 0.002 * rng.normal(size=60)
    recording = Recording(time, np.zeros((60, 0, 2)), (), angles=angle[:, None], joint_names=("pivot",))
    return setting(recording, WHEEL, passive=True)


def wheel_chain(model, kappa=1.0, damping=0.0):
    """The same as numbers: Runge–Kutta steps on unit vectors, the torque on a straight line within a row."""
    p = {name: value.numpy() for name, value in model.parameters.items()}
    dt, steps = 0.02, model.substeps
    keep = np.exp(-DECAY["passive"] * dt)

    def rate(state, s, torque):
        return np.array([state[1], (torque * (1 - s + s * keep) - damping * state[1]) / INERTIA])

    columns = []
    for torque, *state in np.eye(3):
        state, h = np.array(state), dt / steps
        for i in range(steps):
            s = i / steps
            k1 = rate(state, s, torque)
            k2 = rate(state + h / 2 * k1, s + 0.5 / steps, torque)
            k3 = rate(state + h / 2 * k2, s + 0.5 / steps, torque)
            k4 = rate(state + h * k3, s + 1 / steps, torque)
            state = state + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        columns.append([keep * torque, *state])
    stationary = p["torque.scale"].item() / np.sqrt(2 * DECAY["passive"])
    noise = [stationary * np.sqrt(1 - keep**2), p["noise.angle"].item(), p["noise.velocity"].item()]
    first = [stationary, p["initial.angle_scale"].item(), p["initial.velocity_scale"].item()]
    sd = p["emission.angle_scale"].item()
    return Chain(
        np.array(columns).T,
        np.diag(np.square(noise)) * kappa**2,
        np.array([[0.0, 1.0, 0.0]]),
        np.array([[sd**2]]) * kappa**2,
        np.array([0.0, p["initial.angle"].item(), p["initial.velocity"].item()]),
        np.diag(np.square(first)) * kappa**2,
    )


def at_best(here, cause):
    """A cause's log evidence at its best size, and that size."""
    top = int(cause.by_size.argmax())
    levels = sizes(here.regime)
    return cause.by_size[top] - log_prior(levels)[top], levels[top]


def test_evidence_of_a_linear_chain_is_exact():
    here = wheel()
    none = refine(here, (), {}, path_of(here), LOOSE)
    evidence, size = at_best(here, none)
    exact, increments, _, _ = kalman(wheel_chain(here.with_residual(size), none.kappa), here.observations.numpy())
    assert evidence == pytest.approx(exact, abs=1e-5)
    np.testing.assert_allclose(scores(here, none).score, increments, atol=1e-5)


def test_smc_evidence_of_a_linear_chain_is_exact():
    """The twisted proposal is perfect there: every filter finds the same number."""
    here = wheel()
    none = refine(here, (), {}, path_of(here), LOOSE)
    confirmed = confirm(here, none, filters=4)
    exact, *_ = kalman(wheel_chain(confirmed.model), here.observations.numpy())
    other_sizes = none.log_evidence - at_best(here, none)[0]
    assert confirmed.log_evidence == pytest.approx(exact + other_sizes, abs=1e-4)
    assert confirmed.log_evidence_sd < 1e-4


def test_a_parameter_is_integrated_out():
    """∫ p(y | b) p(b) db by quadrature over exact Kalman evidences; refinement is a Laplace approximation of it."""
    here = wheel()
    cause = refine(here, (FRICTION,), {}, path_of(here), LOOSE)
    evidence, size = at_best(here, cause)
    assert abs(cause.mean[0] - BRAKE) < 4 * cause.sd[0]
    y, prior_sd = here.observations.numpy(), unknowns(here, cause.effects).sd[0]

    def density(b):
        exact, *_ = kalman(wheel_chain(here.with_residual(size), cause.kappa, b), y)
        return np.exp(exact - evidence) * halfnorm.pdf(b, scale=prior_sd)

    low, high = max(cause.mean[0] - 6 * cause.sd[0], 0.0), cause.mean[0] + 6 * cause.sd[0]
    integral, _ = quad(density, low, high, epsrel=1e-3, limit=20)
    assert np.log(integral) == pytest.approx(0.0, abs=0.1)


# -- an arm ------------------------------------------------------------------------------------------------------
def test_friction_is_found_and_believed():
    _, none, cause = causes()
    assert cause.key == "viscous_friction.pivot"
    assert abs(cause.mean[0] - DAMPING) < 4 * cause.sd[0]
    assert cause.sd[0] < 0.1 * DAMPING
    assert cause.log_evidence > none.log_evidence + 10
    assert cause.by_size.argmax() == 0  # nothing is left
    assert none.by_size.argmax() > 0
    assert cause.model.parameters["effect.viscous_friction.pivot.damping"].item() == pytest.approx(cause.mean[0])
    # The noise scale starts from the recording's own jitter: a factor near one, n = 160.
    assert 0.7 < cause.kappa < 1.3


@cache
def rubbed(level=0.15, torque=0.5):
    """A pendulum under known commands with dry friction enough to stick at some turns."""
    arm = random_arm(PENDULUM, duration=3.0, fps=50, noise=0.001, torque_scale=torque, commanded=True, seed=2)
    effect = EFFECTS["coulomb_friction"]("pivot")
    values = {"effect.coulomb_friction.pivot.torque": torch.tensor([level], dtype=torch.float64)}
    here = setting(record(arm.with_effects(effect).replace(**values), 2)[0], PENDULUM)
    return here, effect, values


def test_a_path_is_led_through_what_sticks():
    """Where Gauss–Newton by itself ends in a path that nothing explains."""
    here, effect, values = rubbed(0.3, 1.0)
    model = here.model.with_effects(effect).replace(**values)
    loose = path_of(here)
    by_itself = gauss_newton(here.with_residual(FIRM, model), here.observations, start=loose, max_iterations=24)
    path = led(here, model, loose, FIRM)
    quiet = gauss_newton(here.with_residual(FIRM, model), here.observations, start=path, max_iterations=1)
    assert quiet.log_joint > by_itself.log_joint + 1e4
    assert 3 < (path[1:, -1].abs() < 1e-3).sum() < len(path) / 2


def test_dry_friction_is_found_from_a_third_and_from_twice_of_it():
    here, effect, _ = rubbed()
    none = refine(here, (), {}, path_of(here), LOOSE)
    for start in (0.05, 0.3):
        cause = refine(here, (effect,), {"coulomb_friction.pivot.torque": start}, path_of(here), LOOSE)
        assert cause.complete
        assert abs(cause.mean[0] - 0.15) < 4 * cause.sd[0]
        assert cause.log_evidence > none.log_evidence + 50


def test_a_positive_parameter_is_halved_at_most():
    here, _, _ = rubbed()
    among = unknowns(here, (EFFECTS["stribeck_friction"]("pivot").bound(PENDULUM),))
    velocity = among.names.index("stribeck_friction.pivot.velocity")
    point = among.mean.copy()
    there = among.step(point, point - 100.0 * among.sd)
    assert there[velocity] == pytest.approx(point[velocity] / 2)
    assert (there >= among.lower).all()
    assert among.step(point, point + 0.1 * among.sd) == pytest.approx(point + 0.1 * among.sd)


def test_a_step_that_meets_a_bound_is_the_best_within_it():
    """Against a quadratic programme by another solver."""
    generator = np.random.default_rng(3)
    here = setting(recorded(DAMPING), PENDULUM)
    names = ("viscous_friction", "armature", "coulomb_friction")
    among = unknowns(here, [EFFECTS[name]("pivot").bound(PENDULUM) for name in names])
    met = 0
    for _ in range(20):
        root = generator.normal(size=(3, 3)) * among.sd[:, None]
        covariance, mean = root @ root.T, generator.normal(size=3) * among.sd
        point = among.lower + 0.3 * among.sd
        found = _within(among, point, mean, covariance)

        def cost(z, mean=mean, covariance=covariance, point=point):
            return _distance(point + mean - z * among.sd, covariance)

        best = minimize(cost, (found / among.sd), bounds=np.stack([among.lower, among.upper], -1) / among.sd[:, None])
        assert (found >= among.lower).all()
        assert (found <= among.upper).all()
        met += (point + mean < among.lower).any()
        # Coordinates that have met a bound stay there, though the others might let one go again.
        assert cost(found / among.sd) <= 1.5 * best.fun + 1e-6
        clipped = np.clip(point + mean, among.lower, among.upper)
        assert cost(found / among.sd) <= cost(clipped / among.sd) + 1e-9
    assert met > 5


def test_a_stop_is_found_from_beside_it():
    """From a tenth of a radian off, what steps promise and do not keep would be taken for better than the truth."""
    body, stop = PENDULUM, EFFECTS["joint_limit"]("pivot", "upper").bound(PENDULUM)
    arm = random_arm(body, duration=4, fps=100, noise=0.002, torque_scale=0.5, commanded=True, seed=5)
    truth = {"angle": -1.2, "stiffness": 10.0, "damping": 0.3}
    values = {f"{stop.key}.{name}": value for name, value in truth.items()}
    real = arm.with_effects(stop).replace(**{f"effect.{k}": torch.tensor([v]).double() for k, v in values.items()})
    here = setting(record(real, 5)[0], body)
    path = path_of(here)
    right = refine(here, (stop,), values, path, FIRM)
    for off in (-0.1, 0.05):
        beside = {**values, f"{stop.key}.angle": truth["angle"] + off, f"{stop.key}.stiffness": 20.0}
        found = refine(here, (stop,), beside, path, FIRM)
        assert found.complete
        assert abs(found.log_evidence - right.log_evidence) < 5
        assert found.mean == pytest.approx(list(truth.values()), rel=0.15)


def test_friction_that_is_not_there_costs_its_prior():
    """At an edge the half-normal keeps about half: less evidence than without, never a negative damping."""
    _, none, cause = causes(0.0)
    assert cause.mean[0] >= 0
    assert cause.mean[0] < 4 * cause.sd[0]
    assert cause.log_evidence < none.log_evidence
    assert none.by_size.argmax() == 0


def test_an_uncertain_body_is_fitted_too():
    mass = 1.04
    body = Body("pendulum", [ROD], gravity=PENDULUM.gravity, uncertainty={"mass": 0.05})
    here = setting(recorded(DAMPING, mass=mass), body)
    cause = refine(here, (FRICTION,), {}, path_of(here), LOOSE)
    assert cause.names == ("viscous_friction.pivot.damping", "body.mass.0")
    assert (np.abs(cause.mean - [DAMPING, mass]) < 4 * cause.sd).all()
    assert cause.sd[1] < 0.03  # learned: 0.05 to begin with
    assert cause.model.body_parameters().mass.item() == pytest.approx(cause.mean[1])
    confirmed = confirm(here, cause)
    assert confirmed.log_evidence == pytest.approx(cause.log_evidence, abs=0.5 + 4 * confirmed.log_evidence_sd)


def test_smc_agrees_with_the_linearised_evidence():
    here, none, cause = causes()
    for each in (none, cause):
        confirmed = confirm(here, each)
        assert confirmed.log_evidence_sd < 0.3
        assert confirmed.log_evidence == pytest.approx(each.log_evidence, abs=0.5 + 4 * confirmed.log_evidence_sd)


def test_where_filters_die_there_are_paths_and_no_evidence():
    """Drawn so widely that an arm without inertia runs away: the estimates still give a posterior."""
    here = setting(recorded(DAMPING), PENDULUM)
    cause = refine(here, (FRICTION,), {}, path_of(here), LOOSE)
    wild = replace(cause, covariance=1e12 * cause.covariance)
    run = confirm(here, wild, seed=1)
    assert run.log_evidence == -np.inf
    assert np.isnan(run.log_evidence_sd)
    assert (run.values == cause.mean).all()
    assert np.isfinite(posterior(here, cause, run, 1)["posterior"]["torque"]).all()


def test_same_seed_same_numbers_and_all_within_bounds():
    here, _, cause = causes(0.0)  # at the edge: half of a symmetric proposal lies beyond it
    first, again, other = (confirm(here, cause, seed, filters=8) for seed in (1, 1, 2))
    assert first.log_evidence == again.log_evidence
    assert np.array_equal(first.values, again.values)
    assert not np.array_equal(first.values, other.values)
    for confirmed in (first, other):
        assert (confirmed.values >= 0).all()
        assert np.isfinite(confirmed.log_evidence)
    assert abs(first.log_evidence - other.log_evidence) < 4 * (first.log_evidence_sd + other.log_evidence_sd)


def test_posterior_has_the_parameters():
    here, _, cause = causes()
    idata = posterior(here, cause, confirm(here, cause, filters=4), 0)
    drawn = idata["posterior"]["effect.viscous_friction.pivot.damping"]
    assert drawn.shape == idata["posterior"]["torque"].shape[:2]
    assert np.abs(drawn - DAMPING).max() < 10 * cause.sd[0]


def test_a_path_gets_and_loses_a_hidden_hinge():
    here, none, _ = causes()
    hinge = here.model.with_effects(EFFECTS["link_flexibility"]("rod"))
    path = lifted(hinge, none.path)
    assert path.shape[-1] == hinge.state_dim == here.model.state_dim + 2
    assert not path[:, 1:3].any()
    assert torch.equal(lifted(here.model, path), none.path)
    assert lifted(here.model, none.path) is none.path
    assert key_of((FRICTION, EFFECTS["camera_roll"]())) == "camera_roll+viscous_friction.pivot"


# -- the scatter -------------------------------------------------------------------------------------------------
def test_intervals_are_those_of_the_tempered_likelihood():
    here, _, cause = causes()
    among = unknowns(here, cause.effects)
    spread = np.array([[0.3, 0.1], [0.1, 0.2]])
    among = replace(among, sd=np.array([1.0, 2.0]))
    both = replace(cause, covariance=spread)
    np.testing.assert_allclose(tempered_covariance(both, among, 1.0), spread)
    np.testing.assert_allclose(tempered_covariance(both, among, 0.0), np.diag([1.0, 4.0]), atol=1e-12)
    prior = np.diag([1.0, 0.25])
    direct = np.linalg.inv(0.2 * (np.linalg.inv(spread) - prior) + prior)
    np.testing.assert_allclose(tempered_covariance(both, among, 0.2), direct)
    narrow, wide = (finding(here, cause, cause.effects[0], 0, temper).parameters["damping"] for temper in (1.0, 0.1))
    assert wide.sd == pytest.approx(narrow.sd / np.sqrt(0.1), rel=0.1)
    assert wide.mean == pytest.approx(narrow.mean, abs=3 * wide.sd / np.sqrt(4000))


def test_intervals_of_what_was_searched_stay_within_the_prior():
    here, _, cause = causes()
    play = EFFECTS["backlash"]("pivot").bound(PENDULUM)
    name = "backlash.pivot.width"
    counted = replace(cause, noise={name: 0.02}, noise_sd={name: 0.002})
    narrow, wide, widest = (finding(here, counted, play, 0, temper).parameters["width"] for temper in (1.0, 0.2, 1e-9))
    assert narrow.mean == wide.mean == widest.mean == 0.02
    assert np.diff(np.log(narrow.interval_90))[0] == pytest.approx(2 * 1.645 * 0.1, rel=0.05)
    assert np.diff(np.log(wide.interval_90))[0] == pytest.approx(2 * 1.645 * 0.1 / np.sqrt(0.2), rel=0.1)
    (width,) = play.parameters(here.model.scale)
    assert np.diff(np.log(widest.interval_90))[0] == pytest.approx(2 * 1.645 * log_spread(width), rel=0.05)


def test_play_is_searched_and_found():
    """A rod whose load reverses: the width, from a grid that does not have it, and far more than none explains."""
    body = replace(PENDULUM, gravity=(0.0, 0.0))
    play = EFFECTS["backlash"]("pivot")
    arm = random_arm(body, duration=3.0, fps=50, noise=0.0005, torque_scale=0.5, commanded=True, seed=0)
    width = torch.tensor([0.06], dtype=torch.float64)
    recording = record(arm.with_effects(play).replace(**{"effect.backlash.pivot.width": width}), 0)[0]
    here = setting(recording, body)
    none = refine(here, (), {}, path_of(here), LOOSE)
    cause = refine_searched(here, none, play.bound(body))
    assert cause.log_evidence > none.log_evidence + 20
    assert cause.noise["backlash.pivot.width"] == pytest.approx(0.06, rel=0.2)
    assert cause.path.shape[-1] == none.path.shape[-1] + 2
    assert refine_searched(here, none, play.bound(body), cause.log_evidence + 100) is None


def test_stray_detections_are_counted():
    recording = recorded(0.0, rows=100)
    rng = np.random.default_rng(3)
    stray = rng.random(100) < 0.08
    stray[:3] = False  # the first frames place the arm
    points = recording.keypoints + stray[:, None, None] * rng.normal(0.0, 0.06, size=(100, 1, 2))
    here = setting(replace(recording, keypoints=points), PENDULUM)
    clean = setting(recording, PENDULUM)
    path = path_of(clean)
    outliers = EFFECTS["outliers"]().bound(PENDULUM)
    cause = refine_searched(here, refine(here, (), {}, path, LOOSE), outliers)
    assert cause.names == ()
    assert abs(cause.noise["outliers.rate"] - stray.mean()) < 4 * cause.noise_sd["outliers.rate"] < 0.2
    assert abs(cause.noise["outliers.scale"] - 0.06) < 4 * cause.noise_sd["outliers.scale"] < 0.12
    assert cause.log_evidence > refine(here, (), {}, path, LOOSE).log_evidence + 50
    assert refine_searched(clean, refine(clean, (), {}, path, LOOSE), outliers) is None


# -- predictions -------------------------------------------------------------------------------------------------
def test_scores_sum_to_the_evidence():
    """The chain rule: Σ log p(y_t | y_<t), at the best size; exact without parameters."""
    here, none, _ = causes()
    evidence, _ = at_best(here, none)
    assert scores(here, none).score.sum() == pytest.approx(evidence, abs=1e-6)


def test_the_floor_is_what_a_perfect_simulation_scores():
    here, none, cause = causes()
    for setting_, perfect in ((causes(0.0)[0], causes(0.0)[1]), (here, cause)):
        both = scores(setting_, perfect)
        # Squares of n = 160 unit innovations: their sum's sd is √320, of which half counts.
        assert abs((both.floor - both.score).sum()) < 4 * np.sqrt(2 * 160) / 2
    poor = scores(here, none)
    assert (poor.floor - poor.score).sum() > 10


def test_rows_that_were_not_seen_have_no_score():
    here, none, _ = causes()
    gaps = here.observations.clone()
    gaps[[3, 40]] = torch.nan
    both = scores(here.observing(gaps), none)
    for values in (both.score, both.floor):
        assert np.flatnonzero(np.isnan(values)).tolist() == [3, 40]


def test_residual_torque_is_what_the_simulation_lacks():
    here, none, cause = causes()
    mean, sd = residual(here, none)
    assert mean.shape == sd.shape == (80, 1)
    missing = -DAMPING * none.path[:, 2].numpy()
    # A Gaussian process through noise: its own spread says how far off it may be.
    assert np.sqrt((((mean[:, 0] - missing) / sd[:, 0]) ** 2).mean()) < 2
    assert np.corrcoef(mean[:, 0], missing)[0, 1] > 0.8
    after, _ = residual(here, cause)
    assert np.sqrt((after**2).mean()) < 0.05 * np.sqrt((mean**2).mean())


def test_replay_follows_once_the_cause_is_in():
    here, none, cause = causes()
    path = smoothed(here, cause).path
    _, q, _ = here.model.split(path)
    tips = here.model.dynamics.keypoints(q, here.model.body_parameters()).numpy()
    with_cause, without = (replay_rms(replay(c.model, path), tips) for c in (cause, none))
    assert with_cause < 0.001
    assert without > 10 * with_cause
    assert replay(cause.model, path).shape == (80, 1, 2)
    np.testing.assert_allclose(replay(cause.model, path)[[0, 50]], tips[[0, 50]], atol=1e-9)  # set back every second
    assert replay_rms(tips + 0.3, tips) == pytest.approx(0.3 * np.sqrt(2))


def test_the_last_third_is_held_out():
    here, none, cause = causes()
    train, rows = split(here)
    assert np.flatnonzero(rows).tolist() == list(range(53, 80))
    assert torch.isnan(train.observations[53:]).all()
    assert torch.equal(train.observations[:53], here.observations[:53])
    without, with_cause, used = held_out_scores(here, none, cause)
    assert np.array_equal(used, rows)
    result = closed(without, with_cause, used, here.model.time.numpy(), 0)
    assert 0.5 < result.share <= 1.0
    assert result.interval[0] <= result.share <= result.interval[1] <= 1.0
    per_frame = result.per_frame
    assert per_frame["nominal"] < per_frame["corrected"] < per_frame["noise_floor"] + 1.0


def test_a_push_in_the_last_third_has_the_parameters_that_all_rows_give_it():
    push = EFFECTS["external_push"]("tip")
    arm = random_arm(PENDULUM, duration=1.6, fps=50, noise=0.002, torque_scale=0.5, commanded=True, seed=0)
    truth = {"force_x": 6.0, "force_y": 3.0, "start": 1.22, "stop": 1.34}
    given = {f"effect.external_push.tip.{n}": torch.tensor([v], dtype=torch.float64) for n, v in truth.items()}
    here = setting(record(arm.with_effects(push).replace(**given), 0)[0], PENDULUM)
    path = path_of(here)
    none = refine(here, (), {}, path, LOOSE)
    cause = refine(here, (push,), {f"external_push.tip.{n}": v for n, v in truth.items()}, path, LOOSE)
    assert cause.log_evidence > none.log_evidence + 20
    result = closed(*held_out_scores(here, none, cause), here.model.time.numpy(), 0)
    assert result.per_frame["noise_floor"] - result.per_frame["nominal"] > 0.5
    assert result.share > 0.5


def test_another_recording_is_held_out():
    here, none, cause = causes()
    other = setting(recorded(DAMPING, seed=5, rows=60), PENDULUM)
    without, with_cause, rows = held_out_scores(here, none, cause, other)
    assert rows.all()
    assert len(rows) == len(without.score) == 60
    assert np.nansum(with_cause.score - without.score) > 5
    # Parameters are those of the first recording, not fitted again.
    carried = cause.carried_to(other).parameters["effect.viscous_friction.pivot.damping"].item()
    assert carried == pytest.approx(cause.mean[0])


# -- the share that is closed ------------------------------------------------------------------------------------
def series(seed, rows=240, share=0.6):
    """Scores whose gap and gain wander as neighbours do: autoregressive, 0.05 s long at 100 rows a second."""
    rng = np.random.default_rng(seed)
    wander = np.zeros((rows, 2))
    for t in range(1, rows):
        wander[t] = 0.8 * wander[t - 1] + 0.6 * rng.normal(size=2)
    gap = 2.0 + wander[:, 0]
    gain = share * gap + 0.5 * wander[:, 1]
    zero = np.zeros(rows)
    return Scores(zero, zero), Scores(gain, gap), 0.01 * np.arange(rows)


def test_the_interval_covers():
    everything, hits = np.ones(240, bool), 0
    for seed in range(120):
        without, with_cause, time = series(seed)
        low, high = closed(without, with_cause, everything, time, seed).interval
        hits += low <= 0.6 <= high
    # 90 % by name; blocks of 40 rows in 240 are few, and such intervals too short by some per cent.
    assert 0.9 - 0.1 - 4 * np.sqrt(0.09 / 120) < hits / 120 <= 1.0


def test_share_of_known_scores():
    time = 0.1 * np.arange(20)
    rows = np.arange(20) >= 5
    gain, gap = np.full(20, 0.5), np.full(20, 2.0)
    gain[:5] = 100.0  # not held out
    gain[7] = np.nan  # not seen
    result = closed(Scores(np.zeros(20), gap), Scores(gain, gap), rows, time, 0)
    assert result.share == pytest.approx(0.25)
    np.testing.assert_allclose(result.interval, 0.25)
    assert result.per_frame == pytest.approx({"nominal": 0.0, "corrected": 0.5, "noise_floor": 2.0})
    more = closed(Scores(np.zeros(20), gap), Scores(5 * gain, gap), rows, time, 0)
    assert more.share == 1.0  # not more than all
    nothing = closed(Scores(np.zeros(20), -gap), Scores(gain, -gap), rows, time, 0)
    assert (nothing.share, nothing.interval) == (None, None)
