"""What the pages say is what the program does: commands parse, the files shown are read, links lead somewhere."""

import importlib.util
import re
import shlex
from pathlib import Path

import numpy as np
import pytest
import typer.main
from stand_in import deeplabcut

from invdyn.cli import app
from invdyn.inputs import load_body, load_recording

ROOT = Path(__file__).parents[2]
WRITTEN = ("reference/cli.md", "reference/effects.md", "reference/api")
"""Pages that the site's build writes from the code."""
PAGES = [
    page
    for page in sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *(ROOT / "benchmarks").glob("*.md")])
    if not str(page.relative_to(ROOT)).startswith(tuple(f"docs/{name}" for name in WRITTEN))
]
GUIDES = sorted((ROOT / "docs" / "how-to").glob("*.md"))
FILES = ROOT / "docs" / "files.md"


def blocks(page: Path, language: str) -> list[str]:
    """Contents of the fenced blocks of a language ("" for none)."""
    found = re.findall(r"^```(\w*)\n(.*?)^```$", page.read_text(), re.DOTALL | re.MULTILINE)
    return [block for said, block in found if said == language]


def commands() -> list[tuple[str, str]]:
    """(page, command line), continued lines joined."""
    lines = [
        (page.name, line)
        for page in PAGES
        for block in blocks(page, "")
        for line in block.replace("\\\n", " ").splitlines()
    ]
    return [(name, line) for name, line in lines if line.startswith("invdyn ")]


@pytest.mark.parametrize(("page", "line"), commands())
def test_a_command_can_be_pasted_into_a_shell(page, line):
    """Nothing for the shell in it, no stray words, and every option is one of that command's."""
    words = shlex.split(line, comments=True)
    assert not re.search(r"[<>|;&`$]", line.split(" #")[0]), f"{page}: the shell would read {line!r} otherwise"
    command = typer.main.get_command(app).commands[words[1]]
    with command.make_context(words[1], words[2:]) as context:
        assert context.params


def test_pages_have_commands():
    assert len(commands()) > 12


def test_the_recording_and_the_body_shown_fit_one_another(tmp_path):
    (table,), (body_file,) = blocks(FILES, "csv"), blocks(FILES, "toml")
    (tmp_path / "rec.csv").write_text(table)
    (tmp_path / "arm.toml").write_text(body_file)
    body = load_body(str(tmp_path / "arm.toml"))
    recording = load_recording(str(tmp_path / "rec.csv"), body, None, False, as_filmed=True)
    assert recording.keypoint_names == body.keypoint_names
    assert recording.joint_names == body.joint_names
    assert np.isnan(recording.keypoints[1]).all()
    assert np.isfinite(recording.torques).all()


def test_the_snippet_turns_a_log_into_a_recording(tmp_path, monkeypatch):
    (snippet,) = blocks(FILES, "python")
    monkeypatch.chdir(tmp_path)
    Path("robot_log.csv").write_text("t,q1,q2,tau1,tau2\n0,0,0.1,1,2\n0.1,0.2,0.1,1,2\n")
    exec(compile(snippet, str(FILES), "exec"), {})
    recording = load_recording("rec.csv", load_body(str(_body(tmp_path))), None, False, as_filmed=True)
    np.testing.assert_allclose(recording.angles, [[-np.pi / 2, 0.1], [0.2 - np.pi / 2, 0.1]])


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_relative_links_lead_to_files(page):
    for target in re.findall(r"\]\(([^)#:\s]+)(?:#[^)]*)?\)", page.read_text()):
        place = page.parent / target
        if place.suffix == ".ipynb":  # made from the notebook's text
            place = ROOT / "notebooks" / f"{place.stem}.py"
        assert place.exists(), f"{page.name} links to {target}"


@pytest.mark.filterwarnings("ignore:.*a rigid body leaves out:UserWarning")  # what a file has besides is told
@pytest.mark.parametrize("page", GUIDES, ids=lambda page: page.name)
def test_a_guides_code_runs_and_its_bodies_are_read(page, tmp_path, monkeypatch):
    """Python blocks in their order, in one session; every TOML block is a body file."""
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    for block in blocks(page, "python"):
        exec(compile(block, str(page), "exec"), names)
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
    lines = [line for said, line in commands() if said == page.name]
    assert lines
    for line in lines:
        outcome = run(*shlex.split(line, comments=True)[1:])
        assert outcome.exit_code == 0, f"{line}: {outcome.stderr}"
    assert len(quick_inference) == sum("invdyn infer" in line for line in lines)
    made = {"deeplabcut": ["arm.nc", "arm.png"], "robot_log": ["diagnosis/report.html"], "cluster": ["posterior.nc"]}
    assert all((folder / file).exists() for file in made[name])


def _body(folder: Path) -> Path:
    (folder / "arm.toml").write_text(blocks(FILES, "toml")[0])
    return folder / "arm.toml"


def test_the_picture_of_the_rooms_is_that_of_the_code():
    script = _script(ROOT / "docs" / "architecture_picture.py")
    assert script.PICTURE.read_text(encoding="utf-8") == script.drawn(), "run python docs/architecture_picture.py"


def _script(path: Path):
    spec = importlib.util.spec_from_file_location(path.stem, path)
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    return script


def test_each_table_of_the_benchmarks_has_a_script_and_a_place():
    page = _script(ROOT / "benchmarks" / "page.py")
    text = page.PAGE.read_text("utf-8")
    for name, command in page.COMMANDS.items():
        assert (ROOT / "benchmarks" / command.split()[0]).exists(), name
        assert "| new |" in page.replaced(text, name, "| new |")
    with pytest.raises(ValueError, match="expected <!-- nothing -->"):
        page.replaced(text, "nothing", "")


def test_a_table_is_what_a_script_prints_between_bars():
    page = _script(ROOT / "benchmarks" / "page.py")
    printed = "4 cores\n\n| a | b |\n|---|---|\n| 1 | 2 |\n\nload 3\n| c |\n|---|\n| 4 |\n"
    first, second = "| a | b |\n|---|---|\n| 1 | 2 |", "| c |\n|---|\n| 4 |"
    assert page.tables(printed) == f"**4 cores**\n\n{first}\n\n**load 3**\n\n{second}"
    assert page.tables(f"4 cores\n\n{first}\n\nload 3\n") == first
    text = "x\n<!-- one -->\nold\n<!-- end -->\n<!-- two -->\nkept\n<!-- end -->\n"
    assert page.replaced(text, "one", "new") == text.replace("old", "new")
    assert "commit" in page.stamp("cost.py")
