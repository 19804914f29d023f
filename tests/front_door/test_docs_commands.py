"""Every block of every page is run, read or parsed: the guides' code and commands, on files as they describe them.

What `run` calls is the command itself. Only the work within is made small: an inference at once, or a search among few
effects. The pages on films, cameras and the blind check have a file of their own (test_docs_films.py).
"""

import json
import re
import shlex
from importlib import import_module
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pytest
import torch
from pages import GUIDES, PAGES, ROOT, blocks, commands, languages
from reported import diagnosis
from stand_in import deeplabcut

import invdyn.inference
from invdyn.inference.infer_states import generic_methods
from invdyn.inference.methods.registry import PARAMETER_METHODS
from invdyn.inputs import load_body
from invdyn.models.effects import EFFECTS
from invdyn.recordings import write_keypoint_csv

LEFT_OUT = pytest.mark.filterwarnings("ignore:.*a rigid body leaves out:UserWarning")
"""What else a robot's file has is reported."""
RUN = {
    "": None,  # commands: test_docs.py parses them, test_docs_inline.py what is not ours
    # Names of files, words for another program's command, and an error's line.
    "text": {
        ROOT / "docs" / "blind_protocol.md",
        *(ROOT / "docs" / "how-to" / f"{n}.md" for n in ("film", "live", "own_model", "trials")),
    },
    "python": {*GUIDES, ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "docs" / "files.md"},
    "toml": {*GUIDES, ROOT / "docs" / "files.md"},
    "csv": {ROOT / "docs" / "files.md"},
    "json": {ROOT / "docs" / "blind_protocol.md"},
    "sh": {ROOT / "docs" / "how-to" / "own_effect.md"},  # runs what test_conformance_effects.py is
}
"""Where blocks of a language may stand; elsewhere no test would run them. None: anywhere."""


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_a_block_stands_where_a_test_runs_it(page):
    for language in languages(page):
        if not language.startswith("{"):
            assert language in RUN, f"{page.name}: no test runs a block of {language!r}"
            assert RUN[language] is None or page in RUN[language], f"{page.name}: no test runs its {language}"


def session(page: Path) -> dict[str, Any]:
    """Names after a page's Python blocks have run, in their order."""
    names: dict[str, Any] = {}
    for block in blocks(page, "python"):
        exec(compile(block, str(page), "exec"), names)
    return names


@pytest.mark.quick("[!o]*", "own_effect*", "own_sensor*")
@LEFT_OUT
@pytest.mark.parametrize("page", GUIDES, ids=lambda page: page.name)
def test_a_guides_code_runs_and_its_bodies_are_read(page, tmp_path, monkeypatch):
    """Python blocks in their order, in one session; every TOML block is a body file."""
    monkeypatch.chdir(tmp_path)
    with patch.dict(invdyn.inference.METHODS):  # a guide may register one
        session(page)
    for number, block in enumerate(blocks(page, "toml")):
        (tmp_path / f"{number}.toml").write_text(block)
        assert load_body(str(tmp_path / f"{number}.toml")).num_joints > 0


@pytest.mark.parametrize("name", ["deeplabcut", "robot_log", "cluster"])
def test_a_guides_commands_run(name, folder, run, quick_inference):
    """On files as the guide describes them, without the inference itself and with too few rows for a search."""
    page = ROOT / "docs" / "how-to" / f"{name}.md"
    for block in blocks(page, "toml"):
        (folder / "arm.toml").write_text(block)
    deeplabcut(folder / "tracks.csv", links=(0.30 / 0.0021, 0.26 / 0.0021), frames=30)
    if name == "robot_log":
        rows = [f"{0.02 * t:.2f},{-1.5 + 0.01 * t:.2f},1.0\n" for t in range(12)]
        for file in ("rec.csv", "other.csv"):
            (folder / file).write_text("time,shoulder_angle,shoulder_torque\n" + "".join(rows))
    lines = commands(page)
    assert lines
    for line in lines:
        outcome = run(*shlex.split(line, comments=True)[1:])
        assert outcome.exit_code == 0, f"{line}: {outcome.stderr}"
    assert len(quick_inference) == sum("invdyn infer" in line for line in lines)
    made = {"deeplabcut": ["arm.nc", "arm.png"], "robot_log": ["found/report.html"], "cluster": ["posterior.nc"]}
    assert all((folder / file).exists() for file in made[name])


@pytest.mark.long
def test_the_motion_guides_command_runs(tmp_path, monkeypatch, run):
    """On the recording of its own Python, whose links are 1 m long."""
    page = ROOT / "docs" / "how-to" / "motion_and_lengths.md"
    monkeypatch.chdir(tmp_path)
    (body,), (line,) = blocks(page, "toml"), commands(page)
    Path("mouse.toml").write_text(body)
    write_keypoint_csv(session(page)["recording"], Path("paw.csv"))
    quick = invdyn.inference.infer_kinematics
    monkeypatch.setattr(
        invdyn.inference,
        "infer_kinematics",
        lambda *given, **options: quick(*given, **options | {"method": "laplace", "num_filters": 4}),
    )
    outcome = run(*shlex.split(line)[1:])
    assert outcome.exit_code == 0, outcome.stderr
    lengths = [float(found) for found in re.findall(r"length ([\d.]+) ±", outcome.stdout)]
    assert lengths == pytest.approx([1.0, 1.0], abs=0.1)  # four of their sds
    assert Path("angles.csv").exists()


