"""What interpolation loses, and where the energy is, on motions whose answers are known."""

import numpy as np
import pytest

from lerobot_act_chunking.data.timing import ChunkTiming
from lerobot_act_chunking.diagnostics.core.episodes import ActionEpisodes
from lerobot_act_chunking.diagnostics.core.measures import AlohaGraspPoints, RawUnits
from lerobot_act_chunking.diagnostics.core.noise_floor import Dimension, NoiseFloor, measure_noise
from lerobot_act_chunking.diagnostics.resolution.reconstruction import reconstruct, whole_chunks
from lerobot_act_chunking.diagnostics.resolution.spectrum import measure_spectrum
from lerobot_act_chunking.diagnostics.resolution.strides import (
    Tolerance,
    choose_strides,
    chunk_timing,
    measure_stride,
    recommend,
)
from lerobot_act_chunking.envs.aloha.experts.kinematics import HOME_JOINTS
from lerobot_act_chunking.envs.aloha.tasks import JOINT_NAMES
from lerobot_act_chunking.errors import ConfigurationError, DatasetError

FPS = 50.0


def demonstrations(*columns, lengths=(200, 150), names=None):
    """Episodes whose dimensions are these functions of time [s]."""
    episodes = {}
    for episode, n in enumerate(lengths):
        time = np.arange(n) / FPS
        episodes[episode] = np.stack([column(time + episode) for column in columns], axis=1)
    names = names or tuple(f"joint_{dim}" for dim in range(len(columns)))
    return ActionEpisodes("data", FPS, names, episodes)


def wave(hz):
    return lambda time: np.sin(2 * np.pi * hz * time)


def line(time):
    return 3 * time - 1


def still(time):
    return np.full_like(time, 0.4)


def steps(time):
    return (np.floor(time * FPS / 5) % 2).astype(float)  # changes every five control steps


def measured(data, timing, gripper_dims=()):
    return reconstruct(data, timing, RawUnits(data.names), gripper_dims)


def test_straight_lines_lose_nothing_at_any_stride():
    data = demonstrations(line, still)
    for stride in (1, 2, 7, 20):
        found = measured(data, ChunkTiming(1, 3, stride))
        assert max(deviation.max for deviation in found.dimensions) < 1e-12


def test_stride_1_loses_nothing():
    data = demonstrations(wave(7), steps)
    assert all(deviation.max == 0 for deviation in measured(data, ChunkTiming(1, 50, 1)).dimensions)


def test_a_wave_sampled_once_a_period_is_lost():
    """At 5 Hz and ten control steps a period every sample is the same: the whole wave is the error."""
    data = demonstrations(wave(5), lengths=(201,))
    (found,) = measured(data, ChunkTiming(1, 6, 10)).dimensions
    chunks = whole_chunks(data, 51)[..., 0]
    expected = np.abs(chunks - chunks[:, :1])  # the first sample, held
    assert found.max == pytest.approx(expected.max(), abs=1e-9)
    assert found.rms == pytest.approx(np.sqrt((expected**2).mean()), abs=1e-9)
    assert found.p95 == pytest.approx(np.percentile(expected, 95), abs=1e-9)


def test_slow_waves_lose_less_and_larger_strides_more():
    data = demonstrations(wave(0.5), wave(2))
    errors = [[d.rms for d in measured(data, ChunkTiming(1, 3, s)).dimensions] for s in (2, 5, 10)]
    assert (np.diff(errors, axis=0) > 0).all()
    assert (np.diff(errors, axis=1) > 0).all()


def test_dimensions_are_kept_apart():
    found = measured(demonstrations(line, wave(5), still), ChunkTiming(1, 6, 10))
    assert [deviation.name for deviation in found.dimensions] == ["joint_0", "joint_1", "joint_2"]
    assert [deviation.rms > 0.1 for deviation in found.dimensions] == [False, True, False]


