"""Robots of public files, each with one number changed: what the regression names, and how near its values are.

    python benchmarks/robots.py --files FOLDER [--robots so101 ur5e] [--changes none friction mass gain damping rotor
        stribeck delay lag offset] [--seed 47000] [--results FILE]

FOLDER has MJCF files, such as those of MuJoCo Menagerie without meshes, whose joints have position servos. MuJoCo plays
a copy in which one number of one joint or link is another. The log has 10 s of 100 rows: targets, each a sum of three
sines within its joint's range, and angles with .2 mrad of noise. It is read with the file as published. Dry friction is
played as such: by MuJoCo's defaults it is viscous up to speeds at which a light joint never turns.

An answer is right where what it names without a "perhaps" is the effect at its joint, or one of those of which it says
that the log does not tell them apart; of a mass, links' numbers. A
value is the whole number, file and change together, or of links the base parameter that changes most.
"""

import argparse
import tempfile
import time as clock
import warnings
from functools import partial
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from kept import kept

from invdyn.diagnosis.catalogue.linear_laws import INERTIAL
from invdyn.diagnosis.regression.regress import Regression, regress
from invdyn.diagnosis.regression.regressors import nominal_link_numbers
from invdyn.inputs import load_body, read_logs
from invdyn.models.bodies.joint_parts_mjcf import joint_names
from invdyn.recordings import Recording, write_table

SHAPED = ("stribeck_friction", "actuator_delay", "actuator_lag", "encoder_offset")
"""Changes that are none of a model's numbers."""
STEP, RATE, SECONDS = 2.5e-4, 100.0, 10.0
DRY, INSIDE, TINY = 0.999, 0.9, 1e-9
"""Impedance of dry friction; share of the way to a joint's stops that targets go; an angle, rad, that is none."""
Sizes = tuple[float, ...]
Played = tuple[np.ndarray, ...]
"""Times (T,), angles and targets (T, K), and the rms of K (c − q), velocity and acceleration by joint (3, K)."""
CHANGES = {
    "none": "",
    "friction": "coulomb_friction",
    "mass": INERTIAL,
    "gain": "actuator_gain",
    "damping": "viscous_friction",
    "rotor": "armature",
    "stribeck": "stribeck_friction",
    "delay": "actuator_delay",
    "lag": "actuator_lag",
    "offset": "encoder_offset",
}


def played(model: mujoco.MjModel, rng: np.random.Generator, change: str = "", k: int = 0, size: Sizes = ()) -> Played:
    """A log of a model, whose joint ``k`` has a ``change`` that is none of its numbers."""
    K, data, at_rest = model.nv, mujoco.MjData(model), model.dof_frictionloss.copy()
    model.opt.timestep = STEP
    model.dof_solref[:], model.dof_solimp[:, :2] = (2 * STEP, 1.0), DRY
    middle = model.key_qpos[0] if model.nkey else np.where(model.jnt_limited, model.jnt_range.mean(1), 0.0)
    room = np.minimum(np.where(model.jnt_limited, np.ptp(model.jnt_range, 1) / 2, 2.0), 2.0)
    frequency, phase = rng.uniform(0.1, 0.7, (3, K)), rng.uniform(0, 2 * np.pi, (3, K))
    wide = rng.uniform(0.1, 0.25, (3, K)) * room / np.maximum(frequency / 0.3, 1)
    own = [int(np.flatnonzero(model.actuator_trnid[:, 0] == k)[0]) for k in range(K)]
    time = np.arange(0, SECONDS, 1 / RATE)
    angle = 2 * np.pi * frequency * time[:, None, None] + phase
    wave = (wide * (np.sin(angle) - np.sin(phase))).sum(1)
    low, high = np.where(model.jnt_limited, model.jnt_range.T - middle, [[-np.inf], [np.inf]])
    room = np.minimum(low / np.minimum(wave.min(0), -TINY), high / np.maximum(wave.max(0), TINY))
    command = middle + wave * np.minimum(1.0, INSIDE * room)
    data.qpos[:], seen, square, moments = middle, [], [], round(1 / RATE / STEP)
    acting = command[0].copy()
    for n, row in enumerate(command):
        seen.append(data.qpos.copy())
        sizes = []
        for m in range(moments):
            acting[:] = row
            if change == "delay":
                acting[k] = command[max(int(np.floor(n + (m + 0.5) / moments - size[0] * RATE)), 0), k]
            if change == "offset":
                acting[k] -= size[0]
            slow = np.exp(-((data.qvel[k] / size[2]) ** 2)) if change == "stribeck" else 0.0
            if change == "stribeck":
                model.dof_frictionloss[k] = at_rest[k] + size[0] + (size[1] - size[0]) * slow
            if change == "lag":
                acting[k] = data.ctrl[own[k]] if n + m else row[k]
                acting[k] += (row[k] - acting[k]) * -np.expm1(-STEP / size[0])
            data.ctrl[own] = acting
            mujoco.mj_step(model, data)
            asked = (model.actuator_gainprm[:, 0] * (data.ctrl - data.actuator_length))[own]
            sizes.append((asked, data.qvel.copy(), data.qacc.copy()))
        square.append(np.mean(np.square(sizes), 0))
    shown = np.array(seen) + 2e-4 * rng.standard_normal(wave.shape)
    shown[:, k] += size[0] if change == "offset" else 0.0
    return time, shown, command, np.sqrt(np.mean(square, 0))


