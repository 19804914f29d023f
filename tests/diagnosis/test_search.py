"""Candidates, forward selection and what a report says of them."""

import sys
from collections import Counter
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch
from pyro.distributions import Normal

from invdyn.diagnosis.candidates import WINDOW
from invdyn.diagnosis.describe import describe
from invdyn.diagnosis.noise import is_searched
from invdyn.diagnosis.paths import FIRM, data_path, led
from invdyn.diagnosis.pool import Search, considered
from invdyn.diagnosis.predict import correlation
from invdyn.diagnosis.prior import ALPHA, NUMBER, believed, log_prior_of, tempered
from invdyn.diagnosis.promising import KIN, later, refine_kin, refine_promising
from invdyn.diagnosis.refine import refine
from invdyn.diagnosis.screen import screen
from invdyn.diagnosis.search import _aside, _scan, search
from invdyn.diagnosis.separate import SHOWN_BY, separating_experiment
from invdyn.diagnosis.setting import LOOSE, setting
from invdyn.diagnosis.unknowns import unknowns
from invdyn.diagnosis.weigh import ALIKE, _alone
from invdyn.diagnosis.where import MOST_OF, intervals, joints_of
from invdyn.diagnosis.whiten import sizes
from invdyn.inference.gauss_newton import gauss_newton
from invdyn.models import Body, Link
from invdyn.models.effects import EFFECTS
from invdyn.models.effects.base import Effect, Parameter
from invdyn.simulate import random_arm, record

ROD = Link("rod", "pivot", "tip", length=0.3, mass=1.0)
PENDULUM = Body("pendulum", [ROD], gravity=(0.0, -9.81))
UPPER, FORE = Link("upper_arm", "shoulder", "elbow", 0.3, 1.5), Link("forearm", "elbow", "wrist", 0.25, 1.0)
ARM = Body("arm", [UPPER, FORE], gravity=(0.0, -9.81))


def recorded(effect=None, body=PENDULUM, rows=80, effort=0.5, seed=0, **values):
    """A recording of a body with an effect at these values, under known commands, filmed with 2 mm of noise."""
    arm = random_arm(body, duration=rows / 50, fps=50, noise=0.002, torque_scale=effort, commanded=True, seed=seed)
    if effect is not None:
        named = {f"effect.{effect.key}.{name}": torch.tensor([v], dtype=torch.float64) for name, v in values.items()}
        arm = arm.with_effects(effect).replace(**named)
    return record(arm, seed)[0]


@cache
def searched(name=None, *where, **values) -> Search:
    bound = setting(recorded(EFFECTS[name](*where) if name else None, **values), PENDULUM)
    return search(bound, *data_path(bound))


def test_no_gap_wins_where_there_is_none():
    found = searched()
    assert found.ranked[0].key == ""
    assert found.ranked[0].by_size.argmax() == 0
    assert {s.effect.key for s in found.first if s.effect} <= {e.key for e in found.candidates}


def test_friction_is_named():
    found = searched("viscous_friction", "pivot", damping=0.05)
    best = found.ranked[0]
    assert best.key == "viscous_friction.pivot"
    assert abs(best.mean[0] - 0.05) < 4 * best.sd[0]
    assert found.score(best) > found.score(found.pool[""]) + 5
    screened = [s for s in found.first if s.effect is not None]
    assert [s.log_evidence for s in screened] == sorted((s.log_evidence for s in screened), reverse=True)
    # The screen has it in front already, and would have seen it at its usual size.
    place = [s.effect.key for s in screened].index("viscous_friction.pivot")
    assert place < 4
    assert screened[place].dprime > 10


def test_where_torques_are_unknown_the_motion_has_no_cause(monkeypatch):
    """Not even play, which no screen ranks: an unknown torque could do what it does, and nobody looks for it."""
    tried = []
    module = sys.modules[search.__module__]
    monkeypatch.setattr(module, "refine_searched", lambda *given: tried.append(given[2].name))
    arm = recorded(EFFECTS["backlash"]("pivot"), width=0.1)
    for torques, looked in ((None, False), (0 * arm.torques, True)):
        tried.clear()
        bound = setting(replace(arm, torques=torques), PENDULUM)
        found = search(bound, *data_path(bound))
        assert ("backlash" in tried) is looked
        if torques is None:
            assert {e.side for cause in found.pool.values() for e in cause.effects} <= {"observation"}


