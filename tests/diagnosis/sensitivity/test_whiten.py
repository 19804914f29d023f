"""Products of whitened columns, all of them or those that are wanted."""

import numpy as np
from pendulum import ARM, recording_of

from invdyn.diagnosis.hypotheses.continuation import data_path
from invdyn.diagnosis.problem.diagnosis_problem import setting
from invdyn.diagnosis.sensitivity.sensitivities import Columns
from invdyn.diagnosis.sensitivity.whiten import filter_of, sizes, whiten


def test_products_within_groups_are_those_of_all():
    here = setting(recording_of(body=ARM, rows=40), ARM)
    path = data_path(here)[0]
    rng = np.random.default_rng(0)
    columns = Columns(rng.normal(size=(39, 6, 7)), rng.normal(size=(40, here.observations.shape[-1], 7)))
    about = filter_of(here, here.model, path, sizes("commanded"))
    whole = whiten(here, about, columns)
    assert whole.gram.shape == (7, 8, 8)
    groups = [slice(1, 3), slice(3, 4), slice(4, 6)]  # 6 and 7 behind them
    some = whiten(here, about, columns, groups)
    wanted = np.zeros((8, 8), dtype=bool)
    wanted[[0, 6, 7]] = wanted[:, [0, 6, 7]] = True
    for group in groups:
        wanted[group, group] = True
    np.testing.assert_allclose(some.gram[:, wanted], whole.gram[:, wanted], rtol=1e-12)
    np.testing.assert_array_equal(some.columns, whole.columns)
    assert some.count == whole.count


def test_a_column_that_runs_away_is_infinite_without_a_warning():
    """The others are what they are without it; :mod:`.evidence` leaves out what is not finite."""
    here = setting(recording_of(body=ARM, rows=30), ARM)
    about = filter_of(here, here.model, data_path(here)[0], sizes(here.regime)[:1])
    rng = np.random.default_rng(0)
    T, D, seen = here.model.num_steps, here.model.state_dim, here.observations.shape[-1]
    g, d = rng.normal(size=(T - 1, D, 2)), rng.normal(size=(T, seen, 2))
    g[..., 1] *= 1e200
    gram = whiten(here, about, Columns(g, d)).gram
    assert not np.isfinite(gram[0, 2, 2])
    np.testing.assert_allclose(gram[:, :2, :2], whiten(here, about, Columns(g[..., :1], d[..., :1])).gram, rtol=1e-9)
