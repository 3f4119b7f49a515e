"""The KUKA KR270 of C (Tables 1 and 2) and its slot: what the equations give, what the paper prints, and why they differ.

    python -m benchmarks.kr270

C prints the pose, the compliances of the joints and the masses of the links, but no length, no centre of mass, no inertia
and no damping. Those here are of `millax.robot.models.kuka_kr270`, and a damping ratio of 5 %. In a notebook, `rows()` is a
list to loop over and `table(rows())` its table.
"""

import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import equinox as eqx
import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.linalg import eigh
from scipy.optimize import brentq

import millax as mx
from millax.robot import Arm, Robot, models

JOINTS = np.deg2rad([90.0, -50.0, 120.0, 180.0, 25.0, 180.0])
COMPLIANCE = 1e-6 * np.array([0.26, 0.15, 0.26, 1.79, 1.52, 2.13])
SPEED = 8000 * 2 * np.pi / 60
FULL, SETTLED, END = 0.15, 0.3, 0.6
"""Of the simulated cut [s]: the slot is as wide as the tool from `FULL` on, the swing of the entry small from `SETTLED`."""

LOW, STATIC = "6.70 Hz", "58.1 µm"
PLAUSIBLE = (11.0, 15.0)
"""Lowest natural frequency [Hz] of all plausible lengths and inertias."""
NO_LENGTHS = "the paper prints no lengths: widely used ones here"
NO_INERTIA = "the paper prints masses only: rods as links here"


@dataclass(frozen=True)
class Row:
    """A quantity, computed and as the paper has it, and why they differ. `allowed`: what the computed one must lie between;
    None: it is there to be read."""

    quantity: str
    computed: float
    unit: str
    paper: str
    why: str
    allowed: tuple[float, float] | None = None

    @property
    def shown(self) -> str:
        return f"{self.computed:.4g} {self.unit}"

    @property
    def target(self) -> str:
        return "" if self.allowed is None else f"{self.allowed[0]:.4g} to {self.allowed[1]:.4g} {self.unit}"

    @property
    def met(self) -> bool | None:
        return None if self.allowed is None else bool(self.allowed[0] <= self.computed <= self.allowed[1])


def arm(robot: Robot | None = None) -> Arm:
    """The robot at its slot, without a spindle: C prints none."""
    return Arm(models.kuka_kr270() if robot is None else robot, JOINTS, COMPLIANCE, damping_ratio=0.05)


def straight() -> Robot:
    """The arm with a_3 = 0 between its elbow and its forearm, in place of -41 mm."""
    robot = models.kuka_kr270()
    return eqx.tree_at(lambda r: r.xyz, robot, robot.xyz.at[3, 0].set(0.0)).with_rods(0.15)


def points() -> Robot:
    """The arm with each link as a point of its mass at its end: more inertia than any rods have."""
    robot = models.kuka_kr270()
    return dataclasses.replace(robot, centre_of_mass=robot.ends, inertia=np.zeros((robot.joints, 3, 3)))


def slot(duration: float, holds: Arm | None = None, **settings) -> mx.Case:
    """C's slot in aluminium: 8000 rpm, 4 m/min, 4 teeth, entering a straight border at t = 0; 1 mm deep, as k_0 a = 5e6 N/m
    makes it with the law of E. Of an arm of its own, or of `holds`."""
    holds = arm() if holds is None else holds
    tool = mx.EndMill(diameter=0.02, teeth=4)
    law = mx.FractionalLaw(k0=5e9, hs=18e-6, r=0.1, kr=0.3)
    cut = mx.Cut.touching(tool, SPEED, 4 / 60, 1e-3)
    numerics = mx.Settings.suited(tool, law, holds, cut, duration, **settings)
    return mx.Case(tool, law, cut, mx.Stock.box(), holds, numerics)


