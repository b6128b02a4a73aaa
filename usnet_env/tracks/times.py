"""Times of windows as people read them: a date that all of them share is written once."""

from __future__ import annotations

from usnet_env.tracks.leaders import FoundLeaders


def find_date(found: FoundLeaders) -> str:
    """The date of all windows if the times are timestamps of one day, otherwise nothing."""
    times = [time for window in found.windows for time in (window.start, window.end)]
    dates = {time.partition("T")[0] for time in times if isinstance(time, str)}
    return dates.pop() if len(dates) == 1 else ""


def format_time(time: float | int | str, date: str) -> str:
    """A time of the file: up to 12 digits, or a timestamp in UTC without ``date`` and final zeros."""
    if not isinstance(time, str):
        return f"{time:.12g}" if isinstance(time, float) else str(time)
    day, _, clock = time.removesuffix("Z").partition("T")
    clock = clock.rstrip("0").removesuffix(".") if "." in clock else clock
    return clock if day == date else f"{day} {clock}"
