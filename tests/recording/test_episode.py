from dataclasses import replace

import numpy as np
import pytest
from fake_source import FakeSource, film

from lerobot_act_chunking.errors import DatasetError
from lerobot_act_chunking.recording.episode import check_episode

SOURCE = FakeSource(camera=True)


def test_a_good_episode_passes():
    episode = SOURCE.play(7)
    assert len(episode) == 5 + 7 % 3
    check_episode(episode, SOURCE.format)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_value_that_is_not_finite_is_refused_with_its_place(value):
    episode = SOURCE.play(8)
    episode.arrays["action"][3, 1] = value
    with pytest.raises(DatasetError, match=rf"action of seed 8 is {value} at frame 3, entry dy"):
        check_episode(episode, SOURCE.format)


def test_an_unnamed_entry_is_told_by_its_index():
    episode = SOURCE.play(8)
    episode.arrays["action"][3, 1] = np.nan
    form = SOURCE.format
    features = {**form.features, "action": {"dtype": "float32", "shape": (2,), "names": None}}
    with pytest.raises(DatasetError, match=r"entry \[1\]"):
        check_episode(episode, replace(form, features=features))


def test_missing_and_unknown_features_are_refused():
    episode = SOURCE.play(1)
    episode.arrays["observation.smell"] = episode.arrays.pop("observation.state")
    with pytest.raises(DatasetError, match=r"seed 1 has the features .*observation\.smell.* the dataset"):
        check_episode(episode, SOURCE.format)


def test_wrong_shape_and_type_are_refused():
    episode = SOURCE.play(0)
    short = replace(episode, arrays={**episode.arrays, "action": episode.arrays["action"][:, :1]})
    message = r"action of seed 0 is float32 \(5, 1\), expected float32 \(5, 2\)"
    with pytest.raises(DatasetError, match=message):
        check_episode(short, SOURCE.format)
    double = replace(
        episode, arrays={**episode.arrays, "action": episode.arrays["action"].astype(np.float64)}
    )
    with pytest.raises(DatasetError, match="action of seed 0 is float64"):
        check_episode(double, SOURCE.format)


def test_a_video_of_another_length_is_refused():
    episode = replace(SOURCE.play(0), videos={"observation.images.eye": film(np.random.default_rng(0), 4)})
    message = r"observation\.images\.eye of seed 0 has frames \(4, 16, 24, 3\), expected \(5, 16, 24, 3\)"
    with pytest.raises(DatasetError, match=message):
        check_episode(episode, SOURCE.format)
