"""Two parallel robots with closed forms, a Gough-Stewart platform and a planar 3-RPR: K = sum of k w w^T over the legs, with
w = (n, r x n), n the direction of a leg and r the way from the tool centre point to where it holds the platform."""

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from millax.robot import ElasticRobot, ParallelRobot, Payload, Placement, Robot

TOOL = np.array([0.05, -0.03, 0.9])
"""The tool centre point [m]; its axes are those of the base."""
FREE = np.inf


class Known(NamedTuple):
    """A robot, its coordinates, and its K_C and M_C in closed form; M_C is None where only K_C is of interest."""

    robot: ParallelRobot
    q: list[np.ndarray]
    stiffness: np.ndarray
    mass: np.ndarray | None


def gough_stewart() -> Known:
    """Six legs of different stiffness between a universal and a spherical joint, massless, below a tilted platform."""
    start = _ring(0.6, np.deg2rad([-8, 8, 112, 128, 232, 248]))
    tilt = Rotation.from_euler("xyz", [0.2, -0.1, 0.3])
    end = np.array([0.1, 0.05, 0.8]) + tilt.apply(_ring(0.3, np.deg2rad([-52, 52, 68, 172, 188, 292])))
    springs = np.array([3.0, 4.0, 5.0, 3.5, 4.5, 2.5]) * 1e7
    platform = Payload(25.0, (0.02, 0.03, -0.1), np.diag([0.6, 0.7, 1.1]))
    legs, q = [], []
    for i, (a, b, spring) in enumerate(zip(start, end, springs, strict=True)):
        along, length = _way(a, b)
        across = np.cross(along, [np.sin(i), np.cos(i), 0.5])
        across /= np.linalg.norm(across)
        axes = Rotation.from_matrix(np.stack([across, np.cross(along, across), along], axis=1))
        robot = _chain(
            ("revolute", "revolute", "prismatic", "revolute", "revolute", "revolute"),
            axis="xyzxyz",
            xyz=np.zeros((6, 3)),
            base=Placement(a, axes.as_euler("xyz")),
            flange=Placement(axes.inv().apply(TOOL - b), axes.inv().as_euler("xyz")),
            payload=platform if i == 0 else None,
        )
        legs.append(ElasticRobot(robot, [FREE, FREE, 1 / spring, FREE, FREE, FREE]))
        q.append(np.array([0.0, 0.0, length, 0.0, 0.0, 0.0]))
    return Known(ParallelRobot(tuple(legs)), q, _of_legs(start, end, springs), _of_body(platform))


def planar() -> Known:
    """Three legs, each with a spring along it between two hinges about z; out of the plane, springs at the tool."""
    start = _ring(0.7, np.deg2rad([10, 130, 245])) + np.array([0, 0, TOOL[2]])
    end = TOOL + _ring(0.2, np.deg2rad([40, 150, 290])) + np.array([0.05, 0.02, 0])
    springs, upright, tilting = np.array([2.0, 3.0, 4.0]) * 1e7, 1e6, 2e5
    legs, q = [], []
    for a, b, spring in zip(start, end, springs, strict=True):
        along, length = _way(a, b)
        angle = np.arctan2(along[1], along[0])
        xyz = np.zeros((6, 3))
        xyz[3] = Rotation.from_euler("z", -angle).apply(TOOL - b)
        robot = _chain(
            ("revolute", "prismatic", "revolute", "prismatic", "revolute", "revolute"),
            axis="zxzzxy",
            xyz=xyz,
            base=Placement(a, (0.0, 0.0, angle)),
            flange=Placement((0.0, 0.0, 0.0), (0.0, 0.0, -angle)),
        )
        legs.append(ElasticRobot(robot, [FREE, 1 / spring, FREE, 1 / upright, 1 / tilting, 1 / tilting]))
        q.append(np.array([0.0, length, 0.0, 0.0, 0.0, 0.0]))
    out_of_plane = len(springs) * np.diag([0.0, 0.0, upright, tilting, tilting, 0.0])
    return Known(ParallelRobot(tuple(legs)), q, _of_legs(start, end, springs) + out_of_plane, None)


def _ring(radius: float, angle) -> np.ndarray:
    return radius * np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)


def _way(a, b) -> tuple[np.ndarray, float]:
    """Direction and length from one point to another."""
    length = float(np.linalg.norm(b - a))
    return (b - a) / length, length


def _chain(kinds, axis: str, xyz, **others) -> Robot:
    """A leg that weighs nothing. `axis` has a letter for each joint."""
    n = len(kinds)
    return Robot(
        names=tuple(f"joint_{i + 1}" for i in range(n)),
        kinds=kinds,
        xyz=xyz,
        rpy=np.zeros((n, 3)),
        axis=np.eye(3)[["xyz".index(letter) for letter in axis]],
        zero=np.zeros(n),
        mass=np.zeros(n),
        centre_of_mass=np.zeros((n, 3)),
        inertia=np.zeros((n, 3, 3)),
        **others,
    )


def _of_legs(start, end, springs) -> np.ndarray:
    ways = (end - start) / np.linalg.norm(end - start, axis=1, keepdims=True)
    lines = np.concatenate([ways, np.cross(end - TOOL, ways)], axis=1)
    return np.einsum("k,ki,kj->ij", springs, lines, lines)


def _of_body(body: Payload) -> np.ndarray:
    """M of a rigid body at the tool centre point: u' + r' x c is the velocity of its centre of mass."""
    x, y, z = np.asarray(body.centre_of_mass)
    velocity = np.concatenate([np.eye(3), [[0, z, -y], [-z, 0, x], [y, -x, 0]]], axis=1)
    mass = float(body.mass) * velocity.T @ velocity
    mass[3:, 3:] += np.asarray(body.inertia)
    return mass