def changed(model: mujoco.MjModel, change: str, k: int, sizes: np.ndarray) -> Sizes:
    """Change a number of a joint, by a share of its servo's K (c − q), or of its link, by .3 of itself; the new one.

    Of a change that is no number of a model, its numbers.
    """
    torque, speed, acceleration = sizes[:, k]
    if change == "friction":
        model.dof_frictionloss[k] += 0.15 * torque
        return (float(model.dof_frictionloss[k]),)
    if change == "damping":
        model.dof_damping[k] += 0.15 * torque / speed
        return (float(model.dof_damping[k]),)
    if change == "rotor":
        model.dof_armature[k] += 0.3 * torque / acceleration
        return (float(model.dof_armature[k]),)
    if change == "gain":
        servo = int(np.flatnonzero(model.actuator_trnid[:, 0] == k)[0])
        model.actuator_gainprm[servo, 0] *= 0.8
        model.actuator_biasprm[servo, 1] *= 0.8
        return (0.8,)
    if change == "mass":
        body = model.jnt_bodyid[k]
        model.body_mass[body] *= 1.3
        model.body_inertia[body] *= 1.3
        return (1.3,)
    return {"stribeck": (0.1 * torque, 0.3 * torque, 0.4 * speed), "offset": (0.03,)}.get(change, (0.015,))


def read(folder: Path, model: str, names: list[str], log: Played) -> tuple[Recording, Any]:
    """The log as a user's files give it, and the body of the file as published."""
    time, angle, command, _ = log
    columns = {"time": time} | {f"q{k}": angle[:, k] for k in range(len(names))}
    columns |= {f"u{k}": command[:, k] for k in range(len(names))}
    write_table(columns, folder / "log.csv")
    text = "".join(f'[joints.{name}]\nangle = "q{k}"\ntarget = "u{k}"\n' for k, name in enumerate(names))
    (folder / "map.toml").write_text(text)
    body = load_body(model, filmed=False)
    (reading,) = read_logs(str(folder / "log.csv"), body, str(folder / "map.toml"))
    return getattr(reading, "recording", reading), body


def value_error(result: Regression, body: Any, change: str, place: str, before: float, after: float) -> float:
    """Relative error of the number that was changed; NaN where it is not among those that were found."""
    own = [e for e in result.numbers if e.effect == CHANGES[change]]
    if change == "mass":
        link = list(body.link_names).index(place)
        numbers = dict.fromkeys((f"{e.parameter} of {e.place}" for e in own), 0.0)
        for word, each in zip(("mass", "first moment", "second moment"), nominal_link_numbers(body), strict=True):
            axes = ("",) if len(each) == 1 else "xyz" if len(each) == 3 else ("xx", "yy", "zz", "xy", "xz", "yz")
            numbers |= {f"{word} {a}".strip() + f" of {place}": 0.3 * v[link] for a, v in zip(axes, each, strict=True)}
        off = []
        for e in own:
            parts = {f"{e.parameter} of {e.place}": 1.0} | dict(e.known_with)
            shift = sum(factor * numbers.get(name, 0.0) for name, factor in parts.items())
            off.append((abs(shift) / e.sd if e.sd else 0.0, abs(e.value - e.of_file - shift) / abs(e.of_file + shift)))
        return max(off, default=(0.0, np.nan))[1]
    mine = {e.parameter: e.value for e in own if e.place == place}
    if not mine:
        return float("nan")
    first = mine.get("static", next(iter(mine.values())))  # of a friction that falls with speed the one at rest
    return abs((before + first) / after - 1)


