"""The whole way from a recording to a diagnosis, where a part of it says something else."""

import sys

from pendulum import PENDULUM, recording_of

from invdyn.diagnosis import diagnose
from invdyn.models.effects import EFFECTS


def test_held_out_rows_are_scored_with_the_cause_that_is_named(monkeypatch):
    """They are scored beside the confirmation, with the cause that is likely: SMC may name another."""
    recording = recording_of(EFFECTS["viscous_friction"]("pivot"), rows=120, damping=0.05)
    assert diagnose(recording, PENDULUM).to_json()["shrinkage"]["gap_closed"] > 0.8
    room = sys.modules[diagnose.__module__]
    weigh = room.weigh

    def other(bound, found, seed):
        return room.only(bound, found, found.pool[""], weigh(bound, found, seed).log_evidence)

    monkeypatch.setattr(room, "weigh", other)
    named = diagnose(recording, PENDULUM).to_json()
    assert named["causes"][0]["effects"] == []
    told = named["gap"]["elpd_per_frame"]
    assert told["corrected"] == told["nominal"] < told["noise_floor"]
