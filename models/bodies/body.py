"""Bodies: planar chains of rigid links, each scalar of them a number, a prior or a learned parameter.

Denavit–Hartenberg geometry in the plane: θ₁ is counted from the x axis, each further angle from the
parent link, counter-clockwise positive; a limb that hangs down has θ₁ = −π/2. Link k begins at joint k
and ends at its tip, where joint k+1 sits.

Per link: `length` m, `mass` kg, `com` m from the joint along the link (default length/2), `inertia`
kg·m² about the centre of mass (default mass·length²/12, a uniform rod). Per body: `gravity` m/s² and the
first joint `base` m, both (x, y) in the recording's frame. Files: `body_toml.py`, `body_mjcf.py`, `body_urdf.py`.
"""

import dataclasses
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, Self

import pyro
import pyro.distributions as dist
import torch
from torch import Tensor
from torch.distributions import constraints

from invdyn.models.bodies import body_chain, body_toml, body_xml, joint_parts_toml, robot_file
from invdyn.models.bodies.from_files import FromFiles
from invdyn.models.bodies.joint_parts import JointParts, relative
from invdyn.models.bodies.link import Link
from invdyn.models.bodies.placeholders import Moment
from invdyn.models.bodies.protocol import BodyBase
from invdyn.models.bodies.scalars import (
    QUANTITIES,
    BodyError,
    Learned,
    Scalar,
    check_keys,
    check_name,
    nominal,
    prior,
    vector,
)
from invdyn.models.bodies.whole_file import read_whole

MOST_LINKS = 100  # an arm has seven, a snake robot thirty
FOLLOWING = ("com", "inertia")  # quantities that follow from length and mass where a link leaves them out


class BodyParameters(NamedTuple):
    """The numbers of a K-link body as tensors; leading dimensions are many parameter sets.

    `length`, `mass`, `com`, `inertia` (..., K); `gravity`, `base` (..., 2). Units at the top of this file.
    """

    length: Tensor
    mass: Tensor
    com: Tensor
    inertia: Tensor
    gravity: Tensor
    base: Tensor

    def to(self, *args: Any, **kwargs: Any) -> "BodyParameters":
        """Return them with `Tensor.to(*args, **kwargs)` applied to every tensor."""
        return BodyParameters(*(value.to(*args, **kwargs) for value in self))


