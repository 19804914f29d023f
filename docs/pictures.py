"""Make the pictures of README.md, from a real run: `python docs/pictures.py`.

demo.png and demo.gif are what `invdyn demo` draws; cost.png comes from `python benchmarks/cost.py`.
"""

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

DOCS = Path(__file__).parent
COLOURS = 128  # of a palette: a third of the bytes, and the eye sees no difference
WIDTH = 1400  # pixels


def main() -> None:
    """Run the demo, keep its figure with a palette, and its film as it is."""
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([sys.executable, "-m", "invdyn", "demo", "--out", folder], check=True)
        figure = Image.open(Path(folder) / "figure.png").convert("RGB")
        figure = figure.resize((WIDTH, round(figure.height * WIDTH / figure.width)), Image.Resampling.LANCZOS)
        figure.quantize(COLOURS, dither=Image.Dither.NONE).save(DOCS / "demo.png", optimize=True)
        shutil.copyfile(Path(folder) / "film.gif", DOCS / "demo.gif")


if __name__ == "__main__":
    main()
