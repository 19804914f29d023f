"""Sentences can be read at once: their mean length on every surface, and that the measure counts as a reader would."""

from statistics import fmean

import pytest
from pages import script

MEAN = 18
"""Words a sentence at most, in the mean; the usual advice for plain English is 15 to 20."""


@pytest.fixture(scope="module")
def measure():
    return script("docs/sentences.py")


def test_prose_alone_is_counted(measure):
    text = (
        "# A heading that is long\n\nOne [of three](words.md). Then `a long command` in five.\n\n"
        "```\nno prose at all\n```\n- an item is one\n- and so is this. invdyn begins it, 2 m long.\n\n"
        "| a | table of words |\n$$ x = y + z $$\n"
    )
    assert [each.words for each in measure.sentences(text, "")] == [3, 4, 4, 4, 6]


def test_what_is_said_of_an_argument_is_a_sentence_of_its_own(measure):
    prose = measure.running_text(
        "What it does.\n\nArgs:\n    one: the first of\n        two.\n    two: another.\n\n    y = x\n"
    )
    assert [each.text for each in measure.sentences(prose, "")] == ["What it does.", "one: the first of two."]


def test_sentences_are_short(measure):
    found = measure.kinds()
    assert min(len(said) for said in found.values()) > 40
    means = {kind: fmean(each.words for each in said) for kind, said in found.items()}
    assert max(means.values()) <= MEAN, means
