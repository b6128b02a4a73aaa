"""The rules of follow-mixture that ``follow_mixture_ablation.py`` switches off, one at a time.

Every entry says what is switched off, and how: by an edit of a function's text or by another value of a constant. The
texts are those of the build that was measured; if the code changes, an edit that no longer fits is refused.

A rule that accepts or refuses something is replaced by "always" or "never"; a threshold by the value at which it has no
effect; a penalty by 0; a class of features or a start of a search is removed.
"""

from __future__ import annotations

from dataclasses import replace
from math import inf

from partial_replay import Edit, Set, Switch

__all__ = ["GROUPS", "LARGE", "SWITCHES"]

WAYS = "ways"
ARBITRATION = "choice between ways"
SHARED = "one strategy for all (way 1)"
PAIRS = "a regression for each pair (way 2)"
FLOCKS = "heads of flocks (way 3)"
PHASES = "cross-spectra (way 4)"
TOGETHER = "all UAVs together (way 5)"
LARGE = "more than 500 UAVs (way 7)"
CLASSES = "classes of strategies"
PRICES = "penalties and thresholds of the search"
GATES = "tests against surrogates"
MODEL = "null model, noise, likelihood"
PROBABILITY = "probabilities and policy"
GROUPS = (
    WAYS, ARBITRATION, SHARED, PAIRS, FLOCKS, PHASES, TOGETHER, LARGE, CLASSES, PRICES, GATES, MODEL, PROBABILITY
)  # fmt: skip


#: Switches whose replays take long, or that matter less: measured after the others, on fewer games.
_SECOND = frozenset(
    {
        "lonely",
        "merge",
        "flock-chance",
        "lags-half",
        "leave-out",
        "head-price",
        "least-voters",
        "naming",
        "swap",
        "drop",
        "bic",
        "sphere",
        "white",
        "null-own",
        "chance",
        "half-chance",
        "screen-squares",
        "screen-rows",
        "floor",
        "in-doubt",
        "paired-rows",
        "flock-affordable",
        "own-lags",
        "steps-lag",
        "unit-noise",
        "least-noise",
        "one-lag",
        "mixed",
        "squares",
        "flock-starts",
        "flock-onward",
        "start-guesses",
        "start-pairs",
        "start-likely",
        "start-best",
        "edge",
        "worst",
        "phases-negative",
        "columns",
        "again-left",
        "again-likeliest",
        "again-named",
        "together-few",
    }
)

