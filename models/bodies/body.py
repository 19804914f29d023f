"""Bodies: trees of rigid links, each scalar of them a number, a prior or a learned parameter.

A link hangs on its parent, or on the world, by a joint (`joints.py`). The joint's frame lies at `origin` m, rotated by
`rotation`, in the parent's frame; the link's own frame is the joint's, moved. In it lie the centre of mass `com` m, the
`inertia` kg·m² about that (xx, yy, zz, xy, xz, yz) and `sites`, named points, m, that keypoints show.

A link may have a `length` m instead: it is a stick along its x axis, whose `tip` is a site. Unless they say otherwise,
links on it are placed at its tip, its com is in its middle and its inertia that of a thin rod.

The base is what the first joint makes of it: fixed where the link's joint is any on the world, free by a joint of type
free.

A body of two `dimensions` is a chain of sticks in the plane, which keypoints show by x and y (:func:`planar_body`).
Denavit–Hartenberg: θ₁ is counted from the x axis, each further angle from the parent link, counter-clockwise positive;
a limb that hangs down has θ₁ = −π/2. Its numbers are fewer, see :mod:`.planar`.

Files: `body_toml.py`, `body_mjcf.py`, `body_urdf.py`; tables of Denavit and Hartenberg: `dh.py`.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
import pyro
import pyro.distributions as dist
import torch
from torch import Tensor
from torch.distributions import constraints

from invdyn.models.bodies import planar
from invdyn.models.bodies.from_files import FromFiles
from invdyn.models.bodies.geometry import hand, skeleton, turning
from invdyn.models.bodies.inertia import NAMES, check_inertia, tensor
from invdyn.models.bodies.joint_parts import NOTHING, JointParts, relative
from invdyn.models.bodies.joints import WORLD, Motion
from invdyn.models.bodies.link import Link, ordered
from invdyn.models.bodies.protocol import kept_as
from invdyn.models.bodies.rotations import numbers
from invdyn.models.bodies.scalars import QUANTITIES, BodyError, Learned, Scalar, check_keys, check_name, nominal, prior
from invdyn.models.bodies.tree_parameters import Sticks, assembled, moments, vector_of

POSITIVE = ("mass", "length", "inertia", *(f"inertia_{name}" for name in NAMES[:3]))
"""Scalars that are learned as positive numbers, by the last word of their Pyro sites."""


@dataclass(frozen=True)
class Body(FromFiles):
    """A tree of links; `gravity` m/s² in the world's frame, z up unless it says otherwise.

    `uncertainty` has relative sds of all masses (in the plane of length, com and inertia, too), and of joints' parts by
    quantity or of one joint: "mass", "damping", "damping.elbow". `exact` says whether all else is known as it stands:
    that of a file is not, until `exact` says so, as `exact = true` does in a TOML.

    Links are kept with parents before children, else in the order given; `joint_names` are its K
    coordinates. Raises `BodyError` for no links or no coordinates, unknown parents, a cycle, names used twice, inertia
    tensors that break the triangle inequality where that matters, and in the plane for what is no chain of sticks.
    """

    name: str
    links: Sequence[Link]
    gravity: Sequence[float] = (0.0, 0.0, -9.81)
    uncertainty: Mapping[str, float] = field(default_factory=dict)
    dimensions: int = 3
    exact: bool = field(default=True, compare=False)

    def __post_init__(self) -> None:
        check_name(self.name, "name of a body")
        where = f"body '{self.name}'"
        if self.dimensions not in (2, 3):
            raise BodyError(f"{where}: expected 2 or 3 dimensions, got {self.dimensions!r:.40}")
        gravity = numbers(self.gravity, self.dimensions, f"{where}: gravity in m/s²")
        object.__setattr__(self, "gravity", tuple(gravity.tolist()))
        if not self.links:
            raise BodyError(f"{where}: expected at least one link, got none")
        names = {
            "link": [link.name for link in self.links],
            "joint": [link.joint.name for link in self.links],
            "site": [site for link in self.links for site in (*link.sites, *([link.tip] if link.tip else []))],
        }
        for kind, every in names.items():
            for name in every:
                if every.count(name) > 1:
                    raise BodyError(f"{where}: expected names of their own for all {kind}s, got '{name}' twice")
        object.__setattr__(self, "links", ordered(self.links, where))
        quantities = QUANTITIES if self.is_chain else ("mass",)
        object.__setattr__(self, "uncertainty", relative(self.uncertainty, quantities, self.joint_names, where))
        if any(link.load for link in self.links) and (self.exact or self.uncertainty or self.has_priors):
            raise BodyError(
                f"{where}: a load of uncertain mass is for a body that states no other certainty: leave exact, "
                "[uncertainty] and priors out, or give the load's mass as a number"
            )
        if self.is_chain:
            planar.check_chain(self.links, where)
            return
        if not self.num_joints:
            raise BodyError(f"{where}: expected a joint that moves, got only fixed ones")
        for link, directions in zip(self.links, turning(self.links, self.parents), strict=True):
            own = moments(link, nominal(link.mass), None if link.length is None else nominal(link.length))
            check_inertia(tensor(np.array([nominal(x) for x in own])), directions, f"{where}: link '{link.name}'")

    @classmethod
    def planar(
        cls,
        name: str,
        links: Sequence[Link],
        gravity: Sequence[float] = (0.0, -9.81),
        base: Sequence[float] = (0.0, 0.0),
        uncertainty: Mapping[str, float] | None = None,
        exact: bool = True,
    ) -> Self:
        """Return a chain in the plane: sticks on hinges, from the first joint at `base` (x, y) m outwards.

        `planar_body("arm", [Link("upper_arm", "shoulder", "elbow", length=0.3, mass=1.5), …])`: each link begins where
        the one before ends. `gravity` (x, y) m/s²; `uncertainty` has relative sds of "length", "mass", "com" and
        "inertia", and of joints' parts. Raises `BodyError` as `Body` does.
        """
        place = (*numbers(base, 2, f"body '{name}': base in m").tolist(), 0.0)
        chain: list[Link] = []
        for link in links:
            where: dict[str, Any] = {"parent": chain[-1].name} if chain else {"origin": place}
            chain.append(replace(link, **where))
        return cls(name, chain, gravity, uncertainty or {}, 2, exact)

    # -- names and places ------------------------------------------------------------------------
    @property
    def is_chain(self) -> bool:
        """Whether it is a chain of sticks in the plane, with `BodyParameters` as its numbers."""
        return self.dimensions == 2

    @property
    def signed(self) -> frozenset[str]:
        """Its numbers that may be negative."""
        own = {"base"} if self.is_chain else {"inertia", "position", "rotation", "sites"}
        return frozenset({"com", "gravity", *own})

    @property
    def num_joints(self) -> int:
        """Number K of coordinates that torques move."""
        return len(self.joint_names)

    @property
    def link_names(self) -> tuple[str, ...]:
        """Names of the links, parents before children."""
        return tuple(link.name for link in self.links)

    @cached_property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the K coordinates: the joint's, with _yaw, _pitch, _roll, _x, _y or _z where it has several."""
        return tuple(motion.name for _, motion in self.motions())

    @cached_property
    def joint_parts(self) -> tuple[JointParts, ...]:
        """What each of the K coordinates has besides."""
        return tuple(link.parts or NOTHING for link, _ in self.motions())

    @cached_property
    def keypoint_names(self) -> tuple[str, ...]:
        """Names of the S sites, a link's tip first, from the first link on."""
        return tuple(site for link in self.links for site in link.points)

    @cached_property
    def parents(self) -> tuple[int, ...]:
        """The place of each link's parent among the links, −1 for the world."""
        places = {WORLD: -1} | {link.name: place for place, link in enumerate(self.links)}
        return tuple(places[link.parent] for link in self.links)

    @property
    def base(self) -> tuple[float, ...]:
        """Where the first joint is, m, in as many coordinates as the body has dimensions."""
        return tuple(nominal(x) for x in self.links[0].origin or (0.0, 0.0, 0.0))[: self.dimensions]

    @property
    def base_keypoint(self) -> str | None:
        """The keypoint at the base has the first joint's name; "base" where a site of a tree has that."""
        name = self.links[0].joint.name
        return next((each for each in (name, "base") if each not in self.keypoint_names), None)

    def motions(self) -> list[tuple[Link, Motion]]:
        """All coordinates, with the link that each belongs to."""
        return [(link, motion) for link in self.links for motion in link.joint.motions()]

    @property
    def hanging(self) -> list[float]:
        """Coordinates at which a chain in the plane hangs, along x without gravity; of a tree all zero."""
        if not self.is_chain:
            return [0.0] * self.num_joints
        down = math.atan2(self.gravity[1], self.gravity[0]) if any(self.gravity) else 0.0
        return [down] + [0.0] * (self.num_joints - 1)

    @property
    def hand(self) -> tuple[int, int] | None:
        """The last link, or of several that end the tree what they hang on, and the site farthest from its joint.

        None where that is the world, or has no site.
        """
        return hand(self.links, self.parents, self.in_space().parameters().sites)

    def moved_by(self, link: int) -> tuple[int, ...]:
        """Coordinates of its joint, or, where that is fixed, of the next one inwards."""
        owners = [self.links.index(each) for each, _ in self.motions()]
        while link >= 0:
            if found := tuple(k for k, owner in enumerate(owners) if owner == link):
                return found
            link = self.parents[link]
        return ()

    def in_space(self) -> Self:
        """The same body of three dimensions, the plane as its x–y."""
        gravity = (*self.gravity, 0.0)[:3]
        rest = {key: sd for key, sd in self.uncertainty.items() if key not in ("length", "com", "inertia")}
        return replace(self, gravity=gravity, uncertainty=rest, dimensions=3) if self.is_chain else self

    @property
    def _stands(self) -> bool:
        """Whether the first joint is at a place that does not move."""
        return all(motion.turns for motion in self.links[0].joint.motions())

    # -- numbers ---------------------------------------------------------------------------------
    def parameters(
        self, dtype: torch.dtype = torch.float64, device: torch.device | str | None = None, **given: Tensor
    ) -> Any:
        """Return the numbers at the nominal values: priors at their means, learned ones at their starts.

        A `TreeParameters`, of a chain in the plane `BodyParameters`; of these keyword arguments length, mass, com and
        inertia (..., K) take the place of the body's own, and com and inertia that are left out follow. Raises
        `BodyError` for other keywords, or another number than K.
        """

        def draw(value: Scalar, site: str) -> Tensor:
            return torch.tensor(nominal(value), dtype=dtype, device=device)

        found = self._numbers(draw)
        if not given:
            return found
        check_keys(given, QUANTITIES if self.is_chain else (), "Body.parameters")
        own = {key: torch.as_tensor(value, dtype=dtype, device=device) for key, value in given.items()}
        for key, value in own.items():
            if value.shape[-1:] != (self.num_joints,):
                raise BodyError(f"expected {key} of shape (..., {self.num_joints}), got {tuple(value.shape)}")
        return self.completed(found._replace(**own))._replace(**own)

    def sample(
        self, prefix: str = "", dtype: torch.dtype = torch.float64, device: torch.device | str | None = None
    ) -> Any:
        """Return the numbers with priors drawn by `pyro.sample` and learned scalars looked up by `pyro.param`.

        Pyro's sites are called prefix + "upper_arm.mass", "upper_arm.length", "upper_arm.com" along a stick or
        "upper_arm.com_x", "upper_arm.inertia" or "upper_arm.inertia_xx", "upper_arm.origin_x", and "upper_arm.wrist_x"
        for a site called wrist. In a plate, what is sampled gains its dimensions.
        """

        def draw(value: Scalar, site: str) -> Tensor:
            if isinstance(value, dist.Distribution):
                return pyro.sample(prefix + site, value).to(dtype=dtype, device=device)
            number = torch.tensor(nominal(value), dtype=dtype, device=device)
            if not isinstance(value, Learned):
                return number
            positive = site.rpartition(".")[2] in POSITIVE
            return pyro.param(prefix + site, number, constraint=constraints.positive if positive else constraints.real)

        return self._numbers(draw)

    def _numbers(self, draw: Any) -> Any:
        gravity = (*self.gravity, 0.0)[:3]
        found = assembled(self.links, self.parents, gravity, draw, self.is_chain)
        return planar.in_plane(found) if self.is_chain else found

    def completed(self, numbers: Any) -> Any:
        """The numbers with what sticks leave out following their lengths and masses; a tree's tips show its lengths."""
        return self._sticks.completed(numbers)

    def drawn(self, numbers: Any) -> dict[str, Tensor]:
        """Entries that are priors or learned, by `sample`; plain ones of the same number stand as in ``numbers``."""
        entries = self._entries(dist.Distribution | Learned)
        sampled, found = self.sample(dtype=numbers.mass.dtype, device=numbers.mass.device)._asdict(), {}
        for key, indices in entries.items():
            given, shape = getattr(numbers, key), self._shapes[key]
            which = torch.zeros(shape, dtype=torch.bool).reshape(-1)
            which[list(indices)] = True
            found[key] = torch.where(which.reshape(shape).to(given.device), sampled[key], given)
        return found

    def described(self, numbers: Any) -> dict[str, tuple[list[str], Tensor]]:
        """By link, site and axis; joints' positions as "origin". Of a tree `base`, if it stands, and `skeleton`."""
        dims = {
            "mass": ["link"],
            "com": ["link", "space"],
            "inertia": ["link", "moment"],
            "origin": ["link", "space"],
            "rotation": ["link", "space", "space_2"],
            "sites": ["keypoint", "space"],
            "gravity": ["space"],
        }
        if self.is_chain:
            dims = {key: ["link"] for key in QUANTITIES} | {"gravity": ["space"], "base": ["space"]}
        own = {kept_as(name): value.detach() for name, value in numbers._asdict().items()}
        found = {name: (dims[name], value) for name, value in own.items()}
        if self.is_chain:
            return found
        turns = [motion.turns for _, motion in self.motions()]
        found["turns"] = ["joint"], torch.tensor(turns).int()
        if self._stands:
            found["base"] = ["space"], own["origin"][..., 0, :]
        p = self.in_space().parameters()
        edges = skeleton(self.links, self.parents, p.sites, p.position, self._stands)
        return found | ({"skeleton": (["edge", "end"], torch.tensor(edges))} if edges else {})

    # -- what is not known exactly -----------------------------------------------------------------
    @property
    def priors(self) -> dict[str, dict[int, dist.Distribution]]:
        """Priors by number and flat index; in a tree that of a stick's length is its tip's x in the sites."""
        found: dict[str, dict[int, dist.Distribution]] = {}
        for key, index, scalar in self.scalars():
            if isinstance(scalar, dist.Distribution):
                found.setdefault(key, {})[index] = scalar
        return found

    @property
    def learned(self) -> dict[str, tuple[int, ...]]:
        """Entries to be learned, as flat indices by number; in a tree a stick's length is its tip's x in the sites."""
        return self._entries(Learned)

    def with_uncertainty(self) -> Self:
        """The body with its relative sds made priors around the nominal values; those of joints' parts stay.

        Of a tree these are masses: a link without a mass stays so, and moments that are numbers stay as they are. In
        the plane a com or inertia that is given one no longer follows length and mass. Raises `BodyError` there for a
        relative sd of a com or inertia of 0.
        """
        stated = {key: sd for key, sd in self.uncertainty.items() if key in QUANTITIES and sd > 0}
        links = []
        for link in self.links:
            priors = {}
            for key, sd in stated.items():
                if not isinstance(getattr(link, key), float | None):
                    continue
                value = link.nominal(key)
                if value == 0 and self.is_chain:
                    raise BodyError(f"link '{link.name}': {key} is 0 and has no relative sd; give it a prior")
                if value != 0:
                    priors[key] = prior(value, sd * abs(value))
            links.append(replace(link, **priors))
        rest = {} if self.is_chain else {key: sd for key, sd in self.uncertainty.items() if key not in QUANTITIES}
        return replace(self, links=tuple(links), uncertainty=rest)

    def with_values(self, **given: Sequence[Scalar | None]) -> Self:
        """Return the body with other scalars, one for each link: `body.with_values(length=[0.31, 0.27])`.

        An entry is anything that a `Link` takes. Raises `BodyError` for another number of them.
        """
        check_keys(given, QUANTITIES, "Body.with_values")
        count = len(self.links)
        for key, values in given.items():
            if len(values) != count:
                raise BodyError(f"expected {count} values of {key}, one for each link, got {len(values)}")
        links = []
        for place, link in enumerate(self.links):
            new: dict[str, Any] = {key: values[place] for key, values in given.items()}
            links.append(replace(link, **new))
        return replace(self, links=tuple(links))

    def scalars(self) -> Iterator[tuple[str, int, Scalar | None]]:
        """What links say: its number, its flat index there, and itself; in a tree a length is its tip's x."""
        for place, link in enumerate(self.links):
            if self.is_chain:
                yield from ((key, place, getattr(link, key)) for key in QUANTITIES)
                continue
            yield "mass", place, link.mass
            own = {"position": link.origin, "com": vector_of(link, "com"), "inertia": vector_of(link, "inertia")}
            for key, vector in own.items():
                values = vector or ()
                yield from ((key, place * len(values) + i, value) for i, value in enumerate(values))
            for site, at in link.points.items():
                first = 3 * self.keypoint_names.index(site)
                yield from (("sites", first + i, value) for i, value in enumerate(at or [link.length]))

    def _entries(self, kind: Any) -> dict[str, tuple[int, ...]]:
        """Flat indices of the scalars of a kind, by number."""
        found: dict[str, list[int]] = {}
        for key, index, scalar in self.scalars():
            if isinstance(scalar, kind):
                found.setdefault(key, []).append(index)
        order = QUANTITIES if self.is_chain else tuple(found)
        return {key: tuple(found[key]) for key in order if key in found}

    @cached_property
    def _sticks(self) -> Sticks:
        return Sticks(self.links, self.parents, self.keypoint_names, self.is_chain)

    @cached_property
    def _shapes(self) -> dict[str, torch.Size]:
        return {key: value.shape for key, value in self.parameters()._asdict().items()}


load_body = Body.load


planar_body = Body.planar
