"""Pages written from the code: the API room by room, every effect with its formula and a picture, the command line.

An effect's picture is a run of our own: the planar arm under a sweeping torque, the path of a keypoint with the effect
and without it, at a size that its own prior calls likely.
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
    from invdyn.models.effects import EFFECTS

    newest = Path(__file__).stat().st_mtime
    parts = ["# Effects\n\nWhat a real arm has and an ideal simulation lacks. Each effect is one class and one file.\n"]
    for name, kind in EFFECTS.items():
        module = inspect.getmodule(kind)
        formula = (module.__doc__ or "").strip().split("\n\n")[0].replace("\n", " ")
        shown = ""
        if pictures is not None:
            pictures.mkdir(exist_ok=True)
            picture = pictures / f"{name}.svg"
            if not picture.exists() or picture.stat().st_mtime < max(
                Path(inspect.getfile(kind)).stat().st_mtime, newest
            ):
                draw_effect(kind, picture)
            shown = f"![The arm with {kind.phrase} and without](effects/{name}.svg)\n\n"
        rows = "\n".join(f"| `{p.name}` | {p.unit} |" for p in _parameters(kind))
        twins = f"\n\nNo recording tells it from: {', '.join(kind.twins)}." if kind.twins else ""
        parts.append(
            f"## {name}\n\n{kind.phrase[0].upper()}{kind.phrase[1:]}: {kind.meaning}. {formula}\n\n"
            f"{shown}| parameter | unit |\n|---|---|\n{rows}\n\n"
            f"Brought out by {kind.shown_by}.{twins}\n"
        )
    return "\n".join(parts)


def cli_page() -> str:
    """The help of every command."""
    from invdyn.cli import app

    command = typer.main.get_command(app)
    parts = ["# Command line\n"]
    for name, each in sorted(command.commands.items()):
        with Context(each, info_name=f"invdyn {name}", terminal_width=100) as context:
            parts.append(f"## invdyn {name}\n\n```text\n{each.get_help(context)}\n```\n")
    return "\n".join(parts)


def draw_effect(kind: type, file: Path) -> None:
    """Draw what an effect does to the arm: two paths of a coordinate, with it and without."""
    with torch.random.fork_rng():
        time, ideal, real = ideal_arm().time.numpy(), ideal_path(), _seen(arm_with(kind))
    shown = int(np.nanargmax(np.nanstd(real - ideal, axis=0)))
    with plt.rc_context({"font.size": 9, "svg.hashsalt": kind.__name__, "axes.spines.top": False}):
        figure, axes = plt.subplots(figsize=(5.2, 1.8), layout="constrained")
        axes.plot(time, ideal[:, shown], color="0.6", label="ideal")
        axes.plot(time, real[:, shown], color="#0072B2", linewidth=1, label=kind.phrase)
        axes.set(xlabel="time (s)", ylabel=f"{('elbow', 'wrist')[shown // 2]} {'xy'[shown % 2]} (m)")
        axes.legend(frameon=False, ncols=2, loc="lower right", bbox_to_anchor=(1, 1), borderaxespad=0)
        figure.savefig(file, metadata={"Date": None})
        plt.close(figure)


@cache
def ideal_arm():
    """The arm that all effects are drawn on, under a command that sweeps."""
    from invdyn.models import ArmModel, Body, Link

    body = Body("arm", [Link("upper_arm", "shoulder", "elbow", 0.3, 1.5), Link("forearm", "elbow", "wrist", 0.25, 1.0)])
    time = np.arange(0, 3, 0.01)
    hold = np.array([4.0, 1.2])
    sweep = np.stack([2 * np.sin(3 * time), 0.8 * np.sin(5 * time)], -1)
    still = dict.fromkeys(("initial.angle_scale", "initial.velocity_scale", "noise.angle", "noise.velocity"), 1e-6)
    command = hold * np.cos(time)[:, None] + sweep
    return ArmModel(body, time, command=command, parameters=still | {"torque.scale": 1e-6})


@cache
def ideal_path() -> np.ndarray:
    """Its elbow and wrist as seen, (T, 4) m."""
    return _seen(ideal_arm())


def arm_with(kind: type):
    """The arm with the effect at its last place, as large as its prior calls likely."""
    model = ideal_arm()
    effect = kind.everywhere(model.body, model.body.keypoint_names)[-1]
    model = model.with_effects(effect)
    chosen = {}
    for parameter in effect.bound(model.body).parameters(model.scale):
        value = parameter.prior.icdf(torch.tensor(0.8)) if _has_quantiles(parameter.prior) else parameter.prior.mean
        chosen[f"effect.{effect.key}.{parameter.name}"] = torch.as_tensor(value, dtype=torch.float64).reshape(1)
    return model.replace(**chosen)


def _has_quantiles(prior: object) -> bool:
    try:
        prior.icdf(torch.tensor(0.8))
    except NotImplementedError:
        return False
    return True


def _seen(model) -> np.ndarray:
    torch.manual_seed(1)
    _, observations = model.simulate()
    return observations[:, :4].numpy()


def _parameters(kind: type):
    model = ideal_arm()
    return kind.everywhere(model.body, model.body.keypoint_names)[-1].bound(model.body).parameters(model.scale)


def _write(file: Path, text: str) -> None:
    """Write only what changed, so that a second build is quick."""
    if not file.exists() or file.read_text("utf-8") != text:
        file.write_text(text, "utf-8")