_ALL: tuple[Switch, ...] = (
    # Ways
    Switch(
        "way1",
        WAYS,
        "way 1: no shared strategy from pairwise evidence",
        (Edit("explain.at_once", "climbed(samples, history, evidence, most)", "None"),),
    ),
    Switch(
        "way2",
        WAYS,
        "way 2: no fit with a regression for each pair",
        (Edit("explain.at_once", "if history.memory >= SMOOTH:", "if True:"),),
    ),
    Switch(
        "way3",
        WAYS,
        "way 3: no heads of flocks by regression (ways 4 and 5 stay)",
        (
            Edit(
                "explain.by_flocks",
                "explained_by_flocks(*flock_search(rows, spectra, flocks, most), float(np.median(spectra.memory)))",
                "None",
            ),
        ),
    ),
    Switch(
        "way3456",
        WAYS,
        "ways 3 to 6: only the fits from pairwise evidence",
        (Edit("explain.explain", "if rows is None:", "if True:"),),
    ),
    Switch(
        "way4",
        WAYS,
        "way 4: no cross-spectra",
        (Edit("explain.by_flocks", "spectra.noise > PHASES_TELL and", "False and"),),
    ),
    Switch(
        "way5",
        WAYS,
        "way 5: no joint fit of all UAVs",
        (Edit("explain.explain", "samples.complete and in_doubt(found)", "False"),),
    ),
    Switch(
        "way6",
        WAYS,
        "way 6: a shared strategy that nearly fits is not kept for its unassigned UAVs",
        (Edit("explain.explain", "found is not None and held is not None", "False"),),
    ),
    Switch(
        "twice-lags",
        WAYS,
        "flocks are not fitted again with twice the lags",
        (Set("explain._LONG_ROWS", inf),),
    ),
    Switch(
        "again-even",
        WAYS,
        "no second try of ways 1 and 2 where speeds differ without noise",
        (Edit("explain.explain", "if spectra.noise == 0 and not samples.unit:", "if False:"),),
    ),
    # Choice between ways
    Switch(
        "fewest-left",
        ARBITRATION,
        "the result of flocks is taken, also where the first fit leaves fewer unassigned",
        (Edit("explain.explain", "(found is None or unled(first) < unled(found))", "found is None"),),
    ),
    Switch(
        "settles",
        ARBITRATION,
        "a fit with a regression for each pair is final, also with a UAV unassigned",
        (Edit("explain.settles", 'return bool(found.strategy["shared"]) or unled(found) == 0', "return True"),),
    ),
    Switch(
        "nearly-all",
        ARBITRATION,
        "a regression for each pair may leave any number of UAVs unassigned",
        (Edit("explain.nearly_all", "return unled(found)", "return True or unled(found)"),),
    ),
    Switch(
        "lags-half",
        ARBITRATION,
        "twice the lags are tried also where flocks assign most UAVs",
        (Edit("explain.explain", "2 * (found.leader >= 0).sum() < samples.uavs", "True"),),
    ),
    Switch(
        "in-doubt",
        ARBITRATION,
        "the joint fit (way 5) is tried also where flocks are not in doubt",
        (Edit("explain.in_doubt", "return not sure or", "return True or"),),
    ),
    Switch(
        "doubt-failed",
        ARBITRATION,
        "no doubt of flocks because a strategy is not shared or a head failed its test",
        (Edit("explain.in_doubt", "return not sure or", "return"),),
    ),
    Switch(
        "doubt-left",
        ARBITRATION,
        "no doubt of flocks because UAVs are unassigned",
        (Edit("explain.in_doubt", " or unled(found) > LEFT_OUT * len(found.leader)", ""),),
    ),
    Switch(
        "held-complete",
        ARBITRATION,
        "way 6 also where samples are missing",
        (Edit("explain.at_once", "samples.complete and misfit", "misfit"),),
    ),
    Switch(
        "held-fits",
        ARBITRATION,
        "way 6 whatever the lack of fit",
        (
            Edit(
                "explain.at_once",
                "samples.complete and misfit(samples, mixture.strategy, mixture.heads.leader).nearly_holds",
                "samples.complete",
            ),
        ),
    ),
    Switch(
        "held-alone",
        ARBITRATION,
        "way 6 also where a head moves with other UAVs at the same time",
        (
            Edit(
                "explain.at_once",
                "if holds and fly_alone(samples, history, mixture.heads.heads, mixture.heads.leader):",
                "if holds:",
            ),
        ),
    ),
    Switch(
        "held-astray",
        ARBITRATION,
        "way 6 also where flocks assign few of the unassigned UAVs",
        (Edit("explain.missed_by_flocks", " or astray.sum() <= max(LEAST_VOTERS, left_over / 2)", ""),),
    ),
    Switch(
        "held-passed",
        ARBITRATION,
        "way 6 also where flocks find a head among the unassigned UAVs",
        (Edit("explain.missed_by_flocks", "left[found.heads[found.passed]].any() or ", ""),),
    ),
    # Way 1
    Switch(
        "cover",
        SHARED,
        "pairwise evidence needs no least share of assigned UAVs to start from",
        (Set("search.EXPLAINED", 0.0),),
    ),
    Switch(
        "misfit-never",
        SHARED,
        "lack of fit never asks for the richer class with places",
        (Edit("search.shortcut", "if misfit(samples, strategy, leader).follower <= MISFIT:", "if True:"),),
    ),
    Switch(
        "misfit-always",
        SHARED,
        "the richer class with places is always used",
        (Edit("search.shortcut", "if misfit(samples, strategy, leader).follower <= MISFIT:", "if False:"),),
    ),
    Switch(
        "columns",
        SHARED,
        "in the richer class all UAVs are candidates, not only those with much evidence",
        (
            Edit(
                "search.shortcut",
                "np.union1d(worthy[worth[worthy] >= worth[heads].min()], heads)",
                "np.arange(samples.uavs)",
            ),
        ),
    ),
    Switch(
        "reach",
        SHARED,
        "no range threshold (within_reach)",
        (
            Edit("search.within_reach", "if plain is None:", "if True:"),
            Edit("search.within_reach", "return None", "return plain"),
        ),
    ),
    Switch(
        "reach-price",
        SHARED,
        "a range threshold has no penalty",
        (Edit("search.within_reach", "if explained.max() <= price:", "if explained.max() <= 0:"),),
    ),
    Switch(
        "settled",
        SHARED,
        "no assignment of all UAVs to the likeliest head after a poor start (settled)",
        (Edit("search.shortcut", "2 * unexplained(found) > samples.uavs", "False"),),
    ),
    Switch(
        "again",
        SHARED,
        "no new fit where UAVs are unassigned (again)",
        (Set("search._AGAIN", 0),),
    ),
    Switch(
        "again-left",
        SHARED,
        "again: no start without the unassigned UAVs",
        (Edit("search.again", "for guess in (-1, likeliest, named):", "for guess in (likeliest, named):"),),
    ),
    Switch(
        "again-likeliest",
        SHARED,
        "again: no start with the likeliest candidates",
        (Edit("search.again", "for guess in (-1, likeliest, named):", "for guess in (-1, named):"),),
    ),
    Switch(
        "again-named",
        SHARED,
        "again: no start with the heads that pairwise evidence prefers",
        (Edit("search.again", "for guess in (-1, likeliest, named):", "for guess in (-1, likeliest):"),),
    ),
    Switch(
        "again-half",
        SHARED,
        "again: also where most UAVs are unassigned",
        (
            Edit(
                "search.climbed",
                "0 < unexplained(found) <= samples.uavs / 2",
                "(len(found.heads.heads) and 0 < unexplained(found))",
            ),
        ),
    ),
    Switch(
        "with-led",
        SHARED,
        "the last unassigned UAVs are not assigned by pairwise evidence (with_led)",
        (Edit("search.climbed", "return with_led(samples, history, pairs, found) if few else found", "return found"),),
    ),
    Switch(
        "explains-one",
        SHARED,
        "a shared strategy must assign every UAV",
        (Edit("search.explains", "left and (left >= LEAST_VOTERS or not samples.complete)", "left"),),
    ),
    Switch(
        "explains-complete",
        SHARED,
        "a UAV may be unassigned also where samples are missing",
        (Edit("search.explains", " or not samples.complete", ""),),
    ),
    Switch(
        "explains-fits",
        SHARED,
        "a UAV may be unassigned whatever the lack of fit",
        (Edit("search.explains", "if left and not misfit", "if False and not misfit"),),
    ),
    Switch(
        "explains-alone",
        SHARED,
        "a shared strategy is taken also where a head moves with other UAVs",
        (
            Edit(
                "search.explains",
                "return fly_alone(samples, history, found.heads.heads, found.heads.leader)",
                "return True",
            ),
        ),
    ),
    Switch(
        "holds-never",
        SHARED,
        "an unassigned UAV is never taken as a decoy",
        (
            Edit(
                "mixture_evidence.explained_by_mixture",
                "misfit(samples, mixture.strategy, leader, predicted).worst <= MISFIT",
                "False",
            ),
        ),
    ),
    Switch(
        "tested",
        SHARED,
        "few samples of the heads do not make a fit inconclusive",
        (Set("mixture_evidence._MOMENTS_A_NUMBER", 0),),
    ),
    Switch(
        "stray",
        SHARED,
        "an unassigned UAV that cannot have followers is no category (stray)",
        (Edit("mixture_evidence._kinds", "if tested and not holds", "if False and not holds"),),
    ),
    # Way 2
    Switch(
        "plain",
        PAIRS,
        "squares are not dropped where lags alone are stronger evidence (plain_evidence)",
        (Edit("pair_evidence.plain_evidence", "if not pairs.kind.squares:", "if True:"),),
    ),
    Switch(
        "laws",
        PAIRS,
        "no regression for each head that assigns more followers (led_by_laws, joined)",
        (Set("pair_evidence._JOININGS", 0),),
    ),
    Switch(
        "by-chance",
        PAIRS,
        "a UAV is assigned by pairs with any gain (no quantile of surrogates)",
        (Edit("pair_evidence.led_by", "_BY_CHANCE) if moved else 0.0", "_BY_CHANCE) if False else 0.0"),),
    ),
    Switch(
        "joined-chance",
        PAIRS,
        "a regression for a head assigns a UAV with any rise (no quantile of surrogates)",
        (
            Edit(
                "pair_evidence.joined", "np.quantile([rise(time) for time in range(1, len(shifts))], _BY_CHANCE)", "0.0"
            ),
        ),
    ),
    Switch(
        "pairs-few",
        PAIRS,
        "a head with fewer than two sure followers does not end way 2",
        (Edit("pair_evidence.explained_by_pairs", "if (count < LEAST_VOTERS).any():", "if False:"),),
    ),
    Switch(
        "pairs-alone",
        PAIRS,
        "way 2 also where a head moves with other UAVs at the same time",
        (Edit("pair_evidence.explained_by_pairs", " or not fly_alone(samples, history, heads, leader)", ""),),
    ),
    Switch(
        "pairs-smooth",
        PAIRS,
        "way 2 also in smooth motion",
        (Edit("explain.at_once", "if history.memory >= SMOOTH:", "if False:"),),
    ),
    Switch(
        "alone",
        PAIRS,
        "no test that a head does not move with other UAVs, anywhere (fly_alone)",
        (Edit("pair_evidence.fly_alone", "return not", "return True or not"),),
    ),
    Switch(
        "alone-half",
        PAIRS,
        "fly_alone: correlation needs to be significant only, not also large",
        (Set("pair_evidence._FELLOWS", 0.0),),
    ),
    Switch(
        "alone-own",
        PAIRS,
        "fly_alone: a head may move with its own followers",
        (Edit("pair_evidence.fly_alone", " | (2 * own > behind.sum(axis=1))", ""),),
    ),
    Switch(
        "alone-others",
        PAIRS,
        "fly_alone: a head may move with followers of other heads",
        (Edit("pair_evidence.fly_alone", "(2 * elsewhere > own + elsewhere) | ", ""),),
    ),
    # Way 3
    Switch(
        "merge",
        FLOCKS,
        "no flocks: every UAV is a flock of its own",
        (Edit("flocks._merged", "for _ in range(uavs - 1):", "for _ in range(0):"),),
    ),
    Switch(
        "leave-out",
        FLOCKS,
        "a member is not left out of the mean of the flock that it may lead",
        (
            Edit("flock_heads.Watch.watcher", "self.flocks + head if self.label[head] == flock else flock", "flock"),
            Edit("flock_heads.Watch.by_flock", "result[self.label, np.arange(self.uavs)] = own_of_members", "pass"),
        ),
    ),
    Switch(
        "wiener",
        FLOCKS,
        "pasts are not smoothed where positions are noisy",
        (Edit("flock_search.flock_search", "if spectra.noise > 0:", "if False:"),),
    ),
    Switch(
        "flock-pooled",
        FLOCKS,
        "flocks share no strategy: one regression for each flock and UAV",
        (Edit("flock_heads.heads_of_flocks", "for start in starts[:_STARTS]", "for start in starts[:0]"),),
    ),
    Switch(
        "flock-starts",
        FLOCKS,
        "flocks: one start of the search, not three",
        (Set("flock_heads._STARTS", 1),),
    ),
    Switch(
        "flock-onward",
        FLOCKS,
        "flocks: no further start from the best state",
        (Edit("flock_heads.heads_of_flocks", "waiting.append(best.head)", "pass"),),
    ),
    Switch(
        "own-lags",
        FLOCKS,
        "a flock's own past always has all lags, however short the window",
        (Set("flock_heads._ROWS_A_LAG", 1),),
    ),
    Switch(
        "steps-lag",
        FLOCKS,
        "a head's past always has four lags, however short the window",
        (Set("explain._STEPS_A_LAG", 1),),
    ),
    Switch(
        "lonely",
        FLOCKS,
        "a UAV in no flock needs no least gain to follow a head",
        (Set("flock_heads.LONELY", 0.0), Set("flock_evidence.LONELY", 0.0)),
    ),
    Switch(
        "fair",
        FLOCKS,
        "a UAV in no flock needs no fair share of the gain of flocks",
        (Set("flock_heads._FAIR", 0.0),),
    ),
    Switch(
        "lone-votes",
        FLOCKS,
        "gains of UAVs in no flock are not reduced at all (lone_votes)",
        (Edit("flock_heads.lone_votes", "return np.where(alone", "return gain if True else np.where(alone"),),
    ),
    Switch(
        "sobered",
        FLOCKS,
        "candidates of flocks are not ranked again by the robust gain (sobered)",
        (Edit("flock_heads.heads_of_flocks", "best = sobered(watch, best, most)", "pass"),),
    ),
    Switch(
        "moment",
        FLOCKS,
        "robust gain: no cap on the contribution of one sample",
        (Set("flock_heads._MOMENT", inf),),
    ),
    Switch(
        "sober-cap",
        FLOCKS,
        "sobered: a candidate may pass one that was better before",
        (
            Edit(
                "flock_heads.sobered",
                "np.minimum(gain[flock], gain[flock, best] + np.minimum(behind, 0.0))",
                "gain[flock]",
            ),
        ),
    ),
    Switch(
        "least",
        FLOCKS,
        "a head of flocks needs no least gain of 20 nats",
        (Set("flock_evidence._LEAST", 0.0),),
    ),
    Switch(
        "least-share",
        FLOCKS,
        "no least share of the swarm must follow (_LEAST_SHARE and _LONE_SHARE)",
        (
            Edit(
                "flock_evidence.flock_gate",
                "together >= _LEAST_SHARE * watch.uavs or followed.sum() >= _LONE_SHARE * watch.uavs",
                "True",
            ),
        ),
    ),
    Switch(
        "lone-share",
        FLOCKS,
        "the least share of the swarm that follows is the same for UAVs in no flock",
        (Set("flock_evidence._LONE_SHARE", 0.05),),
    ),
    # Way 4
    Switch(
        "phases-noise",
        PHASES,
        "cross-spectra at any noise",
        (Set("explain.PHASES_TELL", 0.0),),
    ),
    Switch(
        "phases-smooth",
        PHASES,
        "cross-spectra at any smoothness",
        (Edit("explain.by_flocks", " and np.median(spectra.memory) >= SMOOTH", ""),),
    ),
    Switch(
        "believed",
        PHASES,
        "a cross-spectral fit is always accepted",
        (
            Edit(
                "flock_leads.Leads.believed",
                "bool(clear > _STANDS_OUT and rise > _RISE and np.median(best) > _ABSURD)",
                "True",
            ),
        ),
    ),
    Switch(
        "stands-out",
        PHASES,
        "cross-spectra: heads need not lead clearly",
        (Set("flock_leads._STANDS_OUT", -inf),),
    ),
    Switch(
        "clear",
        PHASES,
        "cross-spectra: a lead has no upper bound",
        (Set("flock_leads._CLEAR", inf),),
    ),
    Switch(
        "rise",
        PHASES,
        "cross-spectra: no comparison with reversed time",
        (Set("flock_leads._RISE", -inf),),
    ),
    Switch(
        "absurd",
        PHASES,
        "cross-spectra: the fit need not be likely",
        (Set("flock_leads._ABSURD", -inf),),
    ),
    Switch(
        "worst",
        PHASES,
        "cross-spectra: a bad flock may cost any amount",
        (Set("flock_leads._WORST", -1e9),),
    ),
    Switch(
        "phases-negative",
        PHASES,
        "cross-spectra: no start with a negative sign",
        (Edit("flock_leads.fit_response", "np.concatenate([np.eye(_LAGS), -np.eye(_LAGS)[:1]])", "np.eye(_LAGS)"),),
    ),
    Switch(
        "edge",
        PHASES,
        "cross-spectra: no error of the ends of the window",
        (Edit("flock_leads.responses", "2.0 * float(np.median(spectra.power)) / steps", "0.0"),),
    ),
    # Way 5
    Switch(
        "by-head",
        TOGETHER,
        "no second joint fit with equal weights of heads (by_head)",
        (
            Edit(
                "search.climb_together",
                "if found and misfit(samples, found[0].strategy, found[0].heads.leader).head > _SHARED:",
                "if False:",
            ),
        ),
    ),
    Switch(
        "together-complete",
        TOGETHER,
        "the joint fit also where samples are missing",
        (Edit("explain.explain", "and samples.complete and in_doubt", "and in_doubt"),),
    ),
    Switch(
        "start-flocks",
        TOGETHER,
        "joint fit: no starts from flocks",
        (Edit("explain.by_everybody", "[followed(found), *starts]", "[]"),),
    ),
    Switch(
        "start-guesses",
        TOGETHER,
        "joint fit: no starts with a regression for each pair of a flock and a UAV",
        (Edit("explain.by_everybody", "[followed(found), *starts]", "[followed(found)]"),),
    ),
    Switch(
        "start-pairs",
        TOGETHER,
        "joint fit: no start from the assignment by pairwise evidence",
        (
            Edit(
                "search.climb_together",
                "[*starts, pairs.leader, likely(pairs, most)]",
                "[*starts, likely(pairs, most)]",
            ),
        ),
    ),
    Switch(
        "start-likely",
        TOGETHER,
        "joint fit: no start with half of the usual threshold (likely)",
        (Edit("search.climb_together", "[*starts, pairs.leader, likely(pairs, most)]", "[*starts, pairs.leader]"),),
    ),
    Switch(
        "start-best",
        TOGETHER,
        "joint fit: no start that assigns every UAV to its best candidate",
        (Edit("search.climb_together", "climb([*starts, best], by_head=False)", "climb(starts, by_head=False)"),),
    ),
    Switch(
        "together-few",
        TOGETHER,
        "a joint fit may leave any number of UAVs unassigned",
        (Edit("search.climb_together", "unexplained(some) <= LEFT_OUT * samples.uavs", "True"),),
    ),
    Switch(
        "together-alone",
        TOGETHER,
        "a joint fit also where a head moves with other UAVs at the same time",
        (Edit("search.climb_together", " if fly_alone(samples, history, some.heads.heads, some.heads.leader)", ""),),
    ),
    Switch(
        "leads-flock",
        TOGETHER,
        "a joint fit also where a head's flock follows another head (leads_its_flock)",
        (Edit("explain.by_everybody", "leads_its_flock(mixture, flocks) or ", ""),),
    ),
    Switch(
        "drops",
        TOGETHER,
        "a joint fit may demote a head of flocks that does not fit its new cluster (drops)",
        (Edit("explain.by_everybody", " or drops(samples, history, mixture, found)", ""),),
    ),
    Switch(
        "with-led-5",
        TOGETHER,
        "UAVs that a joint fit leaves unassigned are not assigned by pairwise evidence",
        (Edit("explain.by_everybody", "if unexplained(mixture) else mixture", "if False else mixture"),),
    ),
    Switch(
        "half-pass",
        TOGETHER,
        "a joint fit need not pass more tests than the flocks did",
        (Edit("explain.by_everybody", "and (found.passed.any() or 2 * answer.passed.sum() > len(answer.heads))", ""),),
    ),
    # Way 7
    Switch(
        "way7",
        LARGE,
        "way 7: all pairs also for more than 500 UAVs",
        (Set("explain.ALL_PAIRS", 10**9),),
    ),
    Switch(
        "large-half",
        LARGE,
        "a fit that assigns half of a large swarm is not enough, however well it fits",
        (Set("scale._HALF", 0.9),),
    ),
    Switch(
        "large-any",
        LARGE,
        "the strategy of agreeing voters is final, however few UAVs it assigns",
        (Set("scale._HALF", 0.0), Set("scale._ACCOUNTED", 0.0)),
    ),
    Switch(
        "large-agree",
        LARGE,
        "no first fit of the voters that agree",
        (Edit("scale.sampled_search", "if len(agreeing):", "if False:"),),
    ),
    Switch(
        "large-refit",
        LARGE,
        "no second fit of the strategy to the voters",
        (Edit("scale._spread", "if refined is None:", "if True:"),),
    ),
    Switch(
        "large-alone",
        LARGE,
        "agreeing voters are fitted also where a head moves with other UAVs",
        (
            Edit(
                "scale._at_once",
                "return found if fly_alone(samples, history, found.heads.heads, found.heads.leader) else None",
                "return found",
            ),
        ),
    ),
    # Classes
    Switch(
        "turns",
        CLASSES,
        "no class with rotations (turns)",
        (
            Edit(
                "flock_heads.flock_libraries",
                "mixed.append(Library(2, linear=False, turns=True, isotropic=True))",
                "pass",
            ),
        ),
    ),
    Switch(
        "across",
        CLASSES,
        "no class with products of two velocities (across)",
        (
            Edit(
                "flock_heads.flock_libraries",
                "mixed.append(Library(2, squares=True, products=True, across=True))",
                "pass",
            ),
        ),
    ),
    Switch(
        "products",
        CLASSES,
        "no class with products (products and across)",
        (
            Edit(
                "flock_heads.flock_libraries",
                "mixed.append(Library(2, squares=True, products=True, across=True))",
                "pass",
            ),
            Edit(
                "flock_heads.flock_libraries",
                "[Library(lags, squares=True), Library(1, squares=True, products=True)]",
                "[Library(lags, squares=True)]",
            ),
        ),
    ),
    Switch(
        "mixed",
        CLASSES,
        "flocks: no class with lags and squares together",
        (
            Edit(
                "flock_heads.flock_libraries",
                "[Library(lags, squares=True), Library(1, squares=True, products=True)]",
                "[Library(1, squares=True, products=True)]",
            ),
        ),
    ),
    Switch(
        "squares",
        CLASSES,
        "flocks: no class with squares alone",
        (Edit("flock_heads.flock_libraries", "return linear + squares + mixed", "return linear + mixed"),),
    ),
    Switch(
        "one-lag",
        CLASSES,
        "flocks: no classes with one lag only",
        (Edit("flock_heads.flock_libraries", "for lag in {lags, 1}", "for lag in {lags}"),),
    ),
    Switch(
        "isotropic",
        CLASSES,
        "flocks: no classes with equal weights on all axes (turns stay)",
        (Edit("flock_heads.flock_libraries", "for same in (False, True)", "for same in (False,)"),),
    ),
    Switch(
        "towards",
        CLASSES,
        "joint fit: no places of heads",
        (Edit("search.climb_together", "towards=True, own=True", "own=True"),),
    ),
    Switch(
        "own",
        CLASSES,
        "joint fit: no own past of the follower",
        (Edit("search.climb_together", "towards=True, own=True", "towards=True"),),
    ),
    Switch(
        "first-squares",
        CLASSES,
        "way 1: no squares in the class of the shared strategy",
        (Edit("search.shortcut", "Library(samples.memory, squares=True)", "Library(samples.memory)"),),
    ),
    Switch(
        "screen-squares",
        CLASSES,
        "pairwise evidence: no squares",
        (Edit("evidence.affordable_kinds", "for kind in KINDS if", "for kind in KINDS if not kind.squares and"),),
    ),
    Switch(
        "screen-rows",
        CLASSES,
        "pairwise evidence: the richest features at any length of the window",
        (Set("evidence._ROWS_PER_FEATURE", 1.01),),
    ),
    # Prices
    Switch(
        "head-price",
        PRICES,
        "a head has no penalty log N",
        (Edit("mixture.head_price", "return float(np.log(max(uavs, 2)))", "return 0.0"),),
    ),
    Switch(
        "naming",
        PRICES,
        "a follower does not pay log M for the choice of its head",
        (Edit("facility._value", "if len(chosen) > 1 else 0.0", "if False else 0.0"),),
    ),
    Switch(
        "least-voters",
        PRICES,
        "a head may have a single follower",
        (Set("facility.LEAST_VOTERS", 1),),
    ),
    Switch(
        "swap",
        PRICES,
        "the search of heads has no swaps",
        (Edit("facility.locate_heads", "chosen, value = _swap(positive, columns, chosen, price, value)", "pass"),),
    ),
    Switch(
        "drop",
        PRICES,
        "the search of heads has no removals",
        (Edit("facility.locate_heads", "chosen, value = _drop(positive, columns, chosen, price, value)", "pass"),),
    ),
    Switch(
        "bic",
        PRICES,
        "parameters of a shared strategy have no penalty (ways 1 and 5)",
        (Edit("strategy.Strategy.price", "0.5 * self.parameters", "0.0 * self.parameters"),),
    ),
    Switch(
        "flock-bic",
        PRICES,
        "parameters of a strategy of flocks have no penalty",
        (Edit("flock_heads.fit_flocks", "0.5 * some.numbers * float(np.log(observations))", "0.0"),),
    ),
    Switch(
        "chance",
        PRICES,
        "pairwise evidence: the gain by chance is not subtracted",
        (Edit("evidence.gain_and_chance", "float(np.median(surrogate.max(axis=1)))", "0.0"),),
    ),
    Switch(
        "half-chance",
        PRICES,
        "pairwise evidence: a head costs log N and not half the gain by chance",
        (Edit("pair_evidence.pair_evidence", "0.5 * chance, most", "head_price(samples.uavs), most"),),
    ),
    Switch(
        "flock-chance",
        PRICES,
        "flocks: the gain of a regression by chance is not subtracted",
        (
            Edit(
                "flock_heads.each_by_itself",
                "evidence[flock, uav] = exact_gain(watch, some, flock, uav) - chance",
                "evidence[flock, uav] = exact_gain(watch, some, flock, uav)",
            ),
            Edit("flock_heads.each_by_itself", "evidence -= float(np.median(surrogate.max(axis=1)))", "pass"),
        ),
    ),
    Switch(
        "flock-affordable",
        PRICES,
        "flocks: a regression for each pair at any length of the window",
        (Edit("flock_heads.affordable", "some.numbers <= 2.0 * watch.freedom", "True"),),
    ),
    # Gates
    Switch(
        "gate-shared",
        GATES,
        "all heads of a shared strategy pass their test (ways 1, 5, 6)",
        (
            Edit(
                "gate.gate_heads",
                "return judged(count, observed * share - price, surrogate * share)",
                "return judged(count, np.full(len(count), 1e9), 0.0 * surrogate)",
            ),
        ),
    ),
    Switch(
        "gate-pairs",
        GATES,
        "all heads of way 2 pass their test",
        (Edit("pair_evidence.explained_by_pairs", "not gate.passed.all() or ", ""),),
    ),
    Switch(
        "gate-flocks",
        GATES,
        "all heads of flocks pass their test",
        (
            Edit(
                "flock_evidence.flock_gate",
                "passed=gate.passed & (gate.added > _LEAST) & enough",
                "passed=np.ones(len(heads), bool)",
            ),
        ),
    ),
    Switch(
        "gate-phases",
        GATES,
        "all heads of cross-spectra pass their test",
        (
            Edit(
                "flock_leads.lead_gate",
                "return judged(count, added, chance[None])",
                "return judged(count, np.full(len(count), 1e9), 0.0 * chance[None])",
            ),
        ),
    ),
    Switch(
        "gate-margin",
        GATES,
        "tests: no margin of three standard deviations",
        (Set("gate._MARGIN", 0.0),),
    ),
    Switch(
        "gate-twice",
        GATES,
        "tests: a head need not gain twice what chance gives",
        (Set("gate._TIMES", 1.0),),
    ),
    # Model
    Switch(
        "sphere",
        MODEL,
        "equal speeds are not used: normal noise in space instead of von Mises-Fisher",
        (Edit("samples.common_drift", "return none, True", "return none, False"),),
    ),
    Switch(
        "null-own",
        MODEL,
        "the null model has no own past, only mean velocities",
        (
            Edit("history.own_history", "if unlike_white(energy, surprise, len(gram)):", "if False:"),
            Edit(
                "history.own_history", "(_log_likelihood(samples, mean[:, None] + forecast, surprise), surprise),", ""
            ),
        ),
    ),
    Switch(
        "null-shared",
        MODEL,
        "the null model has no law of the own past that all UAVs share",
        (Edit("history.own_history", "if unlike_white(energy, surprise, len(gram)):", "if False:"),),
    ),
    Switch(
        "white",
        MODEL,
        "the shared law of the own past is used also for white velocities",
        (Edit("history.own_history", "if unlike_white(energy, surprise, len(gram)):", "if True:"),),
    ),
    Switch(
        "odd-step",
        MODEL,
        "likelihood: no least value of one step (_ODD_STEP)",
        (Set("strategy._ODD_STEP", -1e9),),
    ),
    Switch(
        "floor",
        MODEL,
        "likelihood: no error of the class beside the noise",
        (Set("likelihood._FLOORS", (0.0,)),),
    ),
    Switch(
        "paired-rows",
        MODEL,
        "strategies with places are fitted to all rows, not to 1,500",
        (Set("strategy.PAIRED_ROWS", 10**9),),
    ),
    Switch(
        "least-noise",
        MODEL,
        "any variance of position noise counts, however small",
        (Set("flock_search.LEAST_NOISE", 0.0),),
    ),
    Switch(
        "unit-noise",
        MODEL,
        "noise is estimated also where speeds are equal",
        (Edit("flock_search.seen_spectra", "samples.unit or ", ""),),
    ),
    # Probabilities and policy
    Switch(
        "temper",
        PROBABILITY,
        "flocks: log-likelihoods are not tempered by 0.7",
        (Set("flock_evidence._TEMPER", 1.0),),
    ),
    Switch(
        "member",
        PROBABILITY,
        "a member of a flock is as likely a head as another UAV",
        (Set("flock_evidence._MEMBER", 0.0),),
    ),
    Switch(
        "gone",
        PROBABILITY,
        "no odds of 3 nats that a flock's head is in the window",
        (Set("flock_evidence._GONE", 0.0),),
    ),
    Switch(
        "typical",
        PROBABILITY,
        "a flock needs no tenth of the typical gain",
        (Set("flock_evidence._TYPICAL", 0.0),),
    ),
    Switch(
        "failed",
        PROBABILITY,
        "a head of flocks that fails its test keeps its probability",
        (Set("flock_evidence._FAILED", 1.0),),
    ),
    Switch(
        "unknown",
        PROBABILITY,
        "no upper bound of the probability without evidence",
        (Set("flock_evidence._UNKNOWN", 1.0),),
    ),
    Switch(
        "trust",
        PROBABILITY,
        "tests that mostly fail do not lower other probabilities",
        (Edit("flock_evidence.explained_by_flocks", "if trust < 0.5:", "if False:"),),
    ),
    Switch(
        "follows-none",
        PROBABILITY,
        "a likely head may also follow another UAV",
        (Edit("flock_evidence.flock_posterior", "*= (1.0 - several[lonely])[:, None]", "*= 1.0"),),
    ),
    Switch(
        "left-curve",
        PROBABILITY,
        "UAVs in no flock and without a head have no curve of their own",
        (Edit("calibration.calibrated", "left = False if found.left is None else found.left", "left = False"),),
    ),
    Switch(
        "a-bit",
        PROBABILITY,
        "any gain counts a UAV in no flock as predicted",
        (Set("flock_evidence._A_BIT", 0.0),),
    ),
    Switch(
        "phases-temper",
        PROBABILITY,
        "cross-spectra: log-likelihoods are not tempered by 0.2",
        (Set("flock_leads._TEMPER", 1.0),),
    ),
    Switch(
        "phases-failed",
        PROBABILITY,
        "cross-spectra: a head that fails its test keeps its probability",
        (Set("flock_leads._FAILED", 1.0),),
    ),
    Switch(
        "one-curve",
        PROBABILITY,
        "one calibration curve for all fits by flocks (fitted to the committed rows)",
        (Edit("calibration.calibrated", "said = verdict(found)", "said = verdict(found); calibration = one_curve"),),
    ),
    Switch(
        "no-curve",
        PROBABILITY,
        "fits by flocks are not calibrated",
        (
            Edit(
                "calibration.calibrated",
                "return plain(found.probability, left), curve(found.given, left), 1.0 - curve.trust",
                "return found.probability, found.given, 0.0",
            ),
        ),
    ),
    Switch(
        "one-rate",
        PROBABILITY,
        "one rate for all heads and one for all unassigned UAVs of a shared strategy",
        (
            Edit(
                "calibration.calibrated",
                "if found.kind is not None:",
                "if found.kind is not None:\n        calibration = one_rate",
            ),
        ),
    ),
    Switch(
        "doubt",
        PROBABILITY,
        "the policy does not reckon with a fit that is wrong as a whole",
        (Edit("policy.choose", "budget = len(order)", "doubt = 0.0; p = sure; budget = len(order)"),),
    ),
    Switch(
        "guess",
        PROBABILITY,
        "another round costs 1 also where heads can only be guessed",
        (Set("policy._GUESS", 0.0),),
    ),
)
SWITCHES = tuple(replace(switch, second=switch.key in _SECOND) for switch in _ALL)
