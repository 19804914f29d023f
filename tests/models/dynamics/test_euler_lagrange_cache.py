"""Derived equations are kept on disk, and a broken file does not matter."""

import functools
import hashlib
import json
import math
import multiprocessing

import pytest
from chains import random_case

from invdyn.models.dynamics import euler_lagrange

derive_once = functools.cache(euler_lagrange.generate)


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    """Each chain is derived once for this file, however often its cache is thrown away."""
    monkeypatch.setattr(euler_lagrange, "generate", derive_once)


def evaluate(functions):
    """A number that every generated function takes part in."""
    p, q, qd, _ = random_case(2, 16)
    values = {"phi": q, "w": qd, **p._asdict()}
    total = 0.0
    for name, words in euler_lagrange.ARGUMENTS.items():
        moving, body = (
            [values[w].unbind(-1) for w in words if (w in euler_lagrange.MOVING) == m] for m in (True, False)
        )
        total += sum(float(x) for x in functions[name].values(*moving, functions[name].numbers(*body)))
    return total


def test_a_derivation_is_kept_and_read_back(tmp_path, monkeypatch):
    first = evaluate(euler_lagrange.torch_functions(2, tmp_path / "new" / "folder"))
    assert len(list((tmp_path / "new" / "folder").iterdir())) == 1

    def derived_again(num_joints):
        raise AssertionError("expected the cached derivation")

    monkeypatch.setattr(euler_lagrange, "generate", derived_again)
    assert evaluate(euler_lagrange.torch_functions(2, tmp_path / "new" / "folder")) == first


@pytest.mark.parametrize(
    "damage",
    [
        lambda text: "",
        lambda text: text[: len(text) // 2],
        lambda text: text.replace("phi1", "phi2", 1),
        lambda text: "[1, 2]",
        lambda text: '{"sources": 3, "sha256": 4}',
        lambda text: "[" * 100_000,
        lambda text: text.replace('"steps": {}', '"steps": []', 1),
        lambda text: text.replace("mass1", "mass3", 1),
        lambda text: text.replace("cos(", "sin(", 1),
        lambda text: text.replace("p0", "p0*(1 + p0/1000000)", 1),
        lambda text: text.replace('"p0"', '"-p0"', 1),
        lambda text: text.replace("inertia1", "inertia1/1", 1).replace('"results": [', '"results": ["0", ', 1),
        lambda text: "\x00\x01",
    ],
)
def test_a_broken_cache_file_is_derived_again_and_mended(tmp_path, damage):
    whole = evaluate(euler_lagrange.torch_functions(2, tmp_path))
    (file,) = tmp_path.iterdir()
    good = file.read_text(encoding="utf-8")
    assert damage(good) != good
    file.write_text(damage(good), encoding="utf-8")
    assert evaluate(euler_lagrange.torch_functions(2, tmp_path)) == whole
    assert file.read_text(encoding="utf-8") == good


def test_a_cache_folder_that_cannot_be_written_does_not_matter(tmp_path):
    (tmp_path / "file").write_text("in the way")
    assert math.isfinite(evaluate(euler_lagrange.torch_functions(2, tmp_path / "file")))


PLANTED = [
    "__import__('pathlib').Path('{mark}').touch()",
    "[p0 for p0 in [().__class__.__base__.__subclasses__()]][0]",
    "cos(open('{mark}', 'w'))",
    "(lambda: open('{mark}', 'w'))()",
    "cos.__globals__['__builtins__']['open']('{mark}', 'w')",
    "(p9 := 1)",
    "p0 if p0 else p0",
    "9**8**8**8**8**8",
    "p0**99999",
    "-" * 20_000 + "p0",
    "p0\n    open('{mark}', 'w')",
]


@pytest.mark.parametrize("text", PLANTED)
@pytest.mark.parametrize("place", ["step", "name", "result"])
def test_a_planted_file_never_runs(tmp_path, text, place):
    """As a step, as a step's name, or as a result: nothing of it is run, and the dynamics are the right ones."""
    whole = evaluate(euler_lagrange.torch_functions(2, tmp_path / "cache"))
    (file,) = (tmp_path / "cache").iterdir()
    text = text.replace("{mark}", str(tmp_path / "mark"))
    programs = json.loads(file.read_text(encoding="utf-8"))
    for part in ("numbers", "values"):
        program = programs["gravity_load"][part]
        if place == "result":
            program["results"][0] = text if part == "values" else program["results"][0]
        else:
            program["steps"] |= {"x9": text} if place == "step" else {f"x9 = {text}; x8": "1"}
    file.write_text(json.dumps(programs), encoding="utf-8")
    assert euler_lagrange._read_cache(file, 2) is None
    assert evaluate(euler_lagrange.torch_functions(2, tmp_path / "cache")) == whole
    assert not (tmp_path / "mark").exists()


def test_a_source_that_earlier_versions_ran_is_not_run(tmp_path):
    """The form that a cache had before: source and its hash, which anybody can make."""
    euler_lagrange.torch_functions(1, tmp_path / "cache")
    (file,) = (tmp_path / "cache").iterdir()
    source = f"open({str(tmp_path / 'mark')!r}, 'w')\ndef _lambdifygenerated(*given):\n    return []\n"
    sources = {name: {"numbers": source, "values": source} for name in euler_lagrange.ARGUMENTS}
    digest = hashlib.sha256(json.dumps(sources, sort_keys=True).encode()).hexdigest()
    file.write_text(json.dumps({"sha256": digest, "sources": sources}))
    euler_lagrange.torch_functions(1, tmp_path / "cache")
    assert not (tmp_path / "mark").exists()


def test_the_folder_is_the_users_alone(tmp_path):
    euler_lagrange.torch_functions(1, tmp_path / "cache")
    assert (tmp_path / "cache").stat().st_mode & 0o777 == 0o700


def derive_with_another(folder, both_found_nothing, results):
    """One of two processes; neither derives before both have looked into the empty cache."""

    def derive(num_joints):
        both_found_nothing.wait()
        return derive_once(num_joints)

    euler_lagrange.generate = derive
    results.put(evaluate(euler_lagrange.torch_functions(2, folder)))


def test_two_processes_that_start_on_an_empty_cache_both_succeed(tmp_path):
    expected = evaluate(euler_lagrange.torch_functions(2, tmp_path / "other"))
    context = multiprocessing.get_context("fork")
    both, results = context.Barrier(2), context.SimpleQueue()
    processes = [context.Process(target=derive_with_another, args=(tmp_path / "new", both, results)) for _ in range(2)]
    for process in processes:
        process.start()
    for process in processes:
        process.join()
    assert [process.exitcode for process in processes] == [0, 0]
    assert [results.get(), results.get()] == [expected, expected]
    assert len(list((tmp_path / "new").iterdir())) == 1  # and nothing half-written
    assert evaluate(euler_lagrange.torch_functions(2, tmp_path / "new")) == expected
