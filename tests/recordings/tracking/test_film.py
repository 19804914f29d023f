"""Films: every picture with the file's own time, as one sees it."""

import subprocess

import imageio_ffmpeg
import numpy as np
import pytest
from filmed import picture, swinging, write_film

from invdyn.recordings import InputError
from invdyn.recordings.paths import is_film
from invdyn.recordings.tracking.film import Film, read_pictures


def test_pictures_come_back_with_uneven_times(tmp_path):
    rng = np.random.default_rng(0)
    times = np.array([0.5, 0.533, 0.61, 0.62, 0.9])  # a film need not start at 0; times count from its first picture
    pictures = [rng.integers(0, 256, (36, 40, 3), dtype=np.uint8) for _ in times]
    film = Film(write_film(tmp_path / "f.mov", pictures, times))
    assert (film.width, film.height, film.expected, film.aspect) == (40, 36, 5, 1)
    found = list(film.pictures())
    assert [each.number for each in found] == [0, 1, 2, 3, 4]
    np.testing.assert_allclose([each.time for each in found], times - 0.5, atol=1e-9)
    np.testing.assert_array_equal([each.rgb for each in found], pictures)
    np.testing.assert_array_equal(list(read_pictures(film, [1, 3])), [pictures[1], pictures[3]])
    assert [each.number for each in film.pictures(start=3)] == [3, 4]


def test_scaling_averages_over_areas(tmp_path):
    rng = np.random.default_rng(1)
    rgb = np.repeat(rng.integers(0, 256, (40, 60, 1), dtype=np.uint8), 3, -1)  # grey: colours are scaled more coarsely
    film = Film(write_film(tmp_path / "f.mov", [rgb], [0.0]))
    (small,) = film.pictures((10, 20))
    expected = rgb.reshape(10, 4, 20, 3, 3).mean((1, 3))
    assert np.abs(small.rgb - expected).max() <= 2  # the scaler's own rounding


@pytest.mark.parametrize("degrees", [90, 180, 270])
def test_a_telephones_film_is_turned_as_ffmpeg_turns_it(tmp_path, degrees):
    """ffmpeg writes the rotation into a copy, and its own decoder says how that is to be seen."""
    rng = np.random.default_rng(2)
    write_film(tmp_path / "f.mov", [rng.integers(0, 256, (20, 30, 3), dtype=np.uint8)], [0.0])
    ffmpeg, turned = imageio_ffmpeg.get_ffmpeg_exe(), tmp_path / "turned.mov"
    copy = [ffmpeg, "-v", "error", "-display_rotation", str(degrees), "-i", tmp_path / "f.mov", "-c", "copy", turned]
    subprocess.run(copy, check=True)
    film = Film(turned)
    decode = [ffmpeg, "-v", "error", "-i", turned, "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    raw = subprocess.run(decode, check=True, capture_output=True).stdout
    seen = np.frombuffer(raw, np.uint8).reshape(film.height, film.width, 3)
    assert (film.width, film.height) == ((30, 20) if degrees == 180 else (20, 30))
    np.testing.assert_array_equal(next(film.pictures()).rgb, seen)
    assert next(film.pictures((15, 10))).rgb.shape == (15, 10, 3)


def test_what_cannot_be_decoded_is_one_line(tmp_path):
    swinging(tmp_path / "good.mov", 5)
    whole = (tmp_path / "good.mov").read_bytes()
    (tmp_path / "words.mp4").write_text("no film at all")
    (tmp_path / "cut.mov").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "empty.mp4").write_bytes(b"")
    for name in ("words.mp4", "cut.mov", "empty.mp4"):
        with pytest.raises(InputError, match=rf"{name}: not a film that can be decoded \(.+\)$"):
            Film(tmp_path / name)
    with pytest.raises(InputError, match="no picture 7 in this film: are the labels another film's"):
        list(read_pictures(Film(tmp_path / "good.mov"), [2, 7]))
    with pytest.raises(OSError, match="nowhere"):
        Film(tmp_path / "nowhere.mp4")


def test_sound_alone_is_no_film(tmp_path):
    tone = ["-f", "lavfi", "-i", "sine=duration=0.2", tmp_path / "tone.mp4"]
    subprocess.run([imageio_ffmpeg.get_ffmpeg_exe(), "-v", "error", *tone], check=True)
    with pytest.raises(InputError, match="there are no pictures in this file"):
        Film(tmp_path / "tone.mp4")


def test_without_the_package(tmp_path, monkeypatch):
    swinging(tmp_path / "f.mov", 2)
    monkeypatch.setitem(__import__("sys").modules, "av", None)
    with pytest.raises(InputError, match=r"f.mov: .*pip install 'invdyn\[tracking\]'"):
        Film(tmp_path / "f.mov")


def test_a_films_suffix():
    assert is_film("a/b.MP4")
    assert not is_film("tracks.csv")
    assert picture(np.array([[20.0, 22.0], [20.0, 31.0]]))[22, 20].argmax() == 0  # red at the elbow


def test_a_playlist_is_no_film(tmp_path):
    """It would have FFmpeg read other files."""
    (tmp_path / "elsewhere").mkdir()
    write_film(tmp_path / "elsewhere" / "f.mov", [np.zeros((32, 32, 3), np.uint8)] * 5, np.arange(5) / 30)
    (tmp_path / "f.mov").write_bytes((tmp_path / "elsewhere" / "f.mov").read_bytes())
    head = "#EXTM3U\n#EXT-X-TARGETDURATION:9\n#EXTINF:1,\n"
    (tmp_path / "hls.m3u8").write_text(f"{head}{tmp_path}/elsewhere/f.mov\n#EXT-X-ENDLIST\n")
    (tmp_path / "concat.mp4").write_text("ffconcat version 1.0\nfile f.mov\n")
    for name in ("hls.m3u8", "concat.mp4"):
        with pytest.raises(InputError, match=rf"{name}: not a film that can be decoded"):
            Film(tmp_path / name)


def with_time_scale(film, box, scale):
    """A film's bytes with another number of ticks a second in a box of its header, mvhd or mdhd."""
    whole = film.read_bytes()
    at = whole.index(box) + 16
    return whole[:at] + scale.to_bytes(4, "big") + whole[at + 4 :]


@pytest.mark.parametrize(("box", "scale"), [(b"mvhd", 10**6), (b"mdhd", 1), (b"mdhd", 0)])
def test_a_damaged_time_scale_is_refused(tmp_path, box, scale):
    swinging(tmp_path / "good.mov", 20)
    assert Film(tmp_path / "good.mov").expected == 20
    (tmp_path / "bad.mov").write_bytes(with_time_scale(tmp_path / "good.mov", box, scale))
    with pytest.raises(
        InputError, match=r"bad\.mov: the file holds 20 pictures, but its times show [12]: its time scale"
    ):
        Film(tmp_path / "bad.mov")


def test_pictures_that_an_edit_list_leaves_out_are_said(tmp_path):
    swinging(tmp_path / "whole.mov", 20)
    shorter = with_time_scale(tmp_path / "whole.mov", b"mvhd", 1300)  # edits are in ticks of the movie, 1000 a second
    (tmp_path / "cut.mov").write_bytes(shorter)
    with pytest.warns(UserWarning, match=r"holds 20 pictures, but its times show 1\d: an edit list leaves"):
        film = Film(tmp_path / "cut.mov")
    assert 10 <= len(list(film.pictures())) < 20