def test_grippers_are_held_as_the_policy_holds_them():
    data = demonstrations(steps, line)
    free, held = (measured(data, ChunkTiming(1, 6, 5), dims).dimensions for dims in ((), (0,)))
    assert held[0].max == 1  # a change within an interval is seen at the next prediction
    assert free[0].rms != held[0].rms
    assert held[1] == free[1]


def test_a_held_dimension_sampled_when_it_changes_is_exact():
    data = demonstrations(steps, lengths=(51,))
    (found,) = measured(data, ChunkTiming(1, 11, 5), (0,)).dimensions
    assert found.max == 0


def test_chunks_lie_within_their_episode_and_begin_anywhere():
    data = demonstrations(lambda time: time * FPS, lengths=(30, 10, 12))
    chunks = whole_chunks(data, 12)[..., 0]
    assert chunks.shape == (19 + 1, 12)
    np.testing.assert_allclose(np.diff(chunks), 1)
    np.testing.assert_allclose(chunks[:, 0], [*range(19), 2 * FPS], atol=1e-9)


def test_no_episode_as_long_as_a_chunk():
    with pytest.raises(
        DatasetError, match="of 201 control steps, the longest has 200: choose a shorter --hor"
    ):
        whole_chunks(demonstrations(line), 201)


def test_positions_of_aloha_are_in_millimetres():
    """The left waist turns, and the left grasp point alone is off, by centimetres."""
    columns = [lambda time, v=value: np.full_like(time, v) for value in (*HOME_JOINTS, 0.5) * 2]
    columns[0] = wave(5)
    data = demonstrations(*columns, lengths=(201,), names=JOINT_NAMES)
    found = reconstruct(data, ChunkTiming(1, 6, 10), AlohaGraspPoints(), ())
    assert [point.name for point in found.points] == ["left gripper", "right gripper"]
    left, right = found.points
    assert right.max == 0
    assert found.farthest is not None
    assert left.max == found.farthest.max > 100
    assert found.dimensions[0].max > 1
    assert all(deviation.max == 0 for deviation in found.dimensions[1:])


def test_energy_of_a_wave_lies_below_and_above_its_frequency():
    spectrum = measure_spectrum(demonstrations(wave(5), wave(12)))
    np.testing.assert_allclose(spectrum.above(4), 1, atol=0.02)
    np.testing.assert_allclose(spectrum.above(8), [0, 1], atol=1e-3)
    np.testing.assert_allclose(spectrum.above(14), 0, atol=1e-3)
    assert spectrum.all_above(8) == pytest.approx(0.5, abs=1e-3)


def test_shares_are_those_of_the_energy():
    mixed = demonstrations(lambda time: 3 * wave(2)(time) + wave(10)(time))
    assert measure_spectrum(mixed).above(5)[0] == pytest.approx(0.1, abs=1e-3)


def test_dimensions_count_alike_whatever_their_units():
    data = demonstrations(lambda time: 500 * wave(2)(time), wave(10))
    assert measure_spectrum(data).all_above(5) == pytest.approx(0.5, abs=1e-3)


def test_drift_is_no_high_frequency():
    """A straight line has none, and a slow wave that ends elsewhere than it began hardly any."""
    data = demonstrations(lambda time: 100 * time + wave(1)(time), lengths=(180,))
    assert measure_spectrum(data).above(5)[0] < 1e-4


def test_what_is_still_has_no_spectrum():
    data = demonstrations(wave(1), still, lambda time: 1e-5 * wave(20)(time))
    spectrum = measure_spectrum(data, measure_noise(list(data.episodes.values()), FPS, data.names).moving)
    assert spectrum.moves.tolist() == [True, False, False]
    assert np.isnan(spectrum.above(5)).tolist() == [False, True, True]
    assert spectrum.all_above(5) < 1e-3
    assert np.isnan(measure_spectrum(demonstrations(still)).all_above(5))


