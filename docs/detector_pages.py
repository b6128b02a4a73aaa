"""Generate a page for each detector that ships: what it assumes, what it needs, and its arguments."""

from __future__ import annotations

from functools import cache

from docstrings import describe_class

from usnet_env.plugins import DETECTORS, DetectorEntry, list_detectors

__all__ = ["detector_classes", "detector_pages"]

_NO_ASSUMPTION = "Nothing: it is a trivial policy, with which others are compared."
#: What each detector assumes about the swarm.
ASSUMPTIONS = {
    "random": _NO_ASSUMPTION,
    "destroy-all": _NO_ASSUMPTION,
    "none": _NO_ASSUMPTION,
    "one-per-round": "A follower's velocity is a linear function of the recent velocities of its head.",
    "lagged-correlation": "A follower turns as its head turned a few steps earlier; no UAV copies its own past.",
    "lagged-regression": "A follower's velocity is a linear function of the recent velocities of its head.",
    "granger": "A head's recent velocities explain a follower's velocity better than the follower's own past does.",
    "factions": "A follower's flight resembles the earlier flight of its leader; heads follow no UAV.",
    "front-most": "A head flies in front of the UAVs that move like it.",
    "directional-delays": "A follower takes the direction of its head after a delay, which differs between pairs.",
    "lagged-network": "A follower's velocity, acceleration or direction is correlated with earlier ones of its head.",
    "net-lag-regression": "A head's past predicts its followers better than their past predicts the head.",
    "transfer-entropy": "A head's past says more about a follower's next velocity than the follower's own past does.",
    "mflica": "A follower's track is that of its head, shifted and warped in time; there are several heads.",
    "flica": "A follower's track is that of its head, shifted and warped in time; there is one head.",
    "gassl": "One cluster with one head. A follower's next velocity is predicted best from its head's last ones.",
    "mc-gassl": "Clusters are apart in the features of a recurrent network; in each, the assumption of `gassl`.",
    "neural-granger": "One cluster with one head, whose past improves the prediction of the most other UAVs.",
    "lead-votes": "Members of a cluster vote for the same UAV; in each cluster, the assumption of `neural-granger`.",
    "follow-mixture": "The UAVs of a group move simultaneously by one law, which is a function of their head's past.",
    "learned": "The swarm resembles those of its training: its strategies, mobilities and sizes.",
}
#: Pages that explain a detector, and a figure with its caption.
EXPLANATIONS = {
    "gassl": "gassl",
    "mc-gassl": "mc_gassl",
    "neural-granger": "neural_granger",
    "lead-votes": "lead_votes",
    "follow-mixture": "follow_mixture",
    "learned": "learned",
}
FIGURES = {
    "gassl": ("paper/attention-heads-f1-m15.png", "Attention weights and the five attention heads, one cluster, f1."),
    "mc-gassl": ("paper/example-m8-n185.png", "One game with 8 clusters and 185 UAVs, with the attention weights."),
    "follow-mixture": ("follow_mixture.svg", "The steps of follow-mixture."),
}


@cache
def detector_classes() -> dict[str, str]:
    """The class of each detector that ships, by name, with its module."""
    points = DETECTORS.entry_points()
    return {name: point.value.replace(":", ".") for name, point in points.items() if name in ASSUMPTIONS}


def detector_pages() -> dict[str, str]:
    """Markdown of the pages, by file name (without suffix)."""
    classes = detector_classes()
    return {entry.name: _write_page(entry, classes[entry.name]) for entry in list_detectors() if entry.name in classes}


def _write_page(entry: DetectorEntry, target: str) -> str:
    tags, name = entry.tags, entry.name
    facts = {
        "assumes": ASSUMPTIONS[name],
        "needs beyond the core": ", ".join(tags.needs) or "nothing",
        "largest window": "no limit" if tags.most_uavs is None else f"{tags.most_uavs:,} UAVs",
        "shortest window": f"{tags.least_steps} step{'s' * (tags.least_steps != 1)}",
        "uses positions": "yes" if tags.uses_positions else "no, velocities only",
        "number of clusters M": "may be given" if tags.takes_clusters else "is not taken",
    }
    rows = "\n".join(f"| {fact} | {value} |" for fact, value in facts.items())
    links = [f"[How it works](../{EXPLANATIONS[name]}.md)"] if name in EXPLANATIONS else []
    links += ["[All detectors](../detectors.md)", "[Results](../results/index.md)"]
    figure = ""
    if name in FIGURES:
        path, caption = FIGURES[name]
        figure = f"![{caption}](../images/{path})\n\n{caption}\n\n"
    return f"""# {name}

{entry.description}

| | |
| --- | --- |
{rows}

`make_detector("{name}")` creates it. `usnet evaluate --detector {name}` plays it. See also: {", ".join(links)}.

{figure}{describe_class(DETECTORS.entry_points()[name].load())}

## Class

```{{eval-rst}}
.. autoclass:: {target}
```
"""
