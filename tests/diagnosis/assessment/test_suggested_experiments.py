"""What would tell rivals apart."""

from invdyn.diagnosis.assessment.suggested_experiments import SHOWN_BY, separating_experiment
from invdyn.models.effects import EFFECTS


def test_a_separating_experiment_for_every_rival():
    assert set(SHOWN_BY) == set(EFFECTS)
    assert separating_experiment(["payload"]) is None
    assert separating_experiment([]) is None
    sentence = separating_experiment(["actuator_delay", "camera_latency"])
    assert sentence == f"Record {SHOWN_BY['camera_latency']}."  # asked for once
    sentence = separating_experiment(["viscous_friction", "armature"])
    assert SHOWN_BY["viscous_friction"] in sentence
    assert SHOWN_BY["armature"] in sentence
