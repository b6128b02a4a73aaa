"""The words and few numbers of an episode that pictures, replays and the terminal share."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from usnet_env.config import format_count
from usnet_env.objectives import f1, group_leader_accuracy
from usnet_env.replay.episode import EpisodeRecord

#: What a UAV is in a round: a candidate that is a head, one that is not, a head that is no candidate, or another UAV;
#: and a candidate where the truth is not known.
HIT, REDUNDANT, MISSED, OTHER, LEADER = "hit", "redundant", "missed", "other", "leader"

_MOST_LISTED = 30  # rows of the table of a round's candidates
_FEWEST_SCORES, _MOST_SCORES, _UNMARKED = 12, 40, 5


def name_uav(record: EpisodeRecord, uav: int) -> str:
    """Name a UAV: its id in the file of recorded tracks, or its number."""
    ids = record.config.get("ids")
    if ids is None:
        return f"{'track' if record.recorded else 'UAV'} {uav}"
    return str(ids[uav])


def name_kind(record: EpisodeRecord) -> str:
    """The word for what moves: a UAV, or an id of recorded tracks."""
    return "id" if record.recorded else "UAV"


def name_round(record: EpisodeRecord) -> str:
    """The word for a part of an episode: a round of a game, or a window of recorded tracks."""
    return "Window" if record.recorded else "Round"


def name_score(record: EpisodeRecord) -> tuple[str, float | None]:
    """Name and value of the score: J of the game, or F1 of recorded tracks; ``None`` if the truth is not known.

    J of recorded tracks does not count: they have one round, in which a missed head costs nothing.
    """
    if not record.labelled:
        return "F1", None
    if record.recorded:
        return "F1", float(f1(record.head, record.candidates[0]))
    return "J", float(record.objective[-1])


def name_game(record: EpisodeRecord) -> str:
    """Say which detector played which episode, and the seed if there is one."""
    seed = "" if record.seed is None else f", seed {record.seed}"
    return f"{record.detector or 'A detector'} on {record.env_id or 'an episode'}{seed}"


def describe_round(record: EpisodeRecord, number: int) -> str:
    """Describe a round (from 1) in a few words."""
    r = number - 1
    named = int(record.candidates[r].sum())
    start, end = (record.config.get(name, [None] * record.rounds)[r] for name in ("start", "end"))
    when = "" if start is None else f"{start} to {end}: "
    if not record.labelled:
        return f"{when}{format_count(named, 'leader')} found"
    candidates = f"{when}{format_count(named, 'candidate')}"
    left = f"{format_count(int(record.heads_left[r]), 'head')} {'not named' if record.recorded else 'left'}"
    if record.over_budget[r]:
        return f"{candidates}, over the shot budget: no UAV destroyed, {left}"
    hits, redundant = int(record.hits[r]), int(record.redundant[r])
    return f"{candidates} ({format_count(hits, 'head')} hit, {redundant} redundant), {left}"


def describe_outcome(record: EpisodeRecord) -> str:
    """Describe in one sentence how the episode ended, with its J; in recorded tracks with F1 and group leaders."""
    heads, left = int(record.head.sum()), int(record.heads_left[-1])
    if not record.labelled:
        windows = format_count(record.rounds, "window")
        return f"In {windows}, {heads} of {record.uavs} ids lead at least once; the truth is unknown."
    all_found = heads > 1 and not left
    found = f"All {heads} heads found" if all_found else f"{heads - left} of {format_count(heads, 'head')} found"
    redundant = format_count(int(record.redundant.sum()), "redundant candidate")
    if record.recorded:
        found, groups = found if heads else "No id leads", ""
        if heads:
            groups = f", group leaders {group_leader_accuracy(record.root[0], record.scores[0]):.2f}"
        windows = format_count(record.rounds, "window")
        return f"{found} in {windows} with {redundant}: {_tell_score(record, 3)}{groups}."
    sense = "J_m, lower is better" if record.problem == "P2" else "J_s, 0 is best"
    rounds = format_count(record.rounds, "round")
    return f"{found} in {rounds} with {redundant}: J = {record.objective[-1]:.3f} ({sense})."


def _tell_score(record: EpisodeRecord, digits: int) -> str:
    """The score that counts, and which value is best, in a few words."""
    name, value = name_score(record)
    best = 1 if record.recorded or record.problem == "P2" else 0
    return f"{name} = {value:.{digits}f} ({best} is best)"


def rank_scores(record: EpisodeRecord, number: int) -> NDArray[np.intp]:
    """Indices of the living UAVs that a chart of a round's scores shows (number from 1), highest score first.

    If there is not room for all, heads are preferred, then candidates. Among equal scores, candidates are first. There
    are 12 to 40 UAVs, if so many live.
    """
    r = number - 1
    scores, named = record.scores[r], record.candidates[r]
    living = np.flatnonzero(record.alive[r])
    marked = int((named | record.head)[living].sum())
    count = min(max(marked + _UNMARKED, _FEWEST_SCORES), _MOST_SCORES)
    shown = living[np.lexsort((-scores[living], ~named[living], ~record.head[living]))][:count]
    return shown[np.lexsort((shown, ~named[shown], -scores[shown]))]


def mark_words(record: EpisodeRecord, number: int) -> NDArray[np.object_]:
    """``(N,)``: what each UAV is in a round (from 1), such as :data:`HIT`."""
    r = number - 1
    named, target = record.candidates[r], record.head & record.alive[r]
    words = np.full(record.uavs, OTHER, object)
    if not record.labelled:
        words[named] = LEADER
        return words
    words[named & target], words[named & ~target], words[target & ~named] = HIT, REDUNDANT, MISSED
    return words


def describe_answer(record: EpisodeRecord, number: int) -> str:
    """How many UAVs the detector names in a round (from 1), in one sentence."""
    named = int(record.candidates[number - 1].sum())
    if not record.labelled:
        return f"It finds {format_count(named, 'leader')}."
    return f"It names {format_count(named, name_kind(record))} as {'a head' if named == 1 else 'heads'}."


def describe_verdict(record: EpisodeRecord, number: int) -> str:
    """The outcome of a round (from 1) in one or two sentences."""
    r = number - 1
    named, hits, redundant = int(record.candidates[r].sum()), int(record.hits[r]), int(record.redundant[r])
    if record.over_budget[r]:
        return f"{named} candidates exceed the shot budget: no UAV is destroyed."
    if not named:
        return f"Without candidates no {'head is hit' if record.recorded else 'UAV is destroyed'}."
    right = f"{hits} {'is a head' if hits == 1 else 'are heads'} (hit)"
    wrong = f"{redundant} {'is' if redundant == 1 else 'are'} not (redundant)"
    parts = [right] * (hits > 0) + [wrong] * (redundant > 0)
    end = "" if record.recorded else f" {'It is' if named == 1 else f'All {named} are'} destroyed."
    return f"{', '.join(parts)}.{end}"


def describe_remerge(record: EpisodeRecord, number: int) -> str:
    """What the followers of the heads that were destroyed in a round (from 1) do, in one sentence."""
    orphans = int(record.orphans[number - 1].sum())
    join = "joins" if orphans == 1 else "join"
    return f"{format_count(orphans, 'follower')} without a head {join} the nearest remaining head."


def describe_ending(record: EpisodeRecord) -> str:
    """The outcome of the game in one sentence."""
    left = int(record.heads_left[-1])
    done = "found" if record.recorded else "destroyed"
    result = f"{format_count(left, 'head')} not found" if left else f"All heads are {done}"
    if record.recorded and not record.head.any():
        result = "No id leads here"
    rounds = "" if record.recorded else f" after {format_count(record.rounds, 'round')}"
    return f"{result}{rounds}: {_tell_score(record, 2)}."


def explain_uav(record: EpisodeRecord, number: int, uav: int) -> str:
    """Why the detector takes a UAV for a head in a round (from 1): its own reason, or what its answer shows."""
    r = number - 1
    if record.reasons is not None and (own := record.reasons[r].get(str(uav))):
        return own
    others, kind = record.alive[r] & (np.arange(record.uavs) != uav), name_kind(record)
    parts = []
    if record.leader_estimate is not None:
        behind = int((record.leader_estimate[r][others] == uav).sum())
        parts.append(format_count(behind, "follower"))
    if record.attention is not None and record.attention[r].any():
        weight = float(record.attention[r][others, uav].sum())
        parts.append(f"receives attention {weight:.3g} (sum over the other {format_count(int(others.sum()), kind)})")
    if not parts:
        rank = int((record.scores[r][record.alive[r]] > record.scores[r, uav]).sum()) + 1
        parts.append(f"score rank {rank} of {int(record.alive[r].sum())}")
    return "; ".join(parts) + "."


def tell_round(record: EpisodeRecord, number: int, names: Sequence[str]) -> tuple[str, str, str, str]:
    """Tell a round (from 1) in Markdown: as it is in the window, with the answer, the destruction and the re-merge.

    Args:
        record: the episode.
        number: of the round.
        names: of all UAVs.
    """
    r = number - 1
    steps = record.position.shape[1] - 1
    start = f"**Round {number} of {record.rounds}:** the detector watches {steps} steps. To it, all UAVs look alike."
    if record.recorded:
        start = f"**Window {number} of {record.rounds}:** {steps} steps."
    if record.choices is not None and record.choices[r]:
        lines = [f"- {agent}, {text}" for agent, text in record.choices[r].items()]
        start = "\n".join([start, "", "What the heads chose for this window:", "", *lines])
    words = mark_words(record, number)
    order = [i for i in np.argsort(-record.scores[r], kind="stable").tolist() if words[i] != OTHER]
    lines = []
    for i in order[:_MOST_LISTED]:
        sure = "" if record.probability is None else f"p {record.probability[r, i]:.2f}, "
        why = explain_uav(record, number, i)
        lines.append(f"- **{names[i]}** {words[i]}, {sure}score {record.scores[r, i]:.3g}: {why}")
    lines += [f"- … and {len(order) - _MOST_LISTED} more"] * (len(order) > _MOST_LISTED)
    marked = "\n".join(lines)
    story = [start, describe_answer(record, number)]
    if record.labelled:
        end = describe_ending(record) if number == record.rounds else _tell_remerge(record, number, names)
        story += [describe_verdict(record, number), end]
    told = ["\n\n".join([*story[: k + 1], *([marked] if k else [])]) + "\n" for k in range(len(story))]
    return told[0], told[1], told[-2 if record.labelled else -1], told[-1]


def _tell_remerge(record: EpisodeRecord, number: int, names: Sequence[str]) -> str:
    """Which followers join which head after a round (from 1), in Markdown."""
    r = number - 1
    orphans = np.flatnonzero(record.orphans[r])
    if not len(orphans):
        return "No follower has lost its head."
    moves = Counter(zip(record.root[r][orphans].tolist(), record.root[r + 1][orphans].tolist(), strict=True))
    lines = [
        f"- {format_count(count, 'follower')} of {names[old]} "
        + (f"{'joins' if count == 1 else 'join'} {names[new]}" if new >= 0 else "stay without a head")
        for (old, new), count in moves.most_common()
    ]
    return "\n".join([describe_remerge(record, number), "", *lines])


def _link(path: str, word: str) -> str:
    """A link that selects an entity in the viewer."""
    return f"[{word}](recording://{path})"


def explain_replay(record: EpisodeRecord) -> str:
    """Explain a recording in Markdown."""
    by = f"**{record.detector or 'A detector'}** on {record.env_id or 'an episode'}"
    tracks = f"{record.uavs} recorded tracks in {format_count(record.rounds, 'window')}."
    if not record.labelled:
        return f"""# Leaders and followers

