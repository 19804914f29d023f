"""What every effect owes: one set of tests over the whole catalogue."""

import math
from itertools import combinations

import numpy as np
import pyro.distributions as dist
import pytest
import torch
from pyro import poutine
from variants import nonideal

from invdyn.diagnosis.catalogue import CATALOGUE
from invdyn.inference import Bootstrap, ParticleFilter
from invdyn.models import Encoders, Keypoints, Observation
from invdyn.models.effects import EFFECTS, HiddenHinge, KeypointOffset, Parameter, ViscousFriction
from invdyn.models.effects.base import Effect, effect_name
from invdyn.models.effects.regularised_friction import BristleFriction, RegularisedFriction
from invdyn.models.observation.missing import observed_log_prob

F32, F64 = torch.float32, torch.float64
FORMS = (*EFFECTS, *(f"nonideal {name}" for name, entry in CATALOGUE.items() if entry.variants))
FORMS = (
    *FORMS,
    *(f"nonideal nonideal {name}" for name, kind in EFFECTS.items() if issubclass(kind, RegularisedFriction)),
)
FORMS = (*FORMS, *(f"{form}: {name}" for name, kind in EFFECTS.items() for form in kind.forms))
EVERY = pytest.mark.parametrize("name", FORMS)
UNITS = {"1", "s", "m", "rad", "kg", "N", "Hz", "s²", "kg·m²", "N·m", "N·s", "rad/s"}
UNITS |= {"N·m/rad", "N·m·s/rad", "N·m·s²/rad²", "m⁻²", "s/m", "s/rad", "m/rad"}


@pytest.fixture
def arm(arm):
    """Arms seen by a tracker that says how sure it is."""

    def make(joints=2, rows=12, **options):
        sure = np.random.default_rng(1).uniform(0.2, 1.0, size=(rows, joints))
        return arm(
            joints,
            rows,
            **{"observation": Observation(Keypoints(range(joints), confidence=sure), Encoders()), **options},
        )

    return make


def at_all_places(name, model):
    form, _, plain = name.rpartition(" ")
    found = EFFECTS[plain].everywhere(model.body, model.body.keypoint_names)
    if EFFECTS[plain].forms:
        found = [effect for effect in found if effect.form == (form[:-1] if form.endswith(":") else None)]
    for _ in range(form.count("nonideal")):
        found = [nonideal(effect) for effect in found]
    several = EFFECTS[plain].site in ("pair", "keypoints") or form == "joints:"
    assert found or (several and model.body.num_joints == 1)
    return found


def one(name, model):
    return at_all_places(name, model)[-1]


def drawn(model, seed=0, count=None):
    """The model with its effects' parameters from their priors: one set, or ``count`` of them."""
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        shape = (1,) if count is None else (count, 1, 1)
        values = {name: prior.expand(shape[:-1]).sample().to(model.dtype) for name, prior in model.priors.items()}
    return model.replace(**values), values


# -- what it says of itself ------------------------------------------------------------------------
@EVERY
def test_names_units_and_priors(name, arm):
    kind = EFFECTS[name.rpartition(" ")[2]]
    assert effect_name(kind) == name.rpartition(" ")[2]
    assert kind.sensor in ("", "keypoints", "encoders", "any")
    for joints, size, weight in ((2, 1.0, 1.0), (1, 0.05, 1e-3), (3, 4.0, 40.0)):
        model = arm(joints, size=size, weight=weight)
        for effect in at_all_places(name, model):
            parameters = effect.bound(model.body).parameters(model.scale)
            assert len({p.name for p in parameters}) == len(parameters) > 0
            assert any(p.absent is not None for p in parameters)
            for p in parameters:
                assert p.unit in UNITS, f"{p.unit} is no unit of any effect yet: if it is right, add it to UNITS"
                assert p.prior.batch_shape == p.prior.event_shape == ()
                inside = torch.tensor([v for v in (*p.grid, p.absent) if v is not None and math.isfinite(v)])
                inside = torch.cat([inside, p.prior.sample((50,))])
                assert bool(p.prior.support.check(inside).all())
                assert len(p.grid) <= 24
                assert len(set(p.grid)) == len(p.grid)
                assert not p.located or p.name in ("moment", "duration")


