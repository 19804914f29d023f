"""A catalogue of effects: immutable, extended by effects of one's own."""

import pickle
from dataclasses import replace

import pytest
from pendulum import ARM, recording_of
from pyro.distributions import Normal

from invdyn.diagnosis import CATALOGUE, CatalogueEntry
from invdyn.diagnosis.assessment.result import Finding
from invdyn.diagnosis.catalogue import Catalogue, Variant
from invdyn.diagnosis.hypotheses.pool import considered
from invdyn.diagnosis.problem.diagnosis_problem import diagnosis_problem
from invdyn.diagnosis.report import words
from invdyn.models.effects import EFFECTS, Effect, Parameter


class BeltDrag(Effect):
    """Torque −b dθ/dt of the first joint of a pair, on the second."""

    site = "pair"

    def parameters(self, scale):
        return (Parameter("damping", "N·m·s/rad", Normal(0.0, scale.torque[self.place[1]])),)

    def force(self, p, now):
        inner, outer = self.place
        return now.at(outer, -p["damping"] * now.qd[..., inner : inner + 1])


def test_it_has_an_entry_for_every_effect():
    assert list(CATALOGUE) == list(EFFECTS)
    assert {name: entry.effect for name, entry in CATALOGUE.items()} == dict(EFFECTS)


def test_relatives_are_in_it_and_have_these_parameters():
    scale = diagnosis_problem(recording_of(body=ARM), ARM).model.scale
    parameters = {
        entry.effect.name: {p.name for p in effect.parameters(scale)}
        for entry, effect in CATALOGUE.everywhere(ARM, ARM.keypoint_names)
        if effect.form is None
    }
    for name, entry in CATALOGUE.items():
        assert set(entry.starts) <= set(CATALOGUE)
        for other, same in (*entry.twins.items(), *entry.special_cases.items()):
            assert set(same) <= parameters[name]
            assert set(same.values()) <= parameters[other]


def test_an_effect_of_ones_own_makes_another_catalogue():
    mine = CATALOGUE | {"belt": BeltDrag}
    assert "belt" in mine
    assert "belt" not in CATALOGUE
    assert len(mine) == len(CATALOGUE) + 1
    with pytest.raises(TypeError):
        CATALOGUE["belt"] = BeltDrag
    with pytest.raises(TypeError, match="belt: expected an effect's class or a CatalogueEntry, got 3"):
        CATALOGUE | {"belt": 3}
    assert list(pickle.loads(pickle.dumps(CATALOGUE))) == list(CATALOGUE)


def test_it_is_considered_under_the_name_that_it_is_given():
    bound = diagnosis_problem(recording_of(body=ARM), ARM)
    bound = replace(bound, catalogue=CATALOGUE | {"belt": BeltDrag})
    (found,) = (effect for effect in considered(bound) if isinstance(effect, BeltDrag))
    assert (found.name, found.key) == ("belt", ".".join(["belt", *ARM.joint_names]))
    assert bound.catalogue.of(found).effect is BeltDrag
    assert "belt" not in {effect.name for effect in considered(bound, ["belt"])}


def test_variants_follow_one_another_to_the_last():
    """Of one's own law too, whose class knows all of them by number."""
    own = CATALOGUE | {"belt_drag": CatalogueEntry(BeltDrag, variants=(Variant({}), Variant({})))}
    forms = [BeltDrag("shoulder", "elbow")]
    while len(forms) < 5 and (form := own.nonideal(forms[-1])) is not None:
        forms.append(form)
    assert [form.variant for form in forms] == [0, 1, 2]


def test_a_report_has_the_words_of_its_entry():
    entry = CatalogueEntry(BeltDrag, phrase="a dragging belt", meaning="a belt that leads over another joint")
    known = Finding("belt", "dynamics", {"joint": "elbow", "partner": "shoulder"}, {}, own=entry)
    assert words.finding_words(known) == "a dragging belt between the elbow and the shoulder"
    assert words.meaning(known) == "a belt that leads over another joint"
    bare = Finding("belt", "dynamics", {"joint": "elbow"}, {}, own=Catalogue({"belt": BeltDrag})["belt"])
    assert words.finding_words(bare) == "belt at the elbow"
    assert words.meaning(bare) is None


def test_a_separating_experiment_for_every_rival():
    assert CATALOGUE.separating_experiment(["payload"]) is None
    assert CATALOGUE.separating_experiment([]) is None
    sentence = CATALOGUE.separating_experiment(["actuator_delay", "camera_latency"])
    assert sentence == f"Record {CATALOGUE['camera_latency'].shown_by}."  # asked for once
    sentence = CATALOGUE.separating_experiment(["viscous_friction", "armature"])
    assert CATALOGUE["viscous_friction"].shown_by in sentence
    assert CATALOGUE["armature"].shown_by in sentence