def test_what_an_unknown_torque_imitates_sets_the_bar(monkeypatch):
    """Only the torque's prior speaks for friction; what gains less than that on the camera's side says no more."""
    bound = setting(replace(recorded(), torques=None), PENDULUM)
    path, stray = data_path(bound)
    gains = {"coulomb_friction": 30.0, "camera_roll": 25.0, "lens_distortion": 40.0, "base_motion": 35.0}
    some = [e for e in considered(bound) if e.name in gains]
    common = unknowns(bound, ())
    screened = screen(bound, bound.model, path, some, common, common.mean)
    nothing = next(s.log_evidence for s in screened if s.effect is None)
    screened = [replace(s, log_evidence=nothing + gains[s.effect.name]) if s.effect else s for s in screened]
    screened = sorted((replace(s, dprime=50.0) for s in screened), key=lambda s: -s.log_evidence)
    tried = []
    monkeypatch.setattr(
        sys.modules[refine_promising.__module__], "refine", lambda *given, **more: tried.append(given[1][0].name)
    )
    none = refine(bound, (), {}, path, LOOSE)
    refine_promising(bound, Search(considered(bound), {"": none}, [], path, stray), none, screened, 9)
    assert tried == ["lens_distortion", "base_motion"]  # a base that shakes takes all points along


def test_what_the_camera_does_shows_beside_the_simulation_alone():
    """Under a residual torque the arm follows what a shutter has bent, and the screen sees nothing."""
    shutter = EFFECTS["rolling_shutter"]().bound(PENDULUM)
    bound = setting(recorded(shutter, rows=150, readout=0.15, effort=0.8), PENDULUM)
    path, _ = data_path(bound)
    common = unknowns(bound, ())
    effects = [e for e in considered(bound) if not is_searched(e)]
    along, own = (
        screen(bound, bound.model, each, effects, common, common.mean)
        for each in (path, led(bound, bound.model, path, FIRM))
    )
    aside = _aside(along, own)
    before, after = ({s.effect.key: s for s in some if s.effect} for some in (along, aside))
    assert set(before) == set(after)
    here = shutter.key
    assert after[here].log_evidence > before[here].log_evidence + 5
    assert abs(after[here].values["readout"] - 0.15) < abs(before[here].values["readout"] - 0.15)
    one, other, found = ({s.effect and s.effect.key: s.log_evidence for s in some} for some in (along, own, aside))
    assert found == {key: max(one[key], other[key]) for key in one}  # those of the motion, too, and none
    assert [s.log_evidence for s in aside] == sorted((s.log_evidence for s in aside), reverse=True)


def test_load_friction_is_found_from_afar():
    bound = setting(recorded(EFFECTS["load_friction"]("pivot"), rows=120, coefficient=0.2), PENDULUM)
    path, _ = data_path(bound)
    none = refine(bound, (), {}, path, LOOSE)
    cause = _scan(bound, none, EFFECTS["load_friction"]("pivot"), -np.inf)
    assert cause.complete
    assert abs(cause.mean[0] - 0.2) < 4 * cause.sd[0]


def test_what_is_little_beside_the_gap_is_nothing_left():
    """A tenth of the residual that the simulation alone needs; and large gaps forgive more than small ones."""
    bound = setting(recorded(), PENDULUM)
    none = refine(bound, (), {}, data_path(bound)[0], LOOSE)
    levels = sizes("commanded")
    needed = replace(none, by_size=np.where(levels == levels[5], 0.0, -1e4), log_evidence=0.0)
    cause = replace(none, effects=considered(bound)[:1], log_evidence=50.0)

    def share(left, gain=50.0):
        left = replace(cause, by_size=np.where(levels == levels[left], 0.0, -60.0), log_evidence=gain)
        return _alone(bound, Search([], {"": needed, left.key: left}, [], none.path, False), left)

    assert share(0) > 0.99
    assert share(2) > 0.99  # 2.4 % of the needed one
    assert share(4) < 0.01
    assert share(4, gain=5000.0) > share(4)
    needed = replace(needed, by_size=np.where(levels == levels[2], 0.0, -1e4))
    assert share(1) > 0.99  # however little is needed
    assert share(2) < 0.01
    plain = replace(needed, by_size=np.where(levels == levels[1], 0.0, -60.0))
    assert _alone(bound, Search([], {"": plain}, [], none.path, False), plain) < 0.01  # but it is more than no gap


