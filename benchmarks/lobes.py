"""Two benchmarks of stability from the literature: milling with a tool mode, and the delayed Mathieu equation."""

import jax.numpy as jnp
import numpy as np

import millax as mx
from millax._semidiscretisation import DelayEquation, mean_over_steps, monodromy

RPM = 2 * np.pi / 60
FEED = 1e-6
"""Feed per tooth [m]: small, so that the cut is the linear one of the literature."""


def lobes(*, immersion=1.0, axes=("x",), speed=5000 * RPM, feed=FEED, **settings) -> mx.Case:
    """One or two modes of 922 Hz, two teeth, down-milling at one radial immersion a_e/D (Insperger and Stepan 2004)."""
    tool = mx.EndMill(0.02, 2)
    stock = mx.Stock.box((None, None), (None, None if immersion == 1 else (2 * immersion - 1) * 0.01))
    structure = mx.Structure(axes, 0.03993, 0.03993 * (2 * np.pi * 922) ** 2, damping_ratio=0.011)
    cut = mx.Cut(speed, feed * speed / np.pi, 1e-3, start=[0.0, 0.0])
    numerics = mx.Settings(1, **{"width": 1e-4 * feed, "passes": 1} | settings)
    return mx.Case(tool, mx.LinearLaw(kt=6e8, kr=1 / 3), cut, stock, structure, numerics)


def mathieu(steps, order=3, delta=3.0, eps=2.0, b0=-0.15, a1=0.1, tau=2 * np.pi):
    """x'' + a1 x' + (delta + eps cos t) x = b0 x(t - tau) by semi-discretisation: its matrix over 2 pi."""
    period = 2 * np.pi
    present = mean_over_steps(lambda t: jnp.array([[0.0, 1.0], [-(delta + eps * jnp.cos(t)), -a1]]), period, steps)
    earlier = jnp.broadcast_to(jnp.array([[0.0], [b0]]), (1, steps, 2, 1))
    h = period / steps
    seen, lags = jnp.array([[1.0, 0.0]]), np.array([tau / h])
    equation = DelayEquation(present, earlier, 0 * earlier, seen, jnp.asarray(h), lags, longest=tau / h)
    return np.asarray(monodromy(equation, order))


def mathieu_radius(delta=3.0, eps=2.0, b0=-0.15, a1=0.1, nodes=50) -> float:
    """The spectral radius of the same with tau = 2 pi, by collocation in Chebyshev's points (Trefethen's differentiation
    matrix): converges geometrically, to 12 digits with these."""
    x = np.cos(np.pi * np.arange(nodes + 1) / nodes)
    c = np.where(np.arange(nodes + 1) % nodes == 0, 2.0, 1.0) * (-1.0) ** np.arange(nodes + 1)
    d = np.outer(c, 1 / c) / (x[:, None] - x[None, :] + np.eye(nodes + 1))
    d = (d - np.diag(d.sum(axis=1))) / np.pi
    one, none = np.eye(nodes + 1), np.zeros((nodes + 1, nodes + 1))
    stiffness = np.diag(delta + eps * np.cos(np.pi * (x + 1)))
    left, right = np.block([[d, -one], [stiffness, d + a1 * one]]), np.block([[none, none], [b0 * one, none]])
    for row, start in ((nodes, 0), (2 * nodes + 1, nodes + 1)):  # the last point is the start, where the one before ended
        left[row], right[row] = np.eye(2 * nodes + 2)[row], np.eye(2 * nodes + 2)[start]
    return float(np.abs(np.linalg.eigvals(np.linalg.solve(left, right))).max())
