"""A malformed input, and the good inputs of which it is made.

A case is a call of the command line in a folder of good inputs, and what is put there first. Good inputs: a one-link
arm (arm.toml), its recording (rec.csv, and DeepLabCut's dlc.csv), truth.csv, a posterior.nc and a checkpoint, the last
two made by the product itself.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

BODY = """name = "arm"
gravity = [0.0, -9.81]
base = [0.0, 0.0]

[[links]]
name = "forearm"
joint = "elbow"
tip = "wrist"
length = 1.0
mass = 0.5
com = 0.5
inertia = 0.04

[uncertainty]
"""
FRAMES = 12
COLUMNS = ("time", "wrist_x", "wrist_y", "wrist_likelihood", "elbow_torque", "elbow_angle")
TRUTH = ("time", "elbow_torque", "elbow_angle", "elbow_velocity")
SMALL = ("--filters", "2", "--particles", "8", "--set", "draws=1", "--torque", "ornstein_uhlenbeck")
GIVEN = ("rec.csv", "--body", "arm.toml")
INFER = ("infer", *GIVEN, "--out", "out.nc", *SMALL)
TRACKED = ("infer", "dlc.csv", "--body", "arm.toml", "--units", "px", "--fps", "30", "--out", "out.nc", *SMALL)
COMPARE = ("compare", *GIVEN, "--methods", "laplace", "--out", "out", *SMALL)
DIAGNOSE = ("diagnose", *GIVEN, "--out", "out")
SIMULATE = ("simulate", "--body", "arm.toml", "--out", "out.csv", "--duration", "0.4")
PLOT = ("plot", "posterior.nc", "--out", "out.csv")
DRAW = ("plot", "posterior.nc", "--out", "out.svg")
BLIND = ("blind", "--out", "out", "--cases", "1")
DEMO = ("demo", "--out", "out")
KEPT = (*INFER, "--checkpoint", "checkpoint")
MIXED = (*INFER, "--torque", "auto", "--checkpoint", "mixed")
"""Of one torque process filters are tasks, of the default's several its sets of parameters are."""

HUGE = "9" * 5000
"""More digits than Python turns into an integer."""
NUMBERS = ("1e308", "-1e308", "1e200", "1e30", "-1e30", "1e-30", "1e-308", "5e-324", "-0.0", "0", HUGE, "1e999", "nan")
WORDS = ("inf", "-inf", "0x10", "1_000", "1,5", "١٢", "one", "--", "1e", '"', "1 2", "1;2", "\0", "$\\frac")


@dataclass(frozen=True)
class Case:
    """A call, what is written into its folder first, and a last touch."""

    kind: str
    arguments: tuple[str, ...]
    files: dict[str, str | bytes] = field(default_factory=dict)
    touch: Callable[[Path], None] | None = None
    what: str = ""

    def prepare(self, folder: Path) -> None:
        """Make the folder's inputs malformed."""
        for name, content in self.files.items():
            (folder / name).unlink(missing_ok=True)
            content = content.encode() if isinstance(content, str) else content
            (folder / name).write_bytes(content)
        if self.touch is not None:
            self.touch(folder)

    def __str__(self) -> str:
        return f"{self.kind}: {self.what[:60]!r} ({self.arguments[0]})"


def with_option(call: tuple[str, ...], option: str, value: str) -> tuple[str, ...]:
    """The call with another value of an option, which it has already or not, or of a setting ("--set draws")."""
    if option.startswith("--set "):
        return (*call, "--set", f"{option.removeprefix('--set ')}={value}")  # the last one counts
    if option in call:
        place = call.index(option) + 1
        return (*call[:place], value, *call[place + 1 :])
    return (*call, option, value)


def table(columns: Sequence[str] = COLUMNS, **cells: str) -> str:
    """A good recording as text, but for cells by name: `wrist_x=…` in the sixth row, or `all_wrist_x=…` in all."""
    lines = [",".join(columns)]
    for row in range(FRAMES):
        good = {"time": row / 30, "wrist_x": 0.1 * row / 30, "wrist_y": -1 + 0.005 * (row % 3), "wrist_likelihood": 0.9}
        good |= {"elbow_torque": 0.1, "elbow_angle": -1.57 + 0.01 * row, "elbow_velocity": 0.3}
        words = {name: repr(good[name]) for name in columns}
        for name, value in cells.items():
            if name.startswith("all_") or row == 5:
                words[name.removeprefix("all_")] = value
        lines.append(",".join(words.values()))
    return "\n".join(lines) + "\n"


def deeplabcut(cell: str = "10.5") -> str:
    """DeepLabCut's csv with two points, in pixels."""
    rows = [f"{row},100,100,.9,{100 + row},{cell if row == 5 else 200},.9" for row in range(FRAMES)]
    names = "bodyparts,elbow,elbow,elbow,wrist,wrist,wrist\ncoords,x,y,likelihood,x,y,likelihood\n"
    return "scorer" + ",net" * 6 + "\n" + names + "\n".join(rows) + "\n"


def make_good(folder: Path, run: Callable) -> None:
    """Write the good inputs into an empty folder; `run` calls the command line there."""
    texts = {"arm.toml": BODY, "rec.csv": table(), "truth.csv": table(TRUTH), "dlc.csv": deeplabcut()}
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    outcome = run(*with_option(KEPT, "--out", "posterior.nc"), "--set", "truth=truth.csv")
    assert outcome.exit_code == 0, outcome.stderr
    outcome = run(*MIXED)
    assert outcome.exit_code == 0, outcome.stderr
    (folder / "out.nc").unlink()
