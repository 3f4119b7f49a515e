"""Numbers that no robot has: what a description looks like whose masses are placeholders or in other units."""

import numpy as np

from ._chain import Robot

HEAVIEST = 1000.0
"""Moving mass of an industrial arm per metre of its length, at the most [kg/m]: three times what one of 2.7 m reach has."""


def implausible(robot: Robot) -> list[str]:
    """What is wrong with masses, centres of mass and inertia, one sentence each. Needs concrete numbers."""
    found = []
    lengths = robot.length
    if robot.mass is not None:
        mass = np.asarray(robot.mass)
        total = mass.sum()
        if total > HEAVIEST * lengths > 0:
            found.append(
                f"robot: its links weigh {total:.4g} kg together, much for an arm of {lengths:.3g} m; look for masses in g, "
                "or for made-up ones"
            )
        if len(mass) > 2 and np.all(mass == mass[0]):
            found.append(f"robot: all its links weigh the same, {mass[0]:g} kg; these look like placeholders")
    if robot.centre_of_mass is not None:
        away = np.linalg.norm(np.asarray(robot.centre_of_mass), axis=1)
        for name, distance in zip(robot.names, away, strict=True):
            if distance > lengths > 0:
                found.append(
                    f"robot: the centre of mass of the link of {name} is {distance:.3g} m from its joint, farther than the "
                    f"arm is long, {lengths:.3g} m; look for lengths in mm"
                )
    if robot.inertia is not None:
        for name, inertia in zip(robot.names, np.asarray(robot.inertia), strict=True):
            small, middle, large = np.linalg.eigvalsh(inertia)
            shown = f"({small:.3g}, {middle:.3g}, {large:.3g}) kg m²"
            if small <= 0:
                found.append(f"robot: the inertia of the link of {name} is not positive definite: principal moments {shown}")
            elif large > (small + middle) * (1 + 1e-6):
                found.append(
                    f"robot: no body has the inertia of the link of {name}: of the principal moments {shown} the largest "
                    "exceeds the sum of the others"
                )
    return found
