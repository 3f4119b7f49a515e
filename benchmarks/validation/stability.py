"""Limits of stability: a benchmark by three methods, the delayed Mathieu equation, the slot's whirl.

The benchmark (Insperger and Stepan 2004) has one mode along the feed, or the same along x and y: 922 Hz, zeta 0.011,
0.03993 kg, K_t = 6e8 and K_n = 2e8 N/m², two straight teeth, down-milling, 5 000-25 000 rpm. Its feed per tooth is 1 µm,
because the linear process of the literature is the limit of small feeds.
"""

import dataclasses

import equinox as eqx
import jax
import numpy as np

import millax as mx
from millax._linearised import leading_multipliers
from millax._semidiscretisation import multipliers
from millax._steady import process_matrices

from ..figures import Figure, below, near
from ..lobes import RPM, lobes, mathieu, mathieu_radius
from ..slot import mean_process, slot
from .papers import MASS, STIFFNESS, TABLE_2

SPEEDS = "5500:24500:5 rpm"
IMMERSIONS = (1.0, 0.5, 0.1, 0.05)
PUBLISHED = {0.2: 0.8192, 0.5: 1.0726, 0.7: 1.2197, 1.0: 1.4040}
"""Spectral radii of the slot at 5 000 rpm over depth [mm], against which discretisations are compared (Ding et al. 2010)."""


def figures():
    yield from _mathieu()
    yield from _published()
    for axes in (("x",), ("x", "y")):
        for immersion in IMMERSIONS:
            yield from _three_methods(axes, immersion)
    yield from _unequal_teeth()
    yield _gradient()
    yield from _whirl()


def _three_methods(axes, immersion):
    found = mx.stability(
        lobes(axes=axes, immersion=immersion, speed=15000 * RPM), SPEEDS, methods=tuple(mx.STABILITY_METHODS)
    )
    semi, *others = found["limit_depth"].to_numpy()
    known = np.isfinite(semi)
    for name, limit in zip(("Floquet multipliers of the engine", "growth in the time domain"), others, strict=True):
        apart = 100 * np.abs(limit[known] / semi[known] - 1)
        what = f"{len(axes)} mode{'s' * (len(axes) > 1)}, a_e/D = {immersion:g}: {name} beside semi-discretisation"
        yield below(f"{what}, limit depth at {known.sum()} speeds, largest difference", apart.max(), 2.0, unit=" %")
    depths = ", ".join(f"{1e3 * depth:.3g}" for depth in semi)
    yield Figure(f"{len(axes)} mode{'s' * (len(axes) > 1)}, a_e/D = {immersion:g}: limit depths [mm]", depths, "", None)


def _unequal_teeth():
    """Variable pitch, over a turn: the same three methods, and what equal teeth are when a turn is looked at."""
    even = lobes(axes=("x", "y"), speed=15000 * RPM, passes=2)
    for pitch in ((170, 190), (160, 200)):
        case = dataclasses.replace(even, tool=mx.EndMill(0.02, 2, pitch=np.radians(pitch)))
        found = mx.stability(case, SPEEDS, methods=tuple(mx.STABILITY_METHODS))
        semi, *others = found["limit_depth"].to_numpy()
        for name, limit in zip(("Floquet multipliers of the engine", "growth in the time domain"), others, strict=True):
            what = f"2 modes, slot, pitch {pitch[0]}° and {pitch[1]}°: {name} beside semi-discretisation, limit depth"
            apart = 100 * np.abs(limit / semi - 1).max()
            yield below(f"{what} at {len(semi)} speeds, largest difference", apart, 2.0, unit=" %")
        depths = ", ".join(f"{1e3 * depth:.3g}" for depth in semi)
        yield Figure(f"2 modes, slot, pitch {pitch[0]}° and {pitch[1]}°: limit depths [mm]", depths, "", None)
    turn = dataclasses.replace(even, tool=mx.EndMill(0.02, 2, pitch=[np.pi, np.pi]))
    apart = abs(float(mx.limit_depth(turn)) / float(mx.limit_depth(even)) - 1)
    yield below("2 modes, slot, equal teeth: limit depth from a turn beside a tooth period", apart, 1e-9, form=".1e")


def _published():
    case = lobes()
    n = len(PUBLISHED)
    cuts = np.full(n, 5000 * RPM), np.full(n, float(case.cut.feed_rate)), 1e-3 * np.array(list(PUBLISHED))
    for (depth, radius), mu in zip(PUBLISHED.items(), leading_multipliers(case, cuts, (), 160), strict=True):
        what = f"one mode, slot, 5 000 rpm, {depth:g} mm: spectral radius beside the published one"
        yield near(what, abs(mu), radius, 3e-3 * radius, form=".4f")


def _mathieu():
    steps = 160
    found = abs(multipliers(mathieu(steps))[0])
    what = f"delayed Mathieu equation, delta 3, eps 2, b0 -0.15, a1 0.1: spectral radius, {steps} steps"
    yield near(f"{what}, beside collocation", found, mathieu_radius(), 1e-4, form=".5f")


def _gradient():
    """Of the limit depth: the implicit function theorem beside central differences."""
    case, errors = lobes(axes=("x", "y"), immersion=0.5, speed=9000 * RPM), []
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
    tau = float(case.cut.tooth_period(case.tool))
    p = process_matrices(case, 400)
    model = np.asarray(p.earlier_rate.sum(axis=0).mean(axis=0) - tau * p.earlier[0].mean(axis=0))
    closed = tau * float(case.cut.depth) * mean_process(case, 20000)
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
