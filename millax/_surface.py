"""What the cut leaves behind: the wall beside the tool, its form error and roughness. And the phases of an entry (E).

The tip of tooth i moves on

    p_i(t) = start + v_f t (1, 0) + u(t) + R_i (cos phi_i, -sin phi_i),        phi_i = Omega t + psi_i,

and the wall at x is the farthest that any tip came there: the envelope of the paths. A tooth leaves the right wall, at
y = start_y - R, near phi = pi/2, and the left wall near phi = 3 pi/2. The spindle turns clockwise and the tool feeds along
+x, so that at the right wall the teeth run against the feed, and the chip ends with zero thickness: *down-milling*. At the
left wall they run with the feed, and the chip begins with zero thickness: *up-milling*.

A tooth path is as good as the displacement between its samples, a cubic through the four nearest; the rotation is exact. The
feed marks of a rigid tool with equal teeth are then those of Martellotti (1941), f_z²/(8 R (1 ± f_z N_z/(2 pi R))²) high,
+ for up-milling, however long a time step is.
"""

from typing import Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from ._case import Case
from ._check import concrete
from ._simulate import Simulation
from ._stock import Stock
from ._types import Scalar

Side = Literal["left", "right"]

SIDES: dict[Side, float] = {"left": 1.0, "right": -1.0}
"""The walls, seen along the feed, and the sign of y there."""

PER_FEED = 16
"""Points of a wall per feed per tooth: the height of the feed marks is then resolved to 12 %, and their Ra to 1 %."""

PER_STEP = 8
"""Instants per time step at which `phases` looks for contact."""

_WIDEST = 0.9
"""Sine of the angle from the crest of a path beyond which it is not followed: the path is 0.56 R below its crest there."""


class TipPaths(NamedTuple):
    """The paths of the tooth tips in a simulated cut. Whatever else turns or offsets a tooth belongs in its angle and
    radius."""

    angles: Float[Array, " teeth"]
    """psi_i [rad]."""
    radii: Float[Array, " teeth"]
    """R_i [m]."""
    speed: Scalar
    """Omega [rad/s]."""
    feed_rate: Scalar
    start: Float[Array, "2"]
    dt: Scalar
    samples: Float[Array, "2 steps"]
    """u in the middle of every step [m], along x and y."""
    length: Int[Array, ""]
    """Samples up to the end of the cut: what lies behind them is not looked at."""

    @property
    def end(self) -> Scalar:
        """The end of the cut [s]."""
        return self.length * self.dt

    def centre(self, t: Float[Array, "..."]) -> tuple[Array, Array]:
        """The tool centre at t [s]."""
        s = t / self.dt - 0.5
        first = jnp.clip(jnp.floor(s).astype(int) - 1, 0, self.length - 4)
        s = s - first
        # Lagrange's polynomials on the nodes 0, 1, 2, 3.
        a, b, c, d = s, s - 1, s - 2, s - 3
        weights = (-b * c * d / 6, a * c * d / 2, -a * b * d / 2, a * b * c / 6)
        x, y = (sum(w * row[first + j] for j, w in enumerate(weights)) for row in self.samples)
        return self.start[0] + self.feed_rate * t + x, self.start[1] + y

    def tip(self, t: Float[Array, "..."], tooth: Int[Array, "..."]) -> tuple[Array, Array]:
        """The tip of a tooth at t [s]."""
        x, y = self.centre(t)
        phi, radius = self.speed * t + self.angles[tooth], self.radii[tooth]
        return x + radius * jnp.cos(phi), y - radius * jnp.sin(phi)


def tip_paths(case: Case, sim: Simulation, height: Float[Array, ""] | float = 0.0) -> TipPaths:
    """The paths of the teeth at a height above their tips [m] in `sim`, the simulation of `case`."""
    tool, cut = case.tool, case.cut
    lag = tool.lag(jnp.asarray(height, dtype=float))
    deviation = tool.deviation(lag)
    still = jnp.zeros(sim.time.size)
    return TipPaths(
        angles=tool.spacing - lag,
        radii=jnp.broadcast_to(tool.radius, (tool.teeth,)) + (0.0 if deviation is None else deviation),
        speed=cut.spindle_speed,
        feed_rate=cut.feed_rate,
        start=cut.start,
        dt=cut.tooth_period(tool) / case.settings.steps_per_tooth,
        samples=jnp.stack([sim.displacement[:, sim.axes.index(axis)] if axis in sim.axes else still for axis in "xy"]),
        length=jnp.sum(~jnp.isnan(sim.time)),  # members of a sweep are filled up with NaN
    )


