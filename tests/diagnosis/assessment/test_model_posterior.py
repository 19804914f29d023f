"""What counts as something left beside a cause."""

import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from pendulum import LOOSE, PENDULUM, recorded, recording_of

from invdyn.diagnosis.assessment.model_posterior import credible, only, share_explained, share_of_small_residuals, weigh
from invdyn.diagnosis.hypotheses.continuation import data_path
from invdyn.diagnosis.hypotheses.pool import HypothesisPool, considered
from invdyn.diagnosis.hypotheses.profile_likelihood import refine_searched
from invdyn.diagnosis.hypotheses.refine import refine
from invdyn.diagnosis.prediction.innovation_tests import (
    correlation,
    prediction_errors,
    show_more,
)
from invdyn.diagnosis.problem.diagnosis_problem import diagnosis_problem
from invdyn.diagnosis.problem.regime import COMMANDED, UNKNOWN_TORQUE
from invdyn.diagnosis.problem.unknowns import bounds
from invdyn.diagnosis.rules import DEFAULT
from invdyn.models import ArmModel
from invdyn.models.effects import EFFECTS
from invdyn.simulate import random_arm, record


def test_the_share_of_small_residuals_raises_evidence_to_a_power_and_not_the_prior():
    """Of two sizes by hand: what the data say counts half."""
    prior, said = np.log([0.9, 0.1]), np.array([0.0, 3.0])
    regime = SimpleNamespace(sizes=np.array([0.0, 5.0]), log_prior=prior)
    cause = SimpleNamespace(effects=(), by_size=said + prior)
    pool = SimpleNamespace(temper=0.5, leaves=lambda cause: False, pool={"": SimpleNamespace(by_size=prior)})
    odds = 0.9 / (0.1 * np.exp(1.5))
    share = share_of_small_residuals(SimpleNamespace(rules=DEFAULT, regime=regime), pool, cause)
    assert share == pytest.approx(odds / (1 + odds))


def test_what_is_little_beside_the_gap_is_nothing_left():
    """A tenth of the residual that the simulation alone needs; and large gaps forgive more than small ones."""
    bound = diagnosis_problem(recording_of(), PENDULUM)
    none = refine(bound, (), {}, data_path(bound)[0], LOOSE)
    levels = COMMANDED.sizes
    needed = replace(none, by_size=np.where(levels == levels[5], 0.0, -1e4), log_evidence=0.0)
    friction = EFFECTS["viscous_friction"]("pivot").bound(PENDULUM)
    known = {"names": (f"{friction.key}.damping",), "mean": np.array([0.05]), "covariance": 1e-6 * np.eye(1)}
    cause = replace(none, effects=(friction,), log_evidence=50.0, **known)

    def share(left, gain=50.0):
        left = replace(cause, by_size=np.where(levels == levels[left], 0.0, -60.0), log_evidence=gain)
        return share_explained(
            bound, HypothesisPool(bound, [], {"": needed, left.key: left}, [], none.path, False), left
        )

    assert share(0) > 0.99
    assert share(2) > 0.99  # 2.4 % of the needed one
    assert share(4) < 0.01
    assert share(4, gain=5000.0) > share(4)
    needed = replace(needed, by_size=np.where(levels == levels[2], 0.0, -1e4))
    assert share(1) > 0.99  # however little is needed
    assert share(2) < 0.01
    plain = replace(needed, by_size=np.where(levels == levels[1], 0.0, -60.0))
    assert (
        share_explained(bound, HypothesisPool(bound, [], {"": plain}, [], none.path, False), plain) < 0.01
    )  # but it is more than no gap


def tolerating(bound, share):
    """The problem under another tolerance."""
    return replace(bound, rules=bound.rules.replace(tolerance=share))


def test_a_torque_under_the_tolerance_is_not_left():
    """Of what a user tolerates nothing is left, however surely it is there; and more of what is over it is."""
    bound = diagnosis_problem(recording_of(), PENDULUM)
    none = refine(bound, (), {}, data_path(bound)[0], LOOSE)
    levels, friction = COMMANDED.sizes, EFFECTS["viscous_friction"]("pivot").bound(PENDULUM)
    needed = replace(none, by_size=np.where(levels == levels[3], 0.0, -1e4), log_evidence=0.0)
    known = {"names": (f"{friction.key}.damping",), "mean": np.array([0.05]), "covariance": 1e-6 * np.eye(1)}
    cause = replace(none, effects=(friction,), log_evidence=50.0, **known)
    left = replace(cause, by_size=np.where(levels == levels[2], 0.0, -600.0))
    pool = HypothesisPool(bound, [], {"": needed, left.key: left}, [], none.path, False)
    assert share_explained(bound, pool, left) == 0.0
    assert share_explained(tolerating(bound, 1.1 * levels[2]), pool, left) > 0.99
    assert share_explained(tolerating(bound, 0.9 * levels[2]), pool, left) == 0.0


