"""Surface location error in closed form: the yardstick of `millax.form_error`.

T. L. Schmitz and B. P. Mann, "Closed-form solutions for surface location error in milling", International Journal of
Machine Tools and Manufacture 46 (2006): in a stable cut the tool moves periodically, u(t) = u(t - tau), so that its
vibration cancels in the chip thickness. The force is that of a rigid tool; its Fourier series times the frequency response
of the structure is the motion, and the wall is left where the tool stands while a tooth passes it. Plain NumPy, nothing of
millax.
"""

import numpy as np

HARMONICS = 2000
"""The motion's harmonics fall off at least as 1/n³."""


def location_error(
    side: str,
    *,
    radius: float,
    teeth: int,
    speed: float,
    feed_per_tooth: float,
    immersion: float,
    depth: float,
    kt: float,
    kr: float,
    mass: float,
    stiffness: float,
    damping_ratio: float,
) -> float:
    """Mean distance of the wall from its nominal place [m], > 0 where material is left, feed marks included.

    A tool that gives way in y, straight equal teeth, F_t = depth kt h, F_r = kr F_t, h = feed_per_tooth cos(phi): first
    order in feed_per_tooth/radius. `immersion` is radial [m]; "left" is up-milling, phi from -pi/2, "right" down-milling,
    phi to pi/2.
    """
    inner = np.arcsin(1 - immersion / radius)
    low, high, wall, sign = (-np.pi / 2, -inner, -np.pi / 2, 1) if side == "left" else (inner, np.pi / 2, np.pi / 2, -1)
    order = teeth * np.arange(-HARMONICS, HARMONICS + 1)

    def integral(k):
        """Of exp(i k phi) over the arc of contact."""
        safe = np.where(k == 0, 1, k)
        return np.where(k == 0, high - low, (np.exp(1j * k * high) - np.exp(1j * k * low)) / (1j * safe))

    # F_y = F_t (cos phi + kr sin phi), and cos² phi + kr sin phi cos phi = 1/2 + p exp(2 i phi) + conj(p) exp(-2 i phi).
    p = (1 - 1j * kr) / 4
    series = integral(-order) / 2 + p * integral(2 - order) + p.conjugate() * integral(-2 - order)
    force = depth * kt * feed_per_tooth * teeth / (2 * np.pi) * series
    w = order * speed
    response = 1 / (stiffness - mass * w**2 + 2j * damping_ratio * np.sqrt(stiffness * mass) * w)
    displacement = np.sum(force * response * np.exp(1j * order * wall)).real
    return -sign * displacement + feed_per_tooth**2 / (24 * radius)


TOOL = {"radius": 0.01, "teeth": 2, "depth": 0.1e-3, "immersion": 3e-3, "kt": 6e8, "kr": 1 / 3}
MODE = {"mass": 0.03993, "stiffness": 0.03993 * (2 * np.pi * 922) ** 2, "damping_ratio": 0.011}
"""A mode and a force law that the literature of milling dynamics often uses: 922 Hz, K_t = 600 N/mm², K_n = 200 N/mm²."""
