"""What a log's numbers count from, of one track and of several that add."""

import numpy as np
import pytest
from robot_xml import robot

from invdyn.diagnosis.check.robot_terms import RobotTerms
from invdyn.models import Body
from invdyn.recordings.logs.mapping import LogMap


@pytest.mark.filterwarnings("ignore:.*clockwise")
def test_a_sum_of_tracks_counts_from_the_sum_of_their_zeros(tmp_path):
    """In other units its angles grow about that zero."""
    (tmp_path / "robot.xml").write_text(robot())
    body = Body.load(tmp_path / "robot.xml", filmed=False)
    lines = [{"track": "a", "zero": 0.2}, {"track": "b", "zero": -0.5}]
    one, several = (
        LogMap.of({"joints": {name: {"angle": angle} for name in body.joint_names}}).joints
        for angle in ({"track": "a", "zero": -0.3}, lines)
    )
    zeros = [
        RobotTerms.of(body, np.zeros((1, 2)), [maps[name] for name in body.joint_names]).angle.zero
        for maps in (one, several)
    ]
    np.testing.assert_allclose(zeros[0], zeros[1])
