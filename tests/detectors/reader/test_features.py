"""The reader's features: a plain reference, what they must not depend on, and odd windows."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from detectors.reader import features as module
from detectors.reader.features import PAIR_GROUPS, Features, make_features

STEPS = 48


def draw_window(uavs=6, steps=STEPS, missed=0.0, seed=0):
    """Random walks of velocity; each odd UAV repeats the one before it 3 steps later."""
    rng = np.random.default_rng(seed)
    velocity = rng.normal(size=(uavs, 3)) + np.cumsum(0.2 * rng.normal(size=(steps, uavs, 3)), 0)
    velocity[3:, 1::2] = velocity[:-3, : uavs - uavs % 2 : 2] + 0.02 * rng.normal(size=velocity[3:, 1::2].shape)
    start = 15 * rng.normal(size=(1, uavs, 3))
    position = np.concatenate([start, start + np.cumsum(velocity, 0)])
    seen = rng.random((steps + 1, uavs)) >= missed
    return hide(position, velocity, seen)


def hide(position, velocity, seen):
    flown = (seen[1:] & seen[:-1])[..., None]
    return np.where(seen[..., None], position, 0).astype("f4"), np.where(flown, velocity, 0).astype("f4"), seen


def group(features, name):
    return features.pair[..., PAIR_GROUPS[name]]


def assert_close(one, other, tolerance=2e-3):
    for x, y in zip(one, other, strict=True):
        np.testing.assert_allclose(x, y, atol=tolerance)


class Reference:
    """Loops over pairs in double precision, where everything is seen."""

    def __init__(self, position, velocity, seen):
        scale = np.sqrt((velocity.astype(float) ** 2).sum(2).mean())
        self.p, self.v = position / scale, velocity / scale
        self.c = self.v - self.v.mean(0)
        self.mean = (self.v[::2] + self.v[1::2]) / 2  # of the steps that follow each second instant
        self.far = np.linalg.norm(self.p[:, None] - self.p[:, :, None], axis=-1)  # (T + 1, i, j)

    def innovate(self, i):
        c = self.c[:, i]
        past = np.concatenate([c[1:-1], c[:-2]], 1)
        gram = past.T @ past
        ridge = (1e-2 * np.trace(gram) / 6 + 1e-4) * np.eye(6)
        e = c[2:] - past @ np.linalg.solve(gram + ridge, past.T @ c[2:])
        length = np.linalg.norm(e, axis=1, keepdims=True)
        return np.concatenate([np.zeros((2, 3)), e * np.minimum(1, 2 * np.sqrt((length**2).mean()) / length)])

    def correlate(self, x, y, lag):
        return (x[lag:] * y[: len(y) - lag]).sum() / np.sqrt((x**2).sum() * (y**2).sum())

    def cc(self, i, j):
        return [self.correlate(self.c[:, i], self.c[:, j], lag) for lag in range(0, 13, 2)]

    def ee(self, i, j):
        return [self.correlate(self.innovate(i), self.innovate(j), lag) for lag in range(13)]

    def geo(self, i, j):
        gap, d = self.p[:-1:2, j] - self.p[:-1:2, i], self.far[:-1:2, i, j]
        ahead = (gap * self.mean[:, i]).sum(1) / d
        turn = (gap[:-1] * np.diff(self.mean[:, i], axis=0)).sum(1) / d[:-1]
        half = len(d) // 2
        slope = np.log((d[half:].mean() / 20 + 0.05) / (d[:half].mean() / 20 + 0.05))
        near = [np.clip((1.1 * r - d) / (0.2 * r), 0, 1).mean() for r in (6, 12, 25, 50, 100)]
        distance = np.log(np.array([d.mean(), d.min()]) / 20 + 0.05)
        return [ahead.mean(), np.abs(ahead).mean(), turn.sum() / len(d), *distance, slope, *near]

    def force(self, i, j):
        gap, a = (self.p[:-1:2, j] - self.p[:-1:2, i])[:-1], np.diff(self.mean[:, i], axis=0)
        drift = (self.mean[:, j] - self.mean[:, i])[:-1]
        pull = (gap * a).sum(1) / np.linalg.norm(gap, axis=1)
        power = np.sqrt((a**2).sum())
        along = [(a * x).sum() / np.linalg.norm(x) / power for x in (gap, gap - gap.mean(0), drift)]
        return [pull.sum() / power / np.sqrt(len(a)), np.abs(pull).sum() / power / np.sqrt(len(a)), *along]

    def places(self, i, j):
        def miss(a, b, lag):  # mean distance from a to where b was
            return np.linalg.norm(self.p[lag:, a] - self.p[: len(self.p) - lag, b], axis=1)

        lags = (0, 1, 2, 4, 8, 16)
        now = np.log(miss(i, j, 0).mean() + 0.5)
        relative = [np.log(miss(i, j, lag).mean() + 0.5) - now for lag in lags[1:]]
        reverse = [np.log((miss(i, j, lag).mean() + 0.5) / (miss(j, i, lag).mean() + 0.5)) for lag in (2, 8)]
        track = [np.stack([miss(*pair, lag)[16 - lag :] for lag in lags]) for pair in ((i, j), (j, i))]
        best = [x.argmin(0) for x in track]
        behind = [(x > 0).mean() for x in best]
        nearest = np.log(track[0].min(0).mean() + 0.5) - now
        return [*relative, 0, *reverse, 0, nearest, behind[0], (best[0] / 5).mean(), behind[0] - behind[1]]

    def find_companions(self, width):
        """Ways of so many steps, and the weights of companions."""
        way, uavs = (self.p[width:] - self.p[:-width]) / np.sqrt(width), range(self.p.shape[1])
        rows = way[:: max(width // 4, 1)]
        apart = np.array([[((rows[:, i] - rows[:, j]) ** 2).sum(1).mean() + 1e-4 for j in uavs] for i in uavs])
        np.fill_diagonal(apart, np.inf)
        weight = (apart.min(1, keepdims=True) / apart) ** 2
        return way, weight / weight.sum(1, keepdims=True)

    def ways(self, i, j):
        found = []
        for width in (4, min(16, len(self.v) // 3)):
            way, weight = self.find_companions(width)
            own = weight[i] + weight[i].max() * (np.arange(len(weight)) == i)
            mean, first = np.einsum("tja,j->ta", way, own) / own.sum(), None
            found.append(np.log(weight[i, j] + 1e-3))
            for lag in (0, 1, 2, 4, 6, 8, 12, 16, 24, 32):
                if 2 * lag >= len(way):
                    found.append(0)
                    continue
                x, y = (part[:: max(width // 4, 1)] for part in (mean[lag:], way[: len(way) - lag, j]))
                cosine = (x * y).sum() / np.sqrt((x**2).sum() * (y**2).sum())
                value = np.log(1 - max(cosine, 0) ** 2 + 1e-4)
                first = value if first is None else first
                found.append(value - (first if lag else 0))
        return found

    def companions(self, j):
        found = []
        for width in (4, min(16, len(self.v) // 3)):
            way, weight = self.find_companions(width)
            mean = np.einsum("tja,ij->tia", way, weight)
            for lag in (0, 1, 2, 4, 6, 8, 12, 16, 24, 32):
                apart = ((mean[lag:] - way[: max(len(way) - lag, 0)]) ** 2).sum(2)
                size = np.log((apart.mean(0) if len(apart) else 0 * weight[0]) + 1e-4)
                score = size - weight @ size
                found += [] if lag else [size[j]]
                found.append(score[j] / np.sqrt(weight[j] @ score**2 + 0.02))
        return found

    def joint(self, i, j):
        change, flown = np.diff(self.v[:, i], axis=0), self.v[:-1] - self.v[:-1].mean(0)
        length, place = np.linalg.norm(change, axis=1, keepdims=True), self.p[1:-1] - self.p[1:-1].mean(0)
        y, found = np.where(length < 8 * length.mean(), change, 0).ravel(), []
        for shared, own, ridge in ((place, flown, 1e-2), (place, flown, 1e-6), (flown, place, 1e-2)):
            x = np.column_stack([*shared.transpose(1, 0, 2).reshape(shared.shape[1], -1), own[:, i].ravel()])
            size = np.linalg.norm(x, axis=0)
            gram = (x / size).T @ (x / size) + ridge * np.eye(len(size))
            part = np.linalg.solve(gram, (x / size).T @ y)
            rest = ((y - x / size @ part) ** 2).sum() / (len(y) - len(size)) + 1e-12 * (y @ y)
            sure, part = part[j] / np.sqrt(rest * np.linalg.inv(gram)[j, j]), (part / size)[:-1]
            found += [np.arcsinh(sure), part[j] / np.sqrt((part**2).mean())]
        return found


@pytest.mark.parametrize("name", ["cc", "ee", "geo", "force", "places", "joint", "ways"])
def test_pairs_agree_with_a_plain_reference(name):
    window = draw_window()
    reference, found = Reference(*window), group(make_features(*window), name)
    for i in range(3):
        for j in range(4, 6):
            expected = np.array(getattr(reference, name)(i, j))
            np.testing.assert_allclose(found[i, j, : len(expected)], expected, atol=3e-3, err_msg=f"{i} {j}")


def test_companions_agree_with_a_plain_reference():
    window = draw_window()
    reference, found = Reference(*window), make_features(*window).uav[:, module.UAV_GROUPS["companions"]]
    for j in range(6):
        np.testing.assert_allclose(found[j], reference.companions(j), atol=3e-3)


def test_pulls_are_scores_of_the_means_and_the_least_of_parts():
    told = make_features(*draw_window())
    parts = np.where(np.eye(6, dtype=bool)[..., None], np.nan, group(told, "joint")[..., :4])
    expected = np.concatenate([np.nanmean(parts, 0), np.nanmin(parts, 0)], 1)
    expected = (expected - expected.mean(0)) / (expected.std(0) + 1e-2)
    np.testing.assert_allclose(told.uav[:, module.UAV_GROUPS["pulls"]], expected, atol=1e-3)


@pytest.mark.parametrize(("uavs", "steps", "missed"), [(7, 60, 0.0), (12, 30, 0.2), (3, 9, 0.1)])
def test_axes_origin_unit_and_order_do_not_matter(uavs, steps, missed):
    position, velocity, seen = draw_window(uavs, steps, missed)
    told = make_features(position, velocity, seen)
    turn = Rotation.from_rotvec([0.3, 1.0, -2.0]).as_matrix()
    assert_close(told, make_features(*hide(position @ turn.T + [300, -20, 5], velocity @ turn.T, seen)))
    assert_close(told, make_features(8 * position, 8 * velocity, seen), 0)
    order = np.random.default_rng(1).permutation(uavs)
    other = make_features(position[:, order], velocity[:, order], seen[:, order])
    assert_close(Features(told.pair[order][:, order], told.uav[order], told.context), other)


def test_what_is_not_seen_has_no_influence():
    position, velocity, seen = draw_window(9, 50, 0.2)
    told = make_features(position, velocity, seen)
    junk = np.where(seen[..., None], position, 1e5), np.where((seen[1:] & seen[:-1])[..., None], velocity, -77)
    assert_close(told, make_features(junk[0].astype("f4"), junk[1].astype("f4"), seen), 0)
    wider = [np.concatenate([x, np.zeros_like(x[:, :1])], 1) for x in (position, velocity, seen)]
    pair, uav, context = make_features(*wider)
    assert_close(told, (pair[:-1, :-1], uav[:-1], context), 1e-4)
    assert not pair[-1].any()
    assert not pair[:, -1].any()
    assert not uav[-1].any()


def test_bits_do_not_depend_on_where_the_memory_lies():
    window = draw_window(11, 70, 0.1)
    told = make_features(*window)
    for offset in (1, 3, 7):
        copies, kept = [], [np.empty(1000 * offset + 13, np.uint8)]  # moves what is allocated next
        for x in window:
            memory = np.empty(x.nbytes + 128, np.uint8)
            start = -memory.ctypes.data % 64 + offset * x.itemsize
            copies.append(memory[start : start + x.nbytes].view(x.dtype).reshape(x.shape))
            copies[-1][...] = x
            kept.append(memory)
        for x, y in zip(told, make_features(*copies), strict=True):
            np.testing.assert_array_equal(x, y)


@settings(max_examples=30, deadline=None, derandomize=True)
@given(
    st.integers(1, 4), st.integers(1, 20), st.integers(0, 99), st.sampled_from([0.0, 1e-20, 1.0, 1e5]),
    st.sampled_from([0.0, 0.4, 1.0]), st.booleans(),
)  # fmt: skip
def test_odd_windows_give_finite_numbers(uavs, steps, seed, speed, missed, planar):
    position, velocity, seen = (
        draw_window(uavs, steps, missed, seed) if steps > 3 else draw_window(uavs, 4, missed, seed)
    )
    position, velocity, seen = position[: steps + 1] * speed, velocity[:steps] * speed, seen[: steps + 1]
    if planar:
        position[..., 2], velocity[..., 2] = 0, 0
    told = make_features(position, velocity, seen)
    assert told.pair.shape == (uavs, uavs, module.PAIR_FEATURES)
    assert told.uav.shape == (uavs, module.UAV_FEATURES)
    assert all(np.isfinite(x).all() and x.dtype == np.float32 for x in told)


@pytest.mark.parametrize("kind", ["PAIR", "UAV", "CONTEXT"])
def test_groups_follow_each_other(kind):
    slices = list(getattr(module, kind + "_GROUPS").values())
    assert [0, *(x.stop for x in slices)] == [*(x.start for x in slices), getattr(module, kind + "_FEATURES")]


def test_followers_are_told_from_leaders():
    told = make_features(*draw_window())
    assert (group(told, "ee")[1::2, ::2].argmax(2).diagonal() == 3).all()  # 1 follows 0, 3 follows 2, 5 follows 4
    strongest = group(told, "tops")[..., 0]
    assert (strongest[1::2, ::2] > strongest[::2, 1::2].T + 0.5).diagonal().all()


def test_whom_all_copy_is_told_in_noise():
    rng = np.random.default_rng(2)
    velocity = [1, 0, 0] + 0.1 * rng.normal(size=(100, 8, 3))
    velocity[1:, 1:] += velocity[:-1, :1] - [1, 0, 0]  # all copy the first, and err on their own
    position = np.concatenate([np.zeros((1, 8, 3)), np.cumsum(velocity, 0)]) + 10 * rng.normal(size=(8, 3))
    position += 0.2 * rng.normal(size=position.shape)
    told = make_features(*hide(position, np.diff(position, axis=0), np.ones((101, 8), bool)))
    companions = told.uav[:, module.UAV_GROUPS["companions"]]
    assert companions[:, 13].argmin() == 0  # ways of 16 steps, 1 step later
    assert companions[0, 13] < companions[1:, 13].min() - 1
    assert (group(told, "ee").max(2)[1:].argmax(1) == 0).mean() < 0.6  # single velocities tell less


def test_who_comes_later_to_the_same_places_is_told():
    position, velocity, _ = draw_window(1, 60)
    both = [np.concatenate([x[:-8], x[8:]], 1) for x in (position, velocity)]  # UAV 0 is 8 steps behind UAV 1
    behind = group(make_features(*both, np.ones(both[0].shape[:2], bool)), "places")[0, 1]
    assert behind[3] == behind[:6].min()  # the lag of 8 steps
    assert behind[10] == 1
    assert behind[12] > 0.5


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("delay", [2, 5])
def test_a_uav_that_turns_as_another_turned_answers_it_with_this_delay(sign, delay):
    rng, steps, uavs = np.random.default_rng(4), 100, 6
    spins = 0.25 * rng.standard_normal((steps, uavs, 3))
    for t in range(1, steps):
        spins[t] = 0.5 * spins[t - 1] + 0.8 * spins[t]
    spins[delay:, 1] = sign * spins[:-delay, 0]
    velocity = np.empty((steps, uavs, 3))
    velocity[0] = rng.standard_normal((uavs, 3))
    for t in range(1, steps):
        velocity[t] = Rotation.from_rotvec(spins[t]).apply(velocity[t - 1])
    velocity /= np.linalg.norm(velocity, axis=2, keepdims=True)
    position = np.concatenate([np.zeros((1, uavs, 3)), np.cumsum(velocity, 0)])
    answers = group(make_features(*hide(position, velocity, np.ones((steps + 1, uavs), bool))), "answers")
    lags = (1, 2, 3, 4, 5, 6, 8, 10, 12)
    turns = answers[..., : len(lags)]
    assert np.abs(turns[1]).max(axis=1).argmax() == 0
    best = np.abs(turns[1, 0]).argmax()
    assert delay - 2 <= lags[best] <= delay  # it compares with a turn of three steps
    assert np.sign(turns[1, 0, best]) == sign
    assert np.abs(turns[1, 0]).max() > 2 * np.abs(turns[0, 1]).max()
