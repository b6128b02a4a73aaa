"""Every check bites: a detector with one mistake fails the check that is about it, with a sentence that says so."""

import random
import re
from itertools import combinations

import broken_detectors as broken
import cheating_detectors as cheating
import numpy as np
import pytest
import torch

from detectors.checks import CHECKS, CheckWarning, check_detector
from detectors.checks.repeatability import check_permuting_uavs_permutes_the_answer, compute_p_value

MISTAKES = [
    ("check_constructor_only_stores", broken.StoresMore(), "also got extra"),
    ("check_constructor_only_stores", broken.ChecksInConstructor(), "TypeError"),
    ("check_constructor_only_stores", broken.CopiesItsArgument(), "not iterable|must store names"),
    ("check_parameters_and_clone", broken.ChangesItsArgument(), "must leave the argument count unchanged, got 4"),
    ("check_parameters_and_clone", broken.FillsItsArgument(names=[]), "must leave the argument names unchanged"),
    ("check_parameters_and_clone", broken.HidesAParameter(), r"get_params must return count, names, got \['count'\]"),
    ("check_answers_with_a_detection", broken.NoDetection(), "must return a usnet_env.Detection"),
    ("check_answers_with_a_detection", broken.TooShort(), "for all 14 UAVs, got 13"),
    ("check_answers_with_a_detection", broken.NeedsASeed(), "TypeError: .*seed"),
    ("check_smallest_swarm", broken.NeedsFour(), "too small a swarm"),
    ("check_single_cluster", broken.NeedsTwoClusters(), "clusters must be at least 2"),
    ("check_masked_uavs_are_never_candidates", broken.NamesTheDead(), "must not be a candidate"),
    ("check_missing_samples", broken.NeedsEverySample(), "a UAV was never seen"),
    ("check_scores_are_finite", broken.DividesByTheSpread(), "scores must be finite"),
    ("check_scores_are_finite", broken.ProbabilityAboveOne(), "from 0 to 1"),
    ("check_batch", broken.LosesAWindow(), "must return 4 detections, got 3"),
    ("check_batch", broken.EmptiesTheList(), "leave the list of windows"),
    ("check_input_unchanged", broken.WritesIntoTheWindow(), "got another velocity"),
    ("check_input_unchanged", broken.ReplacesAnArray(), "got another position"),
    (
        "check_same_seed_same_answer",
        broken.OwnClockAsSeed(),
        "must give the same detection, got different",
    ),
    ("check_episodes_start_afresh", broken.Remembers(), "reset must clear the previous episode"),
    ("check_permuting_uavs_permutes_the_answer", broken.NamesTheFirst(), "got another in a swarm"),
    ("check_pickling", broken.CannotBePickled(), "pickle"),
    ("check_pickling", broken.ForgetsWhenPickled(), "must continue it"),
    ("check_global_generators_untouched", broken.DrawsFromNumPy(), "a change of the global one of numpy.random"),
    ("check_global_generators_untouched", broken.DrawsFromPython(), "a change of the global one of random"),
    ("check_global_generators_untouched", broken.SeedsTorch(), "a change of the global one of torch"),
    ("check_process_settings_untouched", broken.SetsThreads(), "threads of torch"),
    ("check_process_settings_untouched", broken.SilencesNumPy(), "numpy.geterr"),
    ("check_no_reach_for_truth", broken.KeepsAnEnv(), r"detector\.tools\['simulate'\]\[0\]"),
    ("check_no_reach_for_truth", broken.KeepsAState(), r"detector\.look.*SwarmState"),
    ("check_no_reach_for_truth", broken.SharesAGenerator(), r"a shared one at detector\.generator"),
    ("check_no_reach_for_truth", broken.SharesBits(), r"a shared one at detector\.more\.bit_generator"),
    ("check_no_reach_for_truth", broken.KeepsTheGlobalGenerator(), r"a shared one at detector\.fallback"),
    ("check_truth_nearby_changes_nothing", broken.LooksAtTheCaller(), "must not depend on an environment or swarm"),
    ("check_truth_nearby_changes_nothing", broken.SearchesMemory(), "must not depend on an environment or swarm"),
    ("check_seeds_reveal_no_heads", cheating.SearchesItsSeed(), "must not search the seed of the swarm"),
    ("check_large_swarm", broken.NeedsLessMemory(), "MemoryError"),
    ("check_time_budget", broken.Slow(), r"at most 0\.05 s for 82 UAVs, got 0\.(0[6-9]|[1-9])"),
]
EVERY = {check.__name__ for check in CHECKS}
# What a mistake also breaks, as it should. Of all other checks, none may fail.
ALSO = {
    "CopiesItsArgument": {"check_parameters_and_clone"},
    "ChangesItsArgument": {"check_episodes_start_afresh"},
    "NoDetection": EVERY - {"check_constructor_only_stores", "check_seeds_reveal_no_heads"},
    "TooShort": EVERY - {"check_constructor_only_stores", "check_seeds_reveal_no_heads"},
    "WritesIntoTheWindow": {"check_truth_nearby_changes_nothing"},  # which shows one window twice
    "NeedsEverySample": {"check_scores_are_finite"},
    "DividesByTheSpread": {"check_permuting_uavs_permutes_the_answer"},
    "OwnClockAsSeed": {"check_episodes_start_afresh", "check_pickling", "check_truth_nearby_changes_nothing"},
    "KeepsAState": {"check_pickling"},
}


