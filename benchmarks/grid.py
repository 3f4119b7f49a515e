"""The papers' own algorithm in NumPy: the workpiece as a grid of nodes, 1 where there is material and 0 where it is cut.

ESDA 2012, case B, and COROUSSO deliverable 1.4, figures 5 to 7. In every time step each tooth sweeps a sector; the nodes
in it that are still 1 become 0, and their area A is what the tooth has cut: h = A/(R dalpha), with dalpha the angle that
the tip has turned as seen from the tool centre at the start of the step. The force of that thickness moves the tool.

It shares no formula with the engine but those of force law and structure, which makes it an oracle: area divided by
R dalpha is h - h²/(2 R) on the average of the step. It is noisy, by about the spacing over the thickness, and slow.
"""

import numpy as np
from jaxtyping import Bool, Float

import millax as mx

from .compiled import Traces, discrete, observed, time_step


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


def simulate(case: mx.Case, spacing: float, *, stray: float = 1e-3, steps: int | None = None) -> Traces:
    """`case` by the grid algorithm: mean force in each step, displacement in its middle, chip thickness of every tooth.

    **Arguments:**

    - `spacing`: distance of the nodes [m]; the papers' choice depends on tool and time step, 5 to 20 um are usual.
    - `stray`: how far the tool may leave its path, and the thickest chip [m].
    - `steps`: how many time steps, all of them by default.
    """
    tool, cut, n = case.tool, case.cut, case.settings.steps_per_tooth
    steps = case.settings.steps if steps is None else steps
    dt, radius, seen = time_step(case), float(tool.radius), observed(case)[:2]
    (half, half_in), (whole, whole_in) = (discrete(case, t) for t in (dt / 2, dt))
    start, advance = np.asarray(cut.start), np.array([float(cut.feed_rate) * dt, 0.0])
    law, kr = _law(case), float(case.force.kr)

    def tips(at: float) -> Float[np.ndarray, "teeth 2"]:
        phi = 2 * np.pi * (at / (tool.teeth * n) + np.arange(tool.teeth) / tool.teeth)
        return np.stack([np.cos(phi), -np.sin(phi)], axis=1)

    traces = Traces(np.zeros((steps, 2)), np.zeros((steps, 2)), np.zeros((steps, tool.teeth)))
    state, force = np.zeros(len(whole)), np.zeros(2)
    grid = Grid(case.stock, spacing, start, radius, stray)
    for step in range(steps):
        # Where the tool will be at the end of the step depends on the force in it: that of the step before is near.
        commanded = start + advance * step, start + advance * (step + 1)
        before, after = commanded[0] + seen @ state, commanded[1] + seen @ (whole @ state + whole_in @ force)
        grid.follow(float(commanded[1][0]))
        middle, force = tips(step + 0.5), np.zeros(2)
        for tooth, (n0, n1, n_middle) in enumerate(zip(tips(step), tips(step + 1), middle, strict=True)):
            area, turned = grid.cut(before, before + radius * n0, after, after + radius * n1, stray)
            h = area / (radius * turned)
            cosine, sine = n_middle[0], -n_middle[1]
            tangential = law(h)
            force += tangential * np.array([sine - kr * cosine, cosine + kr * sine])
            traces.thickness[step, tooth] = h
        traces.force[step] = force
        traces.displacement[step] = seen @ (half @ state + half_in @ force)
        state = whole @ state + whole_in @ force
    return traces


def _law(case: mx.Case):
    """F_t(h) of one tooth [N] in plain Python (fractional law)."""
    law = case.force
    assert isinstance(law, mx.FractionalLaw)
    k0, hs, r, depth = float(law.k0), float(law.hs), float(law.r), float(case.cut.depth)

    def tangential(h: float) -> float:
        u = h / hs
        return depth * k0 * hs * (u + r * u**2) / (1 + u)

    return tangential
