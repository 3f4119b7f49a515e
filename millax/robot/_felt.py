"""What the tool feels of an arm at its pose, in numbers with labels, units and definitions."""

from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from .._structure import free_rates
from .._types import AXES
from ._arm import Arm
from ._elastic import ElasticRobot
from ._modes import modes

if TYPE_CHECKING:
    import xarray

DIRECTIONS = (*AXES, *(f"about_{axis}" for axis in AXES))
"""The six coordinates of the tool, in the order of every matrix."""

STILL = 1e-9
"""Metres by which a mode moves the tool centre point per radian that it turns the tool, below which it does not move it."""

MIXED = {
    "stiffness": "N/m, N/rad; N, N m/rad",
    "compliance": "m/N, 1/N; rad/N, rad/(N m)",
    "mass": "kg, kg m; kg m, kg m^2",
    "damping": "N s/m, N s/rad; N s, N m s/rad",
}
"""Units of matrices whose coordinates are translations and rotations, block by block."""


def robot_at_tool(arm: Arm) -> "xarray.Dataset":
    """Stiffness, mass and damping of an arm at the tool centre point, its modes there, and which joint gives way.

    "locked" is a force over the motion along it where the tool moves along that direction only, K_ii; "free" where nothing
    else holds the tool, 1/(K^-1)_ii: what is measured by pulling at it.

    **Arguments:**

    - `arm`: at a pose that is not singular.

    **Returns:** a dataset whose variables carry their unit ("units") and definition ("long_name"). In the workpiece frame:
    `stiffness`, `compliance`, `mass`, `damping` (6 by 6, translations first), `locked_stiffness`, `free_stiffness`,
    `locked_mass`, `free_mass`, `principal_compliance`, `principal_direction`, `natural_frequency`, `damping_ratio`,
    `mode_shape`, `modal_stiffness`, `contribution`, `receptance`, `static_deflection`. In the base frame: `pose`,
    `tool_position`, `workpiece_axes`, `outline`.

    Raises `ValueError` for a robot without masses and for a passive joint.
    """
    import xarray

    elastic, loads, q = arm.elastic, arm.loads_in_base, arm.joints
    turn = np.asarray(arm.workpiece)
    frame = np.kron(np.eye(2), turn)
    structure = arm.structure()
    frequency, shapes = (np.asarray(part) for part in modes(structure.mass_matrix, structure.stiffness_matrix))
    mass, damping, stiffness = (
        np.asarray(m) for m in (structure.mass_matrix, structure.damping_matrix, structure.stiffness_matrix)
    )
    compliance = frame.T @ np.asarray(elastic.tool_compliance(q, loads)) @ frame
    at = elastic.at_tool(q, loads)
    tool = np.asarray(elastic.robot.pose(q))[:3, 3]
    moved = np.asarray(elastic.chain.pose(at.coordinates))[:3, 3] - tool
    size, directions = np.linalg.eigh((compliance[:3, :3] + compliance[:3, :3].T) / 2)
    # Deflections of the springs by a unit force on the tool, and what they move it by along that force.
    given_way = np.asarray(at.follow) @ frame @ compliance[:, :3]
    lever = np.asarray(elastic.chain.jacobian(at.coordinates)).T @ frame[:, :3]
    springs, first = _springs(elastic)
    contribution = np.add.reduceat(lever * given_way, first, axis=0) / np.diag(compliance)[:3]

    ratio = damping_ratios(mass, damping, stiffness, shapes)
    length = np.linalg.norm(shapes[:3], axis=0)
    known = length > STILL * np.linalg.norm(shapes[3:], axis=0)
    unit = np.where(known, _pointed(shapes[:3]) / np.where(known, length, 1.0), 0.0)
    modal = np.where(known, (2 * np.pi * frequency / np.where(known, length, 1.0)) ** 2, np.nan)
    line = _frequencies(frequency, ratio)

    matrix = ("row", "column")
    found: dict[str, tuple[Any, Any, str, str]] = {
        "pose": ("joint", q, _joint_units(elastic), "what the drives set"),
        "tool_position": ("base_axis", tool, "m", "tool centre point in the base frame, without loads"),
        "workpiece_axes": (("base_axis", "axis"), turn, "", "axes of the workpiece frame, as columns in the base frame"),
        "static_deflection": ("axis", turn.T @ moved, "m", "by which the loads move the tool centre point"),
        "stiffness": (matrix, stiffness, MIXED["stiffness"], "K: force and moment on the tool by its displacement"),
        "compliance": (matrix, compliance, MIXED["compliance"], "K^-1: displacement of the tool by force and moment"),
        "mass": (matrix, mass, MIXED["mass"], "M at the tool centre point"),
        "damping": (matrix, damping, MIXED["damping"], "C at the tool centre point"),
        "locked_stiffness": ("axis", np.diag(stiffness)[:3], "N/m", "K_ii: the tool moves along i only"),
        "free_stiffness": ("axis", 1 / np.diag(compliance)[:3], "N/m", "1/(K^-1)_ii: the tool is pulled along i only"),
        "locked_mass": ("axis", np.diag(mass)[:3], "kg", "M_ii: the tool is accelerated along i only"),
        "free_mass": ("axis", 1 / np.diag(np.linalg.inv(mass))[:3], "kg", "1/(M^-1)_ii: a sudden force along i only"),
        "principal_compliance": (
            "principal",
            size[::-1],
            "m/N",
            "half axes of the ellipsoid on which the tool moves under unit forces in all directions, largest first",
        ),
        "principal_direction": (("axis", "principal"), _pointed(directions[:, ::-1]), "", "directions of these half axes"),
        "natural_frequency": ("mode", frequency, "Hz", "of the undamped modes, lowest first"),
        "damping_ratio": (
            "mode",
            ratio,
            "",
            "-Re/|lambda| of the damped motion that is most like the mode; 1: it does not vibrate",
        ),
        "mode_shape": (("axis", "mode"), unit, "", "direction in which the mode moves the tool centre point, of length 1"),
        "modal_stiffness": ("mode", modal, "N/m", "of the mode for a force along its motion of the tool centre point"),
        "contribution": (
            ("spring", "axis"),
            contribution,
            "",
            "part of the compliance along i that a joint (or an elastic link) is the cause of, c J_i^2/(K^-1)_ii",
        ),
        "receptance": (
            ("axis", "frequency"),
            receptance(mass, damping, stiffness, line),
            "m/N",
            "|H_ii|: vibration of the tool along i over a harmonic force along i",
        ),
        "outline": (("point", "base_axis"), outline(arm), "m", "base, origins of the joints, flange and tool centre point"),
    }
    coordinates = {
        "axis": list(AXES),
        "base_axis": list(AXES),
        "row": list(DIRECTIONS),
        "column": list(DIRECTIONS),
        "joint": list(elastic.robot.names),
        "spring": springs,
        "mode": np.arange(1, 7),
        "principal": np.arange(1, 4),
        "point": points(arm),
        "frequency": ("frequency", line, {"units": "Hz"}),
    }
    return xarray.Dataset(
        {
            name: (dims, np.asarray(values), {"units": unit, "long_name": words})
            for name, (dims, values, unit, words) in found.items()
        },
        coordinates,
        {"title": "a robot, as the tool feels it"},
    )


