"""All numbers of a diagnosis are in one registry, which is an argument and describes each."""

import ast
import re
from dataclasses import FrozenInstanceError
from pathlib import Path
from runpy import run_path

import pytest
from pendulum import FRICTION, PENDULUM, recording_of

import invdyn.diagnosis as room
from invdyn.diagnosis import Rules, diagnose
from invdyn.diagnosis.rules import COLUMNS, DEFAULT, numbers
from invdyn.models.effects import EFFECTS
from invdyn.recordings import InputError

ROOT = Path(room.__file__).resolve().parent
SOURCES = {p: ast.parse(p.read_text("utf-8")) for p in sorted(ROOT.rglob("*.py"))}
NOT_TUNED = {
    "SCHEMA",
    "Z90",
    "Z_90",
    "ROUND",
    "HINGE",
    "SLIDE",
    "CONNECT",
    "OF_JOINTS",
    "OF_TENDONS",
    "OF_A_JOINT",
    "INTEGRATOR",
    "AT_JOINTS",
    "SPHERE",
}
"""A version of a file format, quantiles of the unit Gaussian, and MuJoCo's numbers of its kinds."""


def test_a_diagnosis_follows_the_rules_that_it_is_given():
    """A tolerance of more than the friction takes: what is missing does not matter."""
    recording = recording_of(FRICTION, rows=60, damping=0.05)
    left_out = [name for name in EFFECTS if name != FRICTION.name]
    usual = diagnose(recording, PENDULUM, without=left_out, most=1)
    tolerant = diagnose(recording, PENDULUM, without=left_out, most=1, rules=Rules().replace(tolerance=0.5))
    assert usual.gap.detected
    assert not tolerant.gap.detected
    assert tolerant.gap.tolerated_torque["pivot"] == pytest.approx(100 * usual.gap.tolerated_torque["pivot"])


def test_the_answer_that_there_is_too_little_keeps_its_rules():
    rules = Rules().replace(min_rows=50)
    found = diagnose(recording_of(FRICTION).at(slice(0, 40)), PENDULUM, rules=rules)
    assert "a diagnosis needs 50" in found.not_enough_data
    assert found.rules == rules


def test_rules_are_immutable_and_know_their_names():
    with pytest.raises(FrozenInstanceError):
        DEFAULT.evidence.tolerance = 1.0
    assert DEFAULT.replace(tolerance=0.2, max_rows=9).recording.max_rows == 9
    assert DEFAULT.replace() == DEFAULT == Rules()
    with pytest.raises(InputError, match=r"unknown rule 'min_outlier' \(closest: 'min_outliers'\): docs/numbers.md"):
        DEFAULT.replace(tolerance=0.2, min_outlier=5)
    with pytest.raises(InputError, match="unknown rule 'nonsense': docs"):
        DEFAULT.replace(nonsense=1.0)


def test_every_number_has_a_name_of_its_own_and_unit_meaning_and_source():
    names = [each.name for _, each in numbers()]
    assert len(set(names)) == len(names) > 150
    for _, each in numbers():
        assert all(each.metadata[what] for what in COLUMNS), each.name
    assert sum(DEFAULT.evidence.effect_count_prior) == pytest.approx(1.0)
    assert len(DEFAULT.evidence.effect_count_prior) == DEFAULT.search.max_effects + 1


def test_every_number_acts():
    read = {node.attr for p, tree in SOURCES.items() if p.name != "rules.py" for node in ast.walk(tree)
            if isinstance(node, ast.Attribute)}  # fmt: skip
    idle = [each.name for _, each in numbers() if each.name not in read]
    assert idle == []


def test_no_tuned_number_stands_elsewhere():
    """At module level: numbers, and tuples of them, but for what is plainly not tuned."""
    found = [
        f"{path.name}:{node.lineno} {name}"
        for path, tree in SOURCES.items()
        for node in tree.body
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None and _is_number(node.value)
        for target in (node.targets if isinstance(node, ast.Assign) else [node.target])
        for name in re.findall(r"\w+", ast.unparse(target))
        if name not in NOT_TUNED
    ]
    assert found == []


def test_rules_are_handed_on():
    """All functions that take them get them from their callers: a default is for tests and users alone."""
    taking = {
        path: {
            node.name
            for node in ast.walk(tree)
            if isinstance(node, ast.FunctionDef)
            and "rules" in {a.arg for a in (*node.args.args, *node.args.kwonlyargs)}
        }
        for path, tree in SOURCES.items()
    }
    forgotten = []
    for path, tree in SOURCES.items():
        names = set(taking[path])
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("invdyn.diagnosis."):
                source = ROOT.joinpath(*node.module.split(".")[2:]).with_suffix(".py")
                names |= taking.get(source, set()) & {each.name for each in node.names}
        for node in ast.walk(tree):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in names:
                given = " ".join(map(ast.unparse, (*node.args, *(k.value for k in node.keywords))))
                if not re.search(r"\b(rules|DEFAULT)\b", given):
                    forgotten.append(f"{path.name}:{node.lineno} {node.func.id}")
    assert forgotten == []


def test_the_page_of_numbers_is_that_of_the_registry():
    """Else run `python docs/numbers_page.py`."""
    docs = ROOT.parent / "docs"
    assert (docs / "numbers.md").read_text("utf-8") == run_path(str(docs / "numbers_page.py"))["page"]()


def _is_number(node):
    try:
        value = ast.literal_eval(node)
    except ValueError:
        return isinstance(node, ast.BinOp | ast.UnaryOp) and not any(isinstance(n, ast.Name) for n in ast.walk(node))
    items = value if isinstance(value, tuple) else (value,)
    return bool(items) and all(isinstance(v, int | float) and not isinstance(v, bool) for v in items)
