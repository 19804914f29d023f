"""A foreign method that looks for the seed and the answers does not find them, where it is kept from them."""

import json
import os
import shutil
import sys
import tempfile
from pathlib import Path

import pytest

from invdyn.blindcheck.confined import Confined, confined
from invdyn.blindcheck.methods import Theirs
from invdyn.recordings import InputError

SPY = """#!/bin/sh
# Writes down which files it could read, whether it could change its case, and how many processes it sees.
out=$1; shift
for file in "$@"; do
  if head -c 1 "$file" > /dev/null 2>&1 && [ -n "$(head -c 1 "$file" 2>/dev/null | tr -d '\\0')" ]; then
    echo "$file" >> "$out/read.txt"
  fi
done
touch case.json 2> /dev/null && echo "case.json" >> "$out/changed.txt"
ls -d /proc/[0-9]* | wc -l > "$out/processes.txt"
cp answer.json "$out/diagnosis.json"
"""
FOUND = {
    "gap": {"detected": False, "elpd_per_frame": {"nominal": 1.0, "corrected": 1.0}},
    "causes": [{"effects": [], "probability": 0.9}],
    "outside_catalogue": {"probability": 0.1},
}


@pytest.fixture
def place():
    """A run's folder that every user may enter, with a case, another one, and a seed's file next to it."""
    place = Path(tempfile.mkdtemp())
    place.chmod(0o755)
    for case in ("case-0000", "case-0001"):
        (place / "run" / "cases" / case).mkdir(parents=True)
        (place / "run" / "cases" / case / "case.json").write_text("{}")
        (place / "run" / "cases" / case / "answer.json").write_text(json.dumps(FOUND))
    (place / "run" / "out").mkdir()
    (place / "run" / "sealed.json").write_text("a hash")
    (place / "seed.txt").write_text("123456789")
    (place / "seed.txt").chmod(0o600)
    (place / "spy").write_text(SPY)
    (place / "spy").chmod(0o755)
    yield place
    shutil.rmtree(place)


def spied(place, keeps):
    """What the spy could read, by kind; and how many processes it saw."""
    files = {
        "its case": place / "run/cases/case-0000/answer.json",
        "another case": place / "run/cases/case-0001/answer.json",
        "the seal": place / "run/sealed.json",
        "the seed": place / "seed.txt",
        "our environment": Path(f"/proc/{os.getpid()}/environ"),
        "our command line": Path(f"/proc/{os.getpid()}/cmdline"),
    }
    out = place / "run" / "out"
    method = Theirs(" ".join([str(place / "spy"), "{out}", *map(str, files.values())]), keeps)
    assert method(place / "run/cases/case-0000", out) is None
    told = (out / "read.txt").read_text().split()
    changed = (out / "changed.txt").exists()
    return (
        {kind for kind, path in files.items() if str(path) in told},
        int((out / "processes.txt").read_text()),
        changed,
    )


def test_in_a_container_it_sees_its_case_alone(place):
    keeps = confined(None, True, [place / "run", place / "seed.txt"])
    if not keeps.container:
        pytest.skip("no bubblewrap that works here")
    read, processes, changed = spied(place, keeps)
    assert read == {"its case"}
    assert processes < 10
    assert not changed


@pytest.mark.skipif(not hasattr(os, "getuid") or os.getuid() != 0, reason="only root can run as another user")
def test_another_user_reads_what_that_user_may(place):
    keeps = confined("nobody", True, [place / "run", place / "seed.txt"])
    keeps.check(place / "run")
    read, _, changed = spied(place, keeps)
    assert read == {"its case", "another case", "the seal", "our command line"}
    assert not changed
    assert (place / "run/out").stat().st_uid == os.getuid()  # what it left running can change nothing any more
    (place / "seed.txt").chmod(0o644)
    with pytest.raises(InputError, match="can read the seed's file; chmod 600 it"):
        keeps.check(place / "run")
    place.chmod(0o700)
    with pytest.raises(InputError, match="does not reach this folder"):
        keeps.check(place / "run")


def test_an_unconfined_run_says_so(place):
    read, *_ = spied(place, Confined())
    assert {"its case", "another case", "the seal", "the seed"} <= read
    assert "can read what you can" in Confined().described()
    if sys.platform == "linux" and os.getuid() != 0:  # root reads all the same
        assert "our environment" not in read


def test_a_user_that_is_not_there(place):
    with pytest.raises(InputError, match="expected a user of this machine, got 'no such user'"):
        Confined(user="no such user").check(place)


def test_the_words_of_a_container(place):
    """With any tools installed: the run's folder is empty in it, the seed's file too, and the case cannot change."""
    keeps = Confined(container=True, hidden=(place / "run", place / "seed.txt"))
    words = keeps.container_command(place / "run/cases/case-0000", place / "run/out")
    text = " ".join(words)
    assert words[0] == "bwrap"
    assert "--unshare-all" in words
    real = place.resolve()
    hides = text.index(f"--tmpfs {real}/run")
    assert f"--ro-bind /dev/null {real}/seed.txt" in text
    assert text.index(f"--ro-bind {place}/run/cases/case-0000") > hides
    assert text.index(f"--bind {place}/run/out") > hides