def test_where_errors_are_alike_from_row_to_row_something_is_left():
    """Without friction, and without a residual to make up for it; with it, errors are as good as independent."""
    bound = setting(recorded(EFFECTS["viscous_friction"]("pivot"), damping=0.05), PENDULUM)
    path = data_path(bound)[0]
    none, right = (refine(bound, e, {}, path, LOOSE) for e in ((), (EFFECTS["viscous_friction"]("pivot"),)))
    wrong = replace(none, by_size=np.where(np.arange(len(none.by_size)) == 0, 0.0, -60.0))
    pool = Search([], {"": none}, [], path, False)
    assert correlation(bound, wrong)[0] > max(ALIKE, 0.5)
    assert _alone(bound, pool, wrong) == 0.0
    alike, chance = correlation(bound, right)
    assert chance == pytest.approx(1 / np.sqrt(2 * 79))
    assert abs(alike) < 4 * chance
    assert _alone(bound, pool, right) > 0.9


def test_three_at_once_may_imitate_what_is_lacking():
    assert believed(1) == believed(2) == 1.0
    assert believed(3) == pytest.approx(0.016 / 0.046)
    assert believed(4) < believed(3)


@pytest.mark.parametrize("gain", [0.0, 1.0, 40.0, 3000.0])
def test_no_more_than_alpha_nats_count(gain):
    assert gain * tempered(gain) <= ALPHA
    assert gain * tempered(gain) == pytest.approx(gain, rel=gain / ALPHA)
    assert tempered(-5.0) == 1.0


@pytest.mark.parametrize(
    ("truth", "twin", "parameter", "value"),
    [("gravity_tilt", "camera_roll", "angle", 0.1), ("actuator_delay.pivot", "camera_latency", "delay", 0.015)],
)
def test_exact_twins_stand_side_by_side(truth, twin, parameter, value):
    found = searched(*truth.split("."), **{parameter: value}) if truth in EFFECTS else None
    if found is None:
        name, *where = truth.split(".")
        found = searched(name, *(where if EFFECTS[name].site != "arm" else ()), **{parameter: value})
    keys = [cause.key for cause in found.ranked]
    first, second = (next(c for c in found.ranked if c.key.split(".")[0] == k.split(".")[0]) for k in (truth, twin))
    assert abs(first.mean[0] - value) < 4 * first.sd[0]
    assert abs(first.log_evidence - second.log_evidence) < 3
    assert {first.key, second.key} <= set(keys[:3])


def test_what_is_left_out_is_not_considered():
    here = setting(recorded(), PENDULUM)
    everything, fewer = considered(here), considered(here, ["viscous_friction", "camera_roll"])
    assert {e.name for e in everything} - {e.name for e in fewer} == {"viscous_friction", "camera_roll"}
    assert not {e.name for e in everything} & {"joint_coupling", "label_swap"}  # they need two joints


def test_screen_is_a_ranking_of_all_and_none():
    here = setting(recorded(), PENDULUM)
    path = gauss_newton(here.with_residual(LOOSE), here.observations).path
    effects = [e for e in considered(here) if e.name in ("viscous_friction", "camera_roll", "external_push")]
    common = unknowns(here, ())
    screened = screen(here, here.model, path, effects, common, common.mean)
    assert len(screened) == len(effects) + 1
    assert [s.log_evidence for s in screened] == sorted((s.log_evidence for s in screened), reverse=True)
    none = next(s for s in screened if s.effect is None)
    assert none.log_evidence == max(s.log_evidence for s in screened)  # each effect costs its prior
    for each in screened:
        assert each.log_evidence == pytest.approx(np.logaddexp.reduce(each.by_size))
        for name, value in each.values.items():
            assert np.isfinite(value), (each.effect.key, name)


def test_a_lagging_camera_is_refined_from_a_path_ahead_of_what_it_saw():
    bound = setting(recorded(), PENDULUM)
    rows, time = len(bound.observations), bound.model.time
    path = torch.stack([3.0 * time, time**0, -time], -1)
    ahead = later(bound, path, 0.03)
    assert torch.allclose(ahead[: rows - 2], path[: rows - 2] + 0.03 * torch.tensor([3.0, 0.0, -1.0]))
    assert torch.equal(ahead[-1], path[-1])
    assert torch.equal(later(bound, path, 0.0), path)


@pytest.mark.parametrize("body", [PENDULUM, ARM], ids=["one joint", "two joints"])
@pytest.mark.parametrize(("name", "twin", "parameter", "sign"), [KIN[0], KIN[1]])
def test_the_twin_of_a_delay_starts_from_a_path_of_its_own(monkeypatch, name, twin, parameter, sign, body):
    """On one joint the motors' delay is that of its motor."""
    bound = setting(recorded(body=body), body)
    path, stray = data_path(bound)
    none, candidates = refine(bound, (), {}, path, LOOSE, rounds=1), considered(bound)
    one = next(e for e in candidates if e.name == name)
    cause = replace(none, effects=(one,), names=(f"{one.key}.{parameter[0]}",), mean=np.array([0.03]))
    started = []
    monkeypatch.setattr(
        sys.modules[refine_kin.__module__], "refine", lambda s, effects, values, path, *_, **__: started.append(path)
    )
    refine_kin(bound, Search(candidates, {"": none, one.key: cause}, [], path, stray), 1)
    shift = 0.03 if twin == "camera_latency" else -0.03
    assert torch.equal(started[0], later(bound, cause.path, shift))
    assert torch.equal(started[1], path)


