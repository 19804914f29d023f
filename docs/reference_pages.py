"""Pages written from the code: the API room by room, every effect with its formula and a picture, the command line.

An effect's picture is a run of our own: the planar arm under a sweeping torque, the path of a keypoint with the effect
and without it, at a size that its own prior calls likely, and how far they are apart.
"""

import inspect
import pkgutil
from functools import cache
from importlib import import_module
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import torch
import typer.main
from click import Context
from torch.distributions import Distribution

ROOMS = {
    "recordings": "Keypoint tracks, encoders and commands: read, checked, written.",
    "models": "What the world does, as Pyro models: bodies, dynamics, torques, sensors, effects.",
    "inference": "How it is learned: filters, smoothers, fits, variational methods, the posterior.",
    "diagnosis": "Where simulation and recording part, and why.",
    "blindcheck": "Reality played by another engine, answers sealed, diagnoses scored.",
}


def write_pages(folder: Path, pictures: bool = True) -> None:
    """Write api/, effects.md with pictures (which take half a minute, once) or without, and cli.md into the folder."""
    (folder / "api").mkdir(parents=True, exist_ok=True)
    for room, what in ROOMS.items():
        _write(folder / "api" / f"{room}.md", api_page(room, what))
    _write(folder / "effects.md", effects_page(folder / "effects" if pictures else None))
    _write(folder / "cli.md", cli_page())


def api_page(room: str, what: str) -> str:
    """One section a module, with its docstring and public members."""
    package = import_module(f"invdyn.{room}")
    modules = sorted(m.name for m in pkgutil.walk_packages(package.__path__, f"{package.__name__}."))
    parts = [f"# invdyn.{room}\n\n{what}\n"]
    for name in modules:
        module = import_module(name)
        if hasattr(module, "__path__") or not (module.__doc__ or "").strip():
            continue
        parts.append(
            f"## {name.removeprefix('invdyn.')}\n\n```{{eval-rst}}\n.. automodule:: {name}\n   :members:\n```\n"
        )
    return "\n".join(parts)


def effects_page(pictures: Path | None) -> str:
    """Name, formula, parameters, twins, experiment and picture of each effect; pictures that are up to date stay."""
    from invdyn.diagnosis.catalogue import CATALOGUE
    from invdyn.diagnosis.catalogue.engine_effects import EFFECTS as ENGINE

    played = {each.name: each for each in ENGINE}
    also = [f"| {each} | yes | {'yes' if each in played else ''} |" for each in CATALOGUE]
    also += [f"| {name} | | yes: {each.meaning} |" for name, each in played.items() if name not in CATALOGUE]
    newest = Path(__file__).stat().st_mtime
    parts = [
        "# Effects\n\nWhat a real arm has and an ideal simulation lacks. Each effect is one class. "
        "A picture shows a coordinate of the same commanded arm with the effect and without it. "
        "The effect is as large as its prior calls likely.\n\n"
        "A diagnosis by MuJoCo's own step looks for these numbers of its model:\n\n"
        "| effect | of an arm | by MuJoCo's own step |\n|---|---|---|\n" + "\n".join(also) + "\n"
    ]
    for name, entry in CATALOGUE.items():
        kind = entry.effect
        module = inspect.getmodule(kind)
        said = (module.__doc__ or "").strip()
        # a file of a family has a line for each of its effects
        own = [line.removeprefix(name).strip() for line in said.splitlines() if line.startswith(f"{name} ")]
        formula = own[0] if own else said.split("\n\n")[0].replace("\n", " ")
        shown = ""
        if pictures is not None:
            pictures.mkdir(exist_ok=True)
            picture = pictures / f"{name}.svg"
            if not picture.exists() or picture.stat().st_mtime < max(
                Path(inspect.getfile(kind)).stat().st_mtime, newest
            ):
                draw_effect(kind, picture)
            shown = f"![The arm with {entry.phrase} and without](effects/{name}.svg)\n\n"
        rows = "\n".join(f"| `{p.name}` | {p.unit} |" for p in _parameters(kind))
        others = [*entry.forms.values(), *entry.variant_words.values()]
        forms = f"\n\nOther forms: {'; '.join(others)}." if others else ""
        twins = f"\n\nNo recording distinguishes it from: {', '.join(entry.twins)}." if entry.twins else ""
        parts.append(
            f"## {name}\n\n{entry.phrase[0].upper()}{entry.phrase[1:]}: {entry.meaning}. {formula}\n\n"
            f"{shown}| parameter | unit |\n|---|---|\n{rows}\n\n"
            f"Brought out by {entry.shown_by}.{forms}{twins}\n"
        )
    return "\n".join(parts)


