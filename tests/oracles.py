"""Independent references: plain NumPy and SciPy, sharing no formula with the engine."""

import numpy as np
from scipy.optimize import brentq


def exact_thickness(position, radius, speed, teeth, t, tooth, passes, tau):
    """Chip thickness of one tooth from exact tooth paths, negative out of contact.

    `position(t)` is the tool centre. The ray from the centre through the tip meets the path of the tooth that cut k
    passes earlier where the cross product of the two directions vanishes; SciPy finds that instant.
    """

    def direction(time, index):
        phi = speed * time + 2 * np.pi * index / teeth
        return np.array([np.cos(phi), -np.sin(phi)])

    centre, n = position(t), direction(t, tooth)
    gaps = []
    for k in range(1, passes + 1):

        def across(s, k=k):
            tip = position(s) + radius * direction(s, tooth + k) - centre
            return n[0] * tip[1] - n[1] * tip[0]

        s = brentq(across, t - k * tau - 0.3 * tau, t - k * tau + 0.3 * tau, xtol=1e-15)
        gaps.append(radius - n @ (position(s) + radius * direction(s, tooth + k) - centre))
    return min(gaps)


def fractional(h, k0, hs, r):
    """F_t per unit depth."""
    u = np.maximum(h, 0.0) / hs
    return k0 * hs * (u + r * u**2) / (1 + u)


def plane_force(phi, tangential, kr):
    """E 29 for one tooth; arrays over phi."""
    return np.array([-kr * np.cos(phi) + np.sin(phi), kr * np.sin(phi) + np.cos(phi)]) * tangential
