"""Linear models whose states and rows are mapped linearly: `infer_states` maps its answer too."""

import pytest
import torch
from swinging_arm import EXACT, EYES, evidence, rotated, simulated, states

from invdyn.inference import infer_states
from invdyn.inference.smoothing.linearised import gaussian_smoother


@pytest.mark.parametrize(
    ("S", "T"),
    [
        (torch.as_tensor(rotated(37)), EYES[1]),
        (torch.diag(torch.tensor([1e3, 0.2]).double()), EYES[1]),
        (EYES[0][[1, 0]], EYES[1]),
        (EYES[0], torch.as_tensor(rotated(37, 3))),
        (EYES[0], torch.diag(torch.tensor([1e3, 2.0, 0.5]).double())),
        (EYES[0], EYES[1][[2, 0, 1]]),
    ],
    ids=["states rotated", "scaled", "permuted", "rows rotated", "rows scaled", "rows permuted"],
)
def test_states_and_rows_of_a_linear_model(S, T):
    rows, y = 20, simulated(20)
    model, other = states(*EYES, rows), states(S, T, rows)

    options = {"method": "laplace", "num_filters": 2, "num_draws": 2, "seed": 1}
    one, two = infer_states(model, y, **options), infer_states(other, y @ T.T, **options)
    shift = -rows * torch.linalg.slogdet(T).logabsdet.item()
    assert evidence(two) == pytest.approx(evidence(one) + shift, rel=EXACT)

    path, moved_path = (gaussian_smoother(m, r).path for m, r in ((model, y), (other, y @ T.T)))
    torch.testing.assert_close(moved_path, path @ S.T, rtol=EXACT, atol=EXACT * float(S.abs().max()))


def test_a_linear_model_with_rows_that_are_missing_at_the_end():
    y = simulated(20)
    longer = torch.cat([y, torch.full((5, 3), torch.nan).double()])
    one, two = (infer_states(states(*EYES, len(r)), r, method="laplace", num_filters=2) for r in (y, longer))
    assert evidence(two) == pytest.approx(evidence(one), rel=EXACT)


def test_a_linear_model_in_single_precision():
    """Rounding is far below what 20 rows say."""
    model, y = states(*EYES, 20), simulated(20)
    one, two = (
        infer_states(m, r, method="laplace", num_filters=2)
        for m, r in ((model, y), (model.to(dtype=torch.float32), y.float()))
    )
    assert evidence(two) == pytest.approx(evidence(one), abs=1e-3)