def test_what_is_not_credible_explains_a_part_only():
    """A spring whose rest is turns away; and stray detections that are as many as anything may be."""
    bound = diagnosis_problem(recording_of(), PENDULUM)
    none = refine(bound, (), {}, data_path(bound)[0], LOOSE)
    spring, stray = EFFECTS["joint_stiffness"]("pivot").bound(PENDULUM), EFFECTS["outliers"]().bound(PENDULUM)
    pool = HypothesisPool(bound, [], {"": none}, [], none.path, False)

    def share(effect, values, searched=False):
        keys = {f"{effect.key}.{name}": value for name, value in values.items()}
        found = {"names": tuple(keys), "mean": np.array(list(keys.values())), "covariance": 1e-8 * np.eye(len(keys))}
        sought = {"noise": keys, "noise_sd": dict.fromkeys(keys, 1e-4)}
        cause = replace(none, effects=(effect,), **(sought if searched else found))
        return share_explained(bound, pool, cause)

    assert share(spring, {"stiffness": 0.1, "torque": 0.2}) > 0.9
    assert share(spring, {"stiffness": 0.1, "torque": 2.0}) == 0.0
    rate, scale = stray.parameters(bound.model.scale)
    width = float(scale.prior.mean)
    assert share(stray, {"rate": 0.1, "scale": width}, searched=True) > 0.9
    assert share(stray, {"rate": bounds(rate)[1], "scale": width}, searched=True) == 0.0


def test_where_errors_are_alike_from_row_to_row_something_is_left():
    """Without friction, and without a residual to make up for it; with it, errors are as good as independent."""
    bound = diagnosis_problem(recording_of(EFFECTS["viscous_friction"]("pivot"), damping=0.05), PENDULUM)
    path = data_path(bound)[0]
    none, right = (refine(bound, e, {}, path, LOOSE) for e in ((), (EFFECTS["viscous_friction"]("pivot"),)))
    wrong = replace(none, by_size=np.where(np.arange(len(none.by_size)) == 0, 0.0, -60.0))
    pool = HypothesisPool(bound, [], {"": none}, [], path, False)
    assert correlation(prediction_errors(bound, wrong))[0] > max(DEFAULT.residual.max_error_correlation, 0.5)
    assert share_explained(bound, pool, wrong) == 0.0
    alike, chance = correlation(prediction_errors(bound, right))
    assert chance == pytest.approx(1 / np.sqrt(2 * 79))
    assert abs(alike) < 4 * chance
    assert share_explained(bound, pool, right) > 0.9


def test_a_residual_that_is_small_and_surely_there_is_left():
    """Of 1,000 nats that one gains without a cause, a hundredth and a few by chance may be left with it."""
    bound = diagnosis_problem(recording_of(EFFECTS["viscous_friction"]("pivot"), damping=0.05), PENDULUM)
    path = data_path(bound)[0]
    none, right = (refine(bound, e, {}, path, LOOSE) for e in ((), (EFFECTS["viscous_friction"]("pivot"),)))
    first = np.arange(len(none.by_size)) == 0
    prior = bound.regime.log_prior
    pool = HypothesisPool(
        bound, [], {"": replace(none, by_size=prior + np.where(first, -1000.0, 0.0))}, [], path, False
    )

    def with_residual(nats):
        return replace(right, by_size=prior + np.where(first, 0.0, np.where(np.arange(len(first)) == 1, nats, -1000.0)))

    assert share_explained(tolerating(bound, 0.001), pool, with_residual(14.0)) > 0.9
    assert share_explained(tolerating(bound, 0.001), pool, with_residual(16.0)) == 0.0
    assert (
        share_explained(tolerating(bound, 0.01), pool, with_residual(16.0)) > 0.9
    )  # it is 2 thousandths of a typical torque