@EVERY
def test_grids_lie_where_the_prior_is(name, arm):
    for p in one(name, arm(2)).bound(arm(2).body).parameters(arm(2).scale):
        draws = torch.sort(p.prior.sample((4000,)).double()).values
        if p.grid:
            assert draws[4] <= min(p.grid)
            assert max(p.grid) <= draws[-4]


@pytest.mark.parametrize(("name", "narrow"), [(n, other) for n, e in CATALOGUE.items() for other in e.special_cases])
def test_what_it_contains_is_a_special_case(name, narrow, arm, states):
    model = arm(2)
    theirs = drawn(model.with_effects(one(narrow, model)), seed=3)[0]
    mine = drawn(model.with_effects(one(name, model)), seed=4)[0]
    values = {
        f"effect.{one(name, model).key}.{own}": theirs.parameters[f"effect.{one(narrow, model).key}.{its}"]
        for own, its in CATALOGUE[name].special_cases[narrow].items()
    }
    rows = torch.arange(mine.num_steps)
    x = states(mine, mine.num_steps)
    here, there = (m.transition_mean(x[:-1], rows[1:]) for m in (mine.replace(**values), theirs))
    torch.testing.assert_close(here, there, rtol=1e-10, atol=1e-10)
    assert not torch.allclose(mine.transition_mean(x[:-1], rows[1:]), there, rtol=1e-6)


@EVERY
def test_reports_have_units(name, arm):
    model = arm(2)
    effect = one(name, model).bound(model.body)
    values = {p.name: p.prior.sample((5, 1)) for p in effect.parameters(model.scale)}
    for value, unit in CATALOGUE.of(effect).reported(effect, values).values():
        assert value.shape == (5, 1)
        assert unit in UNITS


@EVERY
def test_places_are_checked(name, arm):
    model = arm(3)
    effect = one(name, model)
    assert effect.key == ".".join([effect.name, *effect.where])
    with pytest.raises(ValueError, match="twice"):
        model.with_effects(effect, effect)
    kind = type(effect.of if isinstance(effect, BristleFriction) else effect)
    with pytest.raises((ValueError, TypeError)):
        kind("a", "b", "c")
    if effect.where:
        with pytest.raises(ValueError, match="nowhere"):
            model.with_effects(kind(*["nowhere", *effect.where[1:]]))
    if kind.site in ("pair", "keypoints"):
        with pytest.raises(ValueError, match="two different"):
            model.with_effects(kind(effect.where[0], effect.where[0]))
    if kind.site in ("keypoint", "keypoints") and kind.sensor:
        blind = arm(3, observation=Observation(Encoders()))
        with pytest.raises(ValueError, match="tracked"):
            blind.with_effects(effect)


# -- what it does ----------------------------------------------------------------------------------
@pytest.mark.quick("dtype*-[13]-*")
@EVERY
@pytest.mark.parametrize(("dtype", "joints"), [(F64, 1), (F64, 3), (F32, 2)])
def test_absent_it_is_the_ideal_arm(name, joints, dtype, arm, states, widened):
    ideal = arm(joints).to(dtype=dtype)
    rows = torch.arange(ideal.num_steps)
    x = states(ideal, ideal.num_steps)
    y = ideal.emission(x, rows).sample()
    tolerance = {"rtol": 1e-10, "atol": 1e-10} if dtype == F64 else {"rtol": 2e-4, "atol": 2e-4}
    for effect in at_all_places(name, ideal):
        model = ideal.with_effects(effect)
        wide = widened(x, ideal, model)
        alike = ideal.replace()
        alike = alike.in_substeps(model.substeps_taken)
        moved = widened(alike.transition_mean(x[:-1], rows[1:]), ideal, model)
        torch.testing.assert_close(model.transition_mean(wide[:-1], rows[1:]), moved, **tolerance)
        seen = model.emission(wide, rows)
        torch.testing.assert_close(seen.mean, ideal.emission(x, rows).mean, **tolerance)
        torch.testing.assert_close(seen.log_prob(y), ideal.emission(x, rows).log_prob(y), **tolerance)