class Wall(eqx.Module):
    """A wall that a cut has left.

    **Attributes:**

    - `x`, `y`: points of the wall in the workpiece frame [m], shape (points,). y is NaN where there is no wall: outside the
      stock, and in the first and the last turn of the tool, where not every tooth has passed.
    - `nominal`: y of the wall that a rigid tool of zero feed would leave, start_y ± R [m].
    - `side`: "left" (y > 0, up-milling) or "right" (down-milling), seen along the feed. Static.
    """

    x: Float[Array, " points"]
    y: Float[Array, " points"]
    nominal: Scalar
    side: Side = eqx.field(static=True)

    @property
    def deviation(self) -> Float[Array, " points"]:
        """How far the wall lies from the nominal one, into the slot [m]: > 0 where material was left (undercut), < 0 where
        too much was taken (overcut)."""
        return SIDES[self.side] * (self.nominal - self.y)


def walls(case: Case) -> tuple[Side, ...]:
    """The sides on which the commanded cut leaves a wall, of "left" and "right": those where the stock goes on beyond the
    tool. Needs concrete numbers."""
    start = float(case.cut.start[0])
    end = start + float(case.cut.feed_per_tooth(case.tool)) * case.settings.periods
    return tuple(side for side in SIDES if _length_inside(case.stock, (start, end), float(_nominal(case, SIDES[side]))) > 0)


def wall_profile(
    case: Case,
    sim: Simulation,
    side: Side,
    x: Float[Array, " points"] | None = None,
    height: Float[Array, ""] | float = 0.0,
) -> Wall:
    """The wall that the teeth of a simulated cut leave on one side of the tool.

    **Arguments:**

    - `case`, `sim`: a case and its simulation.
    - `side`: "left" or "right", seen along the feed; `walls` says which there are.
    - `x`: where to look at the wall [m], shape (points,); 64 points per feed per tooth resolve the height of feed marks to
      3 %. None: along the whole path of the tool centre, `PER_FEED` points per feed per tooth.

    - `height`: above the tip of the tool [m], 0 to the depth of cut: with a helix every height is cut at another moment.

    Differentiable, and works under `jit` and `vmap` and as a reduction of a sweep. The derivative of the wall is that of the
    tooth that left the point. A tooth is followed up to 64° from abreast of the tool centre, where its path is 0.56 R behind
    its crest: displacements larger than that are not seen to the end.

    Raises `ValueError` for another side.
    """
    if side not in SIDES:
        raise ValueError(f"side: {side!r} given; it must be one of {', '.join(map(repr, SIDES))}")
    cut, feed = case.cut, case.cut.feed_per_tooth(case.tool)
    if x is None:
        x = cut.start[0] + feed * (np.arange(case.settings.periods * PER_FEED) + 0.5) / PER_FEED
    x = jnp.asarray(x, dtype=float)
    y, nominal = _wall(case, sim, jnp.asarray(SIDES[side]), x, jnp.asarray(height, dtype=float))
    return Wall(x, y, nominal, side)


@eqx.filter_jit
def _wall(case: Case, sim: Simulation, sign: Scalar, x: Float[Array, " points"], height: Scalar) -> tuple[Array, Scalar]:
    """y of a wall, and of the nominal one. The side is its sign: both are one program."""
    paths, nominal = tip_paths(case, sim, height), _nominal(case, sign)
    feed = case.cut.feed_per_tooth(case.tool)
    crests = _crests(paths, sign, case.settings.periods)
    winner = _winner(*lax.stop_gradient((paths, crests, x, feed)), sign)
    y = sign * _height(paths, crests, winner, x, sign, newton=3)
    n, offsets = case.stock.normals, case.stock.offsets
    inside = jnp.all(n[:, :1] * x + n[:, 1:] * nominal < offsets[:, None] - 1e-9 * case.tool.radius, axis=0)
    first, last = jnp.min(crests.x), jnp.max(jnp.where(crests.valid, crests.x, -jnp.inf))
    turn = case.tool.teeth * feed
    passed = (x >= first + turn) & (x <= last - turn)
    return jnp.where(inside & passed & jnp.isfinite(y), y, jnp.nan), nominal


class _Crests(NamedTuple):
    """The passages of the teeth by the wall, one after the other: a tooth is abreast of the tool centre."""

    time: Float[Array, " passages"]
    tooth: Int[Array, " passages"]
    x: Float[Array, " passages"]
    """x of the tool centre; infinite after the end of the cut."""
    y: Float[Array, " passages"]
    valid: Bool[Array, " passages"]