def test_keypoints_that_stray_as_one_leave_something(monkeypatch):
    bound = diagnosis_problem(recording_of(EFFECTS["viscous_friction"]("pivot"), damping=0.05), PENDULUM)
    path = data_path(bound)[0]
    none, right = (refine(bound, e, {}, path, LOOSE) for e in ((), (EFFECTS["viscous_friction"]("pivot"),)))
    pool, module = HypothesisPool(bound, [], {"": none}, [], path, False), sys.modules[show_more.__module__]
    for company, left in (
        (DEFAULT.residual.max_shared_outliers, False),
        (DEFAULT.residual.max_shared_outliers + DEFAULT.residual.error_margin * 0.1 + 0.01, True),
    ):
        monkeypatch.setattr(module, "shared_outliers", lambda *_, company=company: (company, 0.1))
        assert (share_explained(bound, pool, right) == 0.0) is left


@pytest.mark.quick("True-True", "False-*")
@pytest.mark.parametrize(("left", "sized"), [(True, False), (True, True), (False, False)])
def test_a_cause_that_leaves_something_pays_for_another_effect(left, sized, monkeypatch):
    """Beside one that leaves nothing it counts P(2)/P(1) = .08/.5 of what it else would; once, if its size tells."""
    effects = [EFFECTS[name]("pivot") for name in ("viscous_friction", "quadratic_drag")]
    bound = diagnosis_problem(recording_of(effects[0], damping=0.02), PENDULUM)
    path = data_path(bound)[0]
    none, damped, dragged = (refine(bound, e, {}, path, LOOSE) for e in ((), effects[:1], effects[1:]))
    dragged = replace(dragged, log_evidence=damped.log_evidence - 1.0)
    if sized:
        spike = np.arange(len(none.by_size)) == 0
        dragged = replace(dragged, by_size=dragged.by_size - np.where(spike, 1e4, 0.0))
    pool = HypothesisPool(bound, considered(bound), {c.key: c for c in (none, damped, dragged)}, [], path, False)
    alone = {none.key: 1.0, damped.key: 1.0, dragged.key: 0.0 if left else 1.0}
    monkeypatch.setattr(
        sys.modules[share_explained.__module__], "share_explained", lambda _, __, cause: alone[cause.key]
    )
    weighed = weigh(bound, pool, 0)
    both = [weighed.causes[c.key][1] + weighed.in_part[c.key] for c in (damped, dragged)]
    evidence = [weighed.log_evidence[c.key] - c.log_evidence for c in (damped, dragged)]
    scores = [pool.score(c) + pool.temper * more for c, more in zip((damped, dragged), evidence, strict=True)]
    odds = np.exp(scores[1] - scores[0])
    assert pool.leaves(dragged) is sized
    assert both[1] / both[0] == pytest.approx(odds * (0.16 if left and not sized else 1.0), rel=1e-6)
    assert sum(both) == pytest.approx(1.0, abs=1e-3)
    assert weighed.outside == pytest.approx(both[1] if left else 0.0)


def test_errors_larger_than_the_noise_at_rest_are_left():
    bound = diagnosis_problem(recording_of(EFFECTS["viscous_friction"]("pivot"), damping=0.05), PENDULUM)
    path = data_path(bound)[0]
    none, right = (refine(bound, e, {}, path, LOOSE) for e in ((), (EFFECTS["viscous_friction"]("pivot"),)))
    pool = HypothesisPool(bound, [], {"": none}, [], path, False)
    assert right.kappa == pytest.approx(1.0, abs=0.2)
    assert share_explained(bound, pool, replace(right, kappa=DEFAULT.residual.max_error_ratio + 0.1)) == 0.0
    assert share_explained(bound, pool, replace(right, kappa=DEFAULT.residual.max_error_ratio - 0.1)) > 0.9


