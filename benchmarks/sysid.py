"""Side by side with MuJoCo's own `sysid`, on the same logs: given which number is wrong, given nothing; and ours.

    python benchmarks/sysid.py [--cases 10] [--seed 50000] [--results FILE] [--ours FILE]       needs mujoco[sysid]

The robots, logs and held-out logs of :mod:`write_back`, where one number of the file is wrong: damping, dry friction or
rotor of a joint, a load, a gear. `mujoco.sysid` (google-deepmind/mujoco, python/mujoco/sysid) fits rollouts by
Gauss–Newton on parameters that it is given, within bounds:

    told    the one number that is wrong
    free    damping, dry friction and rotor of both joints, six numbers

It starts in the true state, and integrates by Runge–Kutta, so that no step of Euler's is taken for friction. `ours` is
told nothing and looks through the whole catalogue; its results are taken from those of :mod:`write_back`, if given. A
number is *moved* where its 90 % interval excludes what it truly is. Excess error as in :mod:`write_back`.
"""

import argparse
import tempfile
import time as clock
import warnings
from collections import defaultdict
from collections.abc import Sequence
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from kept import kept
from mujoco import sysid
from write_back import JOINTS, SimulatedCase, case, motors, simulated_case

from invdyn.diagnosis.write_back.rollout import commands

LARGEST = {"damping": 3.0, "frictionloss": 1.5, "armature": 0.3}
"""Upper bounds: three and more times what is drawn. Lower ones are 0."""
NAMES = {"viscous_friction": "damping", "coulomb_friction": "frictionloss", "armature": "armature"}
QUANTITY = {"frictionloss": "friction", "gear": "motor gain", "payload": "payload"}
KINDS = ("viscous_friction", "coulomb_friction", "armature", "payload", "actuator_gain")


def of_joint(name: str, attribute: str, file: Any) -> Any:
    """A number of a joint as a parameter that begins where the file has it."""
    now = float(np.ravel(getattr(file.joint(name), attribute))[0])

    def change(spec: Any, parameter: Any) -> None:
        old = getattr(spec.joint(name), attribute)
        value = float(parameter.value[0])
        setattr(spec.joint(name), attribute, value if np.isscalar(old) else [value, *np.ravel(old)[1:]])

    return sysid.Parameter(f"{attribute}.{name}", now, 0.0, LARGEST[attribute], modifier=change)


def the_one(effect: str, file: Any) -> Any:
    """The number that an effect changes; a load gets a body of its own in the ``file``'s spec."""
    kind, _, joint = effect.partition(".")
    if kind in NAMES:
        return of_joint(joint, NAMES[kind], file)
    if kind == "payload":
        load = file.body("fore").add_body(name="payload", pos=[0, 0, -0.25])
        load.explicitinertial, load.mass, load.inertia = True, 1e-6, [1e-9] * 3

        def weigh(spec: Any, parameter: Any) -> None:
            spec.body("payload").mass = float(parameter.value[0])

        return sysid.Parameter("payload", 1e-6, 1e-6, 1.0, modifier=weigh)

    def turn(spec: Any, parameter: Any) -> None:
        spec.actuator("e").gear[0] = 10 * float(parameter.value[0])

    return sysid.Parameter(f"gear.{joint}", 1.0, 0.2, 2.0, modifier=turn)


def truth(name: str, made: SimulatedCase) -> float:
    """What a parameter of that name truly is."""
    model, file = (mujoco.MjModel.from_xml_path(str(path)) for path in (made.true, made.file))
    if name == "payload":
        return float(model.body_mass.sum() - file.body_mass.sum())
    attribute, joint = name.split(".")
    if attribute == "gear":
        return float(model.actuator_gear[1, 0] / file.actuator_gear[1, 0])
    dof = int(model.jnt_dofadr[model.joint(joint).id])
    return float(np.ravel(getattr(model, f"dof_{attribute}")[dof])[0])


def fitted(made: SimulatedCase, effect: str, known: bool, folder: Path) -> dict:
    """What `mujoco.sysid` makes of the first log: each number's error and interval, what is left, and seconds."""
    started = clock.process_time()
    spec = mujoco.MjSpec.from_file(str(made.file))
    parameters = sysid.ParameterDict()
    for each in [the_one(effect, spec)] if known else [of_joint(j, a, spec) for j in JOINTS for a in LARGEST]:
        parameters.add(each)
    parameters.move_off_bounds()
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
    for joint in JOINTS:
        kinds = mujoco.mjtSensor.mjSENS_JOINTPOS, mujoco.mjtObj.mjOBJ_JOINT
        spec.add_sensor(name=f"{joint}_pos", type=kinds[0], objtype=kinds[1], objname=joint)
    model = spec.compile()
    zeros = np.array([link.parts.zero for link in made.body.links if link.parts is not None])
    log = made.first
    fine = np.arange(round(log.time[-1] / model.opt.timestep) + 1) * model.opt.timestep
    controls = commands(model, made.body, log).control[np.searchsorted(log.time, fine + 1e-9, side="right") - 1]
    angles = zeros - np.asarray(log.angles)
    sequences = sysid.ModelSequences(
        "robot",
        spec,
        "log",
        sysid.create_initial_state(model, np.zeros(2), np.zeros(2)),
        sysid.TimeSeries.from_control_names(fine, controls, model),
        # its rollouts stamp sensors, which are those of a step's beginning, with the step's end
        sysid.TimeSeries.from_names(log.time + model.opt.timestep, angles, model),
    )
    residual = sysid.build_residual_fn(models_sequences=[sequences])
    with redirect_stdout(StringIO()):  # a line an iteration
        best, result = sysid.optimize(parameters, residual, optimizer="mujoco", verbose=False)
    after, _, _ = residual(result.x, best)
    _, widths = sysid.calculate_intervals(after, result.jac, alpha=0.1)
    seconds = clock.process_time() - started
    copy = mujoco.MjSpec.from_file(str(made.file))
    if known:
        the_one(effect, copy)
    sysid.apply_param_modifiers_spec(best, copy)
    copy.compile()
    (folder / "sysid.xml").write_text(copy.to_xml())
    numbers = {
        name: [float(value), float(width), truth(name, made)]
        for name, value, width in zip(best.keys(), result.x, widths, strict=True)
    }
    return {"numbers": numbers, "left": made.left(folder / "sysid.xml"), "cpu_s": seconds}


