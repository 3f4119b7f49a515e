"""A robot at a pose as what holds a tool: the mass, damping and stiffness that the tool feels."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._check import concrete, finite, not_negative
from .._structure import Structure
from .._types import AXES, Scalar, as_number, optional
from ._beam import Beam
from ._chain import Payload, Placement, Robot, check_load
from ._elastic import ElasticRobot, Loads
from ._modes import modal_damping

NO_EQUILIBRIUM = "robot.loads: no equilibrium found; they are beyond what springs of robot.compliance hold"


class Spindle(eqx.Module):
    """What the flange carries: where the tool centre point is, and what spindle and tool weigh.

    **Arguments:**

    - `xyz`, `rpy`: the tool frame in that of the flange [m], [rad], as of `Placement`: its origin is the tool centre point,
      its z axis that of the spindle and points out of it, towards the workpiece.
    - `mass`: [kg], >= 0.
    - `centre_of_mass`: in the frame of the flange [m], shape (3,).
    - `inertia`: about the centre of mass, in the axes of the flange [kg m²], shape (3, 3), symmetric. Default: that of a
      point.

    Raises `ValueError` for other shapes, and numbers out of these ranges.
    """

    xyz: Float[Array, " 3"] = eqx.field(converter=as_number, default=(0.0, 0.0, 0.0))
    rpy: Float[Array, " 3"] = eqx.field(converter=as_number, default=(0.0, 0.0, 0.0))
    mass: Scalar = eqx.field(converter=as_number, default=0.0)
    centre_of_mass: Float[Array, " 3"] = eqx.field(converter=as_number, default=(0.0, 0.0, 0.0))
    inertia: Float[Array, "3 3"] = eqx.field(converter=as_number, default_factory=lambda: np.zeros((3, 3)))

    def __check_init__(self):
        for name, unit in (("xyz", "m"), ("rpy", "rad")):
            value = getattr(self, name)
            if value.shape != (3,):
                raise ValueError(f"robot.tool.{name}: shape {value.shape} given; it must be (3,)")
            finite(f"robot.tool.{name}", value, unit)
        check_load("robot.tool", self)

    def on(self, robot: Robot) -> Robot:
        """`robot` with this on its flange, in place of its own tool and payload."""
        placed = eqx.tree_at(lambda r: r.tool, robot, Placement(self.xyz, self.rpy))
        load = Payload(self.mass, self.centre_of_mass, self.inertia)
        return eqx.tree_at(lambda r: r.payload, placed, load, is_leaf=lambda x: x is None)


class Arm(eqx.Module):
    """A robot at a pose, as what holds the tool of a case (C 1): M dt'' + C dt' + K dt = F.

    The workpiece frame of the case stands at the tool centre point: its z axis is that of the spindle, from the workpiece
    to the tool, against the z axis of the tool frame; its x axis, the feed, is that of the tool frame, turned by the feed
    angle about the latter's z axis.

    **Arguments:**

    - `robot`: the chain.
    - `joints`: q, what the drives set [rad], [m], shape (n,).
    - `compliance`: of the joints [rad/(N m)], [m/N], > 0, shape (n,).
    - `damping_ratio`: zeta [-] >= 0 of all modes, or of each, in the order of their frequencies, shape (6,); or
    - `damping`: of the joints [N m s/rad], [N s/m], >= 0, shape (n,), or a matrix (n, n). Exactly one of the two is given.
    - `feed_angle`: of the feed [rad], from the x axis of the tool frame towards its y axis.
    - `tool`: what the flange carries. None: the robot as it is.
    - `loads`: under which the robot stands. Force and moment in the workpiece frame, gravity in the base frame. None: under
      none.
    - `beams`: by joint, for elastic links: see `ElasticRobot`.

    Raises `ValueError` for numbers out of these ranges; `check` looks at the pose.
    """

    robot: Robot
    joints: Float[Array, " n"] = eqx.field(converter=as_number)
    compliance: Float[Array, " n"] = eqx.field(converter=as_number)
    damping_ratio: Float[Array, "..."] | None = eqx.field(converter=optional, default=None)
    damping: Float[Array, "..."] | None = eqx.field(converter=optional, default=None)
    feed_angle: Scalar = eqx.field(converter=as_number, default=0.0)
    tool: Spindle | None = None
    loads: Loads | None = None
    beams: dict[str, Beam] = eqx.field(default_factory=dict)

    def __check_init__(self):
        n = self.robot.joints
        if (self.damping is None) == (self.damping_ratio is None):
            raise ValueError("robot: give damping or damping_ratio, and only one of them")
        for name, shapes, unit, words in (
            ("joints", ((n,),), "rad", f"{n} numbers, one per joint"),
            ("compliance", ((n,),), "rad/(N m)", f"{n} numbers, one per joint"),
            ("damping_ratio", ((), (6,)), "", "one number, or 6, one per mode"),
            ("damping", ((n,), (n, n)), "N m s/rad", f"{n} numbers, one per joint, or a matrix of {n} by {n}"),
            ("feed_angle", ((),), "rad", "one number"),
        ):
            value = getattr(self, name)
            if value is None:
                continue
            if value.shape not in shapes:
                raise ValueError(f"robot.{name}: shape {value.shape} given; it must be {words}")
            diagonal = name in ("damping_ratio", "damping") and value.ndim < 2
            if name != "compliance":  # `ElasticRobot` looks at it
                (not_negative if diagonal else finite)(f"robot.{name}", value, unit)
        _ = self.elastic  # its checks

    @property
    def elastic(self) -> ElasticRobot:
        """The robot with its tool, and its springs."""
        robot = self.robot if self.tool is None else self.tool.on(self.robot)
        return ElasticRobot(robot, self.compliance, self.beams)

    @property
    def workpiece(self) -> Float[Array, "3 3"]:
        """Axes of the workpiece frame as columns, in the base frame [-]."""
        c, s = jnp.cos(self.feed_angle), jnp.sin(self.feed_angle)
        in_tool = jnp.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])
        turned = jnp.stack([jnp.stack([c, -s, 0 * c]), jnp.stack([s, c, 0 * c]), jnp.array([0.0, 0.0, 1.0])])
        return self.elastic.robot.pose(self.joints)[:3, :3] @ turned @ in_tool

    @eqx.filter_jit
    def structure(self) -> Structure:
        """Mass, damping and stiffness at the tool centre point in the workpiece frame: six coordinates, translations before
        rotations, of which the tool moves by the first three."""
        elastic, frame = self.elastic, jnp.kron(jnp.eye(2), self.workpiece)
        at = elastic.at_tool(self.joints, self.loads_in_base)
        mass, stiffness = (frame.T @ matrix @ frame for matrix in (at.mass(elastic), at.stiffness))
        if self.damping is None:
            assert self.damping_ratio is not None  # exactly one of the two is given
            damping = modal_damping(mass, stiffness, self.damping_ratio)
        else:
            follow = at.follow[elastic.places] @ frame
            joints = self.damping if self.damping.ndim == 2 else jnp.diag(self.damping)
            damping = follow.T @ joints @ follow
        return Structure(AXES, mass, stiffness, damping=damping, mode_shapes=jnp.eye(3, 6))

    def check(self) -> None:
        """Raise `ValueError` for a pose beyond the limits or singular, a robot without masses, and a mass or stiffness
        matrix that is not positive definite. Traced numbers pass."""
        self.elastic.check(self.joints, "robot.joints")
        stiffness = concrete(self.structure().stiffness)
        if stiffness is not None and np.isnan(stiffness).any():
            raise ValueError(NO_EQUILIBRIUM)
        if stiffness is not None and not np.linalg.eigvalsh((stiffness + stiffness.T) / 2)[0] > 0:
            raise ValueError(
                "robot.loads: under them the robot does not stand; in some direction its stiffness is not positive"
            )

    @property
    def loads_in_base(self) -> Loads | None:
        """`loads` with all their vectors in the base frame."""
        if self.loads is None:
            return None
        turn = self.workpiece
        return Loads(turn @ self.loads.force, turn @ self.loads.moment, self.loads.gravity)


def at_tool(holds: Structure | Arm) -> Structure:
    """The mass-spring-damper that the tool feels of what holds it."""
    return holds.structure() if isinstance(holds, Arm) else holds
