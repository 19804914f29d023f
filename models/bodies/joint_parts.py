"""What a joint has besides its hinge: damping, dry friction, a rotor, a spring, and the motor that drives it.

    τ = u − b θ̇ − f sgn θ̇ − I_a θ̈ − k (θ − θ₀)
    u = clip(command)                                             of a torque motor
    u = clip(K c + u₀ − S θ − D θ̇)                                of a servo whose target is an angle or a velocity c

All as the joint feels it, behind the gear. In MuJoCo's terms (Computation: actuation model) an actuator's force is
gain · ctrl + bias₀ + bias₁ · length + bias₂ · velocity, with length = gear · q, and acts times the gear.

`step` and `late` say how the file's own engine simulates the joint, and are no part of the robot. A first-order engine
kicks velocities at the beginning of each step of h s and then moves with them, so that u acts h/2 early. A damper that
it takes at the end of a step acts h/2 early, too, as an inertia B h/2 would; one that it takes from the beginning h/2
late (Hairer, Lubich & Wanner 2006, §IX.1).

Joints' parts in a body's TOML: keys of a link, and its motor as a table.

damping = 0.1            friction = 0.05        armature = 0.01        stiffness = 2.0        rest = 0.3
motor = {kind = "position", gain = 40.0, stiffness = 40.0, damping = 1.0, low = -5.0, high = 5.0}
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace

from invdyn.models.bodies.scalars import KNOWN, UNKNOWN, BodyError, check_keys, number

KINDS = ("torque", "position", "velocity")


@dataclass(frozen=True)
class Motor:
    """A motor. `kind` says what its command is: "torque" N·m, "position" rad or "velocity" rad/s.

    `gain` K, `stiffness` S and `damping` D are a servo's, N·m a unit; `bias` u₀, and the limits `low`, `high`, N·m.
    `gear` is how far the file's own actuator turns for a radian of the joint; all else is stated at the joint.
    Raises `BodyError` for an unknown kind, a low limit that is not below the high one, and what is no number.
    """

    kind: str = "torque"
    gain: float = 1.0
    stiffness: float = 0.0
    damping: float = 0.0
    bias: float = 0.0
    low: float = -math.inf
    high: float = math.inf
    gear: float = field(default=1.0, compare=False)

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise BodyError(f"expected a motor of the kind {', '.join(KINDS)}, got {self.kind!r:.60}")
        for key in ("gain", "stiffness", "damping", "bias", "gear"):
            object.__setattr__(self, key, number(getattr(self, key), f"a motor's {key}"))
        if not self.gear:
            raise BodyError("expected a motor's gear other than 0, got 0: leave it out for a motor at its joint")
        if not (isinstance(self.low, int | float) and isinstance(self.high, int | float) and self.low < self.high):
            raise BodyError(
                f"expected a motor's limits as numbers, low < high, got {self.low!r:.60} and {self.high!r:.60}"
            )

    @property
    def limited(self) -> bool:
        """Whether it has a limit."""
        return math.isfinite(self.low) or math.isfinite(self.high)

    def turned(self, sign: float, zero: float) -> "Motor":
        """The motor of a joint whose angle θ = zero + sign · q, ``sign`` ±1."""
        bias = sign * self.bias + self.stiffness * zero - (self.gain * zero if self.kind == "position" else 0.0) + 0.0
        low, high = (self.low, self.high) if sign > 0 else (-self.high, -self.low)
        return replace(self, bias=bias, low=low, high=high)


@dataclass(frozen=True)
class JointParts:
    """`damping` b N·m·s/rad, `friction` f N·m, `armature` I_a kg·m², `stiffness` k N·m/rad with its `rest` θ₀ rad.

    `sign` and `zero` say how the robot's own file counts the joint: θ = zero + sign · q. `step` h s of the file's
    engine, 0 for none of first order; `late` N·m·s/rad, dampers at a step's end less those at its beginning.
    Raises `BodyError` for what is no finite number, friction and the like that are negative, and another sign than ±1.
    """

    damping: float = 0.0
    friction: float = 0.0
    armature: float = 0.0
    stiffness: float = 0.0
    rest: float = 0.0
    motor: Motor | None = None
    sign: float = 1.0
    zero: float = 0.0
    step: float = field(default=0.0, compare=False)
    late: float = field(default=0.0, compare=False)

    def __post_init__(self) -> None:
        for key in (*NUMBERS, "sign", "zero", "step", "late"):
            value = number(getattr(self, key), f"a joint's {key}")
            if value < 0 and key in (*NUMBERS, "step") and key != "rest":
                raise BodyError(f"expected a joint's {key} of 0 or more, got {value:g}")
            object.__setattr__(self, key, value)
        if abs(self.sign) != 1:
            raise BodyError(f"expected a joint's sign as 1 or -1, got {self.sign:g}")

    def turned(self, sign: float, zero: float) -> "JointParts":
        """The parts, said in the file's own angle q, of a joint whose angle θ = zero + sign · q."""
        motor = None if self.motor is None else self.motor.turned(sign, zero)
        return replace(self, rest=zero + sign * self.rest if self.stiffness else 0.0, motor=motor, sign=sign, zero=zero)

    @property
    def servo(self) -> Motor | None:
        """Its motor, where that has a target angle or velocity."""
        return self.motor if self.motor is not None and self.motor.kind != "torque" else None

    @property
    def servo_damping(self) -> float:
        """D of a servo whose target is an angle, N·m·s/rad: short of its limits it damps as the joint does."""
        servo = self.servo
        return servo.damping if servo is not None and servo.kind == "position" else 0.0


