"""Products of whitened columns, all of them or those that are wanted."""

import sys
from dataclasses import replace

import numpy as np
from pendulum import ARM, recording_of

from invdyn.diagnosis.hypotheses.continuation import data_path
from invdyn.diagnosis.problem.diagnosis_problem import diagnosis_problem
from invdyn.diagnosis.problem.regime import COMMANDED
from invdyn.diagnosis.rules import FIXED
from invdyn.diagnosis.sensitivity.sensitivities import Columns
from invdyn.diagnosis.sensitivity.whiten import filter_of, products, whiten


def test_products_within_groups_are_those_of_all():
    here = diagnosis_problem(recording_of(body=ARM, rows=40), ARM)
    path = data_path(here)[0]
    rng = np.random.default_rng(0)
    columns = Columns(rng.normal(size=(39, 6, 7)), rng.normal(size=(40, here.observations.shape[-1], 7)))
    about = filter_of(here, here.model, path, COMMANDED.sizes)
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
    here = diagnosis_problem(recording_of(body=ARM, rows=30), ARM)
    about = filter_of(here, here.model, data_path(here)[0], here.regime.sizes[:1])
    rng = np.random.default_rng(0)
    T, D, seen = here.model.num_steps, here.model.state_dim, here.observations.shape[-1]
    g, d = rng.normal(size=(T - 1, D, 2)), rng.normal(size=(T, seen, 2))
    g[..., 1] *= 1e200
    gram = whiten(here, about, Columns(g, d)).gram
    assert not np.isfinite(gram[0, 2, 2])
    np.testing.assert_allclose(gram[:, :2, :2], whiten(here, about, Columns(g[..., :1], d[..., :1])).gram, rtol=1e-9)


def test_products_of_many_numbers_are_those_of_all_sizes_at_once(monkeypatch):
    here = diagnosis_problem(recording_of(body=ARM), ARM)
    path, _ = data_path(here)
    about = filter_of(here, here.model, path, here.regime.sizes)
    rng = np.random.default_rng(0)
    columns = Columns(rng.normal(size=(len(path) - 1, path.shape[1], 5)), rng.normal(size=(len(path), 4, 5)))
    groups = [slice(1, 3), slice(3, 5)]
    whole = products(here, about, columns, groups)
    assert whole.columns.shape[-1] == 6
    monkeypatch.setattr(sys.modules[products.__module__], "FIXED", replace(FIXED, max_whitened=0))
    one_by_one = products(here, about, columns, groups)
    np.testing.assert_allclose(one_by_one.gram, whole.gram, rtol=1e-9, atol=1e-9 * np.abs(whole.gram).max())
    np.testing.assert_array_equal(one_by_one.log_det, whole.log_det)
    assert one_by_one.count == whole.count
