"""A first guess of the modes of a coupled measuring chain: what turns simulated forces into those that were measured.

For given frequencies and damping ratios the residues follow by linear least squares, line by line of the spectrum of a turn:

    Y_h = F_h + sum_m (H_m(h W) - 1) R_m F_h,   h = 1, 2, ...

so that only two numbers per mode are looked for (variable projection, Golub and Pereyra 1973), from many starts in seconds.
"""

import numpy as np
from scipy.optimize import least_squares

import millax as mx

TRIES = 40
BAND = (350.0, 2000.0)
"""Where the starts have their frequencies [Hz]."""

APART = 30.0
"""Optima whose frequencies all differ by less are the same one [Hz]."""


def guesses(force, measured, sigma, turning: float, modes: int, bounds, prior: float, seed: int = 0) -> list[mx.Resonances]:
    """Different optima, the best first.

    - `force`, `measured`: lines of the force on the tool and of what was measured [N], shape (recordings, lines, 3),
      beginning with that at the spindle frequency `turning` [Hz].
    - `sigma`: of the channels [N], shape (recordings, 3).
    - `bounds`: the lower ones of a frequency [Hz] and a damping ratio, and the upper ones.
    - `prior`: standard deviation of the residues.
    """
    line = turning * np.arange(1, force.shape[1] + 1)

    def projected(x):
        """Residuals with the best residues, and these, shape (3, modes, 3)."""
        frequency, ratio = x[:modes, None], x[modes:, None]
        follows = 1 / (1 - (line / frequency) ** 2 + 2j * ratio * line / frequency) - 1
        columns = np.einsum("mh,rhj->rhmj", follows, force).reshape(*force.shape[:2], -1)
        left, residues = [], []
        for i in range(3):
            # A line counts twice: it stands for the one at the negative frequency too.
            scale = np.sqrt(2) / sigma[:, i, None]
            a, b = _real(columns * scale[..., None]), _real((measured[..., i] - force[..., i]) * scale)
            a, b = np.vstack([a, np.eye(3 * modes) / prior]), np.concatenate([b, np.zeros(3 * modes)])
            best = np.linalg.lstsq(a, b, rcond=None)[0]
            left.append(a @ best - b)
            residues.append(best.reshape(modes, 3))
        return np.concatenate(left), np.array(residues)

    random, found = np.random.default_rng(seed), []
    limits = tuple(np.repeat(limit, modes) for limit in bounds)
    scale = np.repeat([100.0, 0.05], modes)
    for _ in range(TRIES):
        start = np.concatenate([random.uniform(*BAND, modes), np.full(modes, 0.05)])
        end = least_squares(lambda x: projected(x)[0], start, bounds=limits, x_scale=scale, max_nfev=100)
        found.append((end.cost, end.x))
    kept = []
    for _, x in sorted(found, key=lambda one: one[0]):
        if all(np.abs(np.sort(x[:modes]) - np.sort(y[:modes])).max() > APART for y in kept):
            kept.append(x)
    return [mx.Resonances(x[:modes], x[modes:], projected(x)[1].transpose(1, 0, 2)) for x in kept]


def _real(lines: np.ndarray) -> np.ndarray:
    """Real and imaginary parts of all lines of all recordings, one below the other."""
    rows = lines.reshape(-1, *lines.shape[2:])
    return np.concatenate([np.real(rows), np.imag(rows)])
