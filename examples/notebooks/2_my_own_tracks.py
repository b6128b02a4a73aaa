"""
My own tracks
=============

Who leads in recorded tracks? This makes a file as a tracker would, with one row for each animal and instant, and
looks for its leaders. Put the name of a file of yours into ``FILE``, and leave out the cell that makes one.
"""

# %%
import numpy as np
import pandas as pd

from usnet_env.tracks import LeaderTracker, find_leaders, read_tracks

FILE = "tracks.csv"

# %% [markdown]
# Eight birds; seven fly as bird-0 flew 1 to 3 s earlier, next to it.

# %%
rng = np.random.default_rng(0)
turns = np.cumsum(rng.normal(0, 0.12, 1400))
course = np.cumsum(np.stack([np.cos(turns), np.sin(turns)], axis=1), axis=0)
rows = []
for bird in range(8):
    delay = 0 if bird == 0 else rng.integers(2, 7)
    x, y = (course[200 - delay : 1400 - delay] + rng.normal(0, 5, 2) + rng.normal(0, 0.05, (1200, 2))).T
    rows.append(pd.DataFrame({"id": f"bird-{bird}", "t": 0.5 * np.arange(1200), "x": x, "y": y}))
pd.concat(rows).to_csv(FILE, index=False)

# %%
tracks = read_tracks(FILE)
print(tracks.report())

# %% [markdown]
# The leaders over the file, and what changes when.

# %%
found = find_leaders(tracks)
print(found)

# %% [markdown]
# An arrow leads to the one that is followed; it is as wide as the share of the windows, and its label is the delay.

# %%
found.plot()

# %%
found.plot_timeline()

# %%
found.plot_delays()

# %% [markdown]
# All of it as a table: a row for each window and each id that leads or follows in it.

# %%
print(found.to_frame().tail())

# %% [markdown]
# The same fixes as they would come: each change is announced as soon as several answers are sure of it.

# %%
tracker = LeaderTracker(step=1.0)
for t, fixes in pd.read_csv(FILE).query("t < 60").groupby("t"):
    for change in tracker.update(t, fixes[["x", "y"]], fixes["id"]).changes:
        print(change)