@dataclass(frozen=True)
class Felt:
    """What the tool feels of a robot there, in the axes of the tool, as C has it: y is across the feed."""

    robot: Robot

    @cached_property
    def axes(self) -> np.ndarray:
        return np.kron(np.eye(2), np.asarray(self.robot.pose(JOINTS))[:3, :3])

    @cached_property
    def stiffness(self) -> np.ndarray:
        return self.axes.T @ np.asarray(arm(self.robot).elastic.stiffness(JOINTS)) @ self.axes

    @cached_property
    def mass(self) -> np.ndarray:
        return self.axes.T @ np.asarray(arm(self.robot).elastic.mass(JOINTS)) @ self.axes

    def misprinted(self, *, base: bool) -> np.ndarray:
        """J^T M_theta J, as C 25 prints it. It takes joints for directions: where J is in the axes of the base it is another
        one than where J is in those of the tool."""
        jacobian, mass = np.asarray(self.robot.jacobian(JOINTS)), np.asarray(self.robot.mass_matrix(JOINTS))
        if base:
            return self.axes.T @ jacobian.T @ mass @ jacobian @ self.axes
        jacobian = self.axes.T @ jacobian
        return jacobian.T @ mass @ jacobian

    @property
    def free(self) -> float:
        """Stiffness against a force along y, all other directions free [N/m]."""
        return 1 / float(np.linalg.inv(self.stiffness)[1, 1])

    def modes(self, mass: np.ndarray) -> tuple[np.ndarray, str]:
        """Frequencies [Hz], ascending, and along which axis the tool moves the most in each."""
        # M v = K v/w², not K v = w² M v: points have no inertia.
        inverse, shapes = eigh(mass, self.stiffness)
        axis = np.abs(shapes[:3, ::-1]).argmax(axis=0)
        with np.errstate(divide="ignore"):
            return _hertz(1 / np.maximum(inverse[::-1], 0)), "".join("xyz"[i] for i in axis)

    def in_y(self, mass: np.ndarray) -> float:
        """The lowest frequency of a mode along y [Hz]."""
        frequency, along = self.modes(mass)
        return float(frequency[along.index("y")])


def _hertz(square):
    return np.sqrt(square) / (2 * np.pi)


def rows() -> list[Row]:
    """All quantities. Takes some seconds: the cut is simulated."""
    usual, flat, heavy = (Felt(robot) for robot in (models.kuka_kr270(), straight(), points()))
    return [*_stiffness(usual, flat), *_frequencies(usual, flat, heavy), *_misprint(usual, flat, heavy), *_cut(usual, flat)]


def _about(value: float, part: float) -> tuple[float, float]:
    return value * (1 - part), value * (1 + part)


def _stiffness(usual: Felt, flat: Felt) -> Iterator[Row]:
    k, held = usual.stiffness / 1e6, "stiffness along {}, other directions held"
    yield Row(f"{held.format('y')}, K_yy", k[1, 1], "MN/m", "", f"{NO_LENGTHS}; its 58.1 µm needs 2.55", _about(2.68, 0.003))
    yield Row(f"{held.format('y')}, a_3 = 0", flat.stiffness[1, 1] / 1e6, "MN/m", "", NO_LENGTHS, _about(2.54, 0.003))
    yield Row(f"{held.format('x')}, K_xx", k[0, 0], "MN/m", "", "K_xy = K_yz = 0: the arm stands in one plane")
    yield Row(f"{held.format('z')}, K_zz", k[2, 2], "MN/m", "", "")
    yield Row("coupling of x and z, K_xz", k[0, 2], "MN/m", "", "")
    yield Row(
        "stiffness along y, other directions free, 1/C_yy", usual.free / 1e6, "MN/m", "", "the tool turns as it yields"
    )


def _frequencies(usual: Felt, flat: Felt, heavy: Felt) -> Iterator[Row]:
    for i, axis in enumerate("xyz"):
        yield Row(f"mass at the tool along {axis}", usual.mass[i, i], "kg", "", NO_INERTIA if i == 0 else "")
    wrong = "6.70 Hz does not follow from M_C = J^-T M_θ J^-1"
    for i, (frequency, axis) in enumerate(zip(*usual.modes(usual.mass), strict=True), start=1):
        what = f"natural frequency {i}, mostly along {axis}"
        yield Row(what, frequency, "Hz", LOW, wrong, PLAUSIBLE) if i == 1 else Row(what, frequency, "Hz", "", "")
    yield Row(
        "lowest along y, a_3 = 0", flat.in_y(flat.mass), "Hz", LOW, "a few centimetres do not bring it there", PLAUSIBLE
    )
    what, why = "lowest along y, links as points at their ends", "nor does more inertia in the links"
    yield Row(what, heavy.in_y(heavy.mass), "Hz", LOW, why, PLAUSIBLE)
    load = brentq(lambda kg: usual.in_y(usual.mass + np.diag([kg, kg, kg, 0, 0, 0])) - 6.70, 0, 2000)
    yield Row("point at the tool that makes it 6.70 Hz", load, "kg", "", "no spindle is printed; the arm is made for 270 kg")