def ours(found: dict, made: SimulatedCase, effect: str) -> dict:
    """The same of a result of :mod:`write_back`."""
    numbers = {}
    words = {value: key for key, value in QUANTITY.items()}
    for change in found["changes"]:
        name = words.get(change["quantity"], change["quantity"])
        low, high = change["interval_90"]
        key = name if name == "payload" else f"{name}.{change['place']}"
        if name in (*LARGEST, "gear", "payload"):
            numbers[key] = [change["to"], max(high - change["to"], change["to"] - low), truth(key, made)]
    named = effect in found["answer"]
    return {"numbers": numbers, "left": found["left"], "cpu_s": found["cpu_s"], "named": named}


def wrong_number(effect: str) -> str:
    """The name of the parameter that an effect changes."""
    kind, _, joint = effect.partition(".")
    return "payload" if kind == "payload" else f"{NAMES.get(kind, 'gear')}.{joint}"


def row(name: str, rows: Sequence[tuple[str, dict]]) -> str:
    """A line of the table, of (effect, result)."""
    off, covered, moved = [], [], []
    for effect, result in rows:
        wrong = wrong_number(effect)
        value, width, true = result["numbers"].get(wrong, [np.nan, np.nan, np.nan])
        off.append(abs(value - true) / true if np.isfinite(value) else np.inf)
        covered.append(bool(abs(value - true) <= width))
        others = [each for key, each in result["numbers"].items() if key != wrong]
        moved.append(sum(abs(v - t) > w for v, w, t in others))
    left = [result["left"] for _, result in rows]
    has = [o for o in off if np.isfinite(o)]
    error = f"{100 * np.median(has):.2g} %" if has else ""
    return (
        f"| {name} | {len(rows)} | {len(has)} | {error} | {sum(covered)} | {np.mean(moved):.1f} | "
        f"{100 * np.median(left):.2g} % | {sum(x <= 0.1 for x in left)} | "
        f"{np.mean([result['cpu_s'] for _, result in rows]):.1f} |"
    )


def main() -> None:
    """Print a line a case and a table."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--cases", type=int, default=10, help="The first so many cases of write_back.")
    options.add_argument("--seed", type=int, default=50_000)
    options.add_argument("--results", type=Path, default=None, help="Where results of sysid are kept.")
    options.add_argument("--ours", type=Path, default=None, help="Results of write_back.")
    given = options.parse_args()
    warnings.simplefilter("ignore", UserWarning)
    found: dict[str, list[tuple[str, dict]]] = defaultdict(list)
    for number in range(given.cases):
        rng = np.random.default_rng([given.seed, number])
        robot = motors(rng)
        effect = list(robot.effects)[number % len(robot.effects)]
        if effect.partition(".")[0] not in KINDS:
            continue
        with tempfile.TemporaryDirectory() as name:
            made = simulated_case(rng, robot, effect, Path(name))
            mine = kept(given.ours, f"{given.seed} {number}", lambda n=number, e=effect: again(given.seed, n, e))
            found["invdyn, told nothing"].append((effect, ours(mine, made, effect)))
            for label, known in (("sysid, told which number", True), ("sysid, six numbers free", False)):
                key = f"{given.seed} {number} {label}"
                result = kept(given.results, key, lambda m=made, e=effect, t=known, f=name: fitted(m, e, t, Path(f)))
                found[label].append((effect, result))
                print(
                    f"{number} {effect} {label}: left {100 * result['left']:.2f} %, {result['cpu_s']:.1f} s", flush=True
                )
    columns = ("method", "cases", "has the wrong number", "its error, median", "90 % holds it", "others moved, mean")
    columns += ("excess left, median", "excess ≤ 10 %", "CPU s")
    print(f"| {' | '.join(columns)} |\n|{'---|' * len(columns)}")
    for label, rows in found.items():
        print(row(label, rows))


def again(seed: int, number: int, effect: str) -> dict:
    """A case of :mod:`write_back`."""
    rng = np.random.default_rng([seed, number])
    return case(rng, motors(rng), effect)


if __name__ == "__main__":
    main()
