"""A model for each case of the conformance tests."""

import pytest
from model_cases import CASES


@pytest.fixture
def model(case):
    return CASES[case]()
