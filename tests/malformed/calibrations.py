"""Damaged calibrations of all kinds, and what is no film or no option of several cameras."""

from collections.abc import Iterator

from .case import HUGE, NUMBERS, Case, with_option
from .paths import device, directory, loop, pipe

CAMERAS = {
    "toml": """[cam1]
size = [640, 480]
matrix = [[800.0, 0.0, 320.0], [0.0, 810.0, 240.0], [0.0, 0.0, 1.0]]
distortions = [-0.1, 0.0, 0.0, 0.0]
rotation = [0.0, 0.0, 0.0]
translation = [0.0, 0.0, 2.0]
fisheye = false
[cam2]
size = [640, 480]
matrix = [[800.0, 0.0, 320.0], [0.0, 810.0, 240.0], [0.0, 0.0, 1.0]]
distortions = [-0.1, 0.0, 0.0, 0.0]
rotation = [0.0, 1.5, 0.0]
translation = [0.5, 0.0, 2.0]
fisheye = false
[metadata]
error = 0.31
""",
    "qca.txt": """<?xml version='1.0'?>
<calibration><cameras>
<camera serial="cam1" model="none" viewrotation="0"><fov_video bottom="1079" left="10" right="1929" top="0"/>
<transform r11="1" r12="0" r13="0" r21="0" r22="1" r23="0" r31="0" r32="0" r33="1" x="1000" y="2000" z="3000"/>
<intrinsic centerPointU="61440" centerPointV="34560" focalLengthU="64000" focalLengthV="64640" skew="0"
radialDistortion1="-0.1" radialDistortion2="0.02" radialDistortion3="0.003" tangentalDistortion1="0.001"
tangentalDistortion2="0.002"/></camera>
</cameras></calibration>
""",
    "yml": """%YAML:1.0
---
image_width: 640
image_height: 480
M1: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 800., 0., 320., 0., 810., 240., 0., 0., 1. ]
D1: [ -0.1, 0., 0., 0. ]
M2: [ [ 800., 0., 320. ], [ 0., 810., 240. ], [ 0., 0., 1. ] ]
D2: [ -0.1, 0., 0., 0. ]
R: [ 0., 1.5, 0. ]
T: [ 0.5, 0., 2. ]
""",
    "json": """{"image_size": [640, 480],
"M1": [[800.0, 0, 320], [0, 810, 240], [0, 0, 1]], "D1": [-0.1, 0, 0, 0],
"M2": [[800.0, 0, 320], [0, 810, 240], [0, 0, 1]], "D2": [-0.1, 0, 0, 0],
"R": [0, 1.5, 0], "T": [0.5, 0, 2]}
""",
}
"""A good calibration of each kind."""
ENTITIES = '<!DOCTYPE a [<!ENTITY b "bbbbbbbbbb"><!ENTITY c "&b;&b;&b;&b;&b;&b;&b;&b;">]><calibration>&c;</calibration>'
WHOLE = {
    "nothing": "",
    "zeros": bytes(1000),
    "a byte": b"\xff",
    "deep lists": "a = " + "[" * 5000 + "]" * 5000,
    "deep tables": '{"a":' * 100_000,
    "deep elements": "<a>" * 5000,
    "an integer": f"a = {HUGE}",
    "an integer in JSON": f'{{"K": {HUGE}}}',
    "a list in JSON": "{} []",
    "another encoding": "<?xml version='1.0' encoding='big5'?><calibration/>",
    "no encoding": "<?xml version='1.0' encoding='foo'?><calibration/>",
    "entities": ENTITIES,
    "entities in UTF-16": ("<?xml version='1.0' encoding='utf-16'?>" + ENTITIES).encode("utf-16"),
}
PLACES = {
    "toml": ("640", "800.0", "-0.1", "1.5", "0.5", "0.31"),
    "qca.txt": ('"1079"', '"10"', '"1"', '"1000"', '"64000"', '"0"', '"-0.1"', '"none"'),
    "yml": ("640", "rows: 3", "800.", "-0.1", "1.5", "0.5"),
    "json": ("640", "800.0", "-0.1", "1.5", "0.5"),
}
"""Numbers of which each is replaced where it stands first."""
VALUES = (
    *NUMBERS,
    "9" * 400,
    "inf",
    "1e155",
    "[1, [2]]",
    "true",
    '"$\\n"',
    f"0x{HUGE}",
    "",
    "{}",
    "null",
    "1979-05-27",
)
TRACKS = "time,wrist_x,wrist_y\n" + "".join(f"{row / 30},{300 + row},{200 + row * row}\n" for row in range(12))
NAMES = {"toml": ("cam1", "cam2"), "qca.txt": ("cam1", "cam2"), "yml": ("camera_1", "camera_2")}
FILES = {"one.csv": TRACKS, "two.csv": TRACKS}
CALIBRATE = ("calibrate", "cam1=film.mp4", "--board", "checkerboard:8x5", "--square", "0.03", "--out", "out.toml")