def test_a_push_is_also_looked_for_at_another_time():
    push = EFFECTS["external_push"]("tip").bound(PENDULUM)
    here = setting(recorded(push, rows=120, impulse_x=0.5, impulse_y=0.2, moment=0.75, duration=0.1), PENDULUM)
    path, common = data_path(here)[0], unknowns(here, ())
    effects = [push, EFFECTS["viscous_friction"]("pivot").bound(PENDULUM)]
    screened = {s.effect.name: s for s in screen(here, here.model, path, effects, common, common.mean) if s.effect}
    found = screened["external_push"]
    assert abs(found.values["moment"] - 0.75) < WINDOW
    assert abs(found.elsewhere["moment"] - found.values["moment"]) > WINDOW
    assert set(found.elsewhere) == set(found.values)
    assert screened["viscous_friction"].elsewhere is None


def test_stray_detections_are_explained_before_anything_else(monkeypatch):
    """Under them nothing else can be told; what is refined is what may stand beside them."""
    arm = random_arm(ARM, duration=3.0, fps=50, noise=0.001, torque_scale=1.0, commanded=True, seed=4)
    recording = record(arm, 4)[0]
    points = recording.keypoints.copy()
    swapped = np.random.default_rng(1).random(len(points)) < 0.06
    points[swapped] = points[swapped][:, ::-1]
    bound = setting(replace(recording, keypoints=points), ARM)
    path, stray = data_path(bound)
    bases = []
    searching = sys.modules[search.__module__]
    plain = searching.refine_promising
    monkeypatch.setattr(
        searching, "refine_promising", lambda s, f, base, *rest: bases.append(base.key) or plain(s, f, base, *rest)
    )
    found = search(bound, path, stray)
    assert found.ranked[0].key == "label_swap.elbow.wrist"
    assert found.ranked[0].complete
    assert bases[0] == "label_swap.elbow.wrist"


# -- Occam's window and the prior -------------------------------------------------------------------------------
def pool(**evidence):
    """A search whose pool has causes with such evidences: "none", "a", "b", "ab", "abc"."""
    here = setting(recorded(), PENDULUM)
    letters = dict(zip("abc", considered(here), strict=False))
    path = torch.zeros(80, 3, dtype=torch.float64)
    plain = refine(here, (), {}, path, LOOSE, rounds=1)
    found = Search(considered(here), {}, [], path, stray=False)
    for name, value in evidence.items():
        effects = () if name == "none" else tuple(letters[letter] for letter in name)
        found.add(replace(plain, effects=effects, log_evidence=value))
    return found, {effect.key: letter for letter, effect in letters.items()}


def test_a_set_that_a_part_of_it_beats_is_no_rival():
    found, letters = pool(none=0.0, a=20.0, b=19.0, ab=21.0, abc=40.0)
    names = ["".join(sorted(letters[e.key] for e in cause.effects)) for cause in found.ranked]
    assert names == ["abc", "a", "b", ""]  # ab gains one nat, which a second effect does not earn
    found, letters = pool(none=0.0, a=20.0, b=0.0, ab=60.0)
    names = ["".join(sorted(letters[e.key] for e in cause.effects)) for cause in found.ranked]
    assert names == ["ab", "a", ""]


def test_of_two_versions_the_better_is_kept():
    found, _ = pool(none=0.0, a=20.0)
    (cause,) = (c for c in found.pool.values() if c.effects)
    found.add(replace(cause, log_evidence=10.0))
    assert found.pool[cause.key].log_evidence == 20.0
    found.add(replace(cause, log_evidence=30.0))
    assert found.pool[cause.key].log_evidence == 30.0


