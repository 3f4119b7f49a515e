"""Virtual joints: a robot that gives way in its joints and links, and what the tool feels of it (C 2-25, E 8-21)."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from .._check import concrete, finite
from .._types import as_number, optional
from ._beam import MOTIONS, POINTS, WEIGHTS, Beam, shapes
from ._chain import Bodies, Placement, Robot
from ._modes import Modes, combination, modes

SINGULAR = 1e-7
"""A pose is singular where a motion of the tool needs so much more of the joints than another: their ratio, lengths counted
in arm lengths. Its stiffness would be greater by the square of it."""

WEIGHTLESS = 1e-12
"""A mass matrix with such a ratio of eigenvalues, its diagonal scaled to 1, is not positive definite."""

NEWTON_STEPS = 50
"""At most, to an equilibrium. Loads that a robot carries take three."""


class Loads(eqx.Module):
    """What loads a robot while it stands still. In the axes of the base frame.

    **Arguments:**

    - `force`: on the tool centre point [N], shape (3,).
    - `moment`: on the tool, about that point [N m], shape (3,). It keeps its direction when the tool turns.
    - `gravity`: g [m/s²], shape (3,): (0, 0, -9.81) on a floor. None: none, and the robot needs no masses.
    """

    force: Float[Array, " 3"] = eqx.field(converter=as_number, default=(0.0, 0.0, 0.0))
    moment: Float[Array, " 3"] = eqx.field(converter=as_number, default=(0.0, 0.0, 0.0))
    gravity: Float[Array, " 3"] | None = eqx.field(converter=optional, default=None)

    def __check_init__(self):
        for name, unit in (("force", "N"), ("moment", "N m"), ("gravity", "m/s²")):
            value = getattr(self, name)
            if value is None:
                continue
            if value.shape != (3,):
                raise ValueError(f"loads.{name}: shape {value.shape} given; it must be (3,), along x, y and z")
            finite(f"loads.{name}", value, unit)

    @property
    def wrench(self) -> Float[Array, " 6"]:
        """Force and moment on the tool."""
        return jnp.concatenate([self.force, self.moment])


class ElasticRobot(eqx.Module):
    """A robot whose joints, and links where they are beams, are springs: the virtual joint model.

    Its coordinates theta are the deflections of the n joints and, after each joint whose link is a beam, the six motions of
    the end of that beam in its axes: N numbers in all. The robot then is a longer chain, `chain`, of N joints, of which the
    drives set n and springs hold all: K_theta theta = J_G^T G + J_F^T F (C 6).

    **Arguments:**

    - `robot`: the chain of rigid links.
    - `compliance`: of the joints [rad/(N m)], of sliding ones [m/N], > 0, shape (n,). Infinity: a passive joint, which no
      spring holds.
    - `beams`: by the name of the joint that moves the link, for links that are elastic too.

    Raises `ValueError` for a compliance that is not positive, a beam without length, and one whose `side` runs along it.
    """

    robot: Robot
    compliance: Float[Array, " n"] = eqx.field(converter=as_number)
    beams: dict[str, Beam] = eqx.field(default_factory=dict)

    def __check_init__(self):
        robot, given = self.robot, concrete(self.compliance)
        if self.compliance.shape != (robot.joints,):
            raise ValueError(f"compliance: shape {self.compliance.shape} given; it must be ({robot.joints},), one per joint")
        if given is not None and not (given > 0).all():
            bad = int(np.argmin(given > 0))
            unit = "rad/(N m)" if robot.kinds[bad] == "revolute" else "m/N"
            raise ValueError(
                f"compliance: {given[bad]:g} {unit} given for {robot.names[bad]}; it must be greater than 0 (infinity: a "
                "passive joint)"
            )
        unknown = sorted(set(self.beams) - set(robot.names))
        if unknown:
            raise ValueError(f"beams: {unknown[0]} is no joint of the robot; its joints are {', '.join(robot.names)}")
        for i, name in enumerate(robot.names):
            line = concrete(robot.ends[i]) if name in self.beams else None
            if line is None:
                continue
            if not line.any():
                raise ValueError(f"beams: the link of {name} has no length, so it is no beam")
            given = self.beams[name].side
            side = None if self.beams[name].side is None else concrete(self.beams[name].side)
            if side is None:
                continue
            if np.linalg.norm(np.cross(side, line)) <= 1e-6 * np.linalg.norm(side) * np.linalg.norm(line):
                raise ValueError(f"beams: side {side} of the link of {name} runs along it; give a direction across it")

    @property
    def coordinates(self) -> int:
        """N, how many springs there are."""
        return self.robot.joints + len(MOTIONS) * len(self.beams)

    @property
    def places(self) -> np.ndarray:
        """Where the joints stand among the N coordinates."""
        elastic = np.array([name in self.beams for name in self.robot.names])
        return np.arange(self.robot.joints) + len(MOTIONS) * (np.cumsum(elastic) - elastic)

    @property
    def chain(self) -> Robot:
        """The robot with six joints at the end of each beam: three that slide along its axes, three that turn about them."""
        robot, nothing = self.robot, jnp.zeros(3)
        names, kinds, xyz, rpy, axis, zero = [], [], [], [], [], []

        def add(name, kind, place, turn, direction, start):
            for column, value in zip(
                (names, kinds, xyz, rpy, axis, zero), (name, kind, place, turn, direction, start), strict=True
            ):
                column.append(value)

        at = robot.xyz[0]
        for i, name in enumerate(robot.names):
            add(name, robot.kinds[i], at, robot.rpy[i], robot.axis[i], robot.zero[i])
            at = robot.ends[i]
            if name in self.beams:
                axes = self.beams[name].axes(at).T
                for k, motion in enumerate(MOTIONS):
                    add(f"{name}.{motion}", "prismatic" if k < 3 else "revolute", at, nothing, axes[k % 3], 0.0)
                    at = nothing
        return Robot(
            names=tuple(names),
            kinds=tuple(kinds),
            xyz=jnp.stack(xyz),
            rpy=jnp.stack(rpy),
            axis=jnp.stack(axis),
            zero=jnp.stack(zero),
            base=robot.base,
            flange=Placement(at, robot.flange.rpy),
            tool=robot.tool,
        )

    @property
    def springs(self) -> Float[Array, "N N"]:
        """K_theta [N m/rad], [N/m]: zero for passive joints."""
        springs = jnp.zeros((self.coordinates, self.coordinates))
        springs = springs.at[self.places, self.places].set(1 / self.compliance)
        for i, name in enumerate(self.robot.names):
            if name in self.beams:
                block = self.places[i] + 1 + np.arange(len(MOTIONS))
                length = jnp.linalg.norm(self.robot.ends[i])
                springs = springs.at[np.ix_(block, block)].set(jnp.linalg.inv(self.beams[name].compliance(length)))
        return springs

    def extended(self, q: Float[Array, " n"]) -> Float[Array, " N"]:
        """The N coordinates of the robot that nothing loads."""
        return jnp.zeros(self.coordinates).at[self.places].set(self.robot.coordinates_of(q))

    def bodies(self, x: Float[Array, " N"]) -> Bodies:
        """What weighs, at the N coordinates x: links and payload as of `Robot.bodies`, beams as four sections each."""
        chain, robot = self.chain, self.robot
        frames = chain.frames(x)
        rigid = [name not in self.beams for name in robot.names]
        parts = [robot.bodies_on(chain, frames, self.places, np.array(rigid))]
        moved, turned = shapes(POINTS)
        for i, name in enumerate(robot.names):
            if rigid[i]:
                continue
            assert robot.mass is not None  # `bodies_on` has looked
            beam, place, line = self.beams[name], self.places[i], robot.ends[i]
            own = place + 1 + np.arange(len(MOTIONS))
            axes = frames.rotation[place] @ beam.axes(line)
            bent = moved * x[own[:3]]
            points = frames.position[place] + (frames.rotation[place] @ line) * POINTS[:, None] + bent @ axes.T
            linear, angular = chain.velocities(frames, points, np.full(len(POINTS), place))
            linear = linear.at[:, :, own[:3]].set(axes * moved[:, None, :])
            angular = angular.at[:, :, own[3:]].set(axes * turned[:, None, :])
            mass = robot.mass[i] * WEIGHTS
            inertia = mass[:, None, None] * (axes * beam.gyration @ axes.T)
            parts.append(Bodies(mass, linear, angular, inertia))
        inertias = [part.inertia for part in parts if part.inertia is not None]
        return Bodies(
            mass=jnp.concatenate([part.mass for part in parts]),
            linear=jnp.concatenate([part.linear for part in parts]),
            angular=jnp.concatenate([part.angular for part in parts]),
            inertia=jnp.concatenate(inertias) if len(inertias) == len(parts) else None,
        )

    def equilibrium(self, q: Float[Array, " n"], loads: Loads) -> Float[Array, " N"]:
        """The N coordinates at which springs hold the loads, K_theta theta = J_G^T G + J_F^T F at q + theta (C 7): by
        Newton's method, from no deflection.

        **Arguments:**

        - `q`: what the drives set [rad], [m].
        - `loads`: what loads the robot.

        Differentiable, by the implicit function theorem. Raises `ValueError` for passive joints, which hold nothing, and
        where there is no equilibrium nearby: the loads are beyond what the springs hold. Traced, it is NaN there.
        """
        self.require_springs("leave the loads out")
        return _found(self._equilibrium(self.robot.coordinates_of(q), loads), loads)

    @eqx.filter_jit
    def _equilibrium(self, q, loads):
        rest, springs = self.extended(q), self.springs

        def left(theta):
            return theta - jnp.linalg.solve(springs, self.load(rest + theta, loads))

        return rest + _root(left, jnp.zeros_like(rest))

    def load(self, x: Float[Array, " N"], loads: Loads) -> Float[Array, " N"]:
        """J_G^T G + J_F^T F (C 5): what gravity and the wrench on the tool load the N coordinates with at x."""
        wrench = self.chain.jacobian(x).T @ loads.wrench
        if loads.gravity is None:
            return wrench
        return wrench + self.bodies(x).weight(loads.gravity)

    def at_tool(self, q: Float[Array, " n"], loads: Loads | None = None) -> "AtTool":
        """What the tool feels of the robot at q: see `AtTool`.

        **Arguments:**

        - `q`: what the drives set [rad], [m].
        - `loads`: under which the robot stands. None: under none, at q itself.

        Raises what `equilibrium` raises.
        """
        if loads is not None:
            self.require_springs("leave the loads out")
        at = self._at_tool(self.robot.coordinates_of(q), loads)
        _found(at.coordinates, loads)
        return at

    @eqx.filter_jit
    def _at_tool(self, q, loads):
        x, held = self._held(q, loads)
        return AtTool(x, *_condensed(self.chain.jacobian(x), held))

    def _held(self, q, loads) -> tuple[Float[Array, " N"], Float[Array, "N N"]]:
        """The coordinates, and K_theta - H."""
        if loads is None:
            return self.extended(q), self.springs
        x = self._equilibrium(q, loads)
        return x, self.springs - jax.jacfwd(self.load)(x, loads)

    def stiffness(self, q: Float[Array, " n"], loads: Loads | None = None) -> Float[Array, "6 6"]:
        """K_C = (J (K_theta - H)^-1 J^T)^-1 (C 17) [N/m, N/rad; N, N m/rad], in the axes of the base frame: the wrench on
        the tool by its displacement, translation first. H holds all that the load changes by with theta, of wrench and
        gravity.

        **Arguments:** as of `at_tool`.
        """
        return self.at_tool(q, loads).stiffness

    def tool_compliance(self, q: Float[Array, " n"], loads: Loads | None = None) -> Float[Array, "6 6"]:
        """K_C^-1 = J (K_theta - H)^-1 J^T [m/N, rad/(N m)]: there also at singular poses. **Arguments:** as of `at_tool`.

        Raises `ValueError` for passive joints, and what `equilibrium` raises.
        """
        self.require_springs("take the stiffness")
        return _found(self._tool_compliance(self.robot.coordinates_of(q), loads), loads)

    @eqx.filter_jit
    def _tool_compliance(self, q, loads):
        x, held = self._held(q, loads)
        jacobian = self.chain.jacobian(x)
        return jacobian @ jnp.linalg.solve(held, jacobian.T)

    def mass(self, q: Float[Array, " n"], loads: Loads | None = None) -> Float[Array, "6 6"]:
        """M_C = B^T M_theta B (E 10, 19): the mass at the tool, in the same axes [kg, kg m; kg m, kg m²].

        B are the deflections that a displacement of the tool brings about at rest. With six springs that is J^-1, and
        M_C = J^-T M_theta J^-1 (C 25, which prints J^T M J); with more, an approximation after Rayleigh and Ritz, good for
        the first three modes.

        **Arguments:** as of `at_tool`.
        """
        return self.at_tool(q, loads).mass(self)

    def modes(self, q: Float[Array, " n"], loads: Loads | None = None) -> Modes:
        """Natural frequencies and mode shapes at the tool (E 21). **Arguments:** as of `at_tool`."""
        at = self.at_tool(q, loads)
        return modes(at.mass(self), at.stiffness)

    def check(self, q: Float[Array, " n"], name: str = "q") -> None:
        """Raise `ValueError` where q is beyond a limit or singular, or the mass matrix, if there is one, not positive
        definite, with the joints it is about; `name` is what messages call q. Traced numbers pass."""
        self.robot.check(q, name)
        q = self.robot.coordinates_of(q)
        jacobian = concrete(self._jacobian(q))
        if jacobian is None:
            return
        _, size, motions = np.linalg.svd(self.scaled(jacobian))
        if len(size) < 6 or size[-1] <= SINGULAR * size[0]:
            springs = jacobian.shape[1]
            if springs < 6:
                raise ValueError(
                    f"{name}: with {springs} springs the tool gives way in {springs} of its six directions only; give "
                    "elastic links (in Python: beams)"
                )
            names = combination(self.chain.names, motions[5])
            shown = ", ".join(f"{angle:.4g}" for angle in np.rad2deg(np.asarray(q)))
            raise ValueError(
                f"{name}: the pose ({shown}) deg is singular: {names} can move without the tool, which cannot move in one "
                f"of its six directions. Change {self._way_out(q)} by a degree"
            )
        if self.robot.mass is None or self.robot.inertia is None:
            return
        mass = np.asarray(self._mass_matrix(q))
        scale = np.sqrt(np.abs(np.diag(mass)))
        values, vectors = np.linalg.eigh(mass / np.outer(scale, scale) if scale.all() else mass)
        if values[0] <= WEIGHTLESS * values[-1]:
            names = combination(self.chain.names, vectors[:, 0])
            raise ValueError(
                f"robot: the mass matrix is not positive definite: what is moved by {names} has no inertia, or a negative "
                "one. Look at mass and inertia of the links from there on"
            )

    @property
    def reach(self) -> float:
        """In which translations of the tool are counted, beside rotations [m]: its length, 1 for one without any."""
        return self.robot.length or 1.0

    def scaled(self, jacobian: Float[np.ndarray, "... 6 N"]) -> Float[np.ndarray, "... 6 N"]:
        """Jacobians at the tool, translations in reaches."""
        return jacobian * np.repeat([1 / self.reach, 1.0], 3)[:, None]

    def _way_out(self, q) -> str:
        """The joint that leads out of a singular pose the fastest. At an outstretched wrist it is none of those that can
        move without the tool."""
        nearby = np.asarray(q) + np.deg2rad(1) * np.eye(self.robot.joints)
        jacobians = np.array([self._jacobian(one) for one in nearby])
        sizes = np.linalg.svd(self.scaled(jacobians), compute_uv=False)
        return self.robot.names[int(np.argmax(sizes[:, 5] / sizes[:, 0]))]

    @eqx.filter_jit
    def _jacobian(self, q) -> Float[Array, "6 N"]:
        """J of the robot that nothing loads."""
        return self.chain.jacobian(self.extended(q))

    @eqx.filter_jit
    def _mass_matrix(self, q) -> Float[Array, "N N"]:
        """M_theta of the robot that nothing loads."""
        return self.bodies(self.extended(q)).mass_matrix

    def require_springs(self, what: str) -> None:
        """Raise `ValueError` where a joint is passive; `what` is what else to do than to give it a spring."""
        given = concrete(self.compliance)
        if given is not None and np.isinf(given).any():
            name = self.robot.names[int(np.argmax(np.isinf(given)))]
            raise ValueError(f"compliance: {name} is passive, and no spring holds it: give it one, or {what}")


class AtTool(eqx.Module):
    """What the tool feels of a robot, in the axes of the base frame.

    - `coordinates`: x, at which springs and loads are in equilibrium, shape (N,).
    - `stiffness`: K_C, shape (6, 6).
    - `follow`: B, by how much the coordinates follow a displacement of the tool, shape (N, 6).
    """

    coordinates: Float[Array, " N"]
    stiffness: Float[Array, "6 6"]
    follow: Float[Array, "N 6"]

    @eqx.filter_jit
    def mass(self, robot: ElasticRobot) -> Float[Array, "6 6"]:
        """M_C = B^T M_theta B."""
        return self.follow.T @ robot.bodies(self.coordinates).mass_matrix @ self.follow


def _root(function, start: Float[Array, " N"]) -> Float[Array, " N"]:
    """Where a function is zero near `start`, by Newton's method; NaN where it finds no such place.

    Not optimistix's, which the tests compare with: that ends a whole batch where one member has no equilibrium, and cannot
    be used in programs that are spread over cores.
    """

    def excess(state):  # of the last step, over one that may be the last
        at, step, _ = state
        # The next step would be some square of this one.
        return jnp.max(jnp.abs(step)) - jnp.finfo(start.dtype).eps ** 0.75 * jnp.max(jnp.abs(at))

    def newton(function, start):
        def step(state):
            at, _, steps = state
            change = jnp.linalg.solve(jax.jacfwd(function)(at), function(at))
            return at - change, change, steps + 1

        begin = start, jnp.full_like(start, jnp.inf), 0
        end = lax.while_loop(lambda state: (excess(state) > 0) & (state[2] < NEWTON_STEPS), step, begin)
        return jnp.where(excess(end) <= 0, end[0], jnp.nan)

    return lax.custom_root(function, start, newton, lambda f, y: jnp.linalg.solve(jax.jacfwd(f)(y), y))


def _found(values: Array, loads: Loads | None) -> Array:
    """`values`, if there is an equilibrium with the loads. Raises `ValueError`."""
    given = None if loads is None else concrete(values)
    if given is not None and np.isnan(given).any():
        raise ValueError("loads: no equilibrium found near q; they are beyond what the springs hold")
    return values


def _condensed(jacobian: Float[Array, "6 N"], held: Float[Array, "N N"]) -> tuple[Array, Array]:
    """K_C and B from [0 J; J^T -(K_theta - H)] [dF; dtheta] = [dt; 0] (C 16): also where some coordinates have no spring
    (E 18-20), and K_C then is singular.

    The system is scaled, lengths and angles, springs and no springs, so that its solution does not lose digits.
    """
    own = jnp.abs(jnp.diag(held))
    stiffest = jnp.max(own)
    scale = jax.lax.stop_gradient(jnp.sqrt(jnp.where(own > 0, own, jnp.where(stiffest > 0, stiffest, 1.0))))
    lever = jacobian / scale
    size = jax.lax.stop_gradient(1 / jnp.linalg.norm(lever, axis=1))
    lever = size[:, None] * lever
    system = jnp.block([[jnp.zeros((6, 6)), lever], [lever.T, -held / jnp.outer(scale, scale)]])
    right = jnp.concatenate([jnp.diag(size), jnp.zeros((len(held), 6))])
    found = jnp.linalg.solve(system, right)
    return size[:, None] * found[:6], found[6:] / scale[:, None]