@dataclass(frozen=True)
class Body(FromFiles, BodyBase):
    """A planar chain. `links` run from the base outwards; `uncertainty` has relative sds by quantity.

    Of joints' parts these are by quantity or of one joint, "damping" or "damping.elbow"; diagnoses alone learn them.

    Raises `BodyError` for no links or more than a hundred, a name used twice, gravity or base that are not two finite
    numbers, and unknown or negative uncertainties.
    """

    name: str
    links: Sequence[Link]
    gravity: Sequence[float] = (0.0, -9.81)
    base: Sequence[float] = (0.0, 0.0)
    uncertainty: Mapping[str, float] = field(default_factory=dict)
    space: ClassVar[int] = 2
    signed: ClassVar[frozenset[str]] = frozenset({"com", "gravity", "base"})

    def __post_init__(self) -> None:
        check_name(self.name, "name of a body")
        where = f"body '{self.name}'"
        object.__setattr__(self, "links", tuple(self.links))
        object.__setattr__(self, "gravity", vector(self.gravity, f"{where}: gravity in m/s²"))
        object.__setattr__(self, "base", vector(self.base, f"{where}: base in m"))
        if not self.links:
            raise BodyError(f"{where}: expected at least one link, got none")
        if len(self.links) > MOST_LINKS:
            raise BodyError(f"{where}: expected at most {MOST_LINKS} links, got {len(self.links)}")
        for key in ("name", "joint", "tip"):
            names = [getattr(link, key) for link in self.links]
            for name in names:
                if names.count(name) > 1:
                    raise BodyError(f"{where}: expected a {key} of its own for each link, got '{name}' twice")
        for place, tip in enumerate(self.keypoint_names):
            # a keypoint is called after the joint that it shows, so one name cannot mean two places
            if tip in self.joint_names and self.joint_names.index(tip) != place + 1:
                raise BodyError(f"{where}: '{tip}' is the tip of one link but the joint of another, elsewhere")
        object.__setattr__(self, "uncertainty", relative(self.uncertainty, QUANTITIES, self.joint_names, where))

    @property
    def num_joints(self) -> int:
        """K, the number of joints and of links."""
        return len(self.links)

    @property
    def has_priors(self) -> bool:
        """Whether any scalar is a prior rather than a number."""
        return any(isinstance(getattr(link, key), dist.Distribution) for link in self.links for key in QUANTITIES)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the K joints, from the base outwards."""
        return tuple(link.joint for link in self.links)

    @property
    def joint_parts(self) -> tuple[JointParts | None, ...]:
        """What each joint has besides its hinge."""
        return tuple(link.parts for link in self.links)

    @property
    def link_names(self) -> tuple[str, ...]:
        """Names of the K links, from the base outwards."""
        return tuple(link.name for link in self.links)

    @property
    def keypoint_names(self) -> tuple[str, ...]:
        """Names of the K tips, from the base outwards."""
        return tuple(link.tip for link in self.links)

    @property
    def base_keypoint(self) -> str:
        """Name of the keypoint at the base: the first joint's."""
        return self.links[0].joint

    @property
    def hand(self) -> tuple[int, int]:
        """The last link and its tip."""
        return self.num_joints - 1, self.num_joints - 1

    @property
    def learned(self) -> dict[str, tuple[int, ...]]:
        """Links whose scalars are to be learned, by quantity."""
        found = {
            key: tuple(k for k, link in enumerate(self.links) if isinstance(getattr(link, key), Learned))
            for key in QUANTITIES
        }
        return {key: links for key, links in found.items() if links}

    @property
    def hanging(self) -> list[float]:
        """Angles at which it hangs; along the x axis without gravity."""
        down = math.atan2(self.gravity[1], self.gravity[0]) if any(self.gravity) else 0.0
        return [down] + [0.0] * (self.num_joints - 1)

    def completed(self, numbers: BodyParameters) -> BodyParameters:
        """The numbers with com and inertia following length and mass, of links that say neither."""
        for key, which in self._left_out(numbers.length.device).items():
            if key == "com":
                numbers = numbers._replace(com=torch.where(which, numbers.length / 2, numbers.com))
            else:
                rod = numbers.mass * numbers.length**2 / 12
                numbers = numbers._replace(inertia=torch.where(which, rod, numbers.inertia))
        return numbers

    def drawn(self, numbers: BodyParameters) -> dict[str, Tensor]:
        """Scalars that are priors or learned, by `sample`; plain ones of the same quantity stand as in ``numbers``."""
        own = self.sample(dtype=numbers.length.dtype, device=numbers.length.device)._asdict()
        found = {}
        for key in QUANTITIES:
            free = [isinstance(getattr(link, key), dist.Distribution | Learned) for link in self.links]
            if any(free):
                which = torch.tensor(free, device=numbers.length.device)
                found[key] = torch.where(which, own[key], getattr(numbers, key))
        return found

    def described(self, numbers: Any) -> dict[str, tuple[list[str], Tensor]]:
        """Its numbers with their dims: links', and vectors of the plane."""
        dims = {key: ["link"] if key in QUANTITIES else ["space"] for key in numbers._fields}
        return {key: (dims[key], value.detach()) for key, value in numbers._asdict().items()}

    def _left_out(self, device: torch.device) -> dict[str, Tensor]:
        """Of com and inertia which links (K,) leave them out; kept where they are asked for, as no row may wait."""
        if device not in self._left_out_on:
            missing = {key: torch.tensor([getattr(link, key) is None for link in self.links]) for key in FOLLOWING}
            self._left_out_on[device] = {key: which.to(device) for key, which in missing.items() if bool(which.any())}
        return self._left_out_on[device]

    @cached_property
    def _left_out_on(self) -> dict[torch.device, dict[str, Tensor]]:
        return {}

    def parameters(
        self, dtype: torch.dtype = torch.float64, device: torch.device | str | None = None, **given: Tensor
    ) -> BodyParameters:
        """Return `BodyParameters` (K,) at the nominal values (see `Link.nominal`).

        Keyword arguments length, mass, com, inertia (..., K) take the place of the body's own, with any
        leading dimensions; the defaults of com and inertia follow them. Raises `BodyError` for other
        keywords, or another number than K.
        """
        check_keys(given, QUANTITIES, "Body.parameters")
        given = {key: torch.as_tensor(value, dtype=dtype, device=device) for key, value in given.items()}
        for key, value in given.items():
            if value.shape[-1:] != (self.num_joints,):
                raise BodyError(f"expected {key} of shape (..., {self.num_joints}), got {tuple(value.shape)}")

        def column(place: int, key: str) -> Tensor | None:
            if key in given:
                return given[key][..., place]
            own = getattr(self.links[place], key)
            return None if own is None else torch.tensor(nominal(own), dtype=dtype, device=device)

        return self._assemble(column, dtype, device)

    def sample(
        self,
        prefix: str = "",
        dtype: torch.dtype = torch.float64,
        device: torch.device | str | None = None,
    ) -> BodyParameters:
        """Return `BodyParameters`: priors by `pyro.sample`, learned scalars by `pyro.param`.

        Sites are called prefix + "upper_arm.length". In a plate, what is sampled gains its dimensions,
        (..., K).
        """

        def column(place: int, key: str) -> Tensor | None:
            own, site = getattr(self.links[place], key), f"{prefix}{self.links[place].name}.{key}"
            if own is None:
                return None
            if isinstance(own, dist.Distribution):
                return pyro.sample(site, own).to(dtype=dtype, device=device)
            value = torch.tensor(nominal(own), dtype=dtype, device=device)
            if isinstance(own, Learned):
                support = constraints.real if key == "com" else constraints.positive
                return pyro.param(site, value, constraint=support)
            return value

        return self._assemble(column, dtype, device)

    def _assemble(
        self,
        column: Callable[[int, str], Tensor | None],
        dtype: torch.dtype,
        device: torch.device | str | None,
    ) -> BodyParameters:
        links = []
        for place in range(self.num_joints):
            length, mass, com, inertia = (column(place, key) for key in QUANTITIES)
            assert length is not None  # a link has both
            assert mass is not None
            rod = mass * length**2 / 12 if inertia is None else inertia
            links.append((length, mass, length / 2 if com is None else com, rod))
        # each quantity has only the leading dimensions that it needs itself
        scalars = [torch.stack(torch.broadcast_tensors(*each), -1) for each in zip(*links, strict=True)]
        vectors = [torch.tensor(value, dtype=dtype, device=device) for value in (self.gravity, self.base)]
        return BodyParameters._make([*scalars, *vectors])

    def with_uncertainty(self) -> Self:
        """Return the body with its relative sds made priors around the nominal values, and none left.

        Scalars that are priors or learned already stay so. A com or inertia that is given one no longer
        follows length and mass. Joints' parts stay as they are. Raises `BodyError` for a relative sd of a com or
        inertia of 0.
        """
        links = []
        for link in self.links:
            priors = {}
            for key, sd in self.uncertainty.items():
                if sd > 0 and key in QUANTITIES and isinstance(getattr(link, key), float | None):
                    if link.nominal(key) == 0:
                        raise BodyError(f"link '{link.name}': {key} is 0 and has no relative sd; give it a prior")
                    priors[key] = prior(link.nominal(key), sd * abs(link.nominal(key)))
            links.append(dataclasses.replace(link, **priors))
        return dataclasses.replace(self, links=tuple(links), uncertainty={})

    def with_values(self, **given: Sequence[Scalar | None]) -> Self:
        """Return the body with other scalars, K of each: `body.with_values(length=[0.31, 0.27])`.

        An entry is anything that a `Link` takes. Raises `BodyError` for another number of them than K.
        """
        check_keys(given, QUANTITIES, "Body.with_values")
        for key, values in given.items():
            if len(values) != self.num_joints:
                raise BodyError(f"expected {self.num_joints} values of {key}, one for each link, got {len(values)}")
        links = []
        for place, link in enumerate(self.links):
            new: dict[str, Any] = {key: values[place] for key, values in given.items()}
            links.append(dataclasses.replace(link, **new))
        return dataclasses.replace(self, links=tuple(links))

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a body file of any kind: MJCF (<mujoco>) or URDF (<robot>), whatever its name, else TOML.

        Raises as they do, and `BodyError`, which says what to do instead, for another kind of XML.
        """
        content = read_whole(path, body_xml.MOST_BYTES)
        if body_xml.is_xml(content):
            return cls.from_robot(robot_file.of(content, str(path)), path)
        return cls.from_tables(body_toml.parse(content, str(path)), path)

    @classmethod
    def from_tables(cls, tables: dict, path: str | Path) -> Self:
        """The body of a TOML file's tables; see `load`."""
        return cls._of(body_toml.of(tables, str(path)), path)

    @classmethod
    def from_toml(cls, path: str | Path) -> Self:
        """Read a body file. Raises `BodyError`, which names the file, or `OSError` if it cannot be read."""
        return cls._of(body_toml.read(path), path)

    @staticmethod
    def link_of(table: dict) -> Link:
        """A link of a table."""
        return Link(**table)

    tables_of = staticmethod(body_chain.tables)

    def largest_moments(self) -> Iterator[Moment]:
        """Of each link about its centre of mass."""
        for link in self.links:
            yield Moment(link.name, link.nominal("inertia"), link.nominal("mass"), link.nominal("length"))

    def to_toml(self, path: str | Path) -> None:
        """Write a body file that `from_toml` reads back.

        Raises `BodyError` for priors that no file can express (all but log-normal), `OSError` for no place.
        """
        links = [
            {key: getattr(link, key) for key in body_toml.LINK_KEYS} | joint_parts_toml.told(link.parts)
            for link in self.links
        ]
        body_toml.write(path, {key: getattr(self, key) for key in body_toml.BODY_KEYS} | {"links": links})
