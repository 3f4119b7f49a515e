"""A robot as a serial chain of rigid links: kinematics, Jacobian, gravity."""

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from .._check import concrete, finite, not_negative
from .._types import as_number, optional

Rows = Float[Array, " n"] | np.ndarray | Sequence[float]
"""A column of a table: one number per joint."""

KINDS = ("revolute", "prismatic")
"""What a joint does along its axis: turn, or slide."""

ROUNDING = 1e-6
"""By what part of it a limit may be missed: rounding, in a file or in single precision."""


def rotation_of(rpy, xp: Any = np):
    """R = Rz(yaw) Ry(pitch) Rx(roll) [-], shape (..., 3, 3), of roll, pitch, yaw [rad], (..., 3); `xp` is NumPy or JAX's."""
    (cr, cp, cy), (sr, sp, sy) = (xp.moveaxis(f(rpy), -1, 0) for f in (xp.cos, xp.sin))
    rows = (
        (cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr),
        (sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr),
        (-sp, cp * sr, cp * cr),
    )
    return xp.stack([xp.stack(row, axis=-1) for row in rows], axis=-2)


def symmetric(name: str, inertia) -> None:
    """Raise `ValueError` for matrices (..., 3, 3) that are not symmetric, but for rounding in a file."""
    given = concrete(inertia)
    if given is not None and np.abs(given - np.swapaxes(given, -2, -1)).max() > 1e-5 * np.abs(given).max():
        raise ValueError(f"{name}: a matrix given is not symmetric; inertia always is")


class Frames(NamedTuple):
    """Frames in another one, of JAX or of NumPy: axes as the columns of `rotation`, shape (..., 3, 3) [-]; origins
    `position`, (..., 3) [m]."""

    rotation: Any
    position: Any

    def then(self, other: "Frames") -> "Frames":
        """The frames that stand at `other` in these."""
        moved = self.position + (self.rotation @ other.position[..., None])[..., 0]
        return Frames(self.rotation @ other.rotation, moved)


class Bodies(NamedTuple):
    """What weighs in a robot, and how it moves with its n coordinates: mass [kg], (b,); Jacobians of the velocity of the
    centre of mass and of the angular velocity, (b, 3, n); inertia about the centre of mass in the axes of the base frame
    [kg m²], (b, 3, 3), None where it is not known."""

    mass: Float[Array, " b"]
    linear: Float[Array, "b 3 n"]
    angular: Float[Array, "b 3 n"]
    inertia: Float[Array, "b 3 3"] | None

    def weight(self, gravity: Float[Array, " 3"]) -> Float[Array, " n"]:
        """What gravity [m/s²] loads the coordinates with [N m], [N]: sum of m J^T g."""
        return jnp.einsum("b,bin,i->n", self.mass, self.linear, gravity)

    @property
    def mass_matrix(self) -> Float[Array, "n n"]:
        """M = sum of m J^T J + J_r^T I J_r [kg m²], [kg]. Raises `ValueError` where the inertia is not known."""
        if self.inertia is None:
            raise ValueError("robot: this one has no inertia; give that of every link, or take rods (with_rods)")
        moved = jnp.einsum("b,bin,bim->nm", self.mass, self.linear, self.linear)
        return moved + jnp.einsum("bin,bij,bjm->nm", self.angular, self.inertia, self.angular)


class Placement(eqx.Module):
    """Where a frame stands in another one: origin p = xyz, axes R = Rz(yaw) Ry(pitch) Rx(roll).

    **Arguments:**

    - `xyz`: p [m], shape (..., 3).
    - `rpy`: roll, pitch, yaw [rad], shape (..., 3): turns about the fixed x, y and z, in this order.
    """

    xyz: Float[Array, "*n 3"] = eqx.field(converter=as_number, default=(0.0, 0.0, 0.0))
    rpy: Float[Array, "*n 3"] = eqx.field(converter=as_number, default=(0.0, 0.0, 0.0))

    @property
    def rotation(self) -> Float[Array, "*n 3 3"]:
        """R [-]."""
        return rotation_of(self.rpy, jnp)

    @property
    def frames(self) -> Frames:
        """R and p."""
        return Frames(self.rotation, self.xyz)


