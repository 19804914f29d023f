"""Springs and ripples of joints: one effect a class.

joint_coupling   a spring across two joints: potential ½ k (θ_i − r θ_j − θ₀)²
joint_stiffness  a spring in a joint: −k (θ − θ₀)
torque_ripple    a torque that repeats with the motor's angle: A sin(N θ + φ), the cogging of its poles
"""

from pyro.distributions import HalfNormal, LogNormal, Normal
from torch import Tensor

from invdyn.models.effects.base import Effect, Parameter, Scale, Situation, Values, as_variant, change, quantiles


class JointCoupling(Effect):
    """Torque T₀ − k (θ_i − r θ_j) at the second joint named, i, and r times its opposite at the first, j.

    What a muscle or a tendon over two joints does, which is slack in some posture: T₀ = k θ₀. Motion of one joint
    against the other distinguishes it from their own stiffness. As a fixed ``tendon`` with a ``springlength`` in
    MuJoCo.
    """

    site = "pair"

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Stiffness k, N·m/rad, torque T₀ with both angles at zero, N·m, and ratio r of the two lever arms, a pure
        number of either sign.
        """
        ratio, torque = Normal(0.0, 0.9), scale.torque[self.place[1]]
        return (
            Parameter("stiffness", "N·m/rad", HalfNormal(0.5 * torque)),
            Parameter("torque", "N·m", Normal(0.0, 0.9 * torque)),
            Parameter("ratio", "1", ratio, None, quantiles(ratio, 6)),
        )

    def force(self, p: Values, now: Situation) -> Tensor:
        """(T₀ − k (θ_i − r θ_j)) (e_i − r e_j)."""
        j, i = self.place
        pull = p["torque"] - p["stiffness"] * (now.q[..., i : i + 1] - p["ratio"] * now.q[..., j : j + 1])
        return now.at(i, pull) - now.at(j, p["ratio"] * pull)


class JointStiffness(Effect):
    """Torque −k (θ − θ₀) at a joint: passive tissue, a cable, a counterbalance.

    Given by its stiffness and by its torque where θ = 0, T₀ = k θ₀; it is linear in both. Rest pose and frequency
    distinguish it from a tilt or an armature. ``stiffness``, ``springref`` in MuJoCo.
    """

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Stiffness k, N·m/rad, and torque at angle zero T₀, N·m, for rest angles anywhere on a circle."""
        j = self.place[0]
        torque = scale.torque[j]
        return (
            change("stiffness", "N·m/rad", 0.5 * torque, scale.filed("stiffness", j)),
            Parameter("torque", "N·m", Normal(0.0, 0.9 * torque)),
        )

    def force(self, p: Values, now: Situation) -> Tensor:
        """T₀ − k θ."""
        return now.at(self.place[0], p["torque"] - p["stiffness"] * self.own(now.q))


PERIODS = (4, 5, 6, 7, 8, 9, 10, 11, 12, 14, 16, 18, 20, 24, 28, 32, 36, 40, 48)


class TorqueRipple(Effect):
    """Torque a sin Nθ + b cos Nθ = A sin(Nθ + φ) at a joint.

    Slow sweeps over many periods distinguish it from a spring. As ``cogging`` in MuJoCo. Poles are no perfect sines:
    the variant has the second harmonic, a₂ sin 2Nθ + b₂ cos 2Nθ, too.
    """

    def nonideal(self) -> Effect | None:
        """With the second harmonic."""
        return None if self.variant else as_variant(self, 1)

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Parts a and b, N·m, and periods N a revolution, which the motor's build makes whole; a₂ and b₂."""
        typical = 0.05 * scale.effort[self.place[0]]
        first, second = Normal(0.0, typical), Normal(0.0, 0.5 * typical)
        return (
            Parameter("sine", "N·m", first),
            Parameter("cosine", "N·m", first),
            Parameter("periods", "1", LogNormal(2.4, 0.7), None, tuple(map(float, PERIODS))),
            *(Parameter(f"second_{part}", "N·m", second) for part in ("sine", "cosine") if self.variant),
        )

    def force(self, p: Values, now: Situation) -> Tensor:
        """Of both harmonics."""
        angle = p["periods"] * self.own(now.q)
        torque = p["sine"] * angle.sin() + p["cosine"] * angle.cos()
        if self.variant:
            torque = torque + p["second_sine"] * (2 * angle).sin() + p["second_cosine"] * (2 * angle).cos()
        return now.at(self.place[0], torque)
