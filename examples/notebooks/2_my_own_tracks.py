"""
From Movebank to a figure
=========================

Fixes of GPS collars, a figure with evidence, and leaders while fixes come. It needs
``pip install '.[render,tracks]'``. For a file of your own, set ``FILE`` and leave out the cell that makes one.
"""

# %%
import numpy as np
import pandas as pd

from usnet_env.tracks import LeaderTracker, find_leaders, read_tracks

FILE = "tracks.csv"

# %% [markdown]
# Two packs of wolves with GPS collars, a fix every 15 minutes for 10 days. ``alpha`` leads four of them and ``beta``
# two, who go 15 to 60 minutes after on the same way. Columns and degrees are those of Movebank.

# %%
rng = np.random.default_rng(1)
fixes = 960
times = pd.date_range("2024-05-01", periods=fixes, freq="15min").strftime("%Y-%m-%d %H:%M:%S.000")
wolves = []
for leader, lags, middle in (("alpha", (1, 2, 3, 4), 0.0), ("beta", (1, 2), 0.2)):
    course = np.cumsum(rng.normal(0, 0.5, fixes + 4))
    way = np.cumsum(150 * np.stack([np.cos(course), np.sin(course)], axis=1), axis=0)  # metres
    for lag in (0, *lags):
        x, y = (way[4 - lag : fixes + 4 - lag] + rng.normal(0, 15, (fixes, 2))).T
        name = f"{leader}-{lag}" if lag else leader
        place = {"location-long": 11 + middle + x / 70_000, "location-lat": 51 + y / 111_000}
        wolves.append(pd.DataFrame({"timestamp": times, **place, "individual-local-identifier": name}))
pd.concat(wolves).to_csv(FILE, index=False)
pd.read_csv(FILE).head()

# %% [markdown]
# What was read, and what is doubtful in it:

# %%
tracks = read_tracks(FILE)
print(tracks.report())

# %% [markdown]
# The leaders over the file, each with the reason:

# %%
found = find_leaders(tracks)
found

# %% [markdown]
# The evidence for one leader: how well each follower repeats its velocity, at each delay. A peak to the right of 0 says
# that the follower comes later; the line is what chance gives.

# %%
found.plot_evidence("alpha")

# %%
found.evidence("alpha")

# %% [markdown]
# An arrow leads to the one that is followed; it is as wide as the share of the windows, and its label is the delay.

# %%
found.plot()

# %% [markdown]
# A row for each window and each id that leads or follows in it, for statistics of your own:

# %%
found.to_frame().tail()

# %% [markdown]
# Live
# ----
#
# The same fixes as they would come, in metres. A change is announced as soon as several answers are sure of it.

# %%
tracker = LeaderTracker(step=900.0)
positions = tracks.position.reshape(len(tracks.ids), fixes, 3)  # the fixes of this file are at the same times
for i in range(100):
    for change in tracker.update(900.0 * i, positions[:, i], tracks.ids).changes:
        print(f"hour {i / 4:.1f}:", str(change).partition(": ")[2])

# %% [markdown]
# If ``beta`` disappeared, which leader would each follow? By the rule of the game, the nearest one that is left:

# %%
window = tracker.track_window
after = tracker.detection.after([name == "beta" for name in window.ids], window.window)
pd.DataFrame({"id": window.ids, "follows": [window.ids[head] if head >= 0 else "" for head in after]})