class Payload(eqx.Module):
    """What the flange carries: a spindle, a gripper.

    **Arguments:**

    - `mass`: [kg], >= 0.
    - `centre_of_mass`: in the frame of the flange [m], shape (3,).
    - `inertia`: about the centre of mass, in the axes of the flange [kg m²], shape (3, 3), symmetric. Default: that of a
      point.
    """

    mass: Float[Array, ""] = eqx.field(converter=as_number)
    centre_of_mass: Float[Array, " 3"] = eqx.field(converter=as_number, default=(0.0, 0.0, 0.0))
    inertia: Float[Array, "3 3"] = eqx.field(converter=as_number, default_factory=lambda: np.zeros((3, 3)))

    def __check_init__(self):
        check_load("payload", self)


def check_load(name: str, load) -> None:
    """Raise `ValueError` for a mass, a centre of mass and an inertia that are none of a body; messages call it `name`."""
    for key, shape, unit in (("mass", (), "kg"), ("centre_of_mass", (3,), "m"), ("inertia", (3, 3), "kg m²")):
        value = getattr(load, key)
        if value.shape != shape:
            raise ValueError(f"{name}.{key}: shape {value.shape} given; it must be {shape}")
        (not_negative if key == "mass" else finite)(f"{name}.{key}", value, unit)
    symmetric(f"{name}.inertia", load.inertia)


