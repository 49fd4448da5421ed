import pytest
import torch

from lerobot_act_chunking.execution.history import ObservationHistory

B, H = 3, 4


def observation(step, batch_size=B):
    """State 100 env + step, image the same in another shape and type."""
    value = 100 * torch.arange(batch_size) + step
    return {
        "state": value[:, None].repeat(1, 5).float(),
        "image": value[:, None, None, None].expand(-1, 2, 7, 6),
    }


def seen(history, envs=None):
    """Steps that the stack of each environment holds."""
    stacked = history.stack(envs)
    assert stacked["state"].shape[1:] == (H, 5)
    assert stacked["image"].shape[1:] == (H, 2, 7, 6)
    assert torch.equal(stacked["state"][:, :, 0].long(), stacked["image"][:, :, 0, 0, 0])
    return stacked["state"][:, :, 0].long().tolist()


def filled(n_steps, stride=1, **kwargs):
    history = ObservationHistory(H, stride)
    for step in range(n_steps):
        history.push(observation(step, **kwargs))
    return history


@pytest.mark.parametrize(
    ("n_steps", "expected"),
    [(1, [0, 0, 0, 0]), (2, [0, 0, 0, 1]), (4, [0, 1, 2, 3]), (5, [1, 2, 3, 4]), (11, [7, 8, 9, 10])],
)
def test_the_first_observation_stands_in_for_those_before(n_steps, expected):
    history = filled(n_steps)
    assert seen(history) == [[100 * env + step for step in expected] for env in range(B)]
    assert history.is_pad().sum(1).tolist() == [max(0, H - n_steps)] * B


def test_padding_comes_first():
    assert filled(2).is_pad().tolist() == [[True, True, False, False]] * B


@pytest.mark.parametrize(
    ("n_steps", "expected", "n_padded"),
    [
        (1, [0, 0, 0, 0], 3),
        (4, [0, 0, 0, 3], 2),
        (6, [0, 0, 2, 5], 2),
        (7, [0, 0, 3, 6], 1),
        (10, [0, 3, 6, 9], 0),
        (25, [15, 18, 21, 24], 0),
    ],
)
def test_strided_observations_end_at_the_newest(n_steps, expected, n_padded):
    history = filled(n_steps, stride=3)
    assert seen(history) == [[100 * env + step for step in expected] for env in range(B)]
    assert history.is_pad().tolist() == [[i < n_padded for i in range(H)]] * B


def test_strided_environments_start_alone():
    history = filled(14, stride=3)
    history.reset(torch.tensor([1]))
    for step in (14, 15, 16, 17):
        history.push(observation(step))
    assert seen(history) == [[8, 11, 14, 17], [114, 114, 114, 117], [208, 211, 214, 217]]
    assert history.is_pad().tolist() == [[False] * H, [True, True, False, False], [False] * H]


def test_environments_start_alone():
    history = filled(6)
    history.reset(torch.tensor([1]))
    assert history.is_pad().tolist() == [[False] * H, [True] * H, [False] * H]
    for step in (6, 7):
        history.push(observation(step))
    assert seen(history) == [[4, 5, 6, 7], [106, 106, 106, 107], [204, 205, 206, 207]]
    assert history.is_pad().tolist() == [[False] * H, [True, True, False, False], [False] * H]


def test_some_environments():
    history, envs = filled(6), torch.tensor([2, 0])
    history.reset(torch.tensor([0]))
    history.push(observation(6))
    assert seen(history, envs) == [[203, 204, 205, 206], [6, 6, 6, 6]]
    assert history.is_pad(envs).tolist() == [[False] * H, [True, True, True, False]]


def test_reset_and_another_batch_size_start_afresh():
    history = filled(6)
    history.reset()
    assert history.stack() == {}
    history.push(observation(6))
    assert seen(history) == [[100 * env + 6] * H for env in range(B)]
    history.push(observation(7, batch_size=2))
    assert seen(history) == [[7] * H, [107] * H]
    assert history.is_pad().shape == (2, H)


def test_reset_of_some_before_the_first_observation_is_nothing():
    history = ObservationHistory(H)
    history.reset(torch.tensor([1]))
    history.push(observation(0))
    assert seen(history) == [[0] * H, [100] * H, [200] * H]


def test_what_is_stacked_and_pushed_is_kept_apart():
    history, pushed = ObservationHistory(H), observation(0)
    history.push(pushed)
    stacked = history.stack()
    pushed["state"].fill_(-1)
    stacked["state"].fill_(-1)
    assert seen(history) == [[0] * H, [100] * H, [200] * H]


def test_one_observation():
    history = ObservationHistory(1)
    for step in range(3):
        history.push(observation(step))
    assert history.stack()["state"][:, :, 0].tolist() == [[2], [102], [202]]
    assert not history.is_pad().any()
