"""The papers' own algorithm in NumPy: the workpiece as a grid of nodes, 1 where there is material and 0 where it is cut.

ESDA 2012, case B, and COROUSSO deliverable 1.4, figures 5 to 7. In every time step each tooth sweeps a sector; the nodes
in it that are still 1 become 0, and their area A is what the tooth has cut: h = A/(R dalpha), with dalpha the angle that
the tip has turned as seen from the tool centre at the start of the step. The force of that thickness moves the tool.

It shares no formula with the engine but those of force law and structure, which makes it an oracle: area divided by
R dalpha is h - h²/(2 R) on the average of the step. It is noisy, by about the spacing over the thickness, and slow.

`simulate` is the papers' algorithm; `cut_along` takes any cutter along a prescribed motion, one grid for each axial slice.
It remembers all passes, however long ago.
"""

import numpy as np
from jaxtyping import Bool, Float

import millax as mx

from .compiled import Traces, discrete, observed, time_step
from .exact import Cutter, Cutting, Forces, Position, law_of


class Grid:
    """A window of the workpiece that moves along with the tool.

    Columns are kept in a ring: column i of the workpiece, at x = i * spacing, is row i % columns of `material`.

    **Arguments:**

    - `stock`: the uncut workpiece. What a tool that came along x would have cut before is taken out of it.
    - `spacing`: distance of the nodes in x and y [m].
    - `centre`: where the tool is at first [m].
    - `radius`: of the tool [m].
    - `stray`: how far the tool may leave its path [m]; so far the window reaches beyond the radius on all sides.
    """

    def __init__(self, stock: mx.Stock, spacing: float, centre, radius: float, stray: float):
        self.normals, self.offsets = np.asarray(stock.normals), np.asarray(stock.offsets)
        self.start, self.radius = np.asarray(centre), radius
        self.spacing, self.reach = spacing, radius + stray
        self.columns = 2 * int(np.ceil(self.reach / spacing)) + 3
        self.rows = np.arange(*self._range(centre[1]))
        self.material: Bool[np.ndarray, "columns rows"] = np.zeros((self.columns, len(self.rows)), bool)
        self.first = self._range(centre[0])[0]
        self._fill(np.arange(self.first, self.first + self.columns))

    def follow(self, x: float) -> None:
        """Move the window to the tool at x [m]: uncut columns come in, those left behind are forgotten."""
        first = self._range(x)[0]
        if first > self.first:
            self._fill(np.arange(max(first, self.first + self.columns), first + self.columns))
            self.first = first

    def cut(self, centre, tip, centre_after, tip_after, depth: float) -> tuple[float, float]:
        """Let a tooth sweep from (`centre`, `tip`) to (`centre_after`, `tip_after`); returns A [m²] and dalpha [rad].

        Nodes farther than `depth` inside the tip's path are not looked at: chips are thinner, so nothing is left there.
        """
        begin, end = tip - centre, tip_after - centre
        radii = np.hypot(*begin), np.hypot(*end)
        inner = 1 - depth / min(radii)
        corners = np.array(
            [begin, end, inner * begin, inner * end, (begin + end) * 0.5 * max(radii) / np.hypot(*(begin + end) / 2)]
        )
        low, high = (corners + centre).min(axis=0), (corners + centre).max(axis=0)
        i = np.arange(int(np.ceil(low[0] / self.spacing)), int(np.floor(high[0] / self.spacing)) + 1)
        j = np.arange(int(np.ceil(low[1] / self.spacing)), int(np.floor(high[1] / self.spacing)) + 1)
        box = np.ix_(i % self.columns, j - self.rows[0])
        material = self.material[box]
        turned = float(np.arctan2(_cross(end, begin), begin @ end))
        if not material.any():
            return 0.0, turned
        x, y = (i * self.spacing - centre[0])[:, None], (j * self.spacing - centre[1])[None, :]
        passed, ahead = _cross((x, y), begin), _cross(end, (x, y))  # teeth turn clockwise
        radius = np.hypot(x, y)
        whole = passed + ahead
        outer = radii[0] + (radii[1] - radii[0]) * passed / np.where(whole > 0, whole, 1.0)
        inside = (passed >= 0) & (ahead > 0) & (radius <= outer) & (radius > outer - depth)
        self.material[box] = material & ~inside
        return np.count_nonzero(material & inside) * self.spacing**2, turned

    def _range(self, middle: float) -> tuple[int, int]:
        first = int(np.floor((middle - self.reach) / self.spacing)) - 1
        return first, first + self.columns

    def _fill(self, columns: np.ndarray) -> None:
        points = np.stack(np.broadcast_arrays(columns[:, None] * self.spacing, self.rows[None, :] * self.spacing))
        uncut = np.ones(points.shape[1:], bool)
        for normal, offset in zip(self.normals, self.offsets, strict=True):
            uncut &= np.tensordot(normal, points, 1) <= offset
        x, y = points - self.start[:, None, None]
        uncut &= np.hypot(np.maximum(x, 0.0), y) > self.radius
        self.material[columns % self.columns] = uncut


def _cross(a, b):
    return a[0] * b[1] - a[1] * b[0]