def _crests(paths: TipPaths, sign: Scalar, periods: int) -> _Crests:
    teeth = len(paths.angles)
    turns = np.arange(-(-periods // teeth) + 1)[:, None]
    abreast = np.pi + sign * np.pi / 2  # 3 pi/2 at the left, pi/2 at the right
    angle = (abreast - paths.angles) % (2 * np.pi) + 2 * np.pi * turns
    order = jnp.argsort(angle.ravel())
    time, tooth = angle.ravel()[order] / paths.speed, order % teeth
    valid = time <= paths.end
    x, y = paths.centre(jnp.where(valid, time, 0.0))
    return _Crests(time, tooth, jnp.where(valid, x, jnp.inf), sign * y + paths.radii[tooth], valid)


def _winner(paths: TipPaths, crests: _Crests, x: Array, feed: Scalar, sign: Scalar) -> Int[Array, " points"]:
    """The passage that left the wall at x: of all those near enough to have come farther than the nearest one did."""
    nearest = jnp.searchsorted(lax.cummax(crests.x), x).astype(int)
    ys = jnp.where(crests.valid, crests.y, jnp.nan)
    # The path of a tooth falls away from its crest as d²/(2 R).
    reach = jnp.sqrt(2 * jnp.max(paths.radii) * (jnp.nanmax(ys) - jnp.nanmin(ys))) / feed + len(paths.radii) + 1
    reach = jnp.where(jnp.isfinite(reach), jnp.minimum(jnp.ceil(reach), len(crests.x)), 0).astype(int)

    def one_more(offset, best):
        k = jnp.clip(nearest + offset, 0, len(crests.x) - 1)
        height = _height(paths, crests, k, x, sign, newton=1)
        higher = height > best[1]
        return jnp.where(higher, k, best[0]), jnp.where(higher, height, best[1])

    start = jnp.clip(nearest, 0, len(crests.x) - 1), jnp.full(x.shape, -jnp.inf)
    return lax.fori_loop(-reach, reach + 1, one_more, start)[0]


def _height(paths: TipPaths, crests: _Crests, k: Int[Array, " points"], x: Array, sign: Scalar, newton: int) -> Array:
    """How far the tip comes out at x in passage k, along ±y [m]; -inf where the passage does not get there."""
    tooth = crests.tooth[k]
    sine = jnp.where(crests.valid[k], x - crests.x[k], 0.0) / paths.radii[tooth]
    there = crests.valid[k] & (jnp.abs(sine) < _WIDEST)
    t = crests.time[k] + sign * jnp.arcsin(jnp.where(there, sine, 0.0)) / paths.speed
    for _ in range(newton):
        (at, _), (rate, _) = jax.jvp(lambda t: paths.tip(t, tooth), (t,), (jnp.ones_like(t),))
        t = jnp.where(there, t - (at - x) / rate, t)
    there &= (t >= 0) & (t <= paths.end)
    return jnp.where(there, sign * paths.tip(jnp.where(there, t, 0.0), tooth)[1], -jnp.inf)


def form_error(wall: Wall, stretch: tuple[float, float] | None = None) -> Scalar:
    """Surface location error: mean of `wall.deviation` over a stretch [m]; > 0 material is left, < 0 too much is taken.

    - `stretch`: from and to [m], along x; it should hold many turns of the tool. None: the last half of the wall.

    The feed marks of a rigid tool are part of it: f_z²/(24 R). NaN where there is no wall.
    """
    inside = _stretch(wall, stretch)
    return _mean(wall.deviation, inside)


class Roughness(NamedTuple):
    """Of a profile z(x), the deviation less its mean line [m]; evaluated over a stretch as a whole."""

    ra: Scalar
    """Mean of abs(z)."""
    rq: Scalar
    """Root of the mean of z²."""
    rz: Scalar
    """Highest peak less deepest valley."""


def roughness(wall: Wall, stretch: tuple[float, float] | None = None) -> Roughness:
    """Ra, Rq and Rz of a wall along the feed (ISO 21920-2, formerly ISO 4287, simplified); arguments as in `form_error`.

    The mean line is the straight line of least squares over the stretch. There is no filter: waves longer than the cut-off
    of a measuring instrument count too, and Rz is not a mean over sections of the stretch (it is ISO's Rt). Feed marks of
    height H have Ra = 0.257 H, Rq = 0.298 H.
    """
    inside = _stretch(wall, stretch)
    x, z = (v - _mean(v, inside) for v in (wall.x, wall.deviation))
    z = z - x * (_mean(x * z, inside) / _mean(x * x, inside))
    highest, deepest = (jnp.max(jnp.where(inside, sign * z, -jnp.inf)) for sign in (1, -1))
    return Roughness(_mean(jnp.abs(z), inside), jnp.sqrt(_mean(z * z, inside)), highest + deepest)


def _stretch(wall: Wall, stretch: tuple[float, float] | None) -> Bool[Array, " points"]:
    there = ~jnp.isnan(wall.y)
    if stretch is None:
        begin, end = jnp.min(jnp.where(there, wall.x, jnp.inf)), jnp.max(jnp.where(there, wall.x, -jnp.inf))
        return there & (wall.x >= (begin + end) / 2)
    return there & (wall.x >= stretch[0]) & (wall.x <= stretch[1])


def _mean(v: Float[Array, " points"], inside: Bool[Array, " points"]) -> Scalar:
    return jnp.sum(jnp.where(inside, v, 0.0)) / jnp.sum(inside)


def _nominal(case: Case, sign: Scalar | float) -> Scalar:
    return case.cut.start[1] + sign * case.tool.radius


def _length_inside(stock: Stock, between: tuple[float, float], y: float) -> float:
    """How much of a line at y lies inside the stock [m], negative where it misses it."""
    low, high = between
    for (nx, ny), offset in zip(np.asarray(stock.normals), np.asarray(stock.offsets), strict=True):
        room = offset - ny * y
        if abs(nx) < 1e-12:
            high = high if room > 1e-9 * max(abs(y), abs(offset)) else -np.inf
        elif nx > 0:
            high = min(high, room / nx)
        else:
            low = max(low, room / nx)
    return high - low


def phases(case: Case, sim: Simulation) -> dict[str, tuple[float, float] | None]:
    """When the phases of an entry into the stock begin and end [s] (E, Fig. 5), in a simulation outside `jit`.

    - "Ia": from the first contact until two teeth are in contact at the same time.
    - "Ib": from then until the tool centre has passed the border.
    - "II": the tool centre is past the border; until the tool reaches a border ahead, or the trace ends.

    The border is every one that faces the tool. A phase that does not occur is None: without such a border all but II are.
    A tooth is in contact where its tip is in the stock and the chip of its time step thicker than half the width of the
    smoothed gates; teeth are looked at eight times in a step.

    In a slot, with a rigid tool of equal teeth, phase Ia ends when the arc of contact is as long as the pitch, when the tool
    is R (1 - cos(pi/N_z)) past the border: in the papers' case, 4 teeth and 4 m/min, after 0.044 s (E: "only 0.04 sec"), and
    the time until a tooth is there, less than a tooth period.

    Raises `ValueError` for a traced simulation.
    """
    if concrete(sim.time) is None:
        raise ValueError("phases: the simulation is traced; call it outside jit, grad and vmap")
    paths = tip_paths(case, sim)
    steps, dt = int(paths.length), float(paths.dt)
    normals, offsets = np.asarray(case.stock.normals), np.asarray(case.stock.offsets)

    def distance(x, y, which=lambda nx: True):
        """From points to the nearest of these borders, positive inside."""
        found = np.full(np.shape(x), np.inf)
        for (nx, ny), offset in zip(normals, offsets, strict=True):
            found = np.minimum(found, offset - nx * x - ny * y) if which(nx) else found
        return found

    middles = (np.arange(steps) + 0.5) * dt
    x, y = map(np.asarray, _centre(paths, jnp.asarray(middles)))
    past = np.flatnonzero(distance(x, y, lambda nx: nx < 0) >= 0)
    ahead = np.flatnonzero(distance(x + float(case.tool.radius), y, lambda nx: nx > 0) < 0)
    end = steps * dt
    entering = int(past[0]) if past.size else steps
    full = middles[entering] if 0 < entering < steps else entering * dt
    done = middles[ahead[0]] if ahead.size else end

    thick = np.asarray(sim.chip_thickness)[:entering] > float(case.settings.width) / 2
    found: dict[int, float] = {}
    for begin in range(0, entering, _STRETCH):
        t = (begin + (np.arange(_STRETCH * PER_STEP) + 0.5) / PER_STEP) * dt
        tips = map(np.asarray, _tip(paths, jnp.asarray(t)[:, None], jnp.arange(case.tool.teeth)))
        cutting = np.repeat(thick[begin : begin + _STRETCH], PER_STEP, axis=0)
        together = np.sum((distance(*tips) > 0)[: len(cutting)] & cutting, axis=1)
        for teeth in {1, 2} - set(found):
            if (when := np.flatnonzero(together >= teeth)).size:
                found[teeth] = float(t[when[0]])
        if 2 in found:
            break
    first, second = found.get(1), found.get(2)
    return {
        "Ia": None if first is None else (first, float(full if second is None else second)),
        "Ib": None if second is None else (second, float(full)),
        "II": (float(full), float(done)) if past.size and done > full else None,
    }


_STRETCH = 1024
"""Time steps that `phases` looks at together: memory does not grow with the length of a trace."""

_centre, _tip = jax.jit(TipPaths.centre), jax.jit(TipPaths.tip)
