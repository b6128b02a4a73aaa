"""The words and few numbers of an episode that pictures, replays and the terminal share."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from usnet_env.config import format_count
from usnet_env.objectives import f1, group_leader_accuracy
from usnet_env.replay.episode import EpisodeRecord

#: What a UAV is in a round: a candidate that is a head, one that is not, a head that is no candidate, or another UAV;
#: and a candidate where the truth is not known.
HIT, REDUNDANT, MISSED, OTHER, LEADER = "hit", "redundant", "missed", "other", "leader"

_MAX_LISTED = 30  # rows of the table of a round's candidates


def name_uav(record: EpisodeRecord, uav: int) -> str:
    """The id of a UAV in the file of recorded tracks, or its number."""
    ids = record.config.get("ids")
    return f"UAV {uav}" if ids is None else str(ids[uav])


def name_round(record: EpisodeRecord) -> str:
    """The word for a part of an episode: a round of a game, or a window of recorded tracks."""
    return "Window" if record.recorded else "Round"


def name_score(record: EpisodeRecord) -> tuple[str, float]:
    """Name and value of the score: J of the game, or F1 of recorded tracks, where a missed head costs nothing in J."""
    if record.recorded:
        return "F1", float(f1(record.head, record.candidates[0]))
    return "J", float(record.objective[-1])


def name_game(record: EpisodeRecord) -> str:
    """Say which detector played which episode, and the seed if there is one."""
    seed = "" if record.seed is None else f", seed {record.seed}"
    return f"{record.detector or 'A detector'} on {record.env_id or 'an episode'}{seed}"


def name_times(record: EpisodeRecord, number: int) -> str:
    """When a window of recorded tracks (from 1) begins and ends in the file, with a colon; nothing in a game."""
    start, end = (record.config.get(name, [None] * record.rounds)[number - 1] for name in ("start", "end"))
    return "" if start is None else f"{start} to {end}: "


def describe_round(record: EpisodeRecord, number: int) -> str:
    """Describe a round (from 1) in a few words."""
    r = number - 1
    count = int(record.candidates[r].sum())
    times = name_times(record, number)
    if not record.labelled:
        return f"{times}{format_count(count, 'leader')} found"
    candidates = f"{times}{format_count(count, 'candidate')}"
    remaining = f"{format_count(int(record.heads_left[r]), 'head')} {'not named' if record.recorded else 'left'}"
    if record.over_budget[r]:
        return f"{candidates}, over the shot budget: no UAV destroyed, {remaining}"
    hits, redundant = int(record.hits[r]), int(record.redundant[r])
    return f"{candidates} ({format_count(hits, 'head')} hit, {redundant} redundant), {remaining}"


def describe_outcome(record: EpisodeRecord) -> str:
    """Describe in one sentence how the episode ended, with its J; in recorded tracks with F1 and group leaders."""
    heads, remaining = int(record.head.sum()), int(record.heads_left[-1])
    rounds = format_count(record.rounds, name_round(record).lower())
    if not record.labelled:
        return f"In {rounds}, {heads} of {record.uavs} ids lead at least once; the truth is unknown."
    score = f"J = {record.objective[-1]:.3f} ({'J_m, lower is better' if record.problem == 'P2' else 'J_s, 0 is best'})"
    if record.recorded:
        groups = group_leader_accuracy(record.root[0], record.scores[0])
        score = f"F1 = {name_score(record)[1]:.3f} (1 is best), group leaders {groups:.2f}"
    redundant = format_count(int(record.redundant.sum()), "redundant candidate")
    found = f"{heads - remaining} of {format_count(heads, 'head')} found" if heads else "No head to find"
    return f"{found} in {rounds} with {redundant}: {score}."


def mark_words(record: EpisodeRecord, number: int) -> NDArray[np.object_]:
    """``(N,)``: what each UAV is in a round (from 1), such as :data:`HIT`."""
    r = number - 1
    is_candidate, is_head = record.candidates[r], record.head & record.alive[r]
    marks = np.full(record.uavs, OTHER, object)
    if record.labelled:
        marks[is_head], marks[is_candidate], marks[is_candidate & is_head] = MISSED, REDUNDANT, HIT
    else:
        marks[is_candidate] = LEADER
    return marks


def _find_reason(record: EpisodeRecord, r: int, uav: int) -> str:
    """The detector's reason in round ``r`` (from 0), or which candidate is in the group that it found for the UAV."""
    if record.reasons is not None and str(uav) in record.reasons[r]:
        return record.reasons[r][str(uav)]
    if record.clusters is None or record.candidates[r, uav] or record.clusters[r, uav] < 0:
        return ""
    candidates = np.flatnonzero(record.candidates[r] & (record.clusters[r] == record.clusters[r, uav])).tolist()
    return f"found in the group of {', '.join(name_uav(record, i) for i in candidates)}" if candidates else ""


def annotated_uavs(record: EpisodeRecord, number: int) -> list[tuple[int, str, str]]:
    """The candidates and missed heads of a round (from 1), highest score first: index, mark, and the reason."""
    r, marks = number - 1, mark_words(record, number)
    annotated = []
    for i in [i for i in np.argsort(-record.scores[r], kind="stable").tolist() if marks[i] != OTHER][:_MAX_LISTED]:
        probability = "" if record.probability is None else f"p {record.probability[r, i]:.2f}, "
        reason = _find_reason(record, r, i)
        annotated.append((i, marks[i], f"{probability}score {record.scores[r, i]:.3g}{': ' * bool(reason)}{reason}"))
    return annotated


def tell_round(record: EpisodeRecord, number: int, names: Sequence[str]) -> tuple[str, str]:
    """Tell a round (from 1) in Markdown, before the answer and with it; ``names`` are those of all UAVs."""
    start = f"**{name_round(record)} {number} of {record.rounds}**"
    if record.choices is not None and record.choices[number - 1]:
        lines = [f"- {agent}, {text}" for agent, text in record.choices[number - 1].items()]
        start = "\n".join([start, "", "What the heads chose for this window:", "", *lines])
    lines = [f"- **{names[i]}** {word}, {reason}" for i, word, reason in annotated_uavs(record, number)]
    hidden = int((mark_words(record, number) != OTHER).sum()) - len(lines)
    lines += [f"- … and {hidden} more"] * (hidden > 0)
    before = f"{start}\n\n{name_times(record, number)}".rstrip(": \n")
    return before, f"{start}\n\n{describe_round(record, number)}.\n\n" + "\n".join(lines)


def explain_replay(record: EpisodeRecord) -> str:
    """Explain a recording in Markdown."""
    outcome = f"**{record.detector or 'A detector'}:** {describe_outcome(record)}"
    if not record.labelled:
        return f"{outcome}\n\nThe truth is unknown: colours, links and green marks show what the detector found.\n"
    return f"""{outcome}

**Left:** what the detector sees, equal dots. With its answer, blue spheres are candidates, colours the groups that it
found, and a larger dot means a higher {"score" if record.probability is None else "probability"}.

**Right:** the truth, large points for heads and followers in the colour of their head. Green spheres are hits, orange
boxes redundant candidates, white spheres heads that were not named; yellow points decoys, grey ones destroyed UAVs.
"""
