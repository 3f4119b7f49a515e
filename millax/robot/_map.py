"""Stiffness over the workspace: every pose of a grid of two joints at once."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._types import AXES, Scalar
from .._units import parse, show
from .._values import Given, Values, read
from ._arm import Arm
from ._felt import outline, points

if TYPE_CHECKING:
    import xarray

MANY = 41
"""Values of each joint by default."""

AROUND = {"revolute": np.deg2rad(45.0), "prismatic": 0.5}
"""How far from the pose a joint without a limit goes by default [rad], [m]."""

ALONE = 15000
"""Poses at a time, times the cube of the number of springs. jaxlib 0.10 spreads batches of more than 200 000 operations (a
dozen of these) over the threads of XLA, in one of which it waits for the others: where two batches do so at once, for ever
(https://github.com/jax-ml/jax/blob/jax-v0.10.2/jaxlib/cpu/lapack_kernels.cc)."""

EXAMPLE = '"-120:-20:41 deg" (from, to, how many)'

PREFIX = "robot.joints.joint_"
"""Joints are named as in a case file, by their number."""


def stiffness_map(arm: Arm, grid: Mapping[str, Given] | None = None) -> "xarray.Dataset":
    """Where the tool gets to with two joints, and how stiff the arm is there.

    **Arguments:**

    - `arm`: the arm; its other joints stay where they are.
    - `grid`: values of two joints, `{"robot.joints.joint_2": "-120:-20:41 deg", ...}`, as `millax.sweep` takes them. None:
      joints 2 and 3, from limit to limit, and 45 degrees to both sides of the pose where there is none.

    **Returns:** a dataset over the two joints. `tool_position` [m] is in the base frame; `free_stiffness` [N/m] along x, y
    and z of the workpiece frame, which turns with the tool; `least_stiffness` [N/m] in the plane x, y;
    `lowest_frequency` [Hz]; `outline`, the arm at its own pose. Poses beyond the limits are NaN, and so are those at which
    the robot does not stand under its loads; singular ones are like any other.

    Raises `ValueError` for other names, for values that are none of joints or all beyond the limits, and where the robot
    stands at no pose.
    """
    import xarray

    robot = arm.robot
    values = {name: _given(arm, name, given) for name, given in (_default(arm) if grid is None else grid).items()}
    if len(values) != 2:
        raise ValueError(f"a map is over two joints, {len(values)} given; name two of {', '.join(_names(arm))}")
    indices = [_names(arm).index(name) for name in values]
    scales = [parse(name, f"1 {v.unit}", _unit(arm, name)) for name, v in values.items()]
    own = np.asarray(arm.joints)[indices] / scales
    si = [v.numbers * scale for v, scale in zip(values.values(), scales, strict=True)]
    joints = np.tile(np.asarray(arm.joints), (*map(len, si), 1))
    joints[..., indices] = np.stack(np.meshgrid(*si, indexing="ij"), axis=-1)
    low, high = (limit[indices] for limit in robot.limits)
    inside = np.all((joints[..., indices] >= low) & (joints[..., indices] <= high), axis=-1)
    if not inside.any():
        raise ValueError(f"{' and '.join(values)}: every pose given is beyond the limits of these joints")
    at = _over(arm, jnp.asarray(joints.reshape(-1, robot.joints)))
    at = {name: np.asarray(part).reshape(*joints.shape[:2], *part.shape[1:]) for name, part in at.items()}
    stands = inside & np.isfinite(at["lowest_frequency"])
    if not stands.any():
        raise ValueError("robot.loads: at no pose of the map do the springs hold them; take smaller loads")
    dims = tuple(values)
    words = {
        "free_stiffness": ("axis", "N/m", "1/(K^-1)_ii along the workpiece frame at that pose: the tool is pulled along i"),
        "least_stiffness": (None, "N/m", "smallest free stiffness in the plane x, y of the workpiece frame"),
        "lowest_frequency": (None, "Hz", "lowest natural frequency"),
    }
    found = {
        "tool_position": (
            (*dims, "base_axis"),
            at["tool_position"],
            {"units": "m", "long_name": "tool centre point in the base frame"},
        ),
        "outline": (
            ("point", "base_axis"),
            outline(arm),
            {"units": "m", "long_name": "base, origins of the joints, flange and tool centre point at the arm's own pose"},
        ),
    }
    for name, (dim, unit, definition) in words.items():
        kept = np.where(stands[..., None] if dim else stands, at[name], np.nan)
        found[name] = ((*dims, *([dim] if dim else [])), kept, {"units": unit, "long_name": definition})
    coordinates = {
        "axis": list(AXES),
        "base_axis": list(AXES),
        "point": points(arm),
        **{
            name: (name, v.numbers, {"units": v.unit, "pose": float(pose)})
            for (name, v), pose in zip(values.items(), own, strict=True)
        },
    }
    return xarray.Dataset(found, coordinates, {"title": "stiffness of a robot over two of its joints"})


@eqx.filter_jit
def _over(arm: Arm, joints: Float[Array, "poses n"]) -> dict[str, Float[Array, "poses ..."]]:
    """As many poses at a time as LAPACK leaves to one thread."""
    together = max(1, ALONE // arm.elastic.coordinates**3)
    return jax.lax.map(lambda q: _at(eqx.tree_at(lambda a: a.joints, arm, q)), joints, batch_size=together)


def _at(arm: Arm) -> dict[str, Float[Array, "..."]]:
    """One pose."""
    elastic, turn = arm.elastic, arm.workpiece
    x, held = elastic._held(arm.joints, arm.loads_in_base)
    jacobian = elastic.chain.jacobian(x)
    # That of `ElasticRobot.tool_compliance`, without looking for the same equilibrium twice.
    compliance = turn.T @ (jacobian[:3] @ jnp.linalg.solve(held, jacobian[:3].T)) @ turn
    in_plane = (compliance[:2, :2] + compliance[:2, :2].T) / 2
    return {
        "tool_position": elastic.robot.pose(arm.joints)[:3, 3],
        "free_stiffness": 1 / jnp.diag(compliance),
        "least_stiffness": 1 / jnp.linalg.eigvalsh(in_plane)[-1],
        "lowest_frequency": lowest_frequency(held, jacobian, elastic.bodies(x).mass_matrix),
    }


def lowest_frequency(held: Float[Array, "N N"], jacobian: Float[Array, "6 N"], mass: Float[Array, "N N"]) -> Scalar:
    """That of the tool [Hz], of the matrices of the springs; there also at singular poses.

    At a singular pose the tool cannot move in some direction, and its mass and stiffness there are infinite; those of the
    springs are not. With K_theta - H = L L^T and an orthonormal basis Q of L^-1 J^T, the 1/w^2 of the tool are the
    eigenvalues of Q^T L^-1 M_theta L^-T Q: with six springs Q has no say.

    **Arguments:**

    - `held`: K_theta - H. NaN comes out where it is not positive definite: the robot does not stand.
    - `jacobian`: J at the tool.
    - `mass`: M_theta.
    """
    root = jnp.linalg.cholesky((held + held.T) / 2)
    basis = jnp.linalg.qr(jax.scipy.linalg.solve_triangular(root, jacobian.T, lower=True))[0]
    half = jax.scipy.linalg.solve_triangular(root, mass, lower=True)
    inner = basis.T @ jax.scipy.linalg.solve_triangular(root, half.T, lower=True) @ basis
    return 1 / (2 * jnp.pi * jnp.sqrt(jnp.linalg.eigvalsh((inner + inner.T) / 2)[-1]))


def _names(arm: Arm) -> list[str]:
    return [f"{PREFIX}{i + 1}" for i in range(arm.robot.joints)]


def _unit(arm: Arm, name: str) -> str:
    return "rad" if arm.robot.kinds[_names(arm).index(name)] == "revolute" else "m"


def _default(arm: Arm) -> dict[str, Values]:
    """Joints 2 and 3, which move the tool most in the plane of the arm; the first two where there are no others."""
    robot, found = arm.robot, {}
    for i in (1, 2) if robot.joints > 2 else range(robot.joints):
        around = float(arm.joints[i]) + np.array([-1.0, 1.0]) * AROUND[robot.kinds[i]]
        low, high = (
            float(other if limit is None or not np.isfinite(limit[i]) else limit[i])
            for limit, other in zip((robot.lower, robot.upper), around, strict=True)
        )
        numbers, turning = np.linspace(low, high, MANY), robot.kinds[i] == "revolute"
        found[f"{PREFIX}{i + 1}"] = Values(np.rad2deg(numbers), "deg") if turning else Values(numbers, "m")
    return found


def _given(arm: Arm, name: str, given: Given) -> Values:
    """Several values of a joint, with their unit."""
    if name not in _names(arm):
        raise ValueError(f"{name}: this is no joint of the robot; its joints are {', '.join(_names(arm))}")
    values, unit = read(name, given), _unit(arm, name)
    if values.unit == "":
        raise ValueError(f"{name}: {show(given)} given, without a unit; it takes {EXAMPLE}")
    values = Values(values.numbers, unit if values.unit is None else values.unit)
    parse(name, f"1 {values.unit}", unit)  # a unit of another kind is an error
    if values.numbers.ndim == 0 or len(np.unique(values.numbers)) < len(values):
        raise ValueError(f"{name}: {show(given)} given; it takes values that differ, such as {EXAMPLE}")
    return values