@pytest.mark.quick("dtype1-*")
@EVERY
@pytest.mark.parametrize("dtype", [F32, F64])
def test_parameter_sets_at_once(name, dtype, arm, states):
    """Sets (S, 1, 1) beside states (S, N, D) at one row and (S, T, D) at all rows, as one by one."""
    S, rows = 3, torch.arange(12)
    ideal = arm(2).to(dtype=dtype)
    model = ideal.with_effects(one(name, ideal))
    many, values = drawn(model, count=S)
    x = states(model, S, 12)
    y = ideal.emission(states(ideal, 12), rows).sample()
    y[3] = torch.nan
    y[5, 0] = torch.nan
    along, cloud = many.transition_mean(x[:, :-1], rows[1:]), many.transition_mean(x, 4)
    seen, snapshot = observed_log_prob(many.emission(x, rows), y), observed_log_prob(many.emission(x, 4), y[4])
    tolerance = {"rtol": 1e-9, "atol": 1e-9} if dtype == F64 else {"rtol": 1e-2, "atol": 1e-2}
    for s in range(S):
        alone = model.replace(**{key: value[s, 0] for key, value in values.items()})
        for found, expected in (
            (along[s], alone.transition_mean(x[s, :-1], rows[1:])),
            (cloud[s], alone.transition_mean(x[s], 4)),
            (seen[s], observed_log_prob(alone.emission(x[s], rows), y)),
            (snapshot[s], observed_log_prob(alone.emission(x[s], 4), y[4])),
        ):
            assert found.dtype == dtype
            assert bool(found.isfinite().all())
            torch.testing.assert_close(found, expected.to(dtype), **tolerance)


@pytest.mark.quick("drawn-*")
@EVERY
@pytest.mark.parametrize("start", ["absent", "drawn"])
def test_gradients(name, start, arm, states):
    """Finite everywhere; where the effect is present and smooth, those of finite differences."""
    ideal = arm(2)
    rows = torch.arange(ideal.num_steps)
    model = ideal.with_effects(one(name, ideal))
    x = states(model, ideal.num_steps)
    y = ideal.emission(states(ideal, ideal.num_steps), rows).sample()
    values = {key: model.parameters[key] for key in model.priors}
    if start == "drawn":
        _, values = drawn(model, seed=1)
    weights = torch.randn(ideal.num_steps - 1, model.state_dim, dtype=F64, generator=torch.Generator().manual_seed(2))

    def value(at):
        there = model.replace(**at)
        total = (weights * there.transition_mean(x[:-1], rows[1:])).sum()
        return total + 1e-3 * observed_log_prob(there.emission(x, rows), y).sum()

    for key, at in values.items():
        free = at.clone().requires_grad_()
        total = value({**values, key: free})
        # a hinge that is locked needs none of its parameters
        slope = torch.autograd.grad(total, free, allow_unused=True)[0] if total.requires_grad else None
        slope = torch.zeros_like(at) if slope is None else slope
        assert bool(slope.isfinite().all()), key
        if start == "drawn" and name != "backlash":  # whose impacts are jumps
            step = 1e-6 * model.priors[key].variance.sqrt()
            with torch.no_grad():
                rise = value({**values, key: at + step}) - value({**values, key: at - step})
            assert slope.item() == pytest.approx((rise / (2 * step)).item(), rel=1e-3, abs=1e-3), key


@pytest.mark.quick("1.0-1.0-*")
@EVERY
@pytest.mark.parametrize(("size", "weight"), [(0.05, 1e-3), (1.0, 1.0), (4.0, 40.0)])
def test_it_simulates_from_mouse_to_robot(name, size, weight, arm):
    torch.manual_seed(3)
    model = arm(2, rows=12, step=0.01 * size**0.5, size=size, weight=weight)
    model, _ = drawn(model.with_effects(one(name, model)), seed=4)
    path, rows = model.simulate((2,))
    assert path.shape == (2, 12, model.state_dim)
    assert bool(path.isfinite().all())
    assert bool(rows.isfinite().all())


@EVERY
def test_pyro_and_smc(name, arm):
    torch.manual_seed(5)
    model = arm(2, rows=4)
    model = model.with_effects(one(name, model))
    _, y = model.simulate()
    y[1] = torch.nan
    y[2, 1] = torch.nan
    trace = poutine.trace(model.sequence).get_trace(y)
    trace.compute_log_prob()
    effect = one(name, model)
    names = {f"effect.{effect.key}.{p.name}" for p in effect.bound(model.body).parameters(model.scale)}
    assert names == {site for site in trace.nodes if site.startswith("effect.")}
    assert math.isfinite(trace.log_prob_sum())
    assert "y_1" not in trace.nodes
    result = ParticleFilter(model, Bootstrap(model), 64).run(y)
    assert bool(result.log_evidence.isfinite().all())


