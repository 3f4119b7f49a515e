"""Limits of stability: a benchmark by three methods, the delayed Mathieu equation, the slot's whirl.

The benchmark (Insperger and Stepan 2004) has one mode along the feed, or the same along x and y: 922 Hz, zeta 0.011,
0.03993 kg, K_t = 6e8 and K_n = 2e8 N/m², two straight teeth, down-milling, 5 000-25 000 rpm. Its feed per tooth is 1 µm,
because the linear process of the literature is the limit of small feeds.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import millax as mx
from millax._linearised import leading_multipliers
from millax._semidiscretisation import DelayEquation, mean_over_steps, monodromy, multipliers
from millax._steady import process_matrices

from ..figures import Figure, below, near
from ..slot import slot
from .papers import MASS, STIFFNESS, TABLE_2

SPEEDS = "5500:24500:5 rpm"
RPM = 2 * np.pi / 60
IMMERSIONS = (1.0, 0.5, 0.1, 0.05)
PUBLISHED = {0.2: 0.8192, 0.5: 1.0726, 0.7: 1.2197, 1.0: 1.4040}
"""Spectral radii of the slot at 5 000 rpm over depth [mm], against which discretisations are compared (Ding et al. 2010)."""


def figures():
    yield from _mathieu()
    yield from _published()
    for axes in (("x",), ("x", "y")):
        for immersion in IMMERSIONS:
            yield from _three_methods(axes, immersion)
    yield _gradient()
    yield from _whirl()


def lobes(axes, immersion, speed=15000 * RPM, feed=1e-6) -> mx.Case:
    """The benchmark at one radial immersion a_e/D."""
    tool = mx.EndMill(0.02, 2)
    stock = mx.Stock.box((None, None), (None, None if immersion == 1 else (2 * immersion - 1) * 0.01))
    structure = mx.Structure(axes, 0.03993, 0.03993 * (2 * np.pi * 922) ** 2, damping_ratio=0.011)
    cut = mx.Cut(speed, feed * speed / np.pi, 1e-3, start=[0.0, 0.0])
    return mx.Case(tool, mx.LinearLaw(kt=6e8, kr=1 / 3), cut, stock, structure, mx.Settings(1, width=1e-4 * feed, passes=1))


def _three_methods(axes, immersion):
    found = mx.stability(lobes(axes, immersion), SPEEDS, methods=tuple(mx.STABILITY_METHODS))
    semi, *others = found["limit_depth"].to_numpy()
    known = np.isfinite(semi)
    for name, limit in zip(("Floquet multipliers of the engine", "growth in the time domain"), others, strict=True):
        apart = 100 * np.abs(limit[known] / semi[known] - 1)
        what = f"{len(axes)} mode{'s' * (len(axes) > 1)}, a_e/D = {immersion:g}: {name} beside semi-discretisation"
        yield below(f"{what}, limit depth at {known.sum()} speeds, largest difference", apart.max(), 2.0, unit=" %")
    depths = ", ".join(f"{1e3 * depth:.3g}" for depth in semi)
    yield Figure(f"{len(axes)} mode{'s' * (len(axes) > 1)}, a_e/D = {immersion:g}: limit depths [mm]", depths, "", None)


def _published():
    case = lobes(("x",), 1.0, 5000 * RPM)
    n = len(PUBLISHED)
    cuts = np.full(n, 5000 * RPM), np.full(n, float(case.cut.feed_rate)), 1e-3 * np.array(list(PUBLISHED))
    for (depth, radius), mu in zip(PUBLISHED.items(), leading_multipliers(case, cuts, (), 160), strict=True):
        what = f"one mode, slot, 5 000 rpm, {depth:g} mm: spectral radius beside the published one"
        yield near(what, abs(mu), radius, 3e-3 * radius, form=".4f")


def _mathieu():
    """x'' + a1 x' + (delta + eps cos t) x = b0 x(t - 2 pi)."""
    delta, eps, b0, a1, steps = 3.0, 2.0, -0.15, 0.1, 160
    present = mean_over_steps(lambda t: jnp.array([[0.0, 1.0], [-(delta + eps * jnp.cos(t)), -a1]]), 2 * np.pi, steps)
    earlier = jnp.broadcast_to(jnp.array([[0.0], [b0]]), (1, steps, 2, 1))
    step = jnp.asarray(2 * np.pi / steps)
    matrix = monodromy(DelayEquation(present, earlier, 0 * earlier, jnp.array([[1.0, 0.0]]), step), (float(steps),))
    found, exact = abs(multipliers(np.asarray(matrix))[0]), _collocated(delta, eps, b0, a1)
    what = f"delayed Mathieu equation, delta 3, eps 2, b0 -0.15, a1 0.1: spectral radius, {steps} steps"
    yield near(f"{what}, beside collocation", found, exact, 1e-4, form=".5f")