class Robot(eqx.Module):
    """A serial chain of n joints and n rigid links. With joint coordinates q, link i stands in the base frame at

        T_0^i = B T_1(q_1) ... T_i(q_i),    T_i(q_i) = O_i J_i(q_i + zero_i),

    and the tool at T_0^n F E. B, F and E are the placements of the first joint's parent in the base frame, of the flange on
    the last link and of the tool on the flange; O_i that of joint i on link i - 1; J_i turns about, or slides along, the
    axis of joint i through the origin of O_i. The frame of a link is thus that of its joint, and turns with it.

    Every vector that goes in or comes out is in the axes of the base frame, z up. Of velocities and Jacobians the linear
    part is first and the angular part second, of wrenches the force first and the moment second.

    **Arguments:**

    - `names`: of the joints. Static.
    - `kinds`: of each joint, "revolute" or "prismatic". Static.
    - `xyz`, `rpy`: O_i [m], [rad], shape (n, 3), as of `Placement`.
    - `axis`: direction of each joint's axis in its frame O_i [-], shape (n, 3). Of any length but 0: only its direction
      counts.
    - `zero`: what is added to q [rad], of a sliding joint [m], shape (n,).
    - `base`, `flange`, `tool`: B, F, E.
    - `lower`, `upper`: limits of q [rad], of a sliding joint [m], shape (n,), with infinities where there are none. None:
      unknown.
    - `mass`: of the links [kg], >= 0, shape (n,).
    - `centre_of_mass`: in the frame of the link [m], shape (n, 3).
    - `inertia`: of each link about its centre of mass, in the axes of the link [kg m²], shape (n, 3, 3), symmetric.
    - `payload`: what the flange carries.

    What a description does not give of masses, centres and inertia is None; what needs it then raises `ValueError`. So do
    shapes that do not fit, numbers out of these ranges, and limits that leave no room.
    """

    names: tuple[str, ...] = eqx.field(static=True, converter=tuple)
    kinds: tuple[str, ...] = eqx.field(static=True, converter=tuple)
    xyz: Float[Array, "n 3"] = eqx.field(converter=as_number)
    rpy: Float[Array, "n 3"] = eqx.field(converter=as_number)
    axis: Float[Array, "n 3"] = eqx.field(converter=as_number)
    zero: Float[Array, " n"] = eqx.field(converter=as_number)
    base: Placement = eqx.field(default_factory=Placement)
    flange: Placement = eqx.field(default_factory=Placement)
    tool: Placement = eqx.field(default_factory=Placement)
    lower: Float[Array, " n"] | None = eqx.field(converter=optional, default=None)
    upper: Float[Array, " n"] | None = eqx.field(converter=optional, default=None)
    mass: Float[Array, " n"] | None = eqx.field(converter=optional, default=None)
    centre_of_mass: Float[Array, "n 3"] | None = eqx.field(converter=optional, default=None)
    inertia: Float[Array, "n 3 3"] | None = eqx.field(converter=optional, default=None)
    payload: Payload | None = None

    def __check_init__(self):
        n = len(self.names)
        if n == 0 or len(set(self.names)) < n:
            raise ValueError(f"robot.names: {list(self.names)} given; name each joint, one at least, and no two alike")
        if len(self.kinds) != n or not set(self.kinds) <= set(KINDS):
            raise ValueError(
                f"robot.kinds: {list(self.kinds)} given; it must be one of {list(KINDS)} for each of {n} joints"
            )
        for name, shape, unit in (
            ("xyz", (n, 3), "m"),
            ("rpy", (n, 3), "rad"),
            ("axis", (n, 3), ""),
            ("zero", (n,), "rad"),
            ("lower", (n,), None),
            ("upper", (n,), None),
            ("mass", (n,), "kg"),
            ("centre_of_mass", (n, 3), "m"),
            ("inertia", (n, 3, 3), "kg m²"),
        ):
            value = getattr(self, name)
            if value is None:
                continue
            if value.shape != shape:
                raise ValueError(f"robot.{name}: shape {value.shape} given; with {n} joints it must be {shape}")
            if unit is not None:  # limits may be infinite
                (not_negative if name == "mass" else finite)(f"robot.{name}", value, unit)
        for name in ("base", "flange", "tool"):
            place = getattr(self, name)
            if place.xyz.shape != (3,) or place.rpy.shape != (3,):
                raise ValueError(f"robot.{name}: shapes {place.xyz.shape} and {place.rpy.shape} given; both must be (3,)")
            finite(f"robot.{name}.xyz", place.xyz, "m")
            finite(f"robot.{name}.rpy", place.rpy, "rad")
        axis = concrete(self.axis)
        if axis is not None and not axis.any(axis=1).all():
            short = self.names[int(np.argmin(axis.any(axis=1)))]
            raise ValueError(f"robot.axis: that of {short} has no length; it must be a direction, such as (0, 0, 1)")
        self._check_limits()
        if self.inertia is not None:
            symmetric("robot.inertia", self.inertia)

    def _check_limits(self) -> None:
        if (self.lower is None) != (self.upper is None):
            raise ValueError("robot: give lower and upper together, or neither; infinities are no limits")
        if self.lower is None or self.upper is None:
            return
        lower, upper = concrete(self.lower), concrete(self.upper)
        if lower is None or upper is None:
            return
        for name, low, high in zip(self.names, lower, upper, strict=True):
            if not low < high:
                raise ValueError(f"robot.lower: {low:g} given for {name}; it must be less than its upper limit, {high:g}")

    @staticmethod
    def from_dh(
        a: Rows,
        alpha: Rows,
        d: Rows,
        theta: Rows,
        names: tuple[str, ...] | None = None,
        **others,
    ) -> "Robot":
        """A robot from the rows of a table of Denavit and Hartenberg, in its standard form:

            T_0^n = B A_1 ... A_n E,    A_i = Rz(q_i + theta_i) Tz(d_i) Tx(a_i) Rx(alpha_i).

        All joints are revolute. Each row gives the `zero` of its joint and the placement of the next one, the last row that
        of the flange. The frame of link i thus stands before its d_i and a_i, at joint i: the centre of mass and the inertia
        of a link count in that frame, not in the one that its row leads to.

        **Arguments:**

        - `a`, `d`: lengths [m], shape (n,).
        - `alpha`, `theta`: angles [rad], shape (n,).
        - `names`: of the joints; None: "joint_1" and so on.
        - `others`: the remaining arguments of `Robot`: `base`, `tool`, limits, masses.

        Differentiable by every number of the table. Raises `ValueError` for rows of unequal number.
        """
        columns = [as_number(column) for column in (a, alpha, d, theta)]
        shapes = [column.shape for column in columns]
        if len(set(shapes)) > 1 or len(shapes[0]) != 1:
            raise ValueError(f"robot: a, alpha, d, theta of shapes {shapes} given; each must have one number per joint")
        length, twist, offset, zero = columns
        n, nothing, before = len(zero), jnp.zeros_like(zero), jnp.zeros((1, 3))
        xyz = jnp.stack([length, nothing, offset], axis=1)
        rpy = jnp.stack([twist, nothing, nothing], axis=1)
        return Robot(
            names=tuple(f"joint_{i + 1}" for i in range(n)) if names is None else names,
            kinds=("revolute",) * n,
            xyz=jnp.concatenate([before, xyz[:-1]]),
            rpy=jnp.concatenate([before, rpy[:-1]]),
            axis=jnp.tile(jnp.array([0.0, 0.0, 1.0]), (n, 1)),
            zero=zero,
            flange=Placement(xyz[-1], rpy[-1]),
            **others,
        )

    def with_rods(self, thickness, mass: Rows | None = None) -> "Robot":
        """The robot with uniform rods as links: a stand-in where only the masses are known.

        The mass m of a link is spread along the straight line r from its joint to the next one, or to the flange: its
        centre is at r/2, its inertia m/12 ((r . r) 1 - r r^T) + 2/5 m t² 1, that of the line, thickened by a ball.

        **Arguments:**

        - `thickness`: t, the radius of the ball [m]: without it a link could turn about its own line for nothing.
        - `mass`: of the links [kg], shape (n,). None: those of the robot.

        Raises `ValueError` for a robot without masses, where none are given.
        """
        mass = self.mass if mass is None else as_number(mass)
        if mass is None:
            raise ValueError("robot.mass: this robot has none; give the mass of every link")
        line, size = self.ends, as_number(thickness)
        square = jnp.sum(line**2, axis=1)[:, None, None] * jnp.eye(3) - line[:, :, None] * line[:, None, :]
        inertia = mass[:, None, None] * (square / 12 + 0.4 * size**2 * jnp.eye(3))
        return dataclasses.replace(self, mass=mass, centre_of_mass=line / 2, inertia=inertia)

    @property
    def joints(self) -> int:
        """Number of joints n."""
        return len(self.names)

    @property
    def ends(self) -> Float[Array, "n 3"]:
        """Where each link ends, in its frame [m]: at the origin of the next joint, the last one at the flange."""
        return jnp.concatenate([self.xyz[1:], self.flange.xyz[None]])

    @property
    def length(self) -> float:
        """How long it is, stretched out, without what its slides add [m]. Needs concrete numbers."""
        return float(np.linalg.norm(self.ends, axis=1).sum())

    @property
    def limits(self) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """Between which coordinates [rad], [m] its drives go, rounding allowed for: infinities where no limits are given.
        Needs concrete numbers."""
        if self.lower is None or self.upper is None:
            return np.full(self.joints, -np.inf), np.full(self.joints, np.inf)
        lower, upper = np.asarray(self.lower), np.asarray(self.upper)
        return lower - ROUNDING * np.abs(lower), upper + ROUNDING * np.abs(upper)

    @property
    def _turning(self) -> np.ndarray:
        return np.array([kind == "revolute" for kind in self.kinds])

    @property
    def _direction(self) -> Float[Array, "n 3"]:
        return self.axis / jnp.linalg.norm(self.axis, axis=1, keepdims=True)

    def frames(self, q: Float[Array, " n"]) -> Frames:
        """Where the links stand at q in the base frame, T_0^1 ... T_0^n: rotations (n, 3, 3) [-] and origins (n, 3) [m]."""
        q = self.coordinates_of(q) + self.zero
        turn, slide = jnp.where(self._turning, q, 0.0), jnp.where(self._turning, 0.0, q)
        place = Placement(self.xyz, self.rpy).frames
        moved = place.then(Frames(_turned(self._direction, turn), self._direction * slide[:, None]))

        def step(before: Frames, one: Frames):
            after = before.then(one)
            return after, after

        return lax.scan(step, self.base.frames, moved)[1]

    def pose(self, q: Float[Array, " n"]) -> Float[Array, "4 4"]:
        """T_0^n F E, where the tool stands at q in the base frame: a homogeneous matrix, lengths in m."""
        rotation, position = self._tool_frame(self.frames(q))
        return jnp.eye(4).at[:3, :3].set(rotation).at[:3, 3].set(position)

    def jacobian(self, q: Float[Array, " n"]) -> Float[Array, "6 n"]:
        """The geometric Jacobian J at the tool centre point: its velocity and the tool's angular velocity are J q'.

        Column i is (z_i x (p - p_i), z_i) for a joint that turns and (z_i, 0) for one that slides, with z_i its axis, p_i
        its origin and p the tool centre point. A wrench w on the tool (force [N], moment about that point [N m]) loads the
        joints with J^T w.
        """
        frames = self.frames(q)
        linear, angular = self.velocities(frames, self._tool_frame(frames).position[None], np.array([self.joints - 1]))
        return jnp.concatenate([linear[0], angular[0]])

    def velocities(
        self, frames: Frames, points: Float[Array, "b 3"], links: Int[np.ndarray, " b"]
    ) -> tuple[Float[Array, "b 3 n"], Float[Array, "b 3 n"]]:
        """Jacobians of points of links: of their velocity, and of the angular velocity of the link.

        **Arguments:**

        - `frames`: of the links, as `frames` gives them.
        - `points`: in the base frame [m].
        - `links`: on which each point is, from 0.
        """
        axis = jnp.einsum("nij,nj->ni", frames.rotation, self._direction)  # a joint does not move its own axis
        turning, carried = self._turning[:, None], (links[:, None] >= np.arange(self.joints))[..., None]
        linear = jnp.where(turning, jnp.cross(axis, points[:, None] - frames.position), axis)
        angular = jnp.broadcast_to(jnp.where(turning, axis, 0.0), linear.shape)
        return jnp.where(carried, linear, 0.0).swapaxes(1, 2), jnp.where(carried, angular, 0.0).swapaxes(1, 2)

    def bodies(self, q: Float[Array, " n"]) -> Bodies:
        """Links and payload, and how they move with the joints. Raises `ValueError` for a robot without masses or centres
        of mass."""
        every = np.arange(self.joints)
        return self.bodies_on(self, self.frames(q), every, every >= 0)

    def bodies_on(
        self, chain: "Robot", frames: Frames, places: Int[np.ndarray, " n"], rigid: Bool[np.ndarray, " n"]
    ) -> Bodies:
        """Those of the links that are `rigid`, and the payload, on a longer chain: `places` says which of its links,
        at `frames`, are those of this robot."""
        missing = [name for name in ("mass", "centre_of_mass") if getattr(self, name) is None]
        if missing:
            raise ValueError(
                f"robot: this one has no {' and no '.join(missing)}; give them for every link, or take rods (with_rods)"
            )
        assert self.mass is not None
        assert self.centre_of_mass is not None
        links, mass, centre = places[rigid], self.mass[rigid], self.centre_of_mass[rigid]
        inertia = None if self.inertia is None else self.inertia[rigid]
        if (load := self.payload) is not None:
            held = chain.flange.frames.then(Frames(jnp.eye(3), load.centre_of_mass))
            links = np.append(links, chain.joints - 1)
            mass, centre = jnp.append(mass, load.mass), jnp.concatenate([centre, held.position[None]])
            if inertia is not None:
                inertia = jnp.concatenate([inertia, (held.rotation @ load.inertia @ held.rotation.T)[None]])
        turned = frames.rotation[links]
        points = frames.position[links] + jnp.einsum("bij,bj->bi", turned, centre)
        linear, angular = chain.velocities(frames, points, links)
        return Bodies(mass, linear, angular, None if inertia is None else turned @ inertia @ turned.swapaxes(1, 2))

    def gravity(self, q: Float[Array, " n"], gravity=(0.0, 0.0, -9.81)) -> Float[Array, " n"]:
        """G = dV/dq with V = -sum_i m_i g . c_i(q): what the joints must exert to hold links and payload [N m], if they
        slide [N].

        **Arguments:**

        - `q`: joint coordinates [rad], [m].
        - `gravity`: g in the axes of the base frame [m/s²].

        Raises `ValueError` for a robot without masses or centres of mass.
        """
        return -self.bodies(q).weight(as_number(gravity))

    def mass_matrix(self, q: Float[Array, " n"]) -> Float[Array, "n n"]:
        """M of the kinetic energy q'^T M q' / 2 of links and payload, rigid as they are [kg m²], of sliding joints [kg].

        Raises `ValueError` for a robot without masses, centres of mass or inertia.
        """
        return self.bodies(q).mass_matrix

    def check(self, q: Float[Array, "*time n"], name: str = "q") -> None:
        """Raise `ValueError` for joint coordinates that are not finite or beyond the limits, with joint, value and limits.

        **Arguments:**

        - `q`: [rad], [m], one set or many, shape (..., n). Traced ones pass: they have no value to look at.
        - `name`: what messages call it.

        A robot without limits has none.
        """
        given = concrete(q)
        if given is None:
            return
        if given.shape[-1:] != (self.joints,):
            raise ValueError(f"{name}: shape {given.shape} given; the last axis must be the {self.joints} joints")
        lower, upper = self.limits
        bad = ~(np.isfinite(given) & (given >= lower) & (given <= upper))
        if bad.any():
            *when, joint = np.argwhere(bad)[0]
            values = given[*when, joint], lower[joint], upper[joint]
            shown, low, high = (_shown(float(value), self.kinds[joint]) for value in values)
            at = f" in set {tuple(map(int, when))}" if when else ""
            raise ValueError(f"{name}: {shown} given for {self.names[joint]}{at}; it must be from {low} to {high}")

    def coordinates_of(self, q) -> Float[Array, " n"]:
        """q as an array. Raises `ValueError` for another number of them than of joints."""
        q = as_number(q)
        if q.shape != (self.joints,):
            raise ValueError(
                f"q: shape {q.shape} given; it must be ({self.joints},), one number per joint. For many sets use jax.vmap"
            )
        return q

    def _tool_frame(self, frames: Frames) -> Frames:
        found = Frames(frames.rotation[-1], frames.position[-1])
        for place in (self.flange, self.tool):
            found = found.then(place.frames)
        return found


def _turned(axis: Float[Array, "n 3"], angle: Float[Array, " n"]) -> Float[Array, "n 3 3"]:
    """Rodrigues: R = I + sin(angle) K + (1 - cos(angle)) K², K v = axis x v."""
    cross = jnp.cross(axis[:, None, :], jnp.eye(3)).swapaxes(1, 2)
    return jnp.eye(3) + jnp.sin(angle)[:, None, None] * cross + (1 - jnp.cos(angle))[:, None, None] * (cross @ cross)


def _shown(value: float, kind: str) -> str:
    if kind == "prismatic" or not np.isfinite(value):
        return f"{value:g}" + (" m" if kind == "prismatic" else " rad")
    return f"{value:.4g} rad ({np.rad2deg(value):.4g} deg)"