def test_episodes_of_different_lengths_agree_on_frequencies():
    short, long = (measure_spectrum(demonstrations(wave(5), lengths=n)) for n in ((100, 200), (200, 200)))
    assert short.above(4)[0] == pytest.approx(long.above(4)[0], abs=0.02)
    assert short.frequencies[-1] == FPS / 2


def test_every_step_counts_alike_however_long_its_episode():
    data = demonstrations(
        lambda time: wave(5)(time) if len(time) == 100 else wave(12)(time), lengths=(100, 300)
    )
    assert measure_spectrum(data).above(8)[0] == pytest.approx(300 / 400, abs=0.01)


def test_episodes_too_short_for_a_spectrum_are_left_out():
    assert measure_spectrum(demonstrations(wave(5), lengths=(200, 3))).above(4)[0] == pytest.approx(
        1, abs=0.02
    )


def floor_of(data, parked):
    kinds = ["noise" if dim in parked else "moves" for dim in range(len(data.names))]
    return NoiseFloor(
        tuple(Dimension(*each, False, 0.0, 0.0, 1.0) for each in zip(data.names, kinds, strict=True))
    )


def make_strides(data, strides, gripper_dims=(), parked=()):
    floor, measure = floor_of(data, parked), RawUnits(data.names)
    spectrum = measure_spectrum(data, floor.moving)
    timings = [chunk_timing(stride, 1.0, FPS) for stride in strides]
    return [measure_stride(data, timing, measure, spectrum, floor, gripper_dims) for timing in timings]


def test_a_stride_s_figures():
    (stride,) = make_strides(demonstrations(wave(2), line), [5])
    assert (stride.stride, stride.timing.chunk_size, stride.timing.control_steps) == (5, 11, 51)
    assert (stride.nyquist_hz, stride.predictions_per_second) == (5.0, 10.0)
    assert stride.worst == pytest.approx(stride.reconstruction.dimensions[0].p95 / 2, rel=1e-2)
    assert stride.above_nyquist < 1e-3


def test_what_is_held_or_still_is_not_held_against_the_tolerance():
    data = demonstrations(wave(0.5), steps, lambda time: 1e-6 * wave(20)(time))
    free, held = (make_strides(data, [5], dims, parked=(2,))[0].worst for dims in ((), (1,)))
    assert free > 0.1
    assert held < 0.01


def test_the_largest_stride_up_to_which_all_are_within():
    strides = make_strides(demonstrations(wave(2)), [1, 2, 3, 5, 10])
    for limit, expected in ((1e-9, 1), (strides[2].worst, 3), (strides[2].worst * 0.99, 2), (1.0, 10)):
        assert recommend(strides, Tolerance(limit, "of range")).stride == expected


def test_a_stride_that_fits_by_chance_is_not_taken():
    """Larger than one that does not fit, it fits by its phase alone."""
    strides = make_strides(demonstrations(wave(5)), [1, 5, 10])
    strides[2] = type(strides[2])(**{**vars(strides[2]), "worst": 0.0})
    assert recommend(strides, Tolerance(0.01, "of range")).stride == 1


@pytest.mark.parametrize(
    ("asked", "also", "expected"),
    [
        ((), None, [1, 2, 3, 4, 5, 8, 10, 16, 20]),
        ((), 7, [1, 2, 3, 4, 5, 7, 8, 10, 16, 20]),
        ((9, 4), None, [1, 4, 9]),
        ((9, 4), 6, [1, 4, 6, 9]),
    ],
)
def test_which_strides_are_tried(asked, also, expected):
    assert choose_strides(asked, also, 1.0, FPS) == expected


def test_a_stride_longer_than_the_horizon_is_refused():
    with pytest.raises(ConfigurationError, match=r"chunk_stride=51 lasts 1\.02 s, longer than --horizon-s=1"):
        chunk_timing(51, 1.0, FPS)
    assert chunk_timing(50, 1.0, FPS).chunk_size == 2