@pytest.mark.parametrize(
    ("name", "said"),
    [
        pytest.param("leg_on_the_floor", "contact floor-foot: ", marks=pytest.mark.slow),
        pytest.param("hand_that_holds", "contact left_pad-ball: ", marks=pytest.mark.long),
        pytest.param("muscles_of_an_arm", "Activations", marks=pytest.mark.long),
    ],
)
def test_a_guides_command_runs_on_what_its_code_writes(name, said, tmp_path, monkeypatch, run):
    """On few particles."""
    page = ROOT / "docs" / "how-to" / f"{name}.md"
    monkeypatch.chdir(tmp_path)
    session(page)
    (line,) = commands(page)
    outcome = run(*shlex.split(line)[1:], "--filters", "2", "--particles", "20", "--set", "draws=4")
    assert outcome.exit_code == 0, outcome.stderr
    assert "dynamics by MuJoCo: " in outcome.output
    assert said in outcome.output
    assert all(Path(name).exists() for name in re.findall(r"--out (\S+)", line))


@pytest.mark.slow
@LEFT_OUT
def test_the_robot_guides_commands_run(tmp_path, monkeypatch, run):
    """The check finds no mistake; the corrected file says .4, as the robot does, where the robot's file says .1."""
    page = ROOT / "docs" / "how-to" / "my_robot.md"
    monkeypatch.chdir(tmp_path)
    session(page)
    few = tuple(set(EFFECTS) - {"viscous_friction", "camera_roll"})
    room = import_module("invdyn.diagnosis.diagnose")  # the package's attribute is the function
    real = room.diagnose
    monkeypatch.setattr(room, "diagnose", lambda **given: real(**given | {"without": few, "workers": 1}))
    for line in commands(page):
        outcome = run(*shlex.split(line)[1:])
        assert outcome.exit_code == 0, f"{line}: {outcome.stderr}"
    text = Path("corrected.xml").read_text()
    changed = re.findall(r'name="elbow"[^>]*damping="([\d.]+)"', text)
    assert [float(value) for value in changed] == pytest.approx([0.4], abs=0.02)
    assert Path("found/report.html").exists()


@pytest.mark.quick("guide-*", "README-laplace")
@pytest.mark.parametrize("method", [name for name in generic_methods() if name not in PARAMETER_METHODS])
@pytest.mark.parametrize(
    "page", [ROOT / "README.md", ROOT / "docs" / "how-to" / "own_model.md"], ids=["README", "guide"]
)
def test_every_method_runs_on_the_models_of_the_pages(page, method):
    """In single precision, as they are written; some methods take them in double precision."""
    names: dict[str, Any] = {}
    (block,) = (each for each in blocks(page, "python") if "(StateSpaceModel)" in each)
    exec(compile(block.partition("\nmodel = ")[0], str(page), "exec"), names)
    (kind,) = (each for each in names.values() if isinstance(each, type) and each.__module__ == "builtins")
    model = kind({name: torch.tensor([1.0]) for name in ("step", "stiffness")})
    model.num_steps = 8
    rows = model.simulate(seed=0)[1]
    few = {"svi": {"max_steps": 3}, "svi-markov": {"max_steps": 3}, "vsmc": {"steps": 1}}
    chains = {"nuts": {"chains": 1, "warmup": 3}, "particle-gibbs": {"warmup": 1, "thin": 1}}
    sizes = {"num_filters": 4, "num_particles": 20, "num_draws": 4}
    idata = invdyn.inference.infer_states(model, rows, method=method, seed=0, **sizes, **(few | chains).get(method, {}))
    assert bool(idata["posterior"]["state"].notnull().all())


def test_contributings_effect_is_one():
    """Its names are those that a file in models/effects/ imports."""
    (block,) = blocks(ROOT / "CONTRIBUTING.md", "python")
    lines = "from pyro.distributions import HalfNormal\nfrom invdyn.models.effects import Effect, Parameter\n"
    names: dict[str, Any] = {}
    exec(compile(lines + block, "CONTRIBUTING.md", "exec"), names)
    body = load_body("paper_planar_arm")
    (first, _) = names["QuadraticDrag"].everywhere(body, body.keypoint_names)
    assert first.key == "quadratic_drag.shoulder"


def test_a_guides_effect_can_be_saved_among_the_others():
    """Its file is imported while the package is: what it takes from there stands above the catalogue."""
    (first, *_) = blocks(ROOT / "docs" / "how-to" / "own_effect.md", "python")
    (line,) = (each for each in first.splitlines() if each.startswith("from invdyn.models.effects "))
    source = (ROOT / "models" / "effects" / "__init__.py").read_text("utf-8")
    before, _, after = source.partition("from invdyn.models.effects.catalogue")
    names: dict[str, Any] = {}
    exec(before, names)
    assert {each.strip() for each in line.partition("import")[2].split(",")} <= set(names)
    assert "\nfrom " not in after  # and so does all else that a file may take


def test_the_protocols_answers_have_the_keys_of_a_diagnosis():
    case, answer = (json.loads(block) for block in blocks(ROOT / "docs" / "blind_protocol.md", "json"))
    assert set(case) == {"regime", "held_out", "without"}
    _same_keys(answer, diagnosis().to_json(), "diagnosis.json")
    for cause in answer["causes"]:
        for finding in cause["effects"]:
            assert finding["effect"] in EFFECTS


def _same_keys(shown: Any, real: Any, where: str) -> None:
    """Keys that are shown are there; those of joints and parameters are anybody's."""
    if isinstance(shown, dict) and isinstance(real, dict):
        named = where.split(".")[-1] in ("joints", "keypoints", "parameters")
        assert named or set(shown) <= set(real), where
        for key in set(shown) & set(real):
            _same_keys(shown[key], real[key], f"{where}.{key}")
    elif isinstance(shown, list) and isinstance(real, list) and shown and real:
        _same_keys(shown[0], real[0], where)
