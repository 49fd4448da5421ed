"""Usage, losses, meaning and drift, on codes that are known."""

import numpy as np
import pytest
from codebook_fakes import FPS, MEAN, STD, TIMING, C, coder, episodes

from lerobot_act_chunking.diagnostics.codebook.chunks import cut_chunks
from lerobot_act_chunking.diagnostics.codebook.drift import measure_drift
from lerobot_act_chunking.diagnostics.codebook.losses import measure_losses
from lerobot_act_chunking.diagnostics.codebook.meaning import EXAMPLES, TENTHS, uses_of_first_code
from lerobot_act_chunking.diagnostics.codebook.usage import measure_usage
from lerobot_act_chunking.diagnostics.core.episodes import ActionEpisodes
from lerobot_act_chunking.diagnostics.core.measures import RawUnits

NAMES = ("reach", "gripper")


def coded(*args, **kwargs):
    return coder().code(cut_chunks(episodes(*args, **kwargs), TIMING))


def test_usage_counts_each_level():
    usage = measure_usage(np.array([[0, 3], [0, 1], [2, 1], [2, 1]]), vocabulary=4)
    first, second = usage.levels
    assert first.counts == [2, 0, 2, 0]
    assert (first.used, first.dead) == (2, [1, 3])
    assert first.perplexity == pytest.approx(2)
    assert second.perplexity == pytest.approx(np.exp(-(0.75 * np.log(0.75) + 0.25 * np.log(0.25))))
    assert usage.combinations == 3
    assert usage.share_of_combinations == pytest.approx(3 / 16)
    assert usage.bits == pytest.approx(4)
    assert usage.entropy_bits == pytest.approx(1 + np.log2(second.perplexity))
    assert usage.share_dead == pytest.approx(0.5)


def test_hundreds_of_codes_do_not_overflow():
    codes = np.random.default_rng(0).integers(256, size=(9, 300))
    usage = measure_usage(codes, vocabulary=256)
    assert usage.bits == pytest.approx(2400)
    assert usage.share_of_combinations == pytest.approx(0, abs=1e-300)


def test_losses_by_dimension_in_raw_units():
    found = coded()
    losses = measure_losses(found, episodes(), RawUnits(NAMES))
    reach, gripper = losses.dimensions
    errors = np.abs(found.decoded - found.chunks.actions)[~found.chunks.is_pad]
    assert (reach.name, gripper.name) == NAMES
    assert reach.mean == pytest.approx(errors[:, 0].mean(), rel=1e-5)
    assert gripper.p95 == pytest.approx(np.percentile(errors[:, 1], 95), rel=1e-5)
    assert losses.points == []
    assert losses.lost_variance == pytest.approx((reach.lost_variance + gripper.lost_variance) / 2)


def test_the_share_that_is_lost_does_not_depend_on_units():
    """Another scale for one dimension changes normalised variances, but not what the codes tell of it."""
    found = coded()
    other = coder().code(found.chunks)
    scaled = type(other)(other.chunks, other.codes, other.decoded, other.lost * [1, 9], other.varies * [1, 9])
    same = [measure_losses(each, episodes(), RawUnits(NAMES)).lost_variance for each in (found, scaled)]
    assert same[0] == pytest.approx(same[1])


def planted(at):
    """Two still episodes, with a jump of the second dimension at these steps."""
    made = {e: np.tile(MEAN + STD * [0.06, 0], (60, 1)).astype(np.float32) for e in (4, 7)}
    for episode, step, size in at:
        made[episode][step, 1] += size * STD[1]
    return ActionEpisodes("data", FPS, NAMES, made)


def test_the_worst_moments_do_not_overlap():
    data = planted([(4, 30, 5.0), (7, 50, 3.0)])
    losses = measure_losses(coder().code(cut_chunks(data, TIMING)), data, RawUnits(NAMES))
    worst = losses.worst
    assert [moment.episode for moment in worst[:2]] == [4, 7]
    assert worst[0].name == "gripper"
    assert worst[0].error == pytest.approx(5 * STD[1], rel=1e-3)
    assert 21 / FPS <= worst[0].time_s <= 30 / FPS
    places = [(moment.episode, moment.time_s) for moment in worst]
    for i, (episode, time) in enumerate(places):
        assert all(e != episode or abs(t - time) >= 10 / FPS - 1e-9 for e, t in places[:i])
    assert [moment.rms for moment in worst] == sorted((moment.rms for moment in worst), reverse=True)


def test_what_the_first_code_is_used_for():
    """Early chunks begin low, late ones high: two codes with their times."""
    steps = np.arange(100)
    values = np.stack([np.where(steps < 70, -1.5, 1.5) + 0.3 * np.sin(steps), 0 * steps], axis=1)
    data = ActionEpisodes("data", FPS, NAMES, {0: (MEAN + STD * values).astype(np.float32)})
    found = coder().code(cut_chunks(data, TIMING))
    early, late = uses_of_first_code(found)
    assert (early.code, late.code) == (2, 5)
    assert early.share == pytest.approx(70 / len(found.codes))
    assert early.share + late.share == pytest.approx(1)
    assert early.progress[2] < 0.7 < late.progress[0]
    assert early.timeline == [1] * 7 + [0] * (TENTHS - 7)
    assert late.timeline == [0] * 7 + [1] * (TENTHS - 7)
    assert early.combinations == len(np.unique(found.codes[found.codes[:, 0] == 2], axis=0))
    assert early.decoded.shape == (min(EXAMPLES, early.combinations), C, 2)
    second, counts = np.unique(found.codes[found.codes[:, 0] == 2][:, 1], return_counts=True)
    first = 2 + (second[counts.argmax()] + 0.5) / 8 - 4
    assert early.decoded[0, 0, 0] == pytest.approx(MEAN[0] + STD[0] * first, rel=1e-5)


def test_data_of_the_same_kind_do_not_drift():
    training, other = coded((200,) * 6, seed=1), coded((200,) * 2, seed=2)
    drift = measure_drift(training, other, 8, "other", seed=0)
    assert drift.largest < drift.expected + 0.1
    assert drift.error_ratio == pytest.approx(1, abs=0.1)
    assert drift.beyond == pytest.approx(0.01, abs=0.015)
    assert drift.chunks == len(other.codes)


def test_other_data_drift():
    training = coded((200,) * 6, seed=1)
    moved = measure_drift(training, coded((200,), seed=2, shift=3.0), 8, "other", seed=0)
    assert moved.distances[0] > 0.6 > 0.2 > moved.distances[1]
    wider = measure_drift(training, coded((200,), seed=2, spread=3.0), 8, "other", seed=0)
    assert wider.error_ratio == pytest.approx(3, rel=0.15)
    assert wider.beyond > 0.3


def test_codes_without_anything_in_common_are_1_apart():
    low, high = coded((50,) * 2, spread=0.1, shift=-2.5), coded((50,), spread=0.1, shift=2.5)
    assert measure_drift(low, high, 8, "other", seed=0).distances[0] == pytest.approx(1)


def test_one_training_episode_says_nothing_of_chance():
    assert measure_drift(coded((50,)), coded((60,)), 8, "other", seed=0).expected is None
