"""Tables whose cells are near float64's limits or no numbers at all, and files of another form."""

from collections.abc import Iterator

from .case import (
    COLUMNS,
    COMPARE,
    DIAGNOSE,
    FRAMES,
    INFER,
    NUMBERS,
    TRACKED,
    TRUTH,
    WORDS,
    Case,
    deeplabcut,
    table,
    with_option,
)

GOOD = table()
LINES = GOOD.splitlines()
FORMS = {
    "empty": "",
    "blank": "\n\n  \n",
    "a byte": b"\xff",
    "zeros": bytes(1000),
    "UTF-16": GOOD.encode("utf-16"),
    "Latin-1": GOOD.replace("wrist", "poignée").encode("latin-1"),
    "two BOMs": "\ufeff\ufeff" + GOOD,
    "old Mac's lines": GOOD.replace("\n", "\r"),
    "a huge header": ",".join(f"k{i}_x" for i in range(20_000)) + "\n",
    "a huge cell": GOOD + "9" * 200_000 + "\n",
    "an open quote": GOOD + '"' + "x" * 200_000,
    "ragged": GOOD + "0.5,1\n",
    "too long a row": GOOD + ",".join("1" * 9) + "\n",
    "header alone": LINES[0],
    "no header": "\n".join(LINES[1:]),
    "header twice": LINES[0] + "\n" + GOOD,
    "a column twice": GOOD.replace("wrist_y", "wrist_x", 1),
    "a column without a name": GOOD.replace("wrist_y", "", 1),
    "an unknown column": GOOD.replace("wrist_y", "wrist_w", 1),
    "semicolons": GOOD.replace(",", ";"),
    "tabs": GOOD.replace(",", "\t"),
    "a time twice": "\n".join([*LINES, LINES[-1]]),
    "times fall": "\n".join([LINES[0], *reversed(LINES[1:])]),
    "one row": "\n".join(LINES[:2]),
    "HTML": "<html><body>404</body></html>",
    "JSON": '{"time": [0, 1]}',
    "deep JSON": "[" * 100_000,
    "HDF5's mark": b"\x89HDF\r\n\x1a\n" + bytes(100),
    "zip's mark": b"PK\x03\x04" + bytes(100),
    "only missing": table(all_wrist_x="", all_wrist_y="", all_elbow_angle=""),
    "all at one place": table(all_wrist_x="0", all_wrist_y="-1", all_elbow_angle="-1.57"),
}


def cases() -> Iterator[Case]:
    """Numbers cell by cell and column by column, then whole files."""
    for column in COLUMNS:
        for value in (*NUMBERS, *WORDS):
            yield Case("number in a recording", INFER, {"rec.csv": table(**{column: value})}, what=f"{column} {value}")
        for value in NUMBERS:
            whole = {"rec.csv": table(**{f"all_{column}": value})}
            yield Case("number in a recording", INFER, whole, what=f"every {column} {value}")
        for value in NUMBERS[:5]:
            cell = {"rec.csv": table(**{column: value})}
            yield Case("number in a recording", DIAGNOSE, cell, what=f"{column} {value}")
    for column in TRUTH:
        for value in (*NUMBERS[:6], *WORDS[:4]):
            cell = {"truth.csv": table(TRUTH, **{column: value})}
            call = (*INFER, "--set", "truth=truth.csv", "--out", "out.csv")
            yield Case("number in a truth", call, cell, what=f"{column} {value}")
    for value in (*NUMBERS, *WORDS):
        content = {"dlc.csv": deeplabcut(value)}
        yield Case("number in a track", (*TRACKED, "--scale", "body"), content, what=value)
    for what, content in FORMS.items():
        for call in (INFER, COMPARE, DIAGNOSE):
            yield Case("form of a table", call, {"rec.csv": content}, what=what)
        truth = with_option(INFER, "--set truth", "truth.csv")
        yield Case("form of a table", truth, {"truth.csv": content}, what=f"truth: {what}")
        yield Case("form of a table", TRACKED, {"dlc.csv": content}, what=f"tracks: {what}")
    for suffix in ("h5", "slp", "nwb", "trc", "xyz"):
        call = ("infer", f"rec.{suffix}", "--body", "arm.toml", "--units", "px", "--out", "out.nc")
        for what in ("empty", "zeros", "HDF5's mark", "deep JSON"):
            for more in ((), ("--fps", "30")):
                content = {f"rec.{suffix}": FORMS[what]}
                yield Case("form of a file", (*call, *more), content, what=f"{suffix} {more} {what}")
    for value in ("", "\0", "1e308", "-3", "0", "nan"):
        labels = ("\t" + value).join(["1", "2", "3"])
        content = (
            "PathFileType\t4\t(X/Y/Z)\ta.trc\nDataRate\tUnits\n10\tmm\nFrame#\tTime\twrist\t\t\n\t\tX1\tY1\tZ1\n\n"
        )
        rows = "".join(f"{row}\t{row / 30}\t{labels}\n" for row in range(FRAMES))
        call = ("infer", "rec.trc", "--body", "arm.toml", "--out", "out.nc")
        yield Case("form of a file", call, {"rec.trc": content + rows}, what=f"trc {value!r}")