@pytest.mark.long
def test_where_errors_lie_along_the_motion_something_is_left():
    """Mistimed frames look like blur where the catalogue lacks them: wider errors with speed, but in one direction."""
    truth = EFFECTS["timestamp_jitter"]()
    bound = diagnosis_problem(recording_of(truth, rows=300, effort=1.0, rate=0.4, sd=0.02), PENDULUM)
    path, _ = data_path(bound)
    none = refine(bound, (), {}, path, LOOSE)
    pool = HypothesisPool(bound, [], {"": none}, [], path, False)
    by_name = {
        name: refine_searched(bound, none, EFFECTS[name]().bound(PENDULUM)) for name in ("varying_noise", truth.name)
    }
    wrong, right = by_name["varying_noise"], by_name[truth.name]
    assert right.log_evidence > wrong.log_evidence
    assert credible(bound, wrong)
    alike, chance = correlation(prediction_errors(bound, wrong))
    assert (
        alike < DEFAULT.residual.max_error_correlation + DEFAULT.residual.error_margin * chance
    )  # no other rule speaks against it
    assert wrong.kappa < DEFAULT.residual.max_error_ratio
    assert share_explained(bound, pool, wrong) == 0.0
    assert share_explained(bound, pool, right) > 0.9


@pytest.mark.quick("restless-1.1-True")
@pytest.mark.parametrize(("longer", "left"), [(1.0, False), (1.1, True)])
@pytest.mark.parametrize("torque", ["restless", "smooth"])
def test_with_unknown_torque_too_errors_alike_from_row_to_row_leave_something(torque, longer, left):
    """No torque takes the tip to where a link of this length does not reach; a torque of any kind is nothing left."""
    recording = recorded(rows=200)
    if torque == "smooth":
        arm = random_arm(PENDULUM, duration=4.0, fps=50, noise=0.002, torque_scale=0.5, commanded=True, seed=1)
        command = 0.6 * torch.sin(5 * arm.time) + 0.4 * torch.sin(11 * arm.time + 1)
        parameters = arm.parameters
        arm = ArmModel(PENDULUM, arm.time, arm.observation, command=command[:, None], parameters=parameters)
        recording = record(arm, 1)[0]
    bound = diagnosis_problem(replace(recording, torques=None), PENDULUM.with_values(length=[0.3 * longer]))
    assert bound.regime == UNKNOWN_TORQUE
    none = refine(bound, (), {}, data_path(bound)[0], bound.regime.path_size)
    pool = HypothesisPool(bound, [], {"": none}, [], none.path, False)
    for weighed in (weigh(bound, pool, 0), only(bound, pool, none, {"": none.log_evidence})):
        assert weighed.outside == pytest.approx(1.0 if left else 0.0)
        assert weighed.causes[""][1] == pytest.approx(0.0 if left else 1.0)


@pytest.mark.quick("*-0.2-*")
@pytest.mark.parametrize(
    ("static", "gained", "gives_way"), [(0.01, 0.95, True), (0.01, 0.85, False), (0.2, 0.95, False)]
)
@pytest.mark.parametrize("alone", [0.0, 1.0])
def test_stribeck_friction_that_is_less_at_rest_is_coulomb_friction(static, gained, gives_way, alone, monkeypatch):
    """Where Coulomb friction gains nine tenths of what the curve does; in part, where it leaves something."""
    coulomb, stribeck = (EFFECTS[f"{name}_friction"]("pivot") for name in ("coulomb", "stribeck"))
    bound = diagnosis_problem(recording_of(coulomb, torque=0.05), PENDULUM)
    path = data_path(bound)[0]
    none, dry = (refine(bound, e, {}, path, LOOSE) for e in ((), (coulomb,)))
    most = none.log_evidence + (dry.log_evidence - none.log_evidence) / gained
    values = {"coulomb": 0.1, "static": static, "velocity": 0.1}
    mine = {"names": tuple(f"{stribeck.key}.{name}" for name in values), "mean": np.array([*values.values()])}
    curved = replace(dry, effects=(stribeck.bound(bound.model.body),), log_evidence=most, **mine)
    pool = HypothesisPool(bound, considered(bound), {c.key: c for c in (none, dry, curved)}, [], path, False)
    module, silent = (
        sys.modules[share_explained.__module__],
        SimpleNamespace(log_evidence=np.nan, log_evidence_sd=np.nan),
    )
    shares = {none.key: 0.0, dry.key: alone, curved.key: 0.0}
    monkeypatch.setattr(module, "share_explained", lambda _, __, cause: shares[cause.key])
    monkeypatch.setattr(module, "confirm_all", lambda _, causes, *__: [silent] * len(causes))
    weighed = weigh(bound, pool, 0)
    assert (weighed.causes[curved.key][1] + weighed.in_part[curved.key] == 0) is gives_way
    if gives_way:
        assert weighed.best.key == dry.key
        assert weighed.in_part[dry.key] == pytest.approx(1 - alone, abs=1e-2)
