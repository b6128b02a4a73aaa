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

_MOST_LISTED = 30  # rows of the table of a round's candidates


def name_uav(record: EpisodeRecord, uav: int) -> str:
    """Name a UAV: its id in the file of recorded tracks, or its number."""
    ids = record.config.get("ids")
    if ids is None:
        return f"{'track' if record.recorded else 'UAV'} {uav}"
    return str(ids[uav])


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
    windows = format_count(record.rounds, "window")
    if not record.labelled:
        return f"In {windows}, {heads} of {record.uavs} ids lead at least once; the truth is unknown."
    all_found = heads > 1 and not left
    found = f"All {heads} heads found" if all_found else f"{heads - left} of {format_count(heads, 'head')} found"
    redundant = format_count(int(record.redundant.sum()), "redundant candidate")
    if record.recorded:
        found, groups = found if heads else "No id leads", ""
        if heads:
            groups = f", group leaders {group_leader_accuracy(record.root[0], record.scores[0]):.2f}"
        return f"{found} in {windows} with {redundant}: F1 = {name_score(record)[1]:.3f} (1 is best){groups}."
    sense = "J_m, lower is better" if record.problem == "P2" else "J_s, 0 is best"
    rounds = format_count(record.rounds, "round")
    return f"{found} in {rounds} with {redundant}: J = {record.objective[-1]:.3f} ({sense})."


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
    kind = format_count(named, "id" if record.recorded else "UAV")
    return f"It names {kind} as {'a head' if named == 1 else 'heads'}."


def describe_remerge(record: EpisodeRecord, number: int) -> str:
    """What the followers of the heads that were destroyed in a round (from 1) do, in one sentence."""
    orphans = int(record.orphans[number - 1].sum())
    join = "joins" if orphans == 1 else "join"
    return f"{format_count(orphans, 'follower')} without a head {join} the nearest remaining head."


def explain_uav(record: EpisodeRecord, number: int, uav: int) -> str:
    """Why the detector takes a UAV for a head in a round (from 1): its own reason, or what its answer shows."""
    r = number - 1
    if record.reasons is not None and (reason := record.reasons[r].get(str(uav))):
        return reason
    if record.leader_estimate is not None:
        others = record.alive[r] & (np.arange(record.uavs) != uav)
        return f"{format_count(int((record.leader_estimate[r][others] == uav).sum()), 'follower')}."
    rank = int((record.scores[r][record.alive[r]] > record.scores[r, uav]).sum()) + 1
    return f"score rank {rank} of {int(record.alive[r].sum())}."


def list_marked(record: EpisodeRecord, number: int) -> list[tuple[int, str, str]]:
    """The candidates and missed heads of a round (from 1), highest score first: index, mark, and reason."""
    words, scores = mark_words(record, number), record.scores[number - 1]
    marked = []
    for i in [i for i in np.argsort(-scores, kind="stable").tolist() if words[i] != OTHER][:_MOST_LISTED]:
        sure = "" if record.probability is None else f"p {record.probability[number - 1, i]:.2f}, "
        marked.append((i, words[i], f"{sure}score {scores[i]:.3g}: {explain_uav(record, number, i)}"))
    return marked


def tell_round(record: EpisodeRecord, number: int, names: Sequence[str]) -> tuple[str, str]:
    """Tell a round (from 1) in Markdown, before the answer and with it; ``names`` are those of all UAVs."""
    r, steps = number - 1, record.position.shape[1] - 1
    start = f"**{name_round(record)} {number} of {record.rounds}:** the detector watches {steps} steps."
    if record.choices is not None and record.choices[r]:
        lines = [f"- {agent}, {text}" for agent, text in record.choices[r].items()]
        start = "\n".join([start, "", "What the heads chose for this window:", "", *lines])
    lines = [f"- **{names[i]}** {word}, {reason}" for i, word, reason in list_marked(record, number)]
    hidden = int((mark_words(record, number) != OTHER).sum()) - len(lines)
    lines += [f"- … and {hidden} more"] * (hidden > 0)
    end = f"\n\n{describe_outcome(record)}" if number == record.rounds else ""
    return start, f"{start}\n\n{describe_round(record, number)}.{end}\n\n" + "\n".join(lines)


def explain_replay(records: Sequence[EpisodeRecord], labels: Sequence[str]) -> str:
    """Explain a recording of one or two episodes in Markdown."""
    record = records[0]
    seed = "" if record.seed is None else f", seed {record.seed}"
    outcomes = "\n".join(
        f"- **{label}:** {describe_outcome(each)}" for label, each in zip(labels, records, strict=True)
    )
    heading = f"""# Who leads this {"group" if record.recorded else "swarm"}?

{record.env_id or "An episode"}{seed}: {record.uavs} {"tracks" if record.recorded else "UAVs"}.

{outcomes}

**Press play.**"""
    if not record.labelled:
        return f"{heading} The truth is not known: colours, links and green marks show what the detector found.\n"
    shooting = "" if record.recorded else " They are destroyed, and their followers join another head."
    return f"""{heading} In each {name_round(record).lower()} the detector watches and names candidates.{shooting}

**What the detector sees** are equal dots. With its answer, blue spheres are candidates, colours are the groups that it
found, a larger dot means a higher {"probability" if record.probability is not None else "score"}, and lines lead to
the leaders that it found.

**The truth** has large points for heads and the colour of their head for followers. With the answer, green spheres
are hits, orange boxes are redundant candidates, and white spheres are heads that were not named. Yellow points are
decoys, grey crosses destroyed UAVs, blue circles the sensing ranges of observers.
"""