@pytest.mark.parametrize("body", [PENDULUM, ARM])
def test_prior_sums_to_that_of_the_number(body):
    candidates = considered(setting(recorded(body=body, rows=30), body))
    assert sum(NUMBER) == pytest.approx(1.0)
    assert np.exp(log_prior_of((), candidates)) == pytest.approx(NUMBER[0])
    single = np.array([np.exp(log_prior_of((e,), candidates)) for e in candidates])
    assert single.sum() == pytest.approx(NUMBER[1])
    # Acting at more joints makes an effect no likelier.
    total = Counter()
    for effect, p in zip(candidates, single, strict=True):
        total[effect.name] += p
    np.testing.assert_allclose(list(total.values()), NUMBER[1] / len(total))
    pairs = sum(np.exp(log_prior_of((a, b), candidates)) for i, a in enumerate(candidates) for b in candidates[i + 1 :])
    # Of two drawn one after the other, less what would be the same twice.
    assert pairs == pytest.approx(NUMBER[2] * (1 - ((single / NUMBER[1]) ** 2).sum()))


# -- what the catalogue lacks ----------------------------------------------------------------------------------
class CubicSpring(Effect):
    """Torque −k θ³ at a joint: in no catalogue."""

    def parameters(self, scale):
        return (Parameter("stiffness", "N·m/rad³", Normal(0.0, 10.0)),)

    def force(self, p, now):
        j = self.place[0]
        return now.at(j, -p["stiffness"] * now.q[..., j : j + 1] ** 3)


def described(recording):
    here = setting(recording, ARM)
    path = gauss_newton(here.with_residual(LOOSE), here.observations).path
    none = refine(here, (), {}, path, LOOSE)
    return describe(here, none, none.path), path


def test_a_cubic_spring_is_put_into_a_formula():
    stiffness = 1.5
    formula, _ = described(recorded(CubicSpring("elbow"), ARM, rows=100, effort=1.0, stiffness=stiffness))
    assert formula.variables[0] == "position:elbow"
    first, (coefficient, sd, unit) = next(iter(formula.terms.items()))
    assert first.endswith(" on elbow")
    assert "θ[elbow]" in first
    assert first in formula.text
    assert unit in formula.text
    assert formula.gain_per_frame > 0
    # Whatever terms there are, they give about the torque that acted.
    assert coefficient < 0
    assert sd > 0


def test_where_nothing_is_left_there_is_no_formula():
    formula, _ = described(recorded(body=ARM, rows=60))
    assert formula is None


# -- where ------------------------------------------------------------------------------------------------------
TIME = 0.01 * np.arange(400)


def gap_at(*stretches):
    gap = np.full(400, 0.001)
    for start, stop, size in stretches:
        gap[(start <= TIME) & (stop > TIME)] = size
    return gap


def test_intervals_hold_most_of_the_gap():
    found = intervals(TIME, gap_at((0.5, 0.8, 2.0), (2.0, 2.5, 2.0)))
    assert len(found) == 2
    first, second = found  # the larger share first
    assert abs(first.start - 2.0) <= 0.06
    assert abs(first.stop - 2.5) <= 0.06
    assert abs(second.start - 0.5) <= 0.2
    assert MOST_OF - 0.05 < first.share + second.share <= 1.0
    assert first.share == pytest.approx(1.0 / 1.6, abs=0.12)  # smoothing blunts the edges


def test_intervals_say_nothing_where_the_gap_is_everywhere_or_nowhere():
    assert intervals(TIME, np.ones(400)) == ()
    assert intervals(TIME, np.zeros(400)) == ()
    assert intervals(TIME, -np.ones(400)) == ()
    assert intervals(TIME, np.full(400, np.nan)) == ()


def test_intervals_of_rows_that_were_not_all_seen():
    gap = gap_at((2.0, 2.5, 2.0))
    gap[::3] = np.nan
    (only,) = intervals(TIME, gap)
    assert abs(only.start - 2.0) <= 0.1
    assert abs(only.stop - 2.5) <= 0.1


def test_joints_of_effects():
    model = setting(recorded(body=ARM, rows=30), ARM).model
    joints = {e.key: joints_of(e.bound(ARM), model) for e in considered(setting(recorded(body=ARM, rows=30), ARM))}
    assert joints["viscous_friction.elbow"] == [1]
    assert joints["joint_coupling.shoulder.elbow"] == [0, 1]
    assert joints["gravity_tilt"] == joints["keypoint_offset.wrist"] == []


def test_a_separating_experiment_for_every_rival():
    assert set(SHOWN_BY) == set(EFFECTS)
    assert separating_experiment(["payload"]) is None
    assert separating_experiment([]) is None
    sentence = separating_experiment(["actuator_delay", "camera_latency"])
    assert sentence == f"Record {SHOWN_BY['camera_latency']}."  # asked for once
    sentence = separating_experiment(["viscous_friction", "armature"])
    assert SHOWN_BY["viscous_friction"] in sentence
    assert SHOWN_BY["armature"] in sentence
