"""Effects that are what their names say, and what a search does about others."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from pendulum import MANY, PENDULUM, recording_of

from invdyn.diagnosis.credible import credible
from invdyn.diagnosis.paths import data_path
from invdyn.diagnosis.refine import refine
from invdyn.diagnosis.search import search
from invdyn.diagnosis.setting import LOOSE, setting
from invdyn.models.effects import EFFECTS


@pytest.mark.parametrize("meet", [False, True])
def test_stops_that_meet_hold_a_joint(meet):
    bound = setting(recording_of(EFFECTS["viscous_friction"]("pivot"), damping=0.05), PENDULUM)
    path, _ = data_path(bound)
    none = refine(bound, (), {}, path, LOOSE)
    stops = [EFFECTS["joint_limit"]("pivot", side).bound(PENDULUM) for side in ("lower", "upper")]
    shaped = bound.shaped(path)
    low, high = shaped.model.scale.range[0].tolist()
    angles = {"lower": high - 0.01 if meet else low + 0.01, "upper": high - 0.01}
    values = {f"{s.key}.{n}": v for s in stops for n, v in (("angle", angles[s.where[1]]), ("stiffness", 5.0))}
    values |= {f"{stop.key}.damping": 0.01 for stop in stops}
    found = {"names": tuple(values), "mean": np.array(list(values.values())), "covariance": 1e-8 * np.eye(6)}
    assert credible(shaped, replace(none, effects=tuple(stops), **found)) is not meet


@pytest.mark.parametrize(
    ("complete", "named", "looked"),
    [(True, True, False), (True, False, True), (False, True, True)],
)
def test_sets_of_several_are_tried_where_the_best_is_not_what_it_is_called(monkeypatch, complete, named, looked):
    """Stribeck friction at more than all speeds may stand for dry friction and viscous, and leave nothing."""
    bound = setting(recording_of(EFFECTS["coulomb_friction"]("pivot"), torque=0.05), PENDULUM)
    path, stray = data_path(bound)
    module, asked = sys.modules[search.__module__], []

    def extend(_, found, base, width):
        if not base.effects:
            none = found.pool[""]
            friction = next(e for e in found.candidates if e.key == "viscous_friction.pivot")
            spike = np.arange(len(none.by_size)) == 0
            by_size = np.where(spike == complete, 0.0, -100.0)
            found.add(replace(none, effects=(friction,), log_evidence=none.log_evidence + 500.0, by_size=by_size))

    monkeypatch.setattr(module, "extend", extend)
    monkeypatch.setattr(module, "credible", lambda *_: named)
    monkeypatch.setattr(module, "shortened", lambda setting, _: setting)
    monkeypatch.setattr(module, "screened_with", lambda *_: ([], []))
    for name in ("_several", "reduce", "_overtaken", "_settled", "refine_every"):
        monkeypatch.setattr(module, name, lambda *_, name=name: asked.append(name))
    search(bound, path, stray, MANY)
    assert ("_several" in asked) is ("_overtaken" in asked) is looked
