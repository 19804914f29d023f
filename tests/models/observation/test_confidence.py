"""A tracker's confidence is a part of the data: of two that rank alike too."""

import numpy as np

from invdyn.inference.execution.checkpoint import digest
from invdyn.models import Keypoints, Observation
from invdyn.models.observation.confidence import Confidence


def test_all_that_is_said_of_a_row_is_data():
    c = np.linspace(0.1, 0.9, 8)[:, None]
    one, half = (Observation(Keypoints([0], confidence=Confidence.of(x))).data() for x in (c, c / 2))
    assert digest(*one[:2]) == digest(*half[:2])
    assert digest(*one) != digest(*half)
