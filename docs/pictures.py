"""Make the pictures of README.md, from real runs: `python docs/pictures.py`, or `… demo`, `… compare`.

demo.png and demo.gif are what `invdyn demo` draws, view.png is the page of `invdyn view` for it. compare.png is the
figure of `invdyn compare`, model.png what the model in README.md gives. diagnosis.png is the top of the report on a
simulated arm with friction at its elbow. Pages need chromium, chromedriver and the extra `dev`. cost.png comes from
`python benchmarks/cost.py`.
"""

import io
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

DOCS = Path(__file__).parent
COLOURS = 128  # of a palette: a third of the bytes, and the eye sees no difference
WIDTH = 1400  # pixels
WINDOW = 1000, 1275  # pixels, of the report that is shown
PAGE = 1280, 1180


def demo(folder: str) -> None:
    """Run the demo, keep its figure with a palette, and its film as it is."""
    subprocess.run([sys.executable, "-m", "invdyn", "demo", "--out", folder], check=True)
    figure = Image.open(Path(folder) / "figure.png")
    _keep(figure.resize((WIDTH, round(figure.height * WIDTH / figure.width)), Image.Resampling.LANCZOS), "demo.png")
    shutil.copyfile(Path(folder) / "film.gif", DOCS / "demo.gif")
    subprocess.run(
        [sys.executable, "-m", "invdyn", "view", f"{folder}/posterior.nc", "--out", f"{folder}/view.html"], check=True
    )
    moment = "const s = document.getElementById('slider'); s.value = 36; s.dispatchEvent(new Event('input'));"
    _photograph(Path(folder) / "view.html", "view.png", PAGE, moment)


def compare(folder: str) -> None:
    """Compare three methods as README.md does, and keep the figure."""
    invdyn = [sys.executable, "-W", "ignore", "-m", "invdyn"]
    files = [f"{folder}/rec.csv", "--body", "paper_planar_arm", "--set", f"truth={folder}/truth.csv"]
    made = ["--body", "paper_planar_arm", "--out", files[0], "--truth", f"{folder}/truth.csv"]
    subprocess.run([*invdyn, "simulate", *made], check=True)
    chosen = ["--torque", "ornstein_uhlenbeck", "--methods", "smc,laplace,svi", "--frames", "0:60"]
    chosen += ["--out", f"{folder}/comparison"]
    subprocess.run([*invdyn, "compare", *files, *chosen], check=True)
    figure = Image.open(next(Path(folder, "comparison").glob("*.png")))
    _keep(figure.resize((WIDTH, round(figure.height * WIDTH / figure.width)), Image.Resampling.LANCZOS), "compare.png")


def model(folder: str) -> None:
    """Run the model that README.md writes, and draw the point, what was seen and the filter's band."""
    import matplotlib.pyplot as plt
    import torch

    text = (DOCS.parent / "README.md").read_text("utf-8")
    snippet = next(block for block in re.findall(r"```python\n(.*?)```", text, re.DOTALL) if "class Wanderer" in block)
    known: dict = {}
    torch.manual_seed(3)
    exec(compile(snippet.replace("_, observations", "states, observations"), "README.md", "exec"), known)
    result = known["result"]
    particles, order = result.states[:, 0, :, 0].sort(-1)
    mass = result.log_weights[:, 0].gather(-1, order).exp().cumsum(-1)
    low, high = (
        particles.gather(-1, (mass < share).sum(-1, keepdim=True).clamp_max(mass.shape[-1] - 1)).squeeze(-1)
        for share in (0.05, 0.95)
    )
    rows = range(len(known["observations"]))
    figure, axes = plt.subplots(figsize=(7, 2.6), layout="constrained")
    axes.fill_between(rows, low, high, alpha=0.3, label="90 % of the filter's particles")
    axes.plot(rows, known["states"].squeeze(), "k--", linewidth=1, label="the point")
    axes.plot(rows, known["observations"].squeeze(), ".", color="0.5", markersize=4, label="what the sensor saw")
    axes.set(xlabel="row", ylabel="place")
    axes.legend(ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1), frameon=False)
    figure.savefig(Path(folder) / "model.png", dpi=150)
    _keep(Image.open(Path(folder) / "model.png"), "model.png")


def diagnosis(folder: str) -> None:
    """Diagnose a simulated arm that has friction at its elbow, and photograph the report."""
    import torch

    from invdyn.diagnosis import diagnose, save
    from invdyn.models import Link, planar_body
    from invdyn.models.effects import ViscousFriction
    from invdyn.simulate import random_arm, record

    upper = Link("upper_arm", joint="shoulder", tip="elbow", length=0.30, mass=1.5)
    fore = Link("forearm", joint="elbow", tip="wrist", length=0.25, mass=1.0)
    body = planar_body("arm", [upper, fore], gravity=(0.0, -9.81))
    arm = random_arm(body, duration=4.0, fps=50, noise=0.002, commanded=True).with_effects(ViscousFriction("elbow"))
    damping = torch.tensor([0.05], dtype=torch.float64)
    recording, _ = record(arm.replace(**{"effect.viscous_friction.elbow.damping": damping}))
    save(diagnose(recording, body), folder)
    _photograph(Path(folder) / "report.html", "diagnosis.png", WINDOW)


def _photograph(page: Path, name: str, window_size: tuple[int, int], script: str = "") -> None:
    """Keep the top of a page, once a script of its own has run."""
    from selenium import webdriver

    options = webdriver.ChromeOptions()
    for flag in ("headless=new", "no-sandbox", "disable-gpu", "hide-scrollbars"):
        options.add_argument(f"--{flag}")
    window = webdriver.Chrome(options=options, service=webdriver.ChromeService(shutil.which("chromedriver")))
    try:
        size = dict(zip(("width", "height"), window_size, strict=True))
        window.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", {**size, "deviceScaleFactor": 1, "mobile": False})
        window.get(page.resolve().as_uri())
        window.execute_script(script)
        _keep(Image.open(io.BytesIO(window.get_screenshot_as_png())), name)
    finally:
        window.quit()


def _keep(picture: Image.Image, name: str) -> None:
    few = picture.convert("RGB").quantize(COLOURS, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    few.save(DOCS / name, optimize=True)


def main() -> None:
    """Make those that are named, or all."""
    known = {"demo": demo, "compare": compare, "model": model, "diagnosis": diagnosis}
    wanted = sys.argv[1:] or list(known)
    if unknown := set(wanted) - set(known):
        sys.exit(f"no picture {', '.join(sorted(unknown))}; expected any of {', '.join(known)}")
    for name in wanted:
        with tempfile.TemporaryDirectory() as folder:
            known[name](folder)


if __name__ == "__main__":
    main()