@EVERY
def test_with_others(name, arm, states):
    """Two effects that are absent but for one are that one."""
    ideal = arm(2)
    effect = one(name, ideal)
    others = [e for e in (ViscousFriction("joint0"), KeypointOffset("tip0")) if e.key != effect.key]
    alone, values = drawn(ideal.with_effects(effect))
    together = ideal.with_effects(*others, effect).replace(**values)
    x, rows = states(alone, 12), torch.arange(12)
    torch.testing.assert_close(together.transition_mean(x[:-1], rows[1:]), alone.transition_mean(x[:-1], rows[1:]))
    torch.testing.assert_close(together.emission(x, rows).mean, alone.emission(x, rows).mean)
    both = drawn(together, seed=6)[0]
    assert bool(both.transition_mean(x[:-1], rows[1:]).isfinite().all())
    changed = both.transition_mean(x[:-1], rows[1:]) - alone.transition_mean(x[:-1], rows[1:])
    assert changed.abs().max() > 0
    torch.manual_seed(0)
    assert bool(both.simulate()[1].isfinite().all())


@EVERY
def test_start_of_linearisation_has_the_models_states(name, arm):
    torch.manual_seed(7)
    model = arm(2, rows=8)
    _, y = model.simulate()
    model = model.with_effects(one(name, model))
    paths = model.initial_paths(y)
    assert paths.shape[1:] == (8, model.state_dim)
    assert bool(model.log_joint(paths, y).isfinite().all())
    assert bool(model.relaxed(1.0).log_joint(paths, y).isfinite().all())


def test_one_hidden_hinge_at_most(arm):
    model = arm(2)
    hinges = [one(name, model) for name, kind in EFFECTS.items() if issubclass(kind, HiddenHinge)]
    assert len(hinges) > 1
    for pair in combinations(hinges, 2):
        with pytest.raises(ValueError, match="at most one effect whose hidden states move the arm"):
            model.with_effects(*pair)


def test_signed_parameters_are_unconstrained(arm):
    model = arm(2).with_effects(ViscousFriction("joint0"), KeypointOffset("tip1"))
    assert "effect.keypoint_offset.tip1.along" in model.unconstrained
    assert "effect.viscous_friction.joint0.damping" not in model.unconstrained


def test_an_effect_of_ones_own(arm, states):
    """One class of a few lines is enough; here a constant torque, which the catalogue lacks."""

    class ConstantTorque(Effect):
        def parameters(self, scale):
            return (Parameter("torque", "N·m", dist.Normal(0.0, scale.torque[self.place[0]])),)

        def force(self, p, now):
            return now.at(self.place[0], p["torque"].expand_as(now.q[..., :1]))

    ideal = arm(2)
    model = ideal.with_effects(ConstantTorque("joint1"))
    model = model.replace(**{"effect.constant_torque.joint1.torque": torch.tensor([0.7], dtype=F64)})
    pushed = arm(2, command=ideal.command + torch.tensor([0.0, 0.7]))
    x = states(ideal, 5)
    torch.testing.assert_close(model.transition_mean(x, 3), pushed.transition_mean(x, 3))


def test_an_effect_that_changes_nothing_is_refused(arm):
    class Misspelt(Effect):
        def parameters(self, scale):
            return ()

        def forces(self, p, now):
            return now.q

    with pytest.raises(ValueError, match="misspelt: expected a method named body, interval, command, force"):
        arm(2).with_effects(Misspelt("joint1"))


def test_a_force_at_no_joint_is_refused(arm, states):
    """One of shape (..., 1) would act at all joints."""

    class Constant(Effect):
        def parameters(self, scale):
            return (Parameter("torque", "N·m", dist.Normal(0.0, 1.0), 0.5),)

        def force(self, p, now):
            return p["torque"].expand_as(now.q[..., :1])

    ideal = arm(2)
    with pytest.raises(ValueError, match=r"^constant: expected a force for each joint, \(..., 2\), .* got \(5, 1\)$"):
        ideal.with_effects(Constant("joint1")).transition_mean(states(ideal, 5), 3)
