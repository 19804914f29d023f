"""Whatever happens to a file, the user gets one line, an InputError or OSError, or a sound recording."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from invdyn.recordings import InputError, load, read_sto, read_truth

GOOD = {
    "rec.csv": "time,a_x,a_y,a_likelihood,s_torque,s_angle\n0,1,2,.9,0,0.5\n0.1,1,2,.8,,0.6\n0.2,,,,1,0.7\n",
    "dlc.csv": "scorer,n,n,n\nbodyparts,a,a,a\ncoords,x,y,likelihood\n0,1,2,.5\n1,3,4,.5\n2,3,4,.5\n",
    "arm.trc": (
        "PathFileType\t4\t(X/Y/Z)\ta.trc\nDataRate\tUnits\n10\tmm\nFrame#\tTime\ta\t\t\n\t\tX1\tY1\tZ1\n\n"
        "1\t0\t1\t2\t3\n2\t.1\t1\t2\t3\n"
    ),
    "nexus.csv": "Trajectories\n100\n,,A:a,,\nFrame,Sub Frame,X,Y,Z\n,,mm,mm,mm\n1,0,1,2,3\n2,0,1,2,3\n\nEvents\n",
    "walk.mot": "Coordinates\nnRows=2\ninDegrees=yes\nendheader\ntime,a\n0,1\n1,2\n",
    "out.sto": "name\nversion=1\nnRows=2\nnColumns=2\ninDegrees=no\nendheader\ntime\ta\n0\t1\n1\t2\n",
    "truth.csv": "time,a_torque,a_angle,a_velocity\n0,1,2,3\n1,1,2,3\n",
}
READERS = {
    "dlc.csv": lambda path: load(path, units="px", fps=30),
    "arm.trc": lambda path: load(path, plane="xy"),
    "out.sto": read_sto,
    "truth.csv": read_truth,
}


@st.composite
def damage(draw, text: bytes) -> bytes:
    """Cut, overwrite, repeat or insert at a random place, up to three times."""
    for _ in range(draw(st.integers(1, 3))):
        start = draw(st.integers(0, len(text)))
        stop = draw(st.integers(start, min(len(text), start + 40)))
        new = draw(st.sampled_from([b"", text[start:stop] * 2, b",", b"\t", b"\n", b'"', b"inf", b"\0", b"1e999"]))
        text = text[:start] + draw(st.one_of(st.just(new), st.binary(max_size=6))) + text[stop:]
    return text


@pytest.mark.parametrize("name", GOOD)
def test_the_whole_file_is_good(tmp_path, name):
    (tmp_path / name).write_text(GOOD[name])
    READERS.get(name, load)(tmp_path / name)


@pytest.mark.filterwarnings("ignore:.*was the file cut off")
@pytest.mark.parametrize("name", GOOD)
def test_damage_is_told_in_one_line(tmp_path, name):
    path = tmp_path / name

    @given(content=damage(GOOD[name].encode()))
    @settings(max_examples=150)
    def check(content):
        path.write_bytes(content)
        message = f"{path}"
        try:
            READERS.get(name, load)(path)
        except (InputError, OSError) as error:
            message = str(error)
        assert len(message.splitlines()) == 1
        assert str(path) in message

    check()
