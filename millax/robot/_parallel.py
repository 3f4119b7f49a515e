"""Robots of several legs that carry one platform (E 18-20)."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._check import concrete
from ._elastic import SINGULAR, AtTool, ElasticRobot
from ._modes import Modes, modes

APART = 1e-6
"""How far the ends of two legs may be from each other [m], [rad]."""

LOOSE = 1e-12
"""A platform moves by itself where it is so much less stiff than in another direction, turns counted in lengths of a leg:
rounding."""


class ParallelRobot(eqx.Module):
    """Legs that end at one tool: each is an `ElasticRobot` from the base to the tool, with passive joints (infinite
    compliance) where it has hinges. What the platform weighs is a payload of one of them.

    A displacement of the tool takes all legs along, dt = J_theta,i theta_i + J_p,i p_i (E 18). The force of each leg follows
    from its own springs, and those of its passive joints are zero: K_C = sum of K_i, M_C = sum of B_i^T M_i B_i (E 19, 20).

    Between the base and the tool each leg must be able to give way in all six directions, by springs, beams or passive
    joints: in a planar robot, too, something out of the plane.

    **Arguments:**

    - `legs`: k >= 1 of them.
    """

    legs: tuple[ElasticRobot, ...] = eqx.field(converter=tuple)

    def __check_init__(self):
        if not self.legs:
            raise ValueError("legs: none given; a robot has at least one")

    def at_tool(self, q: Sequence[Float[Array, " n"]]) -> tuple[AtTool, ...]:
        """What the tool feels of each leg. **Arguments:** as of `stiffness`."""
        self._same_number(q)
        return tuple(leg.at_tool(own) for leg, own in zip(self.legs, q, strict=True))

    def stiffness(self, q: Sequence[Float[Array, " n"]]) -> Float[Array, "6 6"]:
        """K_C, in the axes of the base frame, translation first [N/m, N/rad; N, N m/rad].

        **Arguments:**

        - `q`: of every leg the joint coordinates, those of passive joints among them [rad], [m]. All legs must end at the
          same tool frame: see `check`.
        """
        return jnp.sum(jnp.stack([at.stiffness for at in self.at_tool(q)]), axis=0)

    def mass(self, q: Sequence[Float[Array, " n"]]) -> Float[Array, "6 6"]:
        """M_C, in the same axes [kg, kg m; kg m, kg m²]. **Arguments:** as of `stiffness`."""
        at = self.at_tool(q)
        return jnp.sum(jnp.stack([one.mass(leg) for one, leg in zip(at, self.legs, strict=True)]), axis=0)

    def modes(self, q: Sequence[Float[Array, " n"]]) -> Modes:
        """Natural frequencies and mode shapes at the tool (E 21). **Arguments:** as of `stiffness`."""
        return modes(self.mass(q), self.stiffness(q))

    def check(self, q: Sequence[Float[Array, " n"]]) -> None:
        """Raise `ValueError` for coordinates beyond limits, legs that do not end at the same tool frame, cannot follow the
        tool or move by themselves, and a platform that moves without a spring giving way. Traced numbers pass."""
        self._same_number(q)
        if any(concrete(leaf) is None for leaf in jax.tree.leaves((self, tuple(q)))):
            return
        poses = []
        for i, (leg, own) in enumerate(zip(self.legs, q, strict=True)):
            leg.robot.check(own, f"q of leg {i + 1}")
            poses.append(np.asarray(leg.robot.pose(own)))
            away = np.abs(poses[i] - poses[0]).max()
            if away > APART:
                raise ValueError(
                    f"q: leg {i + 1} ends {away:.2g} (m, or parts of 1 of a direction) from where leg 1 does; give "
                    "coordinates at which all legs meet"
                )
            jacobian = leg.scaled(np.asarray(leg.chain.jacobian(leg.extended(own))))
            size = np.linalg.svd(jacobian, compute_uv=False)
            if len(size) < 6 or size[-1] <= SINGULAR * size[0]:
                raise ValueError(
                    f"q: leg {i + 1} cannot follow the tool in all six directions; free it there by springs, beams or "
                    "passive joints, or change the pose"
                )
            passive = jacobian[:, leg.places[np.isinf(leg.compliance)]]
            if passive.size and np.linalg.matrix_rank(passive, SINGULAR * size[0]) < passive.shape[1]:
                raise ValueError(
                    f"q: the passive joints of leg {i + 1} can move while the tool rests; give one of them a spring, or "
                    "leave it out"
                )
        lengths = np.repeat([max(leg.reach for leg in self.legs), 1.0], 3)
        values = np.linalg.eigvalsh(lengths[:, None] * np.asarray(self.stiffness(q)) * lengths)
        if values[0] <= LOOSE * values[-1]:
            raise ValueError("q: the platform can move without any spring giving way: too few springs, or a singular pose")

    def _same_number(self, q) -> None:
        if len(q) != len(self.legs):
            raise ValueError(f"q: given for {len(q)} legs; the robot has {len(self.legs)}")
