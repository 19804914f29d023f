"""What would tell rivals apart."""

from invdyn.diagnosis.assessment.suggested_experiments import separating_experiment
from invdyn.diagnosis.catalogue import CATALOGUE


def test_a_separating_experiment_for_every_rival():
    assert separating_experiment(["payload"]) is None
    assert separating_experiment([]) is None
    sentence = separating_experiment(["actuator_delay", "camera_latency"])
    assert sentence == f"Record {CATALOGUE['camera_latency'].shown_by}."  # asked for once
    sentence = separating_experiment(["viscous_friction", "armature"])
    assert CATALOGUE["viscous_friction"].shown_by in sentence
    assert CATALOGUE["armature"].shown_by in sentence
