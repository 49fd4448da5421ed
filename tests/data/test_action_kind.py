"""Whether actions are positions or changes, of planted robots."""

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lerobot_act_chunking.data.action_kind import (
    FEWEST_FRAMES,
    MOST_DIMENSIONS,
    asks_for_changes,
    dataset_asks_for_changes,
)

N_EPISODES, LENGTH = 6, 60


def robot(seed, *, changes, joints=4, lag=1, still=0.0):
    """States, actions and episodes of a robot whose dimensions come in any unit and order."""
    rng = np.random.default_rng(seed)
    states, actions = [], []
    for _ in range(N_EPISODES):
        speeds = np.repeat(rng.normal(size=(LENGTH, joints)), 10, axis=0)[: LENGTH + lag]
        speeds[rng.random(len(speeds)) < still] = 0
        path = np.cumsum(0.05 * speeds, axis=0) + rng.normal(size=joints)
        asked = (speeds if changes else path)[lag:]
        states.append(path[:LENGTH] + 0.0005 * rng.normal(size=asked.shape))
        actions.append(asked + 0.01 * rng.normal(size=asked.shape))
    states, actions = np.concatenate(states), np.concatenate(actions)
    states = np.column_stack([states, rng.normal(size=len(states))])[:, rng.permutation(joints + 1)]
    states = states * 10.0 ** rng.uniform(-3, 3, joints + 1) + rng.normal(size=joints + 1)
    actions = actions * 10.0 ** rng.uniform(-3, 3, joints) + rng.normal(size=joints)
    return states, actions, np.repeat(np.arange(N_EPISODES), LENGTH)


@given(
    seed=st.integers(0, 2**32 - 1),
    changes=st.booleans(),
    joints=st.integers(1, 8),
    still=st.sampled_from([0.0, 0.5]),
)
def test_it_is_told_whatever_the_units_and_the_order(seed, changes, joints, still):
    assert asks_for_changes(*robot(seed, changes=changes, joints=joints, still=still)) == changes


@pytest.mark.parametrize("lag", [1, 2, 4, 8])
def test_positions_that_are_reached_late_are_positions(lag):
    assert not asks_for_changes(*robot(0, changes=False, lag=lag))


@pytest.mark.parametrize("changes", [False, True])
def test_grippers_that_are_positions_and_parked_dimensions_do_not_decide(changes):
    states, actions, episode = robot(1, changes=changes)
    rng = np.random.default_rng(0)
    gripper = np.repeat(rng.integers(0, 2, len(actions) // 15), 15).astype(float)
    states = np.column_stack([states, np.roll(gripper, 1)])
    actions = np.column_stack([actions, gripper, np.full(len(actions), 3.0)])
    assert asks_for_changes(states, actions, episode) == changes


def test_actions_that_nothing_explains_are_not_called_changes():
    states, actions, episode = robot(2, changes=True)
    assert not asks_for_changes(states, np.random.default_rng(0).normal(size=actions.shape), episode)
    assert not asks_for_changes(states, np.zeros_like(actions), episode)


def test_changes_are_not_counted_over_the_end_of_an_episode():
    states, actions, episode = robot(3, changes=True)
    alone = np.arange(len(actions))  # every frame is an episode of its own
    assert asks_for_changes(states, actions, episode)
    assert not asks_for_changes(states, actions, alone)


def dataset(folder, seed=0, *, changes=True, frames=None, files=2, dtype="float32", **columns):
    states, actions, episode = robot(seed, changes=changes)
    chunk = folder / "data" / "chunk-000"
    chunk.mkdir(parents=True)
    rows = {"observation.state": states, "action": actions, **columns}
    for number, part in enumerate(np.array_split(np.arange(len(actions))[:frames], files)):
        table = {key: list(value[part].astype(np.float32)) for key, value in rows.items()}
        pq.write_table(
            pa.table({**table, "episode_index": episode[part]}), chunk / f"file-{number:03d}.parquet"
        )
    return {"observation.state": {"dtype": dtype, "shape": (states.shape[1],)}}


@pytest.mark.parametrize("changes", [False, True])
@pytest.mark.parametrize("files", [1, 3])
def test_a_dataset_tells(tmp_path, changes, files):
    features = dataset(tmp_path, changes=changes, files=files)
    assert dataset_asks_for_changes(tmp_path, features, ["observation.state"]) == changes


def test_frames_that_are_not_finite_are_left_out(tmp_path):
    states, _, _ = robot(0, changes=True)
    states[::7] = np.nan
    features = dataset(tmp_path, **{"observation.state": states})
    assert dataset_asks_for_changes(tmp_path, features, ["observation.state"])


def test_what_cannot_tell_is_not_called_changes(tmp_path):
    features = dataset(tmp_path / "whole")
    key = ["observation.state"]
    assert not dataset_asks_for_changes(tmp_path / "no files", features, key)
    assert not dataset_asks_for_changes(tmp_path / "whole", features, [])
    assert not dataset_asks_for_changes(
        tmp_path / "few", dataset(tmp_path / "few", frames=FEWEST_FRAMES - 1), key
    )
    assert not dataset_asks_for_changes(tmp_path / "text", dataset(tmp_path / "text", dtype="string"), key)
    wide = {"observation.state": {"dtype": "float32", "shape": (MOST_DIMENSIONS + 1,)}}
    assert not dataset_asks_for_changes(tmp_path / "whole", wide, key)