def triangulate(suffix: str, name: str | None = None) -> tuple[str, ...]:
    """A call with tracks of two cameras and a calibration of that kind."""
    one, two = NAMES.get(suffix, NAMES["yml"])
    place = f"new.{suffix}" if name is None else name
    return ("triangulate", f"{one}=one.csv", f"{two}=two.csv", "--calibration", place, "--out", "out.csv")


def cases() -> Iterator[Case]:
    """Calibrations, their paths, then films of boards and options."""
    for suffix, good in CAMERAS.items():
        name, call = f"new.{suffix}", triangulate(suffix)
        for what, content in WHOLE.items():
            yield Case("calibration", call, {**FILES, name: content}, what=f"{name} {what}")
        for share in range(10, 100, 20):
            cut = good[: len(good) * share // 100]
            yield Case("calibration", call, {**FILES, name: cut}, what=f"{name} cut at {share} %")
        for place in PLACES[suffix]:
            for value in VALUES:
                word = f'"{value}"'.replace('""', '"') if place.startswith('"') else value
                files = {**FILES, name: good.replace(place, word, 1)}
                yield Case("number in a calibration", call, files, what=f"{name} {place} {value[:20]}")
        for what, touch in {
            "a loop": loop(name),
            "nothing there": None,
            "a folder": directory(name),
            "zeros without end": device(name, "/dev/zero"),
            "a pipe": pipe(name),
        }.items():
            yield Case("path of a calibration", call, FILES, touch, f"{name} {what}")
        for odd in (f"a\0b.{suffix}", "x" * 5000 + f".{suffix}", f"rec.csv/x.{suffix}", f"\udcff.{suffix}"):
            yield Case("path of a calibration", triangulate(suffix, odd), FILES, what=f"{odd[:20]!r}")
    toml = CAMERAS["toml"]
    for unit in ('["m"]', "3", "{}", HUGE, f"0x{HUGE}", '"inch"', '"$\\n"', "nan"):
        files = {**FILES, "new.toml": f"{toml}unit = {unit}\n"}
        yield Case("calibration", triangulate("toml"), files, what=f"unit {unit[:20]}")
    for what, touch in {"a pipe": pipe("film.mp4"), "zeros": device("film.mp4", "/dev/zero")}.items():
        yield Case("film of a board", CALIBRATE, touch=touch, what=what)
    for odd in ("a\0b.mp4", "x" * 5000, "rec.csv", "", "\udcff"):
        yield Case("film of a board", (*CALIBRATE[:1], f"cam1={odd}", *CALIBRATE[2:]), what=f"{odd[:20]!r}")
    for option in ("--find-offsets", "--noise"):
        for value in ("nan", "inf", "1e9", "1e308", "0", "-1", HUGE, ""):
            call = with_option(triangulate("toml"), option, value)
            yield Case("option of cameras", call, {**FILES, "new.toml": toml}, what=f"{option} {value[:20]}")
