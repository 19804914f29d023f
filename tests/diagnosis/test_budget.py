"""A budget ends a search with the best so far, and one that is not hit changes nothing."""

import sys
from dataclasses import replace
from functools import cache, partial
from types import SimpleNamespace

import numpy as np
import pytest
from pendulum import ARM, PENDULUM, recording_of

from invdyn.diagnosis import Rules, diagnose
from invdyn.diagnosis.assessment.regression_alone import by_regression_alone
from invdyn.diagnosis.budget import Budget, Spent, work_of
from invdyn.diagnosis.hypotheses.continuation import data_path
from invdyn.diagnosis.hypotheses.search import search
from invdyn.diagnosis.problem.diagnosis_problem import diagnosis_problem
from invdyn.diagnosis.regression.regress import regress
from invdyn.diagnosis.report.numbers import handy
from invdyn.diagnosis.report.report import render
from invdyn.diagnosis.report.sentences import details, verdict
from invdyn.diagnosis.rules import FIXED
from invdyn.diagnosis.side_by_side import side_by_side
from invdyn.models.effects import EFFECTS
from invdyn.recordings import InputError

ROOM = sys.modules[diagnose.__module__]
NOTHING_ELSE = {"not_begun": None, "planar_only": []}
KEPT = ("viscous_friction", "payload", "camera_roll")
LESS = tuple(name for name in EFFECTS if name not in ("payload", "viscous_friction", "joint_stiffness", "armature"))
LEFT_OUT = tuple(name for name in EFFECTS if name not in KEPT)


@cache
def rubbing():
    return recording_of(EFFECTS["viscous_friction"]("pivot"), rows=60, damping=0.05)


def searched(work, workers=1, seconds=np.inf, clock=lambda: 0.0):
    bound = replace(diagnosis_problem(rubbing(), PENDULUM), budget=Budget(work, seconds, clock))
    path, stray = data_path(bound)
    return search(bound, path, stray, LEFT_OUT, workers), bound.budget


def evidence(found):
    return {key: cause.log_evidence for key, cause in found.pool.items()}


@cache
def whole():
    return searched(np.inf)


def test_work_is_passes_along_rows_by_states_and_sub_steps():
    model = diagnosis_problem(recording_of(body=ARM), ARM).in_substeps(5).model
    budget = Budget(work=1000.0)
    budget.spend(2.0, model, 100)
    assert budget.done == 400.0  # each of five sub-steps a quarter of what a row takes, and three for the row
    budget.share = 0.5
    budget.start("payload")
    budget.spend(0.5, model, 100)
    with pytest.raises(Spent):
        budget.start("payload", "armature")
    assert budget.missed == {"payload", "armature"}


@pytest.mark.parametrize("workers", [1, 2])
def test_parts_side_by_side_have_the_same_budget_each_wherever_they_run(workers):
    model = diagnosis_problem(recording_of(), PENDULUM).in_substeps(1).model
    budget = Budget(work=100.0, share=1.0)

    def part(rows):
        budget.spend(1.0, model, rows)
        if budget.over:
            budget.missed |= {f"after {rows}"}
        return rows, budget.done

    rows = [60, 70, 110]
    assert side_by_side([partial(part, n) for n in rows], workers, budget) == [(n, float(n)) for n in rows]
    assert (budget.done, budget.missed) == (240.0, {"after 110"})


@pytest.mark.long
def test_a_budget_that_is_not_hit_changes_nothing():
    found, budget = whole()
    enough, _ = searched(2 * budget.done)
    assert found.missed == enough.missed == 0
    assert evidence(enough) == evidence(found)


@pytest.mark.quick("0.3")
@pytest.mark.parametrize("share", [0.0, 0.3, 0.7])
def test_the_search_ends_with_the_best_so_far_whatever_the_number_of_workers(share):
    _, budget = whole()
    one, spent = searched(share * budget.done)
    other, again = searched(share * budget.done, workers=2)
    assert one.missed == other.missed > 0
    assert evidence(one) == evidence(other)
    assert spent.done == again.done
    assert "" in one.pool
    # What was begun is brought to an end: a refinement's round, or a screen, of two parts at most.
    assert spent.done < budget.done


def test_seconds_end_it_by_the_clock():
    ticks = iter(range(10**6))
    found, _ = searched(np.inf, seconds=10.0, clock=lambda: next(ticks))
    assert found.missed > 0
    assert next(ticks) < 10**4


@pytest.mark.quick("2")
@pytest.mark.parametrize("workers", [1, 2])
def test_a_stopped_diagnosis_is_told(workers):
    """Whatever listens stays in this process: it may be nothing that can be sent to another."""
    tried = []

    def told(done, total, what):
        tried.append((done, what))

    rules = Rules().replace(passes_per_row=12.0)
    found = diagnose(rubbing(), PENDULUM, without=LEFT_OUT, workers=workers, progress=told, rules=rules)
    told = found.to_json()["search"]
    assert told == {"stopped_at_the_budget": True, "not_looked_at": found.not_looked_at} | NOTHING_ELSE
    assert found.not_looked_at > 0
    (line,) = [sentence for sentence in details(found) if "budget" in sentence]
    assert line.startswith(f"The search stopped at the budget; {found.not_looked_at} candidate")
    assert (1, "screen and refine; no effect") in tried
    assert [done for done, _ in tried] == sorted(done for done, _ in tried)


