"""A load test beside a robot: by how much its tool gives way."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from millax import Case
from millax.robot import Loads

from ._loadtest import CHANNELS, LoadTest, measurement
from ._measured import TraceError


class Deflection(eqx.Module):
    """One load test, ready to be compared with the robot of a case.

    The springs are in equilibrium under gravity and the wrench (C 7), and under gravity alone. Between the two the tool
    frame, origin p and axes R, is displaced by p_loaded - p_unloaded and rotated by R_loaded R_unloaded^T.
    """

    joints: Float[Array, "m n"] | None
    wrench: Float[Array, "m 6"]
    measured: Float[Array, "channels m"]
    channels: tuple[str, ...] = eqx.field(static=True)

    def predict(self, case: Case) -> Float[Array, "channels m"]:
        """The model's channels [m, rad]; NaN for loads beyond what the springs hold. Differentiable."""
        arm = case.robot
        assert arm is not None  # `deflection` has looked
        elastic = arm.elastic
        gravity = None if arm.loads is None else arm.loads.gravity
        m = len(self.wrench)
        joints = jnp.broadcast_to(arm.joints, (m, len(arm.joints))) if self.joints is None else self.joints

        def pose(q, wrench):
            loads = Loads(wrench[:3], wrench[3:], gravity)
            return elastic.chain.pose(elastic.equilibrium(q, loads))

        # Loaded and unloaded in one batch: the root finding is compiled once.
        both = jax.vmap(pose)(jnp.tile(joints, (2, 1)), jnp.concatenate([self.wrench, jnp.zeros_like(self.wrench)]))
        loaded, unloaded = both[:m], both[m:]
        moved = loaded[:, :3, 3] - unloaded[:, :3, 3]
        turned = rotation_vector(loaded[:, :3, :3] @ unloaded[:, :3, :3].swapaxes(1, 2))
        places = np.array([list(CHANNELS).index(channel) for channel in self.channels])
        return jnp.concatenate([moved, turned], axis=1).T[places]


def rotation_vector(rotation: Float[Array, "m 3 3"]) -> Float[Array, "m 3"]:
    """Axis times angle [rad] of rotations by small angles: a with sin(|a|)/|a| a = the skew part of R.

    |a| follows from its sine s by the series of asin(s)/s up to s⁴: up to 0.1 rad, far more than a robot gives way, it
    misses less than 5e-8 of the angle. Differentiable also at 0.
    """
    sine = jnp.stack([rotation[:, i, j] - rotation[:, j, i] for i, j in ((2, 1), (0, 2), (1, 0))], axis=1) / 2
    square = jnp.sum(sine**2, axis=1, keepdims=True)
    return sine * (1 + square / 6 + 3 * square**2 / 40)


def deflection(test: LoadTest, case: Case) -> Deflection:
    """Check `test` against the robot of `case`.

    Raises `TraceError` for a case without a robot, a passive joint, poses of another number of joints, beyond the limits or
    singular.
    """
    arm = case.robot
    if arm is None:
        raise TraceError(
            f"{test.name}: a load test needs a robot, and the case has none: give [robot] in place of [structure]"
        )
    elastic = arm.elastic
    try:
        elastic.require_springs("leave the load test out")
    except ValueError as error:
        raise TraceError(f"{test.name}: {error}") from error
    if test.joints is None:
        poses = {"robot.joints": arm.joints}
    else:
        # A pose is looked at once, however often it was loaded.
        first = np.sort(np.unique(test.joints, axis=0, return_index=True)[1])
        poses = {f"{measurement(i)}, q": jnp.asarray(test.joints[i]) for i in first}
    for where, q in poses.items():
        try:
            elastic.check(q, f"{test.name}: {where}")
        except ValueError as error:
            raise TraceError(str(error)) from error
    joints = None if test.joints is None else jnp.asarray(test.joints)
    return Deflection(joints, jnp.asarray(test.wrench), jnp.asarray(test.values.T), test.channels)
