"""From a case file (TOML) to a `Case`."""

import dataclasses
import difflib
import functools
import math
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import jax.numpy as jnp

from ._case import Case
from ._casekeys import FORCE, LAWS, OTHER_TABLES, SECTIONS, Section, table_of
from ._caseleaves import Leaf, leaves, rewrite
from ._caserobot import arm_of
from ._casesensor import clock_of, sensor_of
from ._cut import Cut
from ._settings import Settings
from ._stock import Stock, passage
from ._structure import Structure
from ._tool import EndMill
from ._units import EXPONENT, in_mm


class CaseError(ValueError):
    """A case that cannot be used; the message names the file, the key, what was given and what is allowed."""


@dataclasses.dataclass(frozen=True)
class CaseFile:
    """A case file that has been read: the case, and the text it came from.

    - `source`: the name of the file, for messages.
    - `text`: its TOML text.
    - `case`: its `Case`.
    """

    source: str
    text: str
    case: Case

    @classmethod
    def read(cls, path: str | os.PathLike) -> "CaseFile":
        """Read a file. Raises `CaseError`."""
        source = os.fspath(path)
        try:
            text = Path(path).read_text(encoding="utf-8")
        except OSError as error:
            raise CaseError(f"{source}: the case file cannot be read: {error.strerror}") from None
        except UnicodeDecodeError:
            raise CaseError(f"{source}: not a text file in UTF-8; a case file is TOML") from None
        return cls.from_text(text, source)

    @classmethod
    def from_text(cls, text: str, source: str = "case") -> "CaseFile":
        """Read TOML text; `source` names it in messages. Raises `CaseError`."""
        import tomlkit
        from tomlkit.exceptions import TOMLKitError

        try:
            tables = tomlkit.parse(text).unwrap()
        except TOMLKitError as error:
            raise CaseError(f"{source}: not valid TOML: {error}") from None
        return cls(source, text, _case(tables, source))

    def changed(self, changes: Mapping[str, Any], source: str) -> "CaseFile":
        """The file with other values, tables in tables as `tables` has them; `source` names it. Raises `CaseError`."""
        import tomlkit

        return CaseFile.from_text(tomlkit.dumps(_merged(self.tables, changes)), source)

    @functools.cached_property
    def tables(self) -> dict[str, Any]:
        """The file as plain dictionaries, lists and values, with the tables of fits and measurements."""
        import tomlkit

        return tomlkit.parse(self.text).unwrap()

    @functools.cached_property
    def leaves(self) -> dict[str, Leaf]:
        """Every number of the file that is a leaf of the case, by its name.

        The name is that of the file: `force.k0`; `structure.damping_ratio.x` where there is one per axis (`.0`, `.1`
        with mode shapes, whose coordinates have no axis); `structure.stiffness.0.1` for an entry of a matrix. A number
        which the file leaves to its default has no name, nor have `cut.feed_per_tooth` and `stock.immersion`: the case
        holds the feed rate and the border that follow from them.
        """
        return leaves(self.tables, _sections(self.tables))

    def leaf(self, name: str) -> Leaf:
        """The leaf called `name`. Raises `CaseError` where there is none, and where another could not be written."""
        if name not in self.leaves:
            raise CaseError(
                f"{self.source}: {name} is not a number of this case file.{_nearest(name, self.leaves)}\n"
                f"  Its numbers: {', '.join(self.leaves)}"
            )
        if (tie := self._tie(name)) is not None:
            raise CaseError(f"{self.source}: another {name} cannot be written, since {tie}")
        return self.leaves[name]

    def _tie(self, name: str) -> str | None:
        """Why another number in the file would not mean the case with that number: something else moves along."""
        cut = self.tables.get("cut", {})
        if name in ("tool.diameter", "cut.start.y") and "immersion" in self.tables.get("stock", {}):
            return "stock.immersion counts from the edge of the tool; give the borders of the stock as stock.y"
        if name == "tool.diameter" and "start" not in cut:
            return "cut.start, where none is given, is one radius before the stock; give cut.start"
        if name == "cut.spindle_speed" and "feed_per_tooth" in cut:
            return "the feed rate follows from cut.feed_per_tooth; give cut.feed_rate"
        if name == self._last_pitch:
            return "the last pitch angle is what the others leave of the turn; take the others"
        return None

    @property
    def _last_pitch(self) -> str:
        return f"tool.pitch.{len(self.tables['tool'].get('pitch', ())) - 1}"

    def with_values(self, values: Mapping[str, float]) -> str:
        """The file's text with other numbers: SI values by leaf name, written in the units of the file.

        Comments, layout and everything else stay as they are; of pitch angles the last one makes up the turn. Raises
        `CaseError` for a name that is no leaf, and one of which no other number can be written.
        """
        # An open exponent may be among the values: a number whose unit has one is written anew in any case.
        written = {leaf: leaf.value for leaf in self.leaves.values() if EXPONENT in leaf.si_unit}
        written |= {self.leaf(name): value for name, value in values.items()}
        pitch = {name: leaf for name, leaf in self.leaves.items() if leaf.field == ("tool", "pitch")}
        if values.keys() & pitch.keys():
            others = (values.get(name, leaf.value) for name, leaf in pitch.items() if name != self._last_pitch)
            written[pitch[self._last_pitch]] = 2 * math.pi - sum(others)
        return rewrite(self.text, written)


