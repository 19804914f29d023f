"""When an estimate of the evidence may be stated, by made-up filters of which the answer is known."""

import math

import pytest
import torch

from invdyn.inference.filters.second_opinion import confirms, contradiction, evidence, exceeds


def filters(mean, sd, count=64, seed=0):
    noise = torch.randn(count, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    return mean + sd * noise - 0.5 * sd**2


def test_filters_that_agree_are_usable():
    found = evidence(filters(-100, 0.2), "controlled")
    assert found.usable
    assert found.standing
    assert found.reason == ""
    assert abs(found.log_evidence + 100) < 4 * found.sd


def test_one_filter_that_carries_all_has_no_error():
    found = evidence(torch.tensor([0.0] * 63 + [200.0]), "bootstrap")
    assert math.isnan(found.sd)
    assert not found.usable
    assert "outer effective sample size 1.0 of 64" in found.reason


@pytest.mark.parametrize(("values", "usable"), [([3.0], False), ([3.0, 3.1], True), ([3.0, 9.0], False)])
def test_few_filters(values, usable):
    assert evidence(torch.tensor(values, dtype=torch.float64), "controlled").usable is usable


def test_filters_without_weight_are_not_usable():
    assert not evidence(torch.full((4,), -torch.inf, dtype=torch.float64), "bootstrap").usable


def test_the_floor_is_where_standard_errors_hold():
    # log-normal estimates: at an sd of 0.8 errors of 3 are as rare as they should be, at 3 they are the rule
    for sd, right in ((0.8, True), (3.0, False)):
        found = [evidence(filters(-50, sd, seed=k), "bootstrap") for k in range(200)]
        stated = [each for each in found if each.usable]
        wrong = sum(abs(each.log_evidence + 50) > 3 * each.sd for each in stated)
        assert (len(stated) > 150) is right
        assert wrong <= 0.05 * 200


def test_a_higher_pilot_contradicts_and_a_collapsed_lower_one_does_not():
    ahead = evidence(filters(-2946.6, 0.3), "controlled")
    higher = evidence(filters(-255, 2.5, 16), "bootstrap")
    collapsed = evidence(filters(-9e4, 4e3, 16), "bootstrap")
    assert exceeds(higher, ahead)
    assert "disagree beyond their errors" in contradiction(ahead, higher)
    assert contradiction(ahead, collapsed) == ""
    judged = evidence(filters(-2946.6, 0.3), "controlled", higher)
    assert not judged.usable
    assert judged.reason == judged.contradicted != ""


def test_a_lower_pilot_contradicts_if_its_filters_agree():
    ahead = evidence(filters(-40, 0.1), "controlled")
    assert contradiction(ahead, evidence(filters(-43, 0.2, 16), "bootstrap")) != ""
    assert contradiction(ahead, evidence(filters(-40.2, 0.2, 16), "bootstrap")) == ""


def test_a_confirmation_has_a_small_error_and_the_same_value():
    ahead = evidence(filters(-40, 0.01), "controlled")
    assert confirms(evidence(filters(-40, 0.2, 16), "defended"), ahead)
    assert not confirms(evidence(filters(-40 + math.log(2), 0.2, 16), "defended"), ahead)
    assert not confirms(evidence(filters(-40, 1.5, 16), "defended"), ahead)


@pytest.mark.parametrize("sd", [1.0, 1.7, 2.0])
def test_filters_that_differ_widely_are_not_believed_for_having_missed_the_tail(sd):
    """Log Ẑ is N(−sd²/2, sd²), log Z zero: the outer ESS often looks well where no filter has reached the tail."""
    torch.manual_seed(0)
    found = [evidence(each, "bootstrap") for each in sd * torch.randn(600, 64).double() - sd**2 / 2]
    usable = [each for each in found if each.usable]
    assert sum(abs(each.log_evidence) > 3 * each.sd for each in usable) <= 0.025 * len(found)
    assert len(usable) > 0.8 * len(found) or sd > 1


def test_filters_without_their_observations_do_not_spoil_the_others():
    torch.manual_seed(0)
    values = 0.3 * torch.randn(64).double()
    values[:5] -= 20
    assert evidence(values, "controlled").usable
