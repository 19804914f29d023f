"""Workflows call what is there: make's targets, the extras of `make install`, a version that the changelog tells of.

They cannot run here; what they call is run by other tests, by `make`, or by hand before a release.
"""

import os
import re
import shutil
import subprocess
import tomllib

import pytest
from pages import ROOT

yaml = pytest.importorskip("yaml", reason="comes with the extra cluster")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
MAKEFILE = (ROOT / "Makefile").read_text("utf-8")


def jobs(name: str) -> dict:
    return yaml.safe_load((ROOT / ".github" / "workflows" / f"{name}.yml").read_text("utf-8"))["jobs"]


def runs(name: str) -> list[str]:
    return [step["run"] for job in jobs(name).values() for step in job["steps"] if "run" in step]


def extras(text: str) -> set[str]:
    (found,) = re.findall(r"-e ['\"]\.\[([^\]]*dev[^\]]*)\]", text)
    return set(found.split(","))


def test_checks_call_targets_and_install_what_make_does():
    lines = runs("checks")
    targets = [target for line in lines for target in re.findall(r"^make (?:-j \d+ )?(\w+)", line)]
    assert set(targets) == {"lint", "docs"}
    assert all(re.search(rf"^{target}:", MAKEFILE, re.MULTILINE) for target in targets)
    assert extras("\n".join(lines)) == extras(MAKEFILE)
    assert extras(MAKEFILE) <= set(PROJECT["optional-dependencies"])


def test_tests_run_on_three_systems_and_the_versions_that_are_allowed():
    matrix = jobs("checks")["test"]["strategy"]["matrix"]
    assert {name.split("-")[0] for name in matrix["os"]} == {"ubuntu", "macos", "windows"}
    assert len(matrix["python"]) == 3
    assert PROJECT["requires-python"] == f">={matrix['python'][0]}"


def test_the_version_is_one():
    cited = re.search(r"^version: (\S+)$", (ROOT / "CITATION.cff").read_text("utf-8"), re.MULTILINE)[1]
    listed = re.findall(r"^## \[(\d\S*)\]", (ROOT / "CHANGELOG.md").read_text("utf-8"), re.MULTILINE)
    assert PROJECT["version"] == cited == listed[0]


@pytest.mark.skipif(not (shutil.which("bash") and shutil.which("sed")), reason="the step is a line for bash")
def test_a_release_tells_its_own_changes(tmp_path):
    (line,) = [line for line in runs("release") if "notes.md" in line and "sed" in line]
    shutil.copy(ROOT / "CHANGELOG.md", tmp_path)

    def notes(tag: str) -> int:
        environment = {**os.environ, "GITHUB_REF_NAME": tag}
        return subprocess.run(["bash", "-ec", line], cwd=tmp_path, env=environment).returncode

    assert notes(f"v{PROJECT['version']}") == 0
    text = (tmp_path / "notes.md").read_text("utf-8")
    assert "### Added" in text
    assert "## [" not in text
    assert "Planar chains from TOML, MJCF and URDF; torque processes" not in text  # 0.1.0
    assert notes("v99.0.0") != 0
