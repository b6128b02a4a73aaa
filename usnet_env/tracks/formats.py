"""Tables: the names of the columns, and what reads some of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
import pandas as pd

from usnet_env.tracks import columns as roles

#: The names of the columns, and what reads some of them: it takes names by role, and its columns are the roles.
Table = tuple[list[str], Callable[[Mapping[str, str]], pd.DataFrame]]
NUMBERS = roles.ROLES.keys() - set(roles.LABELS)


def as_table(frame: pd.DataFrame) -> Table:
    """The columns of a data frame."""
    return list(frame), lambda names: frame[list(names.values())].set_axis(list(names), axis=1)


def as_long(table: Table) -> Table:
    """A table with a row for each time, such as ``t, x1, y1, x2, y2``, as one with a row for each sample of an id."""
    header, read = table
    plain, wide = {roles.split_unit(name)[0] for name in header}, roles.find_wide(header)
    if len(wide) < 2 or {"x", "y"} <= plain or plain & {name.replace("-", "_") for name in roles.ROLES["id"]}:
        return table
    rest = [name for name in header if not any(name in axes.values() for axes in wide.values())]
    if not plain & {*roles.ROLES["t"], *roles.ROLES["frame"]}:
        rest.append("frame")  # the number of the row

    def read_long(names: Mapping[str, str]) -> pd.DataFrame:
        own = {f"{axis}:{label}": axes[axis] for label, axes in wide.items() for axis in names if axis in axes}
        times = {role: name for role, name in names.items() if name in header}
        rows = read(times | own)
        frame = rows[list(times)] if times else pd.DataFrame({"frame": np.arange(len(rows))})
        parts = [
            frame.assign(id=label, **{axis: rows[f"{axis}:{label}"] for axis in axes if f"{axis}:{label}" in rows})
            for label, axes in wide.items()
        ]
        return pd.concat(parts, ignore_index=True).dropna(subset=["x", "y"], ignore_index=True)

    return ["id", *rest, "x", "y", *(["z"] if all("z" in axes for axes in wide.values()) else [])], read_long