NUMBERS = ("damping", "friction", "armature", "stiffness", "rest")
PARTS = {"damping": "N·m·s/rad", "friction": "N·m", "armature": "kg·m²", "stiffness": "N·m/rad"}
"""Parts that may be uncertain, with their units: their sds are relative, and a joint without one keeps none."""
NOTHING = JointParts()


def relative(
    given: Mapping[str, float], quantities: Sequence[str], joints: Sequence[str], where: str
) -> dict[str, float]:
    """Relative standard deviations of ``quantities`` of links, and of parts, of all joints or of one ("damping.elbow").

    Raises `BodyError`, which begins with ``where``, for other words, unknown joints, and what is no such number.
    """
    for key in given:
        part, dot, joint = key.partition(".")
        check_keys([part if part in PARTS else key], [*quantities, *PARTS], f"{where}: uncertainty")
        if dot and joint not in joints:
            raise BodyError(f"{where}: uncertainty of {key}: expected a joint among {', '.join(joints)}")
    sds = {key: number(value, f"{where}: uncertainty of {key}") for key, value in given.items()}
    if not all(sd == 0 or KNOWN <= sd <= UNKNOWN for sd in sds.values()):
        raise BodyError(
            f"{where}: expected relative standard deviations of 0, or from {KNOWN:.0e} to {UNKNOWN:g}, "
            f"as uncertainty, got {sds}"
        )
    return sds


SAID = (*NUMBERS, "sign", "zero", "step", "late")
PART_KEYS = (*SAID, "motor")


def parts_taken(link: dict, where: str) -> JointParts | None:
    """A link's keys that are its joint's parts, taken out of it; None of none. Raises `BodyError`."""
    given = {key: link.pop(key) for key in PART_KEYS if key in link}
    if not given:
        return None
    try:
        if "motor" in given:
            motor = given["motor"]
            if not isinstance(motor, dict):
                raise BodyError(f"expected motor as a table, such as {{low = -5.0, high = 5.0}}, got {motor!r:.60}")
            check_keys(motor, [each.name for each in fields(Motor)], f"{where}: motor")
            if motor.get("kind") == "position":
                motor = {"stiffness": motor.get("gain", 1.0), **motor}
            given["motor"] = Motor(**motor)
        return JointParts(**given)
    except BodyError as error:
        text = str(error)
        raise BodyError(text if text.startswith(where) else f"{where}: {text}") from None


def parts_table(parts: JointParts | None) -> dict:
    """The keys of a link that say the same; those that stand as they would without are left out."""
    if parts is None:
        return {}
    found = {key: getattr(parts, key) for key in SAID if getattr(parts, key) != getattr(NOTHING, key)}
    if parts.motor is not None:
        plain = Motor()
        said = {each.name: getattr(parts.motor, each.name) for each in fields(Motor)}
        found["motor"] = {key: value for key, value in said.items() if key == "kind" or value != getattr(plain, key)}
        if parts.motor.kind == "position":
            found["motor"]["stiffness"] = parts.motor.stiffness
    return found