@pytest.mark.parametrize("given", [{"rules": Rules().replace(passes_per_row=1.0)}, {"budget": 0.005}])
def test_a_search_that_cannot_come_to_its_first_screen_is_not_begun(given):
    """The regression is the answer, which says what it does not examine."""
    tried = []

    def told(done, total, what):
        tried.append(what)

    found = diagnose(rubbing(), PENDULUM, without=LEFT_OUT, progress=told, **given)
    assert not any("screen" in what for what in tried)
    assert found.not_looked_at == 2
    assert found.regression is not None
    assert found.causes == ()
    said, *rest = details(found)
    assert said.endswith("which does not examine a payload, camera roll.")
    assert not [sentence for sentence in rest if "budget" in sentence]
    assert found.to_json()["search"]["not_begun"] == said[:-1]
    # viscous friction is doubtful by these 60 rows of keypoints, and what is missing is less than their noise
    assert not any(stated.sure for stated in found.regression.stated)
    assert not found.gap.detected
    (tolerated,) = found.gap.tolerated_torque.values()
    assert max(found.gap.residual_torque_rms.values()) < 3 * tolerated
    assert verdict(found).startswith(
        f"By regression alone no gap shows, but {handy(3 * tolerated, 'N·m')} at the pivot"
    )
    assert found.regressed is None
    assert found.shrinkage.gap_closed is None


def test_a_torque_beyond_the_noise_is_a_gap_whatever_is_stated():
    recording = recording_of(EFFECTS["viscous_friction"]("pivot"), rows=120, damping=1.5)
    bound = replace(diagnosis_problem(recording, PENDULUM), budget=Budget(work=1.0))
    said = regress(recording, PENDULUM)
    answers = [replace(said, stated=()), said]
    found, whole = (by_regression_alone(each, bound, LEFT_OUT, 0, passive=False, robot=False) for each in answers)
    assert found.gap.detected
    assert found.regressed is None
    assert verdict(whole).startswith("By regression alone there is a gap: viscous friction at the pivot explains")
    assert whole.regressed is not None
    page = render(whole)
    assert page.index("By regression alone") < page.index("No causes were searched for")
    assert "the search has others too" not in page
    assert max(found.gap.residual_torque_rms.values()) > 3 * max(found.gap.tolerated_torque.values())


def test_what_is_tolerated_has_its_share_of_what_the_file_asks_for():
    """In squares, next to the noise; a pendulum asks for I q̈ + m g c cos q."""
    recording = recording_of(rows=120)
    said, limits = regress(recording, PENDULUM), []
    for share in (0.1, 0.3):
        bound = diagnosis_problem(recording, PENDULUM, rules=Rules().replace(tolerance=share))
        bound = replace(bound, budget=Budget(work=0.0))
        limits.append(by_regression_alone(said, bound, LESS, 0, False, False).gap.tolerated_torque["pivot"])
    motion = said.unseen.motion
    asked = 0.03 * motion.qdd + 9.81 * 0.15 * np.cos(motion.q)
    assert limits[1] ** 2 - limits[0] ** 2 == pytest.approx((0.3**2 - 0.1**2) * (asked**2).mean())


def test_a_robots_far_gains_are_a_gap_whatever_the_budget_where_they_close_torque():
    bound, said = diagnosis_problem(rubbing(), PENDULUM), regress(rubbing(), PENDULUM)
    far = replace(said, stated=(), far_gains={"pivot": 8.0}, torque=replace(said.torque, share=0.1))
    found = by_regression_alone(far, bound, LEFT_OUT, 0, False, True)
    assert found.gap.detected
    assert found.to_json()["search"]["not_begun"].startswith(
        "No causes were searched for: the log shows servo gains of 8"
    )
    worse = replace(far, torque=replace(far.torque, share=-0.1))
    others = [(far, False), (said, True), (worse, True)]
    assert [by_regression_alone(each, bound, LEFT_OUT, 0, False, robot) for each, robot in others] == [None] * 3


def test_a_pass_of_a_robot_in_space_takes_the_cube_of_its_joints_in_threes():
    def model(joints, plane=False):
        body = SimpleNamespace(num_joints=joints, is_chain=plane)
        return SimpleNamespace(
            body=body, torque_size=joints, state_dim=3 * joints, contact_states=None, substeps_taken=1
        )

    assert [work_of(2.0, model(joints), 50) for joints in (1, 2, 3, 6)] == [100.0, 100.0, 100.0, 800.0]
    assert work_of(2.0, model(6, plane=True), 50) == 100.0


def test_the_budget_that_is_said_to_begin_a_search_begins_it():
    """In seconds, and as the same work where that is counted; of a log without torque a regression examines less."""
    recording = replace(recording_of(rows=120), torques=None)
    bound, said = (
        diagnosis_problem(recording, PENDULUM, passive=True),
        regress(recording, PENDULUM, passive=True, without=LESS),
    )

    def answer(**left):
        return by_regression_alone(said, replace(bound, budget=Budget(**left)), LESS, 0, True, True)

    none = answer(work=0.0)
    words = none.method["search"]
    seconds = float(words.split("--budget ")[1].split()[0])
    assert words.endswith("does not examine a payload, joint stiffness, rotor inertia")
    assert none.not_looked_at == 3
    assert said.stated == ()
    assert np.isnan(none.gap.probability)
    work, _ = FIXED.work_per_second
    assert answer(seconds=seconds) is answer(work=seconds * work) is answer() is None
    assert answer(seconds=seconds - 1).method == answer(work=(seconds - 1) * work).method == none.method


@pytest.mark.parametrize("seconds", [0.0, -1.0, float("nan")])
def test_no_time_at_all_is_told(seconds):
    with pytest.raises(InputError, match="expected a budget of some seconds"):
        diagnose(rubbing(), PENDULUM, budget=seconds)


def test_a_tolerance_is_a_share():
    with pytest.raises(InputError, match="expected a tolerance from 0 to 1"):
        diagnose(rubbing(), PENDULUM, tolerance=-0.1)
