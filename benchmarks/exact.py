"""Cutting forces from exact tooth paths in NumPy, of any cutter in a prescribed motion: slow, and nothing approximated.

Tooth i stands at phi = Omega t + theta_i - z tan(helix)/R in the slice at height z, its tip at c + R_i n, n = (cos, -sin).
On the ray from the tool centre c through the tip lies material from s_in to s_out, where the ray enters and leaves the
convex stock; the tooth that cut k passes earlier, i + k, has taken away what lies before s_k, where the ray meets the path
of its tip. What is left is the chip thickness,

    h = max(0, min(R_i, s_out) - max(0, s_in, max_k s_k)).

It shares no formula with the engine, which makes it an oracle: the engine expands s_k in the displacement between passes
and integrates over time steps in closed form; here s_k is solved for and time steps are cut into small parts.

A tooth sweeps all that lies between the centre and its path, so that nothing before s_k is left of it. A pass whose path
meets the ray nowhere within a quarter of a turn of where it is expected, with the tip ahead of the centre, is skipped.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

import millax as mx

Position = Callable[[np.ndarray], np.ndarray]
"""Tool centre [m], shape (2, ...), at times t [s] of any shape (...); at t < 0 too, where the tool came from."""
Forces = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]
"""F_t, F_r, F_a of teeth per unit of axial depth [N/m] by chip thickness h [m] and by which tooth it is, two arrays that
broadcast; asked for h > 0 only."""

ROUNDING = 1e-12
"""The last change of a secant, of an angle [rad]: what is left is smaller, of the size of rounding, 1e-15 m."""
INSTANT = 1e-7
"""Time over which a velocity is taken [s]."""
RAYS = 100_000
"""Rays at once: as many as the cache takes."""


@dataclass(frozen=True)
class Cutter:
    """A cutter in axial slices.

    **Arguments:**

    - `radius`: nominal radius R [m], which the lag of the helix refers to.
    - `theta`: angles of the teeth at the tip at t = 0 [rad], ascending within one turn, shape (teeth,). Tooth i + 1 cuts
      before tooth i.
    - `radii`: R_i, shape (slices, teeth) [m].
    - `z`: height of the middle of each slice above the tip [m], shape (slices,).
    - `dz`: height of a slice [m].
    - `helix`: angle of the flutes to the axis [rad].
    - `speed`: Omega [rad/s].
    """

    radius: float
    theta: np.ndarray
    radii: np.ndarray
    z: np.ndarray
    dz: float
    helix: float
    speed: float

    @staticmethod
    def end_mill(radius, teeth, speed, depth, *, slices=1, helix=0.0, pitch=None, runout=0.0) -> "Cutter":
        """An end mill: `pitch` [rad] is the angle from each tooth to the next, `runout` [m] is added to the radii.

        `pitch` is of shape (teeth,), and equal by default; `runout` broadcasts to (slices, teeth).
        """
        pitch = np.full(teeth, 2 * np.pi / teeth) if pitch is None else np.asarray(pitch, float)
        assert np.isclose(pitch.sum(), 2 * np.pi)
        theta = np.concatenate([[0.0], np.cumsum(pitch)[:-1]])
        dz = depth / slices
        radii = np.broadcast_to(radius + np.asarray(runout), (slices, teeth))
        return Cutter(radius, theta, radii, (np.arange(slices) + 0.5) * dz, dz, helix, speed)

    @staticmethod
    def of(case: mx.Case, slices: int | None = None) -> "Cutter":
        """The cutter of a case, in as many slices as its settings say or in `slices`."""
        tool, slices = case.tool, case.settings.slices if slices is None else slices
        speed, depth = float(case.cut.spindle_speed), float(case.cut.depth)
        radius, helix = float(tool.radius), 0.0 if tool.helix is None else float(tool.helix)
        theta = np.asarray(tool.spacing)
        lag = (np.arange(slices)[:, None] + 0.5) * (depth / slices) * np.tan(helix) / radius
        runout = np.zeros(1) if tool.runout is None else np.asarray(tool.runout)
        if tool.offset is not None:
            runout = runout + float(tool.offset) * np.cos(theta - lag - float(tool.offset_angle))
        return Cutter.end_mill(radius, tool.teeth, speed, depth, slices=slices, helix=helix, pitch=tool.pitch, runout=runout)

    @property
    def teeth(self) -> int:
        return len(self.theta)

    @cached_property
    def at_start(self) -> np.ndarray:
        """phi at t = 0, shape (slices, teeth)."""
        return self.angle(0.0, *np.indices(self.radii.shape))

    def standing(self, tooth):
        """theta of tooth i, which may lie beyond the last: tooth i + teeth is tooth i, one turn ahead."""
        return self.theta[tooth % self.teeth] + 2 * np.pi * (tooth // self.teeth)

    def angle(self, t, level, tooth):
        """phi of a tooth in slice `level` at time t; arrays that broadcast."""
        return self.speed * t + self.standing(tooth) - self.z[level] * (np.tan(self.helix) / self.radius)


def linear(kt, kr, ka=0.0, kte=0.0, kre=0.0, kae=0.0) -> Forces:
    """F_t = k_t h + k_te, F_r = k_r k_t h + k_re, F_a = k_a k_t h + k_ae while h > 0; numbers, or one for each tooth."""

    def forces(h, tooth):
        t, r, a, te, re, ae = (np.asarray(x)[tooth] if np.ndim(x) else x for x in (kt, kr, ka, kte, kre, kae))
        return t * h + te, r * t * h + re, a * t * h + ae

    return forces


def fractional(k0, hs, r, kr, ka=0.0) -> Forces:
    """F_t = k_0 h_s (u + r u²)/(1 + u) with u = h/h_s, F_r = k_r F_t, F_a = k_a F_t."""

    def forces(h, tooth):
        u = h / hs
        tangential = k0 * hs * (u + r * u**2) / (1 + u)
        return tangential, kr * tangential, ka * tangential

    return forces


def law_of(case: mx.Case) -> Forces:
    """The law of a case, fractional or linear."""
    law = case.force
    if isinstance(law, mx.FractionalLaw):
        return fractional(*(float(x) for x in (law.k0, law.hs, law.r, law.kr, 0.0 if law.ka is None else law.ka)))
    assert isinstance(law, mx.LinearLaw)
    kt, kr, ke = np.asarray(law.kt), np.asarray(law.kr), np.asarray(law.ke)
    ka = 0.0 if law.ka is None else np.asarray(law.ka)
    kre, kae = (share * ke if own is None else np.asarray(own) for own, share in ((law.kre, kr), (law.kae, ka)))
    return linear(kt, kr, ka, ke, kre, kae)


def flank_of(case: mx.Case) -> tuple[float, float]:
    """What the flanks of the teeth need to press on the wavy surface that they leave."""
    coefficient = case.force.process_damping
    if coefficient is None:
        return 0.0, 0.0
    return float(coefficient / (case.cut.spindle_speed * case.tool.radius)), float(case.cut.feed_rate)


def motion(start, feed_rate, time=None, displacement=None) -> Position:
    """A feed along x from `start`, and on it a displacement sampled at `time`: a cubic spline, from rest at t = 0.

    **Arguments:**

    - `start`: tool centre at t = 0 [m], shape (2,).
    - `feed_rate`: v_f [m/s].
    - `time`: of the samples, > 0 [s], shape (samples,); without it nothing is displaced.
    - `displacement`: [m], shape (samples, 2).
    """
    start, feed = np.asarray(start, float), np.array([float(feed_rate), 0.0])
    if time is not None:
        rest = np.zeros((1, 2))
        samples = np.concatenate([rest, np.asarray(displacement)])
        spline = CubicSpline(np.append(0.0, time), samples, bc_type=((1, rest[0]), "not-a-knot"))

    def position(t):
        along = start + feed * np.asarray(t)[..., None]
        if time is not None:
            along = along + np.where(np.asarray(t)[..., None] > 0, spline(t), 0.0)
        return np.moveaxis(along, -1, 0)

    return position


def followed(case: mx.Case, sim: mx.Simulation, slices: int | None = None):
    """What `cut_along` is to be given, here and in `grid`, to cut once more as the tool moved in a simulation."""
    displacement = np.zeros((len(sim.time), 2))
    for column, axis in enumerate(sim.axes):
        if axis in "xy":
            displacement[:, "xy".index(axis)] = sim.displacement[:, column]
    time = np.asarray(sim.time)
    position = motion(case.cut.start, case.cut.feed_rate, time, displacement)
    return Cutter.of(case, slices), position, case.stock, law_of(case), time, float(time[1] - time[0])


class Cutting(NamedTuple):
    """Means over each time step."""

    force: np.ndarray
    """On the tool along x, y, z [N], shape (steps, 3)."""
    thickness: np.ndarray
    """Chip thickness of each tooth, on the average of its slices [m], shape (steps, teeth)."""


def surface(cutter: Cutter, position: Position, t, level, tooth, k: int):
    """s_k [m]: where the rays of teeth at times t meet the path of the tooth that cut k passes earlier; NaN where nowhere.

    The arrays `t`, `level` and `tooth` are of one shape. At the time looked for the tip is nowhere across the ray: secants
    solve for it, from when the tooth would have been there without any displacement of the tool.
    """
    phi, (x, y), earlier = cutter.angle(t, level, tooth), position(t), tooth + k
    cos, sin, radius = np.cos(phi), np.sin(phi), cutter.radii[level, earlier % cutter.teeth]

    def seen(s):
        """Of the tip at time s: how far it is along the ray, and across."""
        psi, (u, v) = cutter.angle(s, level, earlier), position(s)
        u, v = u + radius * np.cos(psi) - x, v - radius * np.sin(psi) - y
        return cos * u - sin * v, cos * v + sin * u

    expected = t - (cutter.standing(earlier) - cutter.standing(tooth)) / cutter.speed
    s, slope = expected, -radius * cutter.speed
    along, across = seen(s)
    with np.errstate(all="ignore"):  # rays that meet nothing
        for _ in range(20):
            change = -across / slope
            s, before = s + change, across
            along, across = seen(s)
            if np.abs(change).max(initial=0.0) * cutter.speed < ROUNDING:
                break
            slope = np.where(np.abs(change) * cutter.speed > 1e-9, (across - before) / change, slope)
        met = (np.abs(across) < 1e-10 * radius) & (np.abs(s - expected) * cutter.speed < np.pi / 2) & (along > 0)
    return np.where(met, along, np.nan)


def thickness(cutter: Cutter, position: Position, stock: mx.Stock, t, level, tooth, passes: int):
    """Chip thickness h [m] of teeth at times t, as above; the arrays `t`, `level` and `tooth` are of one shape (rays,)."""
    phi = cutter.angle(t, level, tooth)
    begin, end = np.zeros(len(t)), cutter.radii[level, tooth]
    for normal, offset in zip(np.asarray(stock.normals), np.asarray(stock.offsets), strict=True):
        depth = offset - normal @ position(t)
        along = normal[0] * np.cos(phi) - normal[1] * np.sin(phi)
        along = np.where(along == 0, 1e-300, along)
        end = np.where(along > 0, np.minimum(end, depth / along), end)
        begin = np.where(along < 0, np.maximum(begin, depth / along), begin)
    for k in range(1, passes + 1):
        left = np.flatnonzero(end > begin)  # where nothing is left, earlier passes change nothing
        begin[left] = np.fmax(begin[left], surface(cutter, position, t[left], level[left], tooth[left], k))
    return np.maximum(end - begin, 0.0)


def cut_along(
    cutter: Cutter,
    position: Position,
    stock: mx.Stock,
    forces: Forces,
    time: np.ndarray,
    dt: float,
    *,
    passes: int = 8,
    parts: int = 16,
    flank: tuple[float, float] = (0.0, 0.0),
) -> Cutting:
    """Mean force and chip thickness over the steps of length `dt` [s] around `time` [s].

    **Arguments:**

    - `position`, `stock`, `forces`: the motion of the tool, the uncut stock, the force law.
    - `passes`: how many earlier passes are looked at, at least the number of teeth where their radii differ. While every
      tooth cuts, one is enough; a tooth that loses contact needs more.
    - `flank`: process damping C/V [N s/m²], and the feed rate [m/s], which is no vibration: see `flank_of`.
    - `parts`: of a step, each sampled in its middle. A step in which a tooth begins or ceases to cut has the square of it.

    What a mean lacks is of second order in the parts where the thickness is continuous. Where it jumps by J, as at a border
    along the ray, or an edge force does, it is at most J/(2 parts²), which is 0.2 % of the jump with 16 parts.
    """
    time = np.asarray(time, float)
    slices, teeth = cutter.radii.shape
    force, chips = np.zeros((len(time), 3)), np.zeros((len(time), teeth))

    def add(step, level, tooth, n):
        """Cells of one step, slice and tooth each, in n parts; returns those in which contact begins or ceases."""
        changes = []
        for first in range(0, len(step), max(1, RAYS // n)):
            some = slice(first, first + max(1, RAYS // n))
            found, touches = _means(
                cutter, position, stock, forces, time[step[some]], level[some], tooth[some], dt, passes, n, flank
            )
            whole = ~touches if n == parts else np.full(len(touches), True)
            changes.append(~whole)
            kept = step[some][whole], tooth[some][whole]
            np.add.at(force, kept[0], found[whole, :3] * cutter.dz)
            np.add.at(chips, kept, found[whole, 3] / slices)
        changes = np.concatenate(changes)
        return step[changes], level[changes], tooth[changes]

    cells = (i.ravel() for i in np.indices((len(time), slices, teeth)))
    changing = add(*cells, parts)
    if len(changing[0]):
        add(*changing, parts**2)
    return Cutting(force, chips)


def _means(cutter, position, stock, forces, time, level, tooth, dt, passes, parts, flank):
    """Of cells, in `parts` each: means of the force per depth and the thickness, (cells, 4), and where contact changes."""
    within = np.concatenate([(np.arange(parts) + 0.5) / parts, [0.0, 1.0]]) - 0.5
    t = time[:, None] + within * dt  # the ends of the step only show whether the tooth cuts there
    level, tooth = (np.broadcast_to(i[:, None], t.shape) for i in (level, tooth))
    h = thickness(cutter, position, stock, t.ravel(), level.ravel(), tooth.ravel(), passes).reshape(t.shape)
    cutting = h > 0
    phi, h, t = cutter.angle(t, level, tooth)[:, :parts], h[:, :parts], t[:, :parts]
    tangential, radial, axial = (np.where(h > 0, f, 0.0) for f in forces(h, tooth[:, :parts]))
    damping, feed_rate = flank
    if damping:
        vx, vy = (position(t + INSTANT) - position(t - INSTANT)) / (2 * INSTANT)
        radial = radial + np.where(h > 0, damping * ((vx - feed_rate) * np.cos(phi) - vy * np.sin(phi)), 0.0)
    x = tangential * np.sin(phi) - radial * np.cos(phi)
    y = tangential * np.cos(phi) + radial * np.sin(phi)
    changes = cutting.any(axis=1) & ~cutting.all(axis=1)
    return np.stack([part.mean(axis=1) for part in (x, y, axial, h)], axis=1), changes
