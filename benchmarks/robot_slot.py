"""The slot of C (Table 1) with a KUKA KR270 in four poses: four cuts, their forces and displacements measured; and load
tests of it in eight."""

from functools import cache

import numpy as np

import millax as mx
from identification import Parameter, Trace
from millax.robot import Arm, Loads, Robot, Spindle, models

from .kr270 import COMPLIANCE, slot

POSES = (
    (90, -50, 120, 180, 25, 180),
    (60, -70, 110, 150, 50, 120),
    (120, -40, 100, 210, 60, 200),
    (80, -80, 130, 120, -40, 90),
)
"""Joint coordinates [deg]; the first are those of C."""

MORE_POSES = (
    (70, -60, 100, 30, 40, 60),
    (100, -90, 140, 0, -60, 30),
    (50, -45, 95, 90, 30, 10),
    (110, -75, 115, -60, 70, -120),
)
"""Of load tests, beside those of the cuts [deg]."""

PULL = 500.0
"""Of a load test [N], along x, y and -z of the base in each pose."""

TRACKER = 10e-6
"""Its noise [m]."""

DAMPING = (0.05, 0.04, 0.03, 0.05, 0.05, 0.05)
"""Of the modes [-]; the first three are looked for."""

NOISE = {"Fx": 2.0, "Fy": 2.0, "x": 5e-6, "y": 5e-6}
"""Standard deviation [N], [m]."""

EVERY = 8
"""One sample in so many steps is kept: 2.7 kHz."""

TRUTH = {f"robot.compliance.joint_{i + 1}": value for i, value in enumerate(COMPLIANCE)} | {
    f"robot.damping_ratio.mode_{i + 1}": value for i, value in enumerate(DAMPING[:3])
}

SPINDLE = Spindle(
    xyz=(0.15, 0.0, 0.25),
    rpy=(0.0, np.pi / 3, 0.0),
    mass=25.0,
    centre_of_mass=(0.05, 0.0, 0.1),
    inertia=np.diag([0.4, 0.4, 0.3]),
)
"""Beside the axis of the last joint, which a force on that axis would not turn."""


@cache
def cases(poses: int = 4) -> tuple[mx.Case, ...]:
    """0.3 s of the slot in each of the first poses."""
    return tuple(slot(0.3, arm(np.deg2rad(pose))) for pose in POSES[:poses])


def arm(joints, loads: Loads | None = None, robot: Robot | None = None) -> Arm:
    """The robot with its spindle, as it is in truth."""
    robot = models.kuka_kr270() if robot is None else robot
    return Arm(robot, joints, COMPLIANCE, damping_ratio=DAMPING, tool=SPINDLE, loads=loads)


def pulls() -> tuple[np.ndarray, np.ndarray]:
    """Joints [rad] and force [N] of each measurement of the load tests."""
    poses = np.deg2rad([*POSES, *MORE_POSES])
    return np.repeat(poses, 3, axis=0), PULL * np.tile(np.diag([1.0, 1.0, -1.0]), (len(poses), 1))


def traces(seed: int, poses: int = 4) -> list[Trace]:
    """What is measured in each, with white noise."""
    return [_noisy(case, np.random.default_rng([seed, i]), f"pose {i}") for i, case in enumerate(cases(poses), 1)]


def _noisy(case: mx.Case, rng: np.random.Generator, name: str) -> Trace:
    time, clean = _clean(case)
    noise = rng.normal(size=clean.shape) * list(NOISE.values())
    return Trace(time, tuple(NOISE), clean + noise, dict(NOISE), {}, name)


@cache
def _simulated() -> dict[int, tuple[np.ndarray, np.ndarray]]:
    return {}


def _clean(case: mx.Case) -> tuple[np.ndarray, np.ndarray]:
    if id(case) not in _simulated():
        sim = mx.simulate(case)
        columns = np.concatenate([np.asarray(sim.force)[:, :2], np.asarray(sim.displacement)[:, :2]], axis=1)
        _simulated()[id(case)] = np.asarray(sim.time)[::EVERY], columns[::EVERY]
    return _simulated()[id(case)]


def parameters() -> list[Parameter]:
    """Guesses wrong by up to a factor of two."""
    wrong = (2.0, 0.6, 1.5, 0.5, 1.8, 0.6, 2.0, 0.5, 1.6)
    return [Parameter(name, value * factor) for (name, value), factor in zip(TRUTH.items(), wrong, strict=True)]