def cli_page() -> str:
    """The help of every command."""
    from invdyn.cli import app

    command = typer.main.get_command(app)
    parts = ["# Command line\n"]
    for name, each in sorted(command.commands.items()):
        with Context(each, info_name=f"invdyn {name}", terminal_width=80) as context:
            parts.append(f"## invdyn {name}\n\n```text\n{each.get_help(context)}\n```\n")
    return "\n".join(parts)


def draw_effect(kind: type, file: Path) -> None:
    """Draw what an effect does to the arm: two paths of a coordinate, with it and without, and their difference."""
    with torch.random.fork_rng():
        time, ideal, real = ideal_arm().time.numpy(), ideal_path(), simulated_keypoints(arm_with(kind))
    shown = int(np.nanargmax(np.nanstd(real - ideal, axis=0)))
    style = {"font.size": 9, "svg.hashsalt": kind.__name__, "axes.spines.top": False, "axes.spines.right": False}
    with plt.rc_context(style):
        figure, (both, apart) = plt.subplots(
            2, 1, figsize=(5.2, 2.7), sharex=True, height_ratios=(2, 1), layout="constrained"
        )
        both.plot(time, ideal[:, shown], color="0.6", label="ideal")
        both.plot(time, real[:, shown], color="#0072B2", linewidth=1, label=kind.name.replace("_", " "))
        both.set(ylabel=f"{('elbow', 'wrist')[shown // 2]} {'xy'[shown % 2]} (m)")
        both.legend(frameon=False, ncols=2, loc="lower right", bbox_to_anchor=(1, 1), borderaxespad=0)
        apart.plot(time, 1e3 * (real - ideal)[:, shown], color="#0072B2", linewidth=1)
        apart.set(xlabel="time (s)", ylabel="apart (mm)")
        figure.align_ylabels()
        figure.savefig(file, metadata={"Date": None})
        plt.close(figure)


@cache
def ideal_arm():
    """The arm that all effects are drawn on, under a command that sweeps."""
    from invdyn.models import ArmModel, Link, planar_body

    upper = Link("upper_arm", "shoulder", "elbow", 0.3, 1.5)
    body = planar_body(
        "arm", [upper, Link("forearm", "elbow", "wrist", 0.25, 1.0)], gravity=(9.81, 0.0)
    )  # it hangs along x
    time = np.arange(0, 3, 0.01)
    command = np.stack([1.5 * np.sin(3 * time), 0.5 * np.sin(5 * time)], -1)
    # Next to no noise in the motion: an effect on what is seen alone shifts the random numbers.
    names = ("initial.angle_scale", "initial.velocity_scale", "noise.angle", "noise.velocity", "torque.scale")
    known = dict.fromkeys(names, 1e-10) | {"emission.keypoint_scale": 2e-3}
    return ArmModel(body, time, command=command, parameters=known)


@cache
def ideal_path() -> np.ndarray:
    """Its elbow and wrist as seen, (T, 4) m."""
    return simulated_keypoints(ideal_arm())


def arm_with(kind: type):
    """The arm with the effect at its last place, as large as its prior calls likely."""
    effect = at_last_place(kind)
    model = ideal_arm().with_effects(effect)
    chosen = {}
    for parameter in effect.bound(model.body).parameters(model.scale):
        chosen[f"effect.{effect.key}.{parameter.name}"] = likely(parameter.prior)
    return model.replace(**chosen)


def likely(prior: Distribution) -> torch.Tensor:
    """The value that four in five lie below; of a law whose quantiles nobody has written down, as if it were normal."""
    try:
        value = prior.icdf(torch.tensor(0.8))
    except NotImplementedError:
        value = prior.mean + 0.8416 * prior.stddev
    return torch.as_tensor(value, dtype=torch.float64).reshape(1)


def simulated_keypoints(model) -> np.ndarray:
    """What a model's sensors give, (T, 4) m, from a fixed seed."""
    torch.manual_seed(1)
    _, observations = model.simulate()
    return observations[:, :4].numpy()


def at_last_place(kind: type):
    """The effect at the last of its places, in its own form: that of its formula."""
    body = ideal_arm().body
    return [effect for effect in kind.everywhere(body, body.keypoint_names) if effect.form is None][-1]


def _parameters(kind: type):
    model = ideal_arm()
    return at_last_place(kind).bound(model.body).parameters(model.scale)


def _write(file: Path, text: str) -> None:
    """Write only what changed, so that a second build is quick."""
    if not file.exists() or file.read_text("utf-8") != text:
        file.write_text(text, "utf-8")
