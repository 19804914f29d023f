"""Make the pictures of README.md, from real runs: `python docs/pictures.py`.

demo.png, demo.gif             `invdyn demo`
human_arm.png, human_arm.gif   the human arm, where the recording can be had
cost.png                       comes from `python benchmarks/cost.py`
"""

import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

DOCS = Path(__file__).parent
COLOURS = 128  # of a palette: half the bytes, and the eye sees no difference
HUMAN_ARM = "human-arm --body human_arm_on_table --body-lengths --learn-lengths --frames 50:250"


def invdyn(*arguments: str | Path) -> None:
    """Run the command line as a user does."""
    subprocess.run([sys.executable, "-m", "invdyn", *map(str, arguments)], check=True)


def shrink(source: Path, target: Path) -> None:
    """Save a figure with a palette, 1,400 pixels wide."""
    figure = Image.open(source).convert("RGB")
    figure = figure.resize((1400, round(figure.height * 1400 / figure.width)), Image.Resampling.LANCZOS)
    figure.quantize(COLOURS, dither=Image.Dither.NONE).save(target, optimize=True)


def main() -> None:
    """Make all of them."""
    with tempfile.TemporaryDirectory() as folder:
        run = Path(folder)
        invdyn("demo", "--out", run / "demo")
        shrink(run / "demo" / "figure.png", DOCS / "demo.png")
        (run / "demo" / "film.gif").replace(DOCS / "demo.gif")
        outputs = ("--out", run / "arm.nc", "--figure", run / "arm.png", "--film", DOCS / "human_arm.gif")
        invdyn("infer", *HUMAN_ARM.split(), *outputs)
        shrink(run / "arm.png", DOCS / "human_arm.png")


if __name__ == "__main__":
    main()
