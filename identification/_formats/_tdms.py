"""National Instruments' TDMS: a column is "group/channel"; its unit is the property `unit_string`, its times follow from
`wf_increment` and `wf_start_offset` where it is a waveform."""

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from .._measured import TraceError
from ._arrays import Array, unreadable, with_arrays
from ._raw import EvenTimes, Raw


def read(path: Path) -> Raw:
    """The columns of a TDMS file. Raises `TraceError`, which begins with the path."""
    from nptdms import TdmsFile

    arrays = []
    try:
        with TdmsFile.open(path) as file:
            complete = not file.file_status.incomplete_final_segment
            for group in file.groups():
                for channel in group.channels():
                    if channel.dtype.kind in "iuf":
                        unit = str(channel.properties.get("unit_string", "")).strip() or None
                        read = partial(_channel, path, group.name, channel.name)
                        name = f"{group.name}/{channel.name}"
                        arrays.append(Array(name, (len(channel),), read, unit, _clock(channel.properties)))
    except Exception as error:
        raise unreadable(path, "a TDMS file", error) from None
    if not complete:
        raise TraceError(f"{path}: the file is cut short: its last segment is not complete. Copy or record it again")
    return with_arrays(path, arrays)


def _clock(properties: Mapping[str, Any]) -> EvenTimes | None:
    if "wf_increment" not in properties:
        return None
    start, step = float(properties.get("wf_start_offset", 0)), float(properties["wf_increment"])
    return EvenTimes(start, step, properties.get("wf_start_time"))


def _channel(path: Path, group: str, channel: str) -> np.ndarray:
    from nptdms import TdmsFile

    try:
        with TdmsFile.open(path) as file:
            return file[group][channel][:]
    except Exception as error:
        raise unreadable(path, "a TDMS file", error) from None
