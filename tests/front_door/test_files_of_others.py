"""Files of others in bounded memory: a clear line or a reading, no traceback, nothing over budget, nothing left over.

The inputs are those of `malformed.others`. Each but the costly ones is read once; `pytest -m slow` reads 1,000,
drawn by hypothesis from all.
"""

import random
import shutil
import sys
from collections import Counter

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from malformed.bounded import Bounded
from malformed.others import ALL, BOMB, EITHER, ODD, PATH, READ, REFUSE

for module in ("mcap", "rosbags", "pyarrow", "safetensors", "mujoco"):
    pytest.importorskip(module)
pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="bounds of a process as Linux has them")

KINDS = (BOMB, PATH, ODD)
FINE = {REFUSE: {"clear line"}, READ: {"read"}, EITHER: {"clear line", "read"}}


@pytest.fixture(scope="module")
def tried(tmp_path_factory):
    """Function of an input and a seed: its outcome. "silent" is a file that had to be refused and was read."""
    folder = tmp_path_factory.mktemp("others")

    with Bounded() as bounded:

        def tried(hostile, seed):
            own, temporary = folder / "own", folder / "temporary"
            own.mkdir()
            temporary.mkdir()
            try:
                path = hostile.make(own, random.Random(seed))
                before = _tree(own)
                found = bounded.read(hostile.reader, path, temporary)
                if any(temporary.iterdir()) or _tree(own) != before:
                    return found | {"outcome": "left over"}
            finally:
                shutil.rmtree(own)
                shutil.rmtree(temporary)
            if found["outcome"] == "read" and hostile.must == REFUSE:
                return found | {"outcome": "silent"}
            if found["outcome"] == "clear line" and hostile.must == READ:
                return found | {"outcome": "refused"}
            return found

        yield tried


def _tree(folder):
    return {str(path.relative_to(folder)): path.lstat().st_size for path in folder.rglob("*")}


@pytest.mark.quick("paths out of a bag")
@pytest.mark.parametrize("kind", KINDS)
def test_each_input_once(tried, kind):
    """All but those that take seconds, whose sizes are those of others."""
    wrong = {}
    for hostile in ALL:
        if hostile.kind == kind and not hostile.costly:
            found = tried(hostile, 0)
            if found["outcome"] not in FINE[hostile.must]:
                wrong[hostile.what] = found
    assert not wrong


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("part", range(10))
def test_drawn_inputs(tried, capsys, part):
    tried_here = 100
    count = Counter()
    wrong = {}
    peak = 0

    @given(hostile=st.sampled_from(ALL), seed=st.integers(0, 2**32))
    @settings(max_examples=tried_here, database=None, suppress_health_check=list(HealthCheck))
    def draw(hostile, seed):
        nonlocal peak
        found = tried(hostile, seed + part)
        count[hostile.kind, "tried"] += 1
        count[hostile.kind, found["outcome"]] += 1
        peak = max(peak, found["peak"])
        if found["outcome"] not in FINE[hostile.must]:
            wrong[hostile.what, seed] = found

    draw()
    outcomes = ("tried", "clear line", "read", "traceback", "over budget", "left over", "silent")
    others = sorted({outcome for _, outcome in count} - {*outcomes})
    with capsys.disabled():
        print(f"\n{'':22}" + "".join(f"{outcome:>13}" for outcome in (*outcomes, *others)))
        for kind in KINDS:
            print(f"{kind:22}" + "".join(f"{count[kind, outcome]:13}" for outcome in (*outcomes, *others)))
        print(f"peak of memory {peak / 2**20:.0f} MiB")
    assert not wrong
    assert sum(count[kind, "tried"] for kind in KINDS) >= 0.9 * tried_here


@pytest.mark.filterwarnings("default")
def test_a_file_that_is_read_twice_warns_once(run, data_folder, tmp_path):
    """The first reading tells the plane from space; the second is the one that is used."""
    folder = data_folder / "opensim_arm26"
    body = ("--body", folder / "arm26.osim", "--frames", "500:600", "--out", tmp_path / "never.nc")
    outcome = run("infer", folder / "arm26_elbow_flex.trc", *body)
    assert outcome.exit_code == 2
    assert outcome.stderr.count("y is up in this file") == 1
