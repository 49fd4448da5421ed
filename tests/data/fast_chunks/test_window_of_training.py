"""A policy acts on the very windows it was trained on, at every step of an episode."""

from types import SimpleNamespace

import pytest
import torch
from lerobot.datasets.factory import resolve_delta_timestamps
from lerobot_sets import LENGTHS
from tiers import some

from lerobot_act_chunking.data.batch import FeatureSpec, Observation
from lerobot_act_chunking.data.timing import ChunkTiming
from lerobot_act_chunking.data.window import ObservationWindow

STATE, TOP, SIDE = "observation.state", "observation.images.top", "observation.images.side"
SPEC = FeatureSpec({STATE: (6,)}, {TOP: (3, 8, 12), SIDE: (3, 6, 10)}, (4,))
STARTS = [sum(LENGTHS[:i]) for i in range(len(LENGTHS))]


def trained_on(dataset, timing):
    """The window of every frame, as LeRobot's loader makes batches of them."""
    items = [dict(dataset[i]) for i in range(len(dataset))]
    batch = {key: torch.stack([item[key] for item in items]) for key in (STATE, TOP, SIDE)}
    return Observation.window_from_lerobot(batch, SPEC, timing.n_obs_steps)


def acted_on(stock, timing):
    """The window of every frame when its episode is played; all episodes at once, each time one ends anew."""
    window = ObservationWindow(timing.n_obs_steps, timing.obs_stride)
    windows = {}
    for step in range(max(LENGTHS)):
        played = [start + step % length for start, length in zip(STARTS, LENGTHS, strict=True)]
        ended = [env for env, length in enumerate(LENGTHS) if step and step % length == 0]
        if ended:
            window.reset(torch.tensor(ended))
        items = [stock[frame] for frame in played]
        frames = {key: torch.stack([item[key] for item in items]) for key in (STATE, TOP, SIDE)}
        window.push(Observation.from_lerobot(frames, SPEC))
        stacked = window.stack()
        for env, frame in enumerate(played):
            seen = {key: value[env] for key, value in {**stacked.vectors, **stacked.images}.items()}
            for key, value in windows.setdefault(frame, seen).items():
                assert torch.equal(value, seen[key])  # the same whenever it is played
    return [windows[frame] for frame in range(sum(LENGTHS))]


@pytest.mark.parametrize(("n_obs_steps", "obs_stride"), some(2, [(1, 1), (2, 1), (4, 1), (3, 2), (2, 5)]))
def test_acting_sees_what_training_saw(images, open_both, n_obs_steps, obs_stride):
    timing = ChunkTiming(n_obs_steps, chunk_size=3, obs_stride=obs_stride)
    _, plain = open_both(images)
    policy = SimpleNamespace(
        observation_delta_indices=timing.observation_deltas,
        action_delta_indices=timing.action_deltas,
        reward_delta_indices=None,
    )
    stamps = resolve_delta_timestamps(policy, plain.meta)
    played = acted_on(plain, timing)
    for dataset in open_both(images, delta_timestamps=stamps):
        windows = trained_on(dataset, timing)
        for frame, expected in enumerate(played):
            for key, value in {**windows.vectors, **windows.images}.items():
                assert value.shape[1] == n_obs_steps
                assert torch.equal(value[frame], expected[key]), (frame, key)