def _collocated(delta, eps, b0, a1, nodes=50) -> float:
    """The same by collocation in Chebyshev's points, converged to 12 digits."""
    x = np.cos(np.pi * np.arange(nodes + 1) / nodes)
    c = np.where(np.arange(nodes + 1) % nodes == 0, 2.0, 1.0) * (-1.0) ** np.arange(nodes + 1)
    d = np.outer(c, 1 / c) / (x[:, None] - x[None, :] + np.eye(nodes + 1))
    d = (d - np.diag(d.sum(axis=1))) / np.pi
    one, none = np.eye(nodes + 1), np.zeros((nodes + 1, nodes + 1))
    stiffness = np.diag(delta + eps * np.cos(np.pi * (x + 1)))
    left, right = np.block([[d, -one], [stiffness, d + a1 * one]]), np.block([[none, none], [b0 * one, none]])
    for row, start in ((nodes, 0), (2 * nodes + 1, nodes + 1)):
        left[row], right[row] = np.eye(2 * nodes + 2)[row], np.eye(2 * nodes + 2)[start]
    return float(np.abs(np.linalg.eigvals(np.linalg.solve(left, right))).max())


def _gradient():
    """Of the limit depth: the implicit function theorem beside central differences."""
    case, errors = lobes(("x", "y"), 0.5, 9000 * RPM), []
    gradient = jax.grad(mx.limit_depth)(case)
    for where in (
        lambda c: c.force.kt,
        lambda c: c.force.kr,
        lambda c: c.structure.mass,
        lambda c: c.structure.stiffness,
        lambda c: c.structure.damping_ratio,
        lambda c: c.cut.spindle_speed,
    ):
        x = where(case)
        high, low = (float(mx.limit_depth(eqx.tree_at(where, case, x * (1 + d)))) for d in (1e-5, -1e-5))
        difference = (high - low) / (2e-5 * float(x))
        errors.append(abs(float(where(gradient)) / difference - 1))
    return below("derivatives of the limit depth by six numbers, largest error", max(errors), 1e-5, form=".1e")


def _whirl():
    """Slow motion of the papers' slot: dF = G u' with G = tau times the mean of dF/du, since u - u(t - tau) = tau u'."""
    case = slot(axes=("x", "y"), duration=0.01, border=False)
    tau, teeth = float(case.cut.tooth_period(case.tool)), case.tool.teeth
    p = process_matrices(case, 400)
    model = np.asarray(p.earlier_rate.sum(axis=0).mean(axis=0) - tau * p.earlier[0].mean(axis=0))
    phi = (np.arange(20000) + 0.5) * np.pi / 20000 - np.pi / 2
    slope = jax.vmap(jax.grad(case.force.tangential))(case.cut.feed_per_tooth(case.tool) * np.cos(phi))
    force = np.stack([np.sin(phi) - 0.3 * np.cos(phi), np.cos(phi) + 0.3 * np.sin(phi)])
    normal = np.stack([np.cos(phi), -np.sin(phi)])
    depth = float(case.cut.depth)
    closed = tau * teeth / 2 * depth * np.einsum("ip,jp,p->ij", force, normal, np.asarray(slope)) / len(phi)
    for i, j in np.ndindex(2, 2):
        what = f"papers' slot: mean dF{'xy'[i]}/d{'xy'[j]}' of the model's Jacobian beside the closed form"
        yield near(what, model[i, j], closed[i, j], 0.01 * np.abs(closed).max(), form=".2f", unit=" N s/m")
    for row, (mass, stiffness) in enumerate(zip(MASS, STIFFNESS, strict=True)):
        ours, theirs = (_frequencies(float(mass), stiffness, g) for g in (model, closed))
        for k, which in enumerate(("lower", "upper")):
            what = f"E Table 2, {mass} kg, {stiffness / 1e6:.2f} MN/m: {which} whirl frequency, model beside closed form"
            yield near(what, ours[k], theirs[k], 0.01 * theirs[k], form=".2f", unit=" Hz")
        printed = f"f1x {TABLE_2['first_frequency.x'][row]}, f1y {TABLE_2['first_frequency.y'][row]} Hz"
        between = f"whirl {ours[0]:.1f} and {ours[1]:.1f} Hz"
        yield Figure(
            f"E Table 2, {mass} kg, {stiffness / 1e6:.2f} MN/m: the paper's peaks of the spectrum", printed, between, None
        )


def _frequencies(mass: float, stiffness: float, process: np.ndarray) -> np.ndarray:
    """Of M u'' + (C - G) u' + K u = 0, damped [Hz]."""
    damping = 2 * 0.05 * np.sqrt(stiffness * mass) * np.eye(2) - process
    rates = np.block([[np.zeros((2, 2)), np.eye(2)], [-stiffness / mass * np.eye(2), -damping / mass]])
    found = np.linalg.eigvals(rates)
    return np.sort(found.imag[found.imag > 0]) / (2 * np.pi)