def _merged(tables: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    merged = dict(tables)
    for key, value in changes.items():
        inner = merged.get(key)
        merged[key] = _merged(inner, value) if isinstance(inner, Mapping) and isinstance(value, Mapping) else value
    return merged


def load_case(case: str | os.PathLike | Mapping[str, Any]) -> Case:
    """The `Case` that a case file describes.

    **Arguments:**

    - `case`: the path of a TOML file, or its tables as dictionaries. Bare numbers are SI; others are text with a unit
      ("10000 rpm").

    Raises `CaseError`, a `ValueError`: no such file, broken TOML, a key that is unknown or missing, a wrong unit or
    type, a value out of range, a stock that the tool never meets. The tables of fits and measurements are left alone.
    """
    return _case(case, "case") if isinstance(case, Mapping) else CaseFile.read(case).case


def _case(tables: Mapping[str, Any], source: str) -> Case:
    try:
        values = {name: _read(name, section, table_of(tables, name)) for name, section in _sections(tables).items()}
        return _build(values, Path(source).parent)
    except ValueError as error:
        raise CaseError(f"{source}: {error}") from error


def _build(values: Mapping[str, dict[str, Any]], folder: Path) -> Case:
    tool = EndMill(**values["tool"])
    force = dict(values["force"])
    law = LAWS[force.pop("law")](**force)
    cut = _cut(tool, **values["cut"])
    structure = Structure(**values["structure"]) if values["structure"] else Structure.rigid()
    if values["robot"]:
        if values["structure"]:
            raise ValueError("[structure] and [robot] given; each says what holds the tool. Give one of them")
        structure = arm_of(folder, *(values[name] for name in ("robot", "robot.tool", "robot.links", "robot.loads")))
    settings = Settings.suited(tool, law, structure, cut, **values["simulation"])
    sensor = sensor_of(*(values[name] for name in ("sensor", "sensor.resonances", "sensor.low_pass")))
    case = Case(tool, law, cut, _stock(tool, cut, **values["stock"]), structure, settings, sensor, clock_of(values["clock"]))
    _require_met(case)
    return case


def _cut(tool: EndMill, spindle_speed, depth, feed_rate=None, feed_per_tooth=None, start=None) -> Cut:
    if feed_per_tooth is not None:
        feed_rate = feed_per_tooth * spindle_speed * tool.teeth / (2 * math.pi)
    if start is None:
        return Cut.touching(tool, spindle_speed, feed_rate, depth)
    return Cut(spindle_speed, feed_rate, depth, start)


def _stock(tool: EndMill, cut: Cut, x=(0.0, None), y=None, immersion=None, milling=None) -> Stock:
    if immersion is None:
        if milling is not None:
            raise ValueError(f'stock.milling: "{milling}" given without stock.immersion, of which it is the side')
        return Stock.box(x, (None, None) if y is None else y)
    if y is not None:
        raise ValueError("stock: y and immersion given; each says where the stock is across the feed. Give one of them")
    return Stock.immersed(tool, immersion, milling, x, axis_y=cut.start[1])


def _require_met(case: Case) -> None:
    """Raise `ValueError` where the tool, on its commanded path, never meets the stock in the simulated time.

    The tool is a disc as large as its farthest tooth may be. Until it meets the stock nothing moves it from that path.
    """
    tool, cut = case.tool, case.cut
    x, y = map(float, cut.start)
    radius = sum(float(jnp.max(part)) for part in (tool.radius, tool.runout, tool.offset) if part is not None)
    feed_rate, duration = float(cut.feed_rate), case.settings.periods * float(cut.tooth_period(tool))
    end = x + feed_rate * duration
    met = passage(case.stock, y, radius)
    if met is not None and met[0] < end and x < met[1]:
        return
    if met is None:
        sides = " and ".join(in_mm(n * o) for n, o in zip(case.stock.normals[:, 1], case.stock.offsets, strict=True) if n)
        way_out = f"It passes beside it: the stock has borders at y = {sides}. Change cut.start or stock.y"
    elif x >= met[1]:
        way_out = f"It leaves the stock behind at x = {in_mm(met[1])}. Start before that (cut.start), or change stock.x"
    elif feed_rate == 0:
        way_out = f"It has no feed, and would only beyond x = {in_mm(met[0])}. Start there (cut.start), or give a feed"
    else:
        way_out = (
            f"It would at x = {in_mm(met[0])}, after {(met[0] - x) / feed_rate:.4g} s. Start nearer (cut.start), or "
            "simulate longer (simulation.duration)"
        )
    raise ValueError(
        f"stock: the tool does not meet it in the simulated time. Its centre goes from x = {in_mm(x)} (cut.start) to "
        f"{in_mm(end)}, along y = {in_mm(y)}, at {in_mm(feed_rate)}/s (cut.feed_rate) for {duration:.4g} s; its radius is "
        f"{in_mm(radius)}.\n  {way_out}"
    )


def _sections(tables: Mapping[str, Any]) -> dict[str, Section]:
    """The tables that this file may hold, [force] with the keys of its law. Raises `ValueError`."""
    for name in tables:
        if name in OTHER_TABLES:
            continue
        if name not in SECTIONS:
            hint = _owner(name) or _nearest(name, SECTIONS)
            raise ValueError(f"[{name}] is not a table of a case file.{hint}\n  Tables: {', '.join(SECTIONS)}")
    if (force := table_of(tables, "force")) is None:
        return SECTIONS
    if "law" not in force:
        raise ValueError(f"force.law is missing.\n  [force] takes: {SECTIONS['force']} and the keys of the law")
    law = SECTIONS["force"].keys["law"].read("force.law", force["law"], force)
    return SECTIONS | {"force": FORCE[str(law)]}


def _read(name: str, section: Section, table: Mapping[str, Any] | None) -> dict[str, Any]:
    """The values of the table called `name`, in SI. Raises `ValueError`."""
    inner = [f"[{name}.{table}]" for table in _inner(name)]
    takes = f"\n  [{name}] takes: {section}" + (f"; and the tables {', '.join(inner)}" if inner else "")
    if table is None:
        if section.required:
            raise ValueError(f"the table [{name}] is missing.{takes}")
        return {}
    for key in table:
        if key not in section.keys and f"{name}.{key}" not in SECTIONS:
            hint = _owner(key) or _nearest(key, [*section.keys, *_inner(name)])
            raise ValueError(f"{name}.{key} is not a key of [{name}].{hint}{takes}")
    for key, kind in section.keys.items():
        if kind.required and key not in table:
            raise ValueError(f"{name}.{key} is missing.{takes}")
    for group in section.exactly_one:
        if sum(key in table for key in group) != 1:
            raise ValueError(f"give {' or '.join(f'{name}.{key}' for key in group)}: one of them, and only one.{takes}")
    return {
        key: section.keys[key].read(f"{name}.{key}", value, table) for key, value in table.items() if key in section.keys
    }


def _inner(name: str) -> list[str]:
    """The tables in the table of this name."""
    return [section.rpartition(".")[2] for section in SECTIONS if section.rpartition(".")[0] == name]


def _nearest(word: str, words: Iterable[str]) -> str:
    close = difflib.get_close_matches(word, list(words), n=1, cutoff=0.5)
    return f" Did you mean {close[0]}?" if close else ""


def _owner(key: str) -> str:
    tables = [f"[{name}]" for name, section in SECTIONS.items() if key in section.keys]
    laws = [f'the force law "{law}"' for law, section in FORCE.items() if key in section.keys]
    return f" It belongs to {(tables + laws)[0]}." if tables or laws else ""
