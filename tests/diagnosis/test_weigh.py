"""What counts as something left beside a cause."""

from dataclasses import replace

import numpy as np
import pytest
from pendulum import PENDULUM, recording_of

from invdyn.diagnosis.paths import data_path
from invdyn.diagnosis.pool import Search, considered
from invdyn.diagnosis.predict import correlation
from invdyn.diagnosis.refine import refine
from invdyn.diagnosis.setting import LOOSE, setting
from invdyn.diagnosis.weigh import ALIKE, _alone
from invdyn.diagnosis.whiten import sizes
from invdyn.models.effects import EFFECTS


def test_what_is_little_beside_the_gap_is_nothing_left():
    """A tenth of the residual that the simulation alone needs; and large gaps forgive more than small ones."""
    bound = setting(recording_of(), PENDULUM)
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
    bound = setting(recording_of(EFFECTS["viscous_friction"]("pivot"), damping=0.05), PENDULUM)
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
