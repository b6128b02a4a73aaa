"""Units of times and lengths, and degrees: they become seconds and metres."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd

from usnet_env.arrays import Floats
from usnet_env.tracks import columns

_RECORDING_ERA = (315_532_800, 4_102_444_800)  # seconds from 1970 to 1980 and to 2100
_MAX_INTERVAL = 0.05  # seconds between samples, or 72 minutes in days


def guess_time_unit(time: Floats, names: Mapping[str, str]) -> tuple[float, str]:
    """Seconds in one unit of times that are numbers, and what they seem to be if the column's name doesn't say it."""
    if unit_name := columns.split_unit(names["frame" if "frame" in names else "t"])[1]:
        return columns.TIME_UNITS.get(unit_name, 1.0), ""
    first = float(np.min(time))
    for unit, words in ((1e-3, "milliseconds"), (1e-6, "microseconds"), (1e-9, "nanoseconds")):
        if _RECORDING_ERA[0] <= first * unit <= _RECORDING_ERA[1]:
            return unit, f"{words} since 1970"
    steps = np.diff(np.unique(time))
    if 25_569 <= first <= 73_050 and len(steps) and np.median(steps) < _MAX_INTERVAL and (time != np.floor(time)).any():
        return 86_400.0, "days of a spreadsheet"
    return 1.0, ""


def scale_lengths(rows: pd.DataFrame, names: Mapping[str, str], length_unit: str | None) -> pd.DataFrame:
    """The rows with lengths in metres; the unit is ``length_unit``, or else that in the name of each axis."""
    for axis in ("x", "y", "z"):
        unit = length_unit or columns.split_unit(names.get(axis, ""))[1]
        if axis in rows and unit in columns.LENGTH_UNITS:
            rows[axis] *= columns.LENGTH_UNITS[unit]
    return rows


def project_positions(rows: pd.DataFrame, origin: Floats | None = None) -> tuple[list[Floats], Floats | None, str]:
    """The two or three coordinates, ``(S,)`` metres each, their origin if it is known, and what they are.

    Degrees (WGS 84) are projected to metres east and north of the middle of the tracks by the azimuthal equidistant
    projection. The middle is that of the 1st and the 99th percentiles, so that a wrong fix far away doesn't move it; or
    it is a given ``origin``.
    """
    if "lon" not in rows:
        return [rows[axis].to_numpy() for axis in ("x", "y", "z") if axis in rows], None, "metres"
    import pyproj

    longitude, latitude = rows["lon"].to_numpy(), rows["lat"].to_numpy()
    east = (longitude - longitude[0] + 180.0) % 360.0 - 180.0  # tracks may cross the 180th meridian
    centre = [float(np.quantile(degrees, (0.01, 0.99)).mean()) for degrees in (east, latitude)]
    centre[0] = (float(longitude[0]) + centre[0] + 180.0) % 360.0 - 180.0
    centre = centre if origin is None else origin[:2].tolist()
    local = f"+proj=aeqd +lon_0={centre[0]!r} +lat_0={centre[1]!r} +datum=WGS84 +units=m"
    axes = list(pyproj.Transformer.from_crs("EPSG:4326", local, always_xy=True).transform(longitude, latitude))
    height = 0.0
    if "z" in rows:
        height = float(np.round(rows["z"].mean()) if origin is None else origin[2])
        axes.append(rows["z"].to_numpy() - height)
    frame = "metres in a local azimuthal equidistant frame (pyproj), from degrees"
    return axes, np.array([*centre, height]), frame