{by}. {describe_outcome(record)}

{tracks} **Press play.** The truth is not known:
colours, links and marks show what the detector found.

- {_link("world/verdict/leader", "leader")}, green spheres: leaders in this window
- {_link("world/swarm/heads", "heads")}, large points: leaders in this or another window
- {_link("world/swarm/followers", "followers")}: the others, in the colour of the leader that they follow, or grey
- {_link("world/swarm/links", "links")} and {_link("world/swarm/tracks", "tracks")}; the bars are
  {_link("scores/bars", "scores")}, highest first
"""
    lines = [
        f"- {_link('world/verdict/hit', 'hit')}, green spheres: candidates that are heads",
        f"- {_link('world/verdict/redundant', 'redundant')}, orange boxes: candidates that are not",
        f"- {_link('world/verdict/missed', 'missed')}, white spheres: heads that it did not name",
        f"- {_link('world/swarm/destroyed', 'destroyed')}: grey crosses",
    ]
    present = {word for number in range(1, record.rounds + 1) for word in mark_words(record, number)}
    present |= set() if record.recorded else {"destroyed"}
    lines = [line for line in lines if line.partition("[")[2].partition("]")[0] in present]
    if record.decoys.any():
        lines.append(f"- {_link('world/swarm/decoys', 'decoys')}, yellow diamonds: fly like heads, without followers")
    if record.observers is not None:
        lines.append(f"- {_link('world/observers', 'observers')} with circles of their sensing ranges")
    size = "probability" if record.probability is not None else "score"
    attention = (
        f", {_link('world/found/attention', 'attention')} as white lines" if record.attention is not None else ""
    )
    game = f"""{record.uavs} UAVs fly in {format_count(int(record.head.sum()), "cluster")}; in each, the followers
