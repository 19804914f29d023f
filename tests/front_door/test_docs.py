"""What the pages say is what the program does: commands parse, the files shown are read, links lead somewhere."""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest
import typer.main
from pages import PAGES, ROOT, blocks, commands, script

from invdyn.cli import app
from invdyn.inputs import load_body, load_recording

FILES = ROOT / "docs" / "files.md"
PICTURE = re.compile(r"!\[[^\]]*\]\(([^)]*)\)")


@pytest.mark.parametrize(("page", "line"), [(page.name, line) for page in PAGES for line in commands(page)])
def test_a_command_can_be_pasted_into_a_shell(page, line):
    """Nothing for the shell in it, no other words, and every option is one of that command's."""
    words = shlex.split(line, comments=True)
    assert not re.search(r"[<>|;&`$]", line.split(" #")[0]), f"{page}: the shell would read {line!r} otherwise"
    command = typer.main.get_command(app).commands[words[1]]
    with command.make_context(words[1], words[2:]) as context:
        assert context.params


def test_pages_have_commands():
    assert sum(len(commands(page)) for page in PAGES) > 12


def test_the_recording_and_the_body_shown_fit_one_another(tmp_path):
    (table,), (body_file,) = blocks(FILES, "csv"), blocks(FILES, "toml")
    (tmp_path / "rec.csv").write_text(table)
    (tmp_path / "arm.toml").write_text(body_file)
    body = load_body(str(tmp_path / "arm.toml"))
    recording = load_recording(str(tmp_path / "rec.csv"), body, as_filmed=True)
    assert recording.keypoint_names == body.keypoint_names
    assert recording.joint_names == body.joint_names
    assert np.isnan(recording.keypoints[1]).all()
    assert np.isfinite(recording.torques).all()


def test_the_snippet_turns_a_log_into_a_recording(tmp_path, monkeypatch):
    (snippet,) = blocks(FILES, "python")
    monkeypatch.chdir(tmp_path)
    Path("robot_log.csv").write_text("t,q1,q2,tau1,tau2\n0,0,0.1,1,2\n0.1,0.2,0.1,1,2\n")
    exec(compile(snippet, str(FILES), "exec"), {})
    recording = load_recording("rec.csv", load_body(str(_body(tmp_path))), as_filmed=True)
    np.testing.assert_allclose(recording.angles, [[-np.pi / 2, 0.1], [0.2 - np.pi / 2, 0.1]])


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_relative_links_lead_to_files(page):
    for target in re.findall(r"\]\(([^)#:\s]+)(?:#[^)]*)?\)", page.read_text()):
        place = page.parent / target
        if place.suffix == ".ipynb":  # made from the notebook's text
            place = ROOT / "notebooks" / f"{place.stem}.py"
        assert place.exists(), f"{page.name} links to {target}"


def _body(folder: Path) -> Path:
    (folder / "arm.toml").write_text(blocks(FILES, "toml")[0])
    return folder / "arm.toml"


def test_the_picture_of_the_rooms_is_that_of_the_code():
    picture = script("docs/architecture_picture.py")
    assert picture.PICTURE.read_text(encoding="utf-8") == picture.drawn(), "run python docs/architecture_picture.py"


def test_each_picture_of_a_page_is_made_by_a_script():
    shown = {Path(link).name for page in PAGES for link in PICTURE.findall(page.read_text("utf-8"))}
    scripts = [*(ROOT / "docs").glob("*.py"), *(ROOT / "benchmarks").glob("*.py")]
    text = "".join(script.read_text("utf-8") for script in scripts)
    kept = {path.name for ending in ("png", "gif", "svg") for path in (ROOT / "docs").glob(f"*.{ending}")}
    assert shown == kept
    assert {name for name in kept if f'"{name}"' not in text} == set()


def test_each_table_of_the_benchmarks_has_a_script_and_a_place():
    page = script("benchmarks/page.py")
    text = page.PAGE.read_text("utf-8")
    for name, command in page.COMMANDS.items():
        assert (ROOT / "benchmarks" / command.split()[0]).exists(), name
        assert "| new |" in page.replaced(text, name, "| new |")
    with pytest.raises(ValueError, match="expected <!-- nothing -->"):
        page.replaced(text, "nothing", "")


def test_a_table_is_what_a_script_prints_between_bars():
    page = script("benchmarks/page.py")
    printed = "4 cores\n\n| a | b |\n|---|---|\n| 1 | 2 |\n\nload 3\n| c |\n|---|\n| 4 |\n"
    first, second = "| a | b |\n|---|---|\n| 1 | 2 |", "| c |\n|---|\n| 4 |"
    assert page.tables(printed) == f"**4 cores**\n\n{first}\n\n**load 3**\n\n{second}"
    assert page.tables(f"4 cores\n\n{first}\n\nload 3\n") == first
    text = "x\n<!-- one -->\nold\n<!-- end -->\n<!-- two -->\nkept\n<!-- end -->\n"
    assert page.replaced(text, "one", "new") == text.replace("old", "new")
    assert "commit" in page.stamp("cost.py")
