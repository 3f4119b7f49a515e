"""The papers' slot: KR240, aluminium, 10 000 rpm, 4 m/min, 4 teeth, entering a straight border at t = 0.

And the same slot with other structures: a light tool mode at its stability limit and beyond, and six coordinates with full
matrices; and one half of it, milled up or down.
"""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import millax as mx

SPEED = 10000 * 2 * np.pi / 60
FEED = 4 / 60


def slot(
    *,
    axes=("x", "y"),
    mass=100.0,
    stiffness=3e5,
    damping_ratio=0.05,
    duration=1.0,
    border=True,
    diameter=0.02,
    teeth=4,
    depth=1e-3,
    tool=None,
    **settings,
) -> mx.Case:
    """`tool` holds what makes the end mill other than straight and even: helix, runout."""
    tool = mx.EndMill(diameter, teeth, **(tool or {}))
    law = mx.FractionalLaw(k0=5e9, hs=18e-6, r=0.1, kr=0.3)
    cut = mx.Cut.touching(tool, SPEED, FEED, depth)
    structure = mx.Structure(axes, mass, stiffness, damping_ratio=damping_ratio) if axes else mx.Structure.rigid()
    stock = mx.Stock.box() if border else mx.Stock.box((None, None))
    numerics = mx.Settings.suited(tool, law, structure, cut, duration, **settings)
    return mx.Case(tool, law, cut, stock, structure, numerics)


LIGHT = {"mass": 0.03993, "stiffness": 0.03993 * (2 * np.pi * 922) ** 2, "damping_ratio": 0.011}
"""A tool's own bending mode, 922 Hz."""


def light(**numbers) -> mx.Case:
    """The slot cut by a rigid machine with a light tool mode in x and y, at its limit depth."""
    case = slot(duration=0.001, **LIGHT)
    return slot(depth=limit_depth(case), **(LIGHT | numbers))


def mean_process(case: mx.Case, points: int = 1000) -> np.ndarray:
    """Mean process matrix of a slot per unit of depth, in closed form but for the integral over the angle [N/m²]:

    B = N/(2 pi) integral F_t'(f_z cos phi) p n^T over half a turn, F = p F_t.
    """
    phi = (np.arange(points) + 0.5) * np.pi / points - np.pi / 2
    slope = jax.vmap(jax.grad(case.force.tangential))(case.cut.feed_per_tooth(case.tool) * np.cos(phi))
    force = np.array([np.sin(phi) - case.force.kr * np.cos(phi), np.cos(phi) + case.force.kr * np.sin(phi)])
    return np.asarray(case.tool.teeth / 2 * (force * slope) @ np.array([np.cos(phi), -np.sin(phi)]).T / points)


def limit_depth(case: mx.Case) -> float:
    """Depth of a slot at which it becomes unstable [m]: zero-order solution for equal modes in x and y.

    Per unit of depth a, the mean over a turn of -dF/du is B (`mean_process`). It closes the loop
    a (1 - exp(-i w tau)) G(w) b = 1, b an eigenvalue of B. Of all w at which a is real, the one with the
    smallest a > 0 counts.
    """
    tau, mean = float(case.cut.tooth_period(case.tool)), mean_process(case)
    s = case.structure
    k, m, c = (float(matrix[0, 0]) for matrix in (s.stiffness_matrix, s.mass_matrix, s.damping_matrix))
    w = np.sqrt(k / m) * np.linspace(0.5, 3.0, 100000)
    flexibility = (1 - np.exp(-1j * w * tau)) / (k - m * w**2 + 1j * c * w)
    depths = 1 / np.outer(np.linalg.eigvals(mean), flexibility)
    real = (depths.imag[:, 1:] * depths.imag[:, :-1] < 0) & (depths.real[:, 1:] > 0) & (abs(depths[:, 1:]) < 1)
    return float(depths.real[:, 1:][real].min())


def strong_chatter(**numbers) -> mx.Case:
    """The light tool mode at twice its limit depth: it swings by 0.12 mm, more than the feed, and teeth leave the cut."""
    return slot(border=False, depth=2 * limit_depth(slot(duration=0.001, **LIGHT)), **(LIGHT | numbers))


def up_milling(**numbers) -> mx.Case:
    """Half of the slot: only the side at which teeth begin to cut with no thickness."""
    return dataclasses.replace(slot(border=False, **numbers), stock=mx.Stock.box((None, None), (0.0, None)))


def down_milling(**numbers) -> mx.Case:
    """Half of the slot: only the side at which teeth begin to cut with their full thickness."""
    return dataclasses.replace(slot(border=False, **numbers), stock=mx.Stock.box((None, None), (None, 0.0)))


def six_coordinates(**numbers) -> mx.Case:
    """The slot with six coordinates, full matrices M, C, K, moving the tool in x, y and z."""
    rng = np.random.default_rng(20120701)

    def matrix(scale):
        a = rng.normal(size=(6, 6))
        return scale * (a @ a.T / 6 + np.eye(6))

    shapes = rng.normal(size=(3, 6)) / 2
    structure = mx.Structure(("x", "y", "z"), matrix(50.0), matrix(3e5), damping=matrix(300.0), mode_shapes=shapes)
    return with_structure(slot(axes=(), **numbers), structure)


def modes(count: int, **numbers) -> mx.Case:
    """The slot with `count` coordinates, alternately along x and y, that together are as stiff and as heavy as two."""
    share = (count + 1) // 2
    shapes = np.zeros((2, count))
    shapes[np.arange(count) % 2, np.arange(count)] = 1 / share**0.5
    structure = mx.Structure(
        ("x", "y"), 100 * np.ones(count), 3e5 * (1 + np.arange(count)), damping_ratio=0.05, mode_shapes=shapes
    )
    return with_structure(slot(axes=(), **numbers), structure)


def with_structure(case: mx.Case, structure: mx.Structure) -> mx.Case:
    """`case` with another structure, and settings suited to it."""
    s = case.settings
    periods, steps_per_tooth = s.periods, s.steps_per_tooth
    duration = periods * case.cut.tooth_period(case.tool)
    settings = mx.Settings.suited(case.tool, case.force, structure, case.cut, duration, steps_per_tooth, s.passes, s.width)
    return mx.Case(case.tool, case.force, case.cut, case.stock, structure, settings)


def six_parameters(case: mx.Case) -> list:
    """The force law, damping and stiffness: what the derivatives and batches of the benchmarks vary."""
    law, structure = case.force, case.structure
    return [law.k0, law.hs, law.r, law.kr, structure.damping_ratio, structure.stiffness]


def scaled(case: mx.Case, where, factors):
    """`case` with the leaves that `where` selects multiplied by `factors`."""
    return eqx.tree_at(where, case, [leaf * factor for leaf, factor in zip(where(case), factors, strict=True)])


def traces(case: mx.Case, force_unit=100.0, displacement_unit=1e-5):
    """Force and displacement as one vector of numbers of order 1."""
    sim = mx.simulate(case, throw=False)
    return jnp.concatenate([sim.force[:, :2].ravel() / force_unit, sim.displacement.ravel() / displacement_unit])