def outline(arm: Arm) -> Float[np.ndarray, "points 3"]:
    """The arm as a line in the base frame [m], through `points`."""
    robot = arm.elastic.robot
    frames = robot.frames(arm.joints)
    flange = frames.position[-1] + frames.rotation[-1] @ robot.flange.xyz
    ends = robot.base.xyz, *frames.position, flange, robot.pose(arm.joints)[:3, 3]
    return np.stack([np.asarray(end) for end in ends])


def points(arm: Arm) -> list[str]:
    """Names of the points of `outline`."""
    return ["base", *arm.robot.names, "flange", "tool"]


def damping_ratios(mass, damping, stiffness, shapes) -> Float[np.ndarray, " n"]:
    """zeta [-] of every mode: -Re/|lambda| of a motion e^(lambda t) of M x'' + C x' + K x = 0.

    Damping may couple the modes. Each mode then takes the damped motion that is most like it, and no two the same one.

    **Arguments:**

    - `mass`, `damping`, `stiffness`: M, C, K, shape (n, n).
    - `shapes`: of the undamped modes, as of `modes`.
    """
    from scipy.optimize import linear_sum_assignment

    n = len(mass)
    values, vectors = np.linalg.eig(free_rates(mass, damping, stiffness))
    # One of each pair of conjugates, and both motions of a mode that does not vibrate.
    one = np.imag(values) >= 0
    values, motions = values[one], vectors[:n, one]
    like = np.abs(shapes.T @ mass @ motions) ** 2 / np.sum(np.real(motions.conj() * (mass @ motions)), axis=0)
    values = values[linear_sum_assignment(like, maximize=True)[1]]
    return -np.real(values) / np.abs(values)


def receptance(mass, damping, stiffness, frequency) -> Float[np.ndarray, "3 frequencies"]:
    """|H_ii| = |((K - w^2 M + i w C)^-1)_ii| [m/N] along x, y and z at these frequencies [Hz]."""
    w = 2 * np.pi * np.asarray(frequency)[:, None, None]
    inverse = np.linalg.inv(stiffness - w**2 * mass + 1j * w * damping)
    return np.abs(np.diagonal(inverse, axis1=1, axis2=2)[:, :3].T)


def _springs(elastic: ElasticRobot) -> tuple[list[str], list[int]]:
    """Joints and elastic links by their names, and the first coordinate of each."""
    names, first = [], []
    for name, place in zip(elastic.robot.names, elastic.places, strict=True):
        names.append(name)
        first.append(int(place))
        if name in elastic.beams:
            names.append(f"link of {name}")
            first.append(int(place) + 1)
    return names, first


def _joint_units(elastic: ElasticRobot) -> str:
    kinds = [{"revolute": "rad", "prismatic": "m"}[kind] for kind in elastic.robot.kinds]
    return kinds[0] if len(set(kinds)) == 1 else ", ".join(kinds)


def _pointed(columns: Float[np.ndarray, "3 n"]) -> Float[np.ndarray, "3 n"]:
    """Columns that are directions without sign, with the sign that makes the largest number positive."""
    largest = np.take_along_axis(columns, np.argmax(np.abs(columns), axis=0)[None], axis=0)
    return columns * np.where(largest < 0, -1.0, 1.0)


def _frequencies(natural, ratio) -> Float[np.ndarray, " frequencies"]:
    """From well below the lowest mode to above the highest one, so dense that no resonance falls between two of them."""
    low, high = natural[0] / 4, 2 * natural[-1]
    many = np.log(high / low) / (max(ratio.min(), 1e-4) / 3)
    return np.geomspace(low, high, int(np.clip(many, 500, 20000)))
