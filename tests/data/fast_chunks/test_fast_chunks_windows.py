import numpy as np
import pytest

from lerobot_act_chunking.data.fast_chunks.windows import EpisodeWindows

FIRST, END = np.array([0, 3, 7]), np.array([3, 7, 8])


@pytest.mark.parametrize(
    ("index", "episode", "offsets", "rows", "padding"),
    [
        (4, 1, [-2, -1, 0, 1, 2, 3], [3, 3, 4, 5, 6, 6], [1, 0, 0, 0, 0, 1]),
        (0, 0, [0, 1, 2, 3], [0, 1, 2, 2], [0, 0, 0, 1]),
        (2, 0, [0, 1], [2, 2], [0, 1]),
        (3, 1, [-1, 0], [3, 3], [1, 0]),
        (6, 1, [0, 1], [6, 6], [0, 1]),
        (7, 2, [-9, 0, 9], [7, 7, 7], [1, 0, 1]),
    ],
)
def test_windows_end_at_their_episode(index, episode, offsets, rows, padding):
    windows = EpisodeWindows(FIRST, END, None)
    got, is_pad = windows.rows(np.array([index]), np.array([episode]), np.array(offsets))
    assert got.tolist() == [rows]
    assert is_pad.astype(int).tolist() == [padding]


def test_a_batch_is_the_stack_of_its_frames():
    windows, offsets = EpisodeWindows(FIRST, END, None), np.array([-1, 0, 1, 2])
    rows, is_pad = windows.rows(np.array([5, 1, 7]), np.array([1, 0, 2]), offsets)
    assert rows.tolist() == [[4, 5, 6, 6], [0, 1, 2, 2], [7, 7, 7, 7]]
    assert is_pad.tolist() == [
        [False, False, False, True],
        [False, False, False, True],
        [True, False, True, True],
    ]


def test_indices_become_rows_where_only_some_episodes_are_loaded():
    loaded = {3: 0, 4: 1, 5: 2, 6: 3, 7: 4}
    windows = EpisodeWindows(FIRST, END, loaded)
    rows, is_pad = windows.rows(np.array([4, 7]), np.array([1, 2]), np.array([0, 3]))
    assert rows.tolist() == [[1, 3], [4, 4]]
    assert is_pad.tolist() == [[False, True], [False, True]]


def test_a_frame_that_is_not_loaded_lies_beyond_every_table():
    rows, _ = EpisodeWindows(FIRST, END, {7: 0}).rows(np.array([1]), np.array([0]), np.array([0]))
    assert rows.min() > 10**15