@pytest.fixture(autouse=True)
def the_process_as_it_was():
    numpy_state, python_state, torch_state = np.random.get_state(), random.getstate(), torch.get_rng_state()  # noqa: NPY002
    threads, errors = torch.get_num_threads(), np.geterr()
    yield
    np.random.set_state(numpy_state)  # noqa: NPY002
    random.setstate(python_state)
    torch.set_rng_state(torch_state)
    torch.set_num_threads(threads)
    np.seterr(**errors)


def failures(detector, **options):
    results = check_detector(detector, on_fail=None, **options)
    return {result.check: result.reason for result in results if result.status == "failed"}


def test_the_good_one_passes():
    assert failures(broken.Good()) == {}


def test_a_probability_of_none_is_no_mistake():
    (check,) = [check for check in CHECKS if check.__name__ == "check_scores_are_finite"]
    check(broken.NoProbability())


def test_every_check_has_a_mistake():
    assert {name for name, *_ in MISTAKES} == {check.__name__ for check in CHECKS}


KINDS = [type(detector).__name__ for _, detector, _ in MISTAKES]


@pytest.mark.parametrize(("name", "detector", "sentence"), MISTAKES, ids=KINDS)
def test_a_mistake_fails_its_check(name, detector, sentence):
    (check,) = [check for check in CHECKS if check.__name__ == name]
    budget = {"seconds": 0.05} if name == "check_time_budget" else {}
    with pytest.raises(Exception) as failure:  # noqa: PT011  # a check's own sentence, or what the detector raises
        check(detector, **budget)
    assert re.search(sentence, f"{type(failure.value).__name__}: {failure.value}")


@pytest.mark.slow
@pytest.mark.parametrize(("name", "detector", "sentence"), MISTAKES, ids=KINDS)
def test_it_fails_no_other_check(name, detector, sentence):
    failed = failures(detector, seconds=0.05 if name == "check_time_budget" else 30)
    assert set(failed) == {name} | ALSO.get(type(detector).__name__, set()), failed
    assert re.search(sentence, failed[name]), failed[name]
    assert "\n" not in failed[name]


def test_ties_by_index_where_nothing_distinguishes_the_uavs_are_a_warning_with_its_remedy():
    with pytest.warns(CheckWarning, match=r"ties are broken by the index .* self\.rng\.permutation\(window\.uavs\)\.$"):
        check_permuting_uavs_permutes_the_answer(broken.FavoursLowIndices())


def test_two_samples_of_one_distribution_seldom_differ():
    rng = np.random.default_rng(0)
    values = [compute_p_value(rng.random((8, 20)), rng.random((8, 20))) for _ in range(100)]
    assert 0.3 < np.median(values) < 0.7
    assert np.mean(np.array(values) < 0.05) < 0.12
    assert min(values) >= 1 / 2000


def test_the_p_value_is_that_of_all_relabellings():
    rng = np.random.default_rng(1)
    pooled = rng.random((8, 3))
    means = [
        np.delete(pooled, chosen, 0).mean(0) - pooled[list(chosen)].mean(0) for chosen in combinations(range(8), 4)
    ]
    lengths = np.linalg.norm(means, axis=1)
    exact = np.mean(lengths >= np.linalg.norm(pooled[:4].mean(0) - pooled[4:].mean(0)) - 1e-12)
    assert compute_p_value(pooled[:4], pooled[4:]) == pytest.approx(exact, abs=4 * np.sqrt(exact * (1 - exact) / 2000))


def test_two_samples_of_two_distributions_do():
    rng = np.random.default_rng(0)
    assert compute_p_value(rng.random((8, 20)), rng.random((8, 20)) + 0.5) == 1 / 2000
    same = np.tile(rng.random(20), (8, 1))
    assert compute_p_value(same, same) == 1
    assert compute_p_value(same, same + 1e-3) < 0.002