follow one head. **Press play.** In each round the detector watches and names candidates; these are destroyed, and their
followers join another head."""
    if record.recorded:
        game = f"{tracks} **Press play.** The detector watches and names heads; nothing is destroyed."
    return f"""## Who leads this swarm?

{by}, seed {record.seed}. {describe_outcome(record)}

{game}

**Left: what the detector sees**, equal dots. With the answer: {_link("world/found/candidates", "candidates")}, blue
spheres; {_link("world/found/uavs", "groups")} that it found in colours of its own, larger for a higher {size};
{_link("world/found/links", "leaders")} that it found{attention}.

**Right: the truth**: {_link("world/swarm/heads", "heads")}, large, and {_link("world/swarm/followers", "followers")} in
the colour of their head; {_link("world/swarm/links", "links")}.

{chr(10).join(lines)}

Click a word to select it; the eye beside its name in the left panel hides or shows it.
"""


def explain_comparison(records: Sequence[EpisodeRecord], labels: Sequence[str]) -> str:
    """Explain a recording of two episodes in Markdown."""
    rows = "\n".join(f"- **{label}:** {describe_outcome(each)}" for label, each in zip(labels, records, strict=True))
    first = records[0]
    if not first.labelled:
        return f"""# Two detectors, the same tracks

{first.env_id or "An episode"}: {first.uavs} recorded tracks. The truth is not known.

{rows}

**Press play.** Colours, links and marks show what each detector found.
"""
    kind = "tracks" if first.recorded else "UAVs"
    end = "" if first.recorded else " The swarms differ after a round in which other UAVs were destroyed."
    return f"""# Two detectors, one swarm

{first.env_id or "An episode"}, seed {first.seed}: {first.uavs} {kind}, {format_count(int(first.head.sum()), "head")}.

{rows}

**Press play.** Above: what each detector sees, and its answer. In the middle: the truth, with hits (green), redundant
candidates (orange boxes) and missed heads (white).{end}
"""
