"""Which effects a regression cannot tell apart: moments of columns that say the same, or nearly the same."""

import numpy as np
import pytest

from invdyn.diagnosis.regression.grouped_evidence import Choice, Moments, Statement
from invdyn.diagnosis.rules import DEFAULT


def choice(likeness):
    """Of damping, a gain that is so like it, and friction at one joint, where damping is all that there is."""
    rng = np.random.default_rng(0)
    damping, friction, other = rng.standard_normal((3, 400))
    X = np.stack([damping, likeness * damping + np.sqrt(1 - likeness**2) * other, friction])
    y = 0.6 * damping + 0.2 * rng.standard_normal(400)
    rows = np.array([400.0])
    moments = Moments((X @ X.T)[None], (X @ y)[None], np.array([y @ y]), rows, rows)
    kinds = {kind: {"elbow": (n,)} for n, kind in enumerate(("damping", "gain", "friction"))}
    return Choice(moments, kinds, np.ones(3), np.full(3, -np.inf), np.zeros(1), DEFAULT)


@pytest.mark.parametrize(("likeness", "rivals"), [(0.9999, ("gain",)), (0.9, ())])
def test_rivals_explain_as_much_in_anothers_stead(likeness, rivals):
    some = choice(likeness)
    best = some._fitted((Statement("damping", {"elbow": (0,)}, 1.0),))
    assert best.score > some._fitted(()).score + 100
    assert some.rivals(best) == ({("damping", "elbow"): rivals} if rivals else {})


def test_an_effect_that_is_stated_too_is_no_rival():
    some = choice(0.9999)
    both = some._fitted(tuple(Statement(kind, {"elbow": (n,)}, 1.0) for n, kind in enumerate(("damping", "gain"))))
    assert some.rivals(both) == {}


@pytest.mark.parametrize(("first", "second"), [("damping", "damping"), ("damping", "gain")])
def test_a_rival_is_one_at_all_places_of_a_statement_or_with_one_that_is_stated_elsewhere(first, second):
    """Of two joints, by what is stated at each; each gain is as good as the damping there."""
    rng = np.random.default_rng(1)
    damping, other = rng.standard_normal((2, 2, 400))
    like = 0.9999 * damping + np.sqrt(1 - 0.9999**2) * other
    X = np.zeros((2, 4, 400))
    X[[0, 1], [0, 1]], X[[0, 1], [2, 3]] = damping, like
    y = 0.6 * damping + 0.2 * rng.standard_normal((2, 400))
    rows = np.full(2, 400.0)
    moments = Moments(X @ X.mT, np.einsum("kpr,kr->kp", X, y), (y**2).sum(1), rows, rows)
    kinds = {"damping": {"elbow": (0,), "wrist": (1,)}, "gain": {"elbow": (2,), "wrist": (3,)}}
    some = Choice(moments, kinds, np.ones(4), np.full(4, -np.inf), np.zeros(2), DEFAULT)
    stated = {"elbow": first, "wrist": second}
    statements = [
        Statement(kind, {place: kinds[kind][place] for place, own in stated.items() if own == kind}, 1.0)
        for kind in dict.fromkeys(stated.values())
    ]
    exchanged = {"damping": ("gain",), "gain": ("damping",)}
    assert some.rivals(some._fitted(tuple(statements))) == {(k, place): exchanged[k] for place, k in stated.items()}