def _misprint(usual: Felt, flat: Felt, heavy: Felt) -> Iterator[Row]:
    """What C 25 gives as it is printed. C does not say in which axes its J is, nor what it held."""
    readings = {}
    for links, felt in (("rods", usual), ("rods, a_3 = 0", flat), ("points at ends", heavy)):
        for axes in ("base", "tool"):
            mass, name = felt.misprinted(base=axes == "base"), f"{links}, J in {axes} axes"
            readings[f"{name}, mode along y"] = felt.in_y(mass)
            readings[f"{name}, K_yy/M_yy"] = _hertz(felt.stiffness[1, 1] / mass[1, 1])
            readings[f"{name}, 1/(C_yy M_yy)"] = _hertz(felt.free / mass[1, 1])
    why = f"one of {len(readings)} readings: it depends on the axes of J, and what is held is not said"
    chosen = ["rods, J in base axes, mode along y", "rods, J in tool axes, mode along y"]
    chosen += [min(readings, key=readings.__getitem__), max(readings, key=readings.__getitem__)]
    chosen += [min(readings, key=lambda name: abs(readings[name] - 6.70))]
    for name, part in zip(chosen, ("", "", ", the lowest", ", the highest", ", the nearest"), strict=True):
        yield Row(f"J^T M_θ J as C 25 prints it{part} ({name})", readings[name], "Hz", LOW, why)
    total = float(usual.robot.mass.sum())
    why = "nearer than all of these, but in no equation of C"
    yield Row(f"the whole mass, {total:.1f} kg, on 1/C_yy", _hertz(usual.free / total), "Hz", LOW, why)


def _cut(usual: Felt, flat: Felt) -> Iterator[Row]:
    case = slot(END)
    sim, period = mx.simulate(case), float(case.cut.tooth_period(case.tool))
    yield Row("teeth per second", 1 / period, "Hz", "about 700 Hz", "4 teeth at 8000 rpm; 700 Hz would be 10 500 rpm")
    full, settled = (round(start / period) * case.settings.steps_per_tooth for start in (FULL, SETTLED))
    force = np.asarray(sim.force)[settled:].mean(axis=0)
    locked = "the paper's seems to be F_y/K_yy, of a tool that cannot turn"
    yield Row("mean F_y in the full slot", force[1], "N", "", "the paper draws it, and prints no number")
    yield Row("F_y/K_yy", 1e6 * force[1] / usual.stiffness[1, 1], "µm", STATIC, NO_LENGTHS, (55.0, 58.5))
    yield Row("F_y/K_yy, a_3 = 0", 1e6 * force[1] / flat.stiffness[1, 1], "µm", STATIC, NO_LENGTHS, (55.0, 58.5))
    compliance = np.linalg.inv(np.asarray(arm().structure().stiffness))
    static = 1e6 * float(compliance[1, :3] @ force)
    yield Row("C_yx F_x + C_yy F_y, the tool free", static, "µm", STATIC, locked)
    y = 1e6 * np.asarray(sim.displacement)[:, 1]
    yield Row("mean displacement along y, simulated", y[settled:].mean(), "µm", STATIC, locked, _about(static, 0.005))
    yield Row("largest displacement along y, simulated", y[full:].max(), "µm", "63.2 µm", f"{locked}; damping not printed")


def table(of: Sequence[Row]) -> Table:
    """The rows for a terminal or a notebook."""
    made = Table(title="KUKA KR270, pose and slot of C", title_justify="left", show_edge=False, pad_edge=False)
    for column, justify in (("quantity", "left"), ("computed", "right"), ("paper", "right"), ("why they differ", "left")):
        made.add_column(column, justify=justify)
    for row in of:
        made.add_row(row.quantity, row.shown, row.paper or "—", row.why)
    return made


def main() -> None:
    mx.set_up()
    Console(width=150).print(table(rows()))


if __name__ == "__main__":
    main()
