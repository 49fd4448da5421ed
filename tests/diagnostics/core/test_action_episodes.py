"""Demonstrations as every instrument reads them."""

import numpy as np
import pytest

from lerobot_act_chunking.data.actions import episode_starts, is_dataset, require_dataset
from lerobot_act_chunking.diagnostics.core.episodes import evenly
from lerobot_act_chunking.errors import DatasetError


@pytest.mark.parametrize("n", [1, 2, 7, 100])
@pytest.mark.parametrize("most", [1, 2, 6, 7, 99, 500])
def test_even_indices_are_different_ordered_and_reach_both_ends(n, most):
    found = evenly(n, most)
    assert len(found) == min(n, most)
    assert found[0] == 0
    assert len(found) == 1 or found[-1] == n - 1
    gaps = {*np.diff(found).tolist()}
    assert min(gaps, default=1) >= 1
    assert max(gaps, default=1) - min(gaps, default=1) <= 1


def test_nothing_is_spread_to_nothing():
    assert evenly(0, 5).tolist() == evenly(5, 0).tolist() == []


@pytest.mark.parametrize("episode", [[0, 0, 1, 1, 1, 4], [7, 7, 8, 8, 8, 9]])
def test_an_episode_starts_where_its_number_does(episode):
    assert episode_starts(np.array(episode)).tolist() == [0, 2, 5]


def test_a_dataset_is_a_folder_with_its_description(tmp_path):
    assert not is_dataset(tmp_path)
    assert not is_dataset(str(tmp_path / "nowhere"))
    with pytest.raises(
        DatasetError, match=r"there is no dataset at .*give a LeRobotDataset's folder \(with me"
    ):
        require_dataset(tmp_path)
    (tmp_path / "meta").mkdir()
    (tmp_path / "meta" / "info.json").write_text("{}")
    assert is_dataset(str(tmp_path))
    require_dataset(tmp_path)
