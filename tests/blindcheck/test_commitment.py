"""Answers cannot be changed after they are sealed, and are not on the disk before they are opened."""

import json
import sys

import pytest

from invdyn.blindcheck.commitment import Locked, Sealed, canonical, digest, read_opened, run_apart
from invdyn.recordings import InputError

ANSWERS = {"none-000": {"effects": []}, "commanded-000": {"effects": [{"effect": "armature", "unit": "kg·m²"}]}}


def test_opened_answers_are_those_that_were_sealed(tmp_path):
    sealed = Sealed(ANSWERS)
    printed = sealed.commit_to(tmp_path / "sealed.json")
    assert "armature" not in (tmp_path / "sealed.json").read_text()
    assert "armature" not in repr(sealed)
    assert sealed.open_to(tmp_path / "answers.json") == ANSWERS
    assert read_opened(tmp_path / "answers.json", printed) == ANSWERS


def test_locked_answers_open_to_their_key_and_label_alone(tmp_path):
    answer = ANSWERS["commanded-000"]
    locked = Locked(tmp_path / "locked", b"k" * 32)
    locked.put("case-0000", "7, armature", answer)
    on_disk = (tmp_path / "locked" / "case-0000").read_bytes()
    assert b"armature" not in on_disk
    assert locked.get("case-0000", "7, armature") == answer
    assert locked.get("case-0000", "8, armature") is None
    assert locked.get("case-0001", "7, armature") is None
    assert Locked(tmp_path / "locked", b"l" * 32).get("case-0000", "7, armature") is None
    (tmp_path / "locked" / "case-0000").write_bytes(on_disk[:-1])
    assert locked.get("case-0000", "7, armature") is None
    locked.put("case-0001", "9, none", ANSWERS["none-000"])
    assert (tmp_path / "locked" / "case-0001").stat().st_size == len(on_disk)
    with pytest.raises(ValueError, match="16384 bytes at most"):
        locked.put("case-0002", "10", {"effects": "x" * 20000})


def test_changed_answers_are_refused(tmp_path):
    sealed = Sealed(ANSWERS)
    sealed.open_to(tmp_path / "answers.json")
    opened = json.loads((tmp_path / "answers.json").read_text())
    opened["answers"]["none-000"]["effects"] = ["payload"]
    (tmp_path / "answers.json").write_text(json.dumps(opened))
    with pytest.raises(InputError, match="not the answers"):
        read_opened(tmp_path / "answers.json")
    other = Sealed(ANSWERS)  # another nonce
    other.open_to(tmp_path / "other.json")
    with pytest.raises(InputError, match="not the answers"):
        read_opened(tmp_path / "other.json", sealed.commitment)
    (tmp_path / "no.json").write_text("{}")
    with pytest.raises(InputError, match="expected opened answers"):
        read_opened(tmp_path / "no.json")


def test_what_is_changed_after_sealing_is_not_sealed():
    answers = {"a": {"effects": []}}
    sealed = Sealed(answers, nonce=bytes(32))
    answers["a"]["effects"].append("payload")
    assert sealed.commitment == Sealed({"a": {"effects": []}}, nonce=bytes(32)).commitment
    assert sealed.commitment != Sealed(answers, nonce=bytes(32)).commitment


def test_one_text_for_the_same_answers():
    assert canonical({"b": 1, "a": 2.5}) == canonical({"a": 2.5, "b": 1}) == b'{"a":2.5,"b":1}'
    with pytest.raises(ValueError, match="not JSON compliant"):
        canonical({"a": float("nan")})


def test_a_diagnosis_runs_in_the_case_folder_alone(tmp_path):
    (tmp_path / "case.json").write_text("{}")
    tells = "import os, sys; print(os.listdir(), repr(sys.stdin.read()))"
    finished = run_apart([sys.executable, "-c", tells], tmp_path)
    assert finished.stdout.split() == ["['case.json']", "''"]
    assert run_apart([sys.executable, "-c", "raise SystemExit(3)"], tmp_path).returncode == 3
    before = digest(tmp_path)
    (tmp_path / "case.json").write_text("{ }")
    assert digest(tmp_path) != before