def logs(file: Path, change: str, seed: int) -> tuple[int, float, float, Played, Played]:
    """Of one motion the joint that is changed, a number before and after, and the logs without and with the change."""
    seeds = [seed, *map(ord, file.stem)]
    nominal, model = (mujoco.MjModel.from_xml_path(str(file)) for _ in range(2))
    clean = played(nominal, np.random.default_rng(seeds))
    k = int(np.random.default_rng([seed, *map(ord, change)]).integers(model.nv))
    numbers = {"friction": "dof_frictionloss", "damping": "dof_damping", "rotor": "dof_armature"}
    before = float(getattr(model, numbers[change])[k]) if change in numbers else float(change == "gain")
    if change == "none":
        return k, before, before, clean, clean
    size = changed(model, change, k, clean[3])
    live = change if CHANGES[change] in SHAPED else ""
    after = size[1] if change == "stribeck" else size[0]
    return k, before, after, clean, played(model, np.random.default_rng(seeds), live, k, size)


def case(file: Path, change: str, seed: int) -> dict[str, Any]:
    """One log and its answer."""
    k, before, after, clean, log = logs(file, change, seed)
    names = list(joint_names(mujoco.MjModel.from_xml_path(str(file))))
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        recording, body = read(Path(folder), str(file), names, log)
        start = clock.process_time()
        result = regress(recording, body)
        seconds = clock.process_time() - start
        unchanged = result if change == "none" else regress(read(Path(folder), str(file), names, clean)[0], body)
    assert result is not None
    assert unchanged is not None
    place = names[k] if change != "mass" else body.link_names[body.joint_names.index(names[k])]
    sure = {(s.effect, p) for s in result.stated for p in s.sure}
    sets = {(effect, p) for s in result.stated for p in s.sure for effect in s.rivals.get(p, ())}
    right = {(effect, p) for effect, p in sure if effect == CHANGES[change] and (change == "mass" or p == place)}
    return {
        "place": place,
        "named": bool(right) or (CHANGES[change], place) in sets,
        "else": len(sure - right),
        "error": value_error(result, body, change, place, before, after) if change != "none" else None,
        "shows": float((result.torque.before / unchanged.torque.before).max()),
        "closed": result.torque.share,
        "said": [
            f"{e}.{p} {s.probability[p]:.2f}" for s in result.stated for e, p in [(s.effect, q) for q in s.places]
        ],
        "far": dict(result.far_gains),
        "seconds": seconds,
    }


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--files", type=Path, required=True)
    parser.add_argument("--robots", nargs="*")
    parser.add_argument("--changes", nargs="*", default=list(CHANGES), choices=CHANGES)
    parser.add_argument("--seed", type=int, default=47000)
    parser.add_argument("--results", type=Path)
    args = parser.parse_args()
    files = [file for file in sorted(args.files.glob("*.xml")) if not args.robots or file.stem in args.robots]
    print("| robot | changed | shows | named | beside it | value off | torque closed | CPU s |")
    print("|---|---|---|---|---|---|---|---|")
    for file in files:
        for change in args.changes:
            name = f"{file.stem} {change} {args.seed}"
            found = kept(args.results, name, partial(case, file, change, args.seed))
            what = f"{change}, {found['place']}" if change != "none" else "nothing"
            named = "" if change == "none" else "yes" if found["named"] else "no"
            off = "" if found["error"] is None else "–" if np.isnan(found["error"]) else f"{100 * found['error']:.1f} %"
            shows = f"{found['shows']:.2g}" if change != "none" else ""
            closed, seconds = f"{100 * found['closed']:.0f} %", f"{found['seconds']:.1f}"
            print(
                "|",
                " | ".join((file.stem, what, shows, named, str(found["else"]), off, closed, seconds)),
                "|",
                flush=True,
            )


if __name__ == "__main__":
    main()