def simulate(
    case: mx.Case,
    spacing: float,
    *,
    stray: float = 1e-3,
    steps: int | None = None,
    cutter: Cutter | None = None,
    forces: Forces | None = None,
) -> Traces:
    """`case` by the grid algorithm: mean force in each step, displacement in its middle, chip thickness of every tooth.

    **Arguments:**

    - `spacing`: distance of the nodes [m]; the papers' choice depends on tool and time step, 5 to 20 um are usual.
    - `stray`: how far the tool may leave its path, and the thickest chip [m].
    - `steps`: how many time steps, all of them by default.
    - `cutter`, `forces`: other ones than those of the case.
    """
    steps = case.settings.steps if steps is None else steps
    cutter, law = cutter or Cutter.of(case), forces or law_of(case)
    dt, seen = time_step(case), observed(case)[:2]
    (half, half_in), (whole, whole_in) = (discrete(case, t) for t in (dt / 2, dt))
    start, advance = np.asarray(case.cut.start), np.array([float(case.cut.feed_rate) * dt, 0.0])
    traces = Traces(np.zeros((steps, 2)), np.zeros((steps, 2)), np.zeros((steps, cutter.teeth)))
    state, force = np.zeros(len(whole)), np.zeros(2)
    grids = _grids(cutter, case.stock, spacing, start, stray)
    for step in range(steps):
        # Where the tool will be at the end of the step depends on the force in it: that of the step before is near.
        commanded = start + advance * step, start + advance * (step + 1)
        before, after = commanded[0] + seen @ state, commanded[1] + seen @ (whole @ state + whole_in @ force)
        h = _swept(grids, cutter, (step * dt, (step + 1) * dt), (before, after), commanded[1][0], stray)
        force = _force(cutter, law, (step + 0.5) * dt, h)[:2]
        traces.thickness[step] = h.mean(axis=0)
        traces.force[step] = force
        traces.displacement[step] = seen @ (half @ state + half_in @ force)
        state = whole @ state + whole_in @ force
    return traces


def cut_along(
    cutter: Cutter,
    position: Position,
    stock: mx.Stock,
    forces: Forces,
    time: np.ndarray,
    dt: float,
    *,
    spacing: float,
    stray: float = 1e-3,
    finer: int = 4,
    early: int = 0,
) -> Cutting:
    """Mean force and chip thickness in the steps of length `dt` [s] around `time` [s], one following the other.

    The thickness is the h of which A/(R dalpha) is h - h²/(2 R). Other arguments as in `exact.cut_along` and `simulate`.

    **Arguments:**

    - `finer`: parts of a step. In each the force is that of its mean thickness, in the direction of its middle.
    - `early`: steps that are cut before the first. Without them the tool has cut, at first, what the largest of its teeth
      could reach along x: not yet right where the radii differ, or in material that it has been in before.
    """
    t = time[0] + dt * ((np.arange(-early * finer, len(time) * finer) + 0.5) / finer - 0.5)
    half = dt / finer / 2
    centres = position(np.append(t - half, t[-1] + half)).T
    grids = _grids(cutter, stock, spacing, centres[0], stray)
    force, thickness = np.zeros((len(t), 3)), np.zeros((len(t), cutter.teeth))
    for step, now in enumerate(t):
        between = centres[step], centres[step + 1]
        swept = _swept(grids, cutter, (now - half, now + half), between, between[1][0], stray)
        h = cutter.radii - np.sqrt(cutter.radii**2 - 2 * cutter.radii * swept)
        force[step], thickness[step] = _force(cutter, forces, now, h), h.mean(axis=0)
    means = (x[early * finer :].reshape(len(time), finer, -1).mean(axis=1) for x in (force, thickness))
    return Cutting(*means)


def _grids(cutter: Cutter, stock: mx.Stock, spacing: float, centre, stray: float) -> list[Grid]:
    """One for each slice."""
    return [Grid(stock, spacing, centre, float(cutter.radii.max()), stray) for _ in cutter.z]


def _swept(grids: list[Grid], cutter: Cutter, times, centres, x, stray: float) -> Float[np.ndarray, "slices teeth"]:
    """A/(R dalpha) [m] of all teeth, which sweep while the tool goes from one of the two `centres` to the other.

    The windows follow the tool to `x`.
    """
    for grid in grids:
        grid.follow(float(x))
    tips = [centre + cutter.radii[:, :, None] * _directions(cutter, t) for t, centre in zip(times, centres, strict=True)]
    h = np.zeros(cutter.radii.shape)
    for level, tooth in np.ndindex(h.shape):
        tip, tip_after = (at[level, tooth] for at in tips)
        area, turned = grids[level].cut(centres[0], tip, centres[1], tip_after, stray)
        h[level, tooth] = area / (cutter.radii[level, tooth] * turned)
    return h


def _directions(cutter: Cutter, t: float) -> Float[np.ndarray, "slices teeth 2"]:
    """From the tool centre to every tip."""
    phi = cutter.at_start + cutter.speed * t
    return np.stack([np.cos(phi), -np.sin(phi)], axis=-1)


def _force(cutter: Cutter, forces: Forces, t: float, h: Float[np.ndarray, "slices teeth"]) -> Float[np.ndarray, " 3"]:
    """On the tool along x, y, z [N]."""
    n = _directions(cutter, t)
    cos, sin = n[..., 0], -n[..., 1]
    tangential, radial, axial = (np.where(h > 0, f, 0.0) * cutter.dz for f in forces(h, np.arange(cutter.teeth)))
    parts = tangential * sin - radial * cos, tangential * cos + radial * sin, axial
    return np.array([part.sum() for part in parts])
