"""Print a ranked table: the custom detector and detectors that ship with USNET, on the same swarms."""

import usnet_env

result = usnet_env.evaluate(
    "USNET/MultiCluster-v0",
    ["most-copied", "lagged-regression", "lagged-correlation", "random(count=3)", "destroy-all"],
    episodes=20,
    env_kwargs={"follow": "f3", "clusters": 3, "uavs": 40, "observation_steps": 30},
)
print("place  detector                  F1 of round 1         J")
ranked = sorted(result.summary, key=lambda entry: -entry["metrics"]["f1_first"]["mean"])
for place, entry in enumerate(ranked, start=1):
    f1, j = entry["metrics"]["f1_first"], entry["metrics"]["J"]
    print(f"{place:5}  {entry['detector']:24}  {f1['mean']:.2f} ({f1['low']:.2f}–{f1['high']:.2f})  {j['mean']:8.2f}")
