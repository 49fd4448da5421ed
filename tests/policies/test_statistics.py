import re
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from lerobot.configs import FeatureType, NormalizationMode, PolicyFeature

from lerobot_act_chunking.errors import DatasetError
from lerobot_act_chunking.policies.statistics import check_statistics, floored_statistics

STATS = {
    "observation.state": {"mean": np.array([1.0, 2.0]), "std": np.array([1e-4, 0.5]), "min": [0.0, 0.0]},
    "action": {
        "min": torch.tensor([1.0, -2.0]),
        "max": torch.tensor([1.0, 2.0]),
        "q01": torch.tensor([1.0, -1.0]),
        "q99": torch.tensor([1.004, 1.0]),
        "mean": torch.zeros(2),
        "std": torch.ones(2),
    },
    "timestamp": {"mean": [float("nan")]},
}


def config(**modes):
    return SimpleNamespace(
        input_features={"observation.state": PolicyFeature(FeatureType.STATE, (2,))},
        output_features={"action": PolicyFeature(FeatureType.ACTION, (2,))},
        normalization_mapping={key: NormalizationMode(mode) for key, mode in modes.items()},
    )


def test_small_standard_deviations_are_lifted_to_the_floor():
    floored = floored_statistics(config(STATE="MEAN_STD"), STATS, 0.01)
    assert floored["observation.state"]["std"].tolist() == pytest.approx([0.01, 0.5])
    assert floored["observation.state"]["mean"].tolist() == [1.0, 2.0]


@pytest.mark.parametrize(("mode", "low", "high"), [("MIN_MAX", "min", "max"), ("QUANTILES", "q01", "q99")])
def test_small_ranges_are_widened_about_their_centre(mode, low, high):
    floored = floored_statistics(config(ACTION=mode), STATS, 0.01)["action"]
    middle = (STATS["action"][low][0] + STATS["action"][high][0]).item() / 2
    assert floored[low][0].item() == pytest.approx(middle - 0.01)
    assert floored[high][0].item() == pytest.approx(middle + 0.01)
    assert (floored[low][1], floored[high][1]) == (STATS["action"][low][1], STATS["action"][high][1])


def test_the_datasets_own_statistics_stay():
    floored_statistics(config(STATE="MEAN_STD", ACTION="MIN_MAX"), STATS, 0.5)
    assert STATS["observation.state"]["std"][0] == 1e-4
    assert STATS["action"]["max"][0] == 1.0


def test_no_floor_changes_nothing():
    floored = floored_statistics(config(STATE="MEAN_STD", ACTION="MIN_MAX"), STATS, 0.0)
    assert floored["observation.state"]["std"].tolist() == pytest.approx([1e-4, 0.5])
    assert torch.equal(floored["action"]["min"], STATS["action"]["min"])


def test_features_that_are_not_normalised_need_no_statistics():
    assert floored_statistics(config(), {}, 0.01) == {}


def test_missing_statistics_are_named():
    with pytest.raises(DatasetError, match=r"no max or min of 'observation\.state' to normalise it by"):
        floored_statistics(config(STATE="MIN_MAX"), {"observation.state": {"mean": [0.0]}}, 0.01)


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_spoiled_statistics_are_named(value):
    stats = {**STATS, "action": {**STATS["action"], "std": torch.tensor([1.0, value])}}
    with pytest.raises(DatasetError, match=r"statistic 'std' of 'action' is .*holds a NaN or an infinity"):
        check_statistics(config(ACTION="MEAN_STD"), stats)


def test_statistics_the_policy_does_not_use_may_be_anything():
    check_statistics(config(STATE="MEAN_STD"), STATS)
    check_statistics(config(), {"action": {"mean": "unknown", "std": [-1.0, 0.5]}})


@pytest.mark.parametrize(
    ("mode", "values", "fault"),
    [
        ("MEAN_STD", {"std": [0.5, -1.0]}, "statistic 'std' of 'action' is [0.5, -1.0]: a spread below 0"),
        ("MEAN_STD", {"std": [1j, 1.0]}, "statistic 'std' of 'action' is [1j, 1.0]: no real number"),
        ("MEAN_STD", {"mean": "unknown"}, "statistic 'mean' of 'action' is 'unknown': no real number"),
        (
            "MEAN_STD",
            {"mean": [[1.0], [1.0, 2.0]]},
            "statistic 'mean' of 'action' is [[1.0], [1.0, 2.0]]: no",
        ),
        ("MEAN_STD", {"mean": None}, "statistic 'mean' of 'action' is None: no real number"),
        ("MEAN_STD", {"mean": [1.0]}, "statistic 'mean' of 'action' has 1 numbers, but the policy has 2"),
        (
            "MIN_MAX",
            {"min": [0.0, 9.0], "max": [1.0, 2.0]},
            "'min' of 'action' is [0.0, 9.0], above 'max' of",
        ),
        ("QUANTILES", {"q01": [0.0, 9.0], "q99": [1.0, 2.0]}, "'q01' of 'action' is [0.0, 9.0], above 'q99'"),
    ],
)
def test_statistics_that_nothing_can_be_normalised_by_are_named(mode, values, fault):
    stats = {**STATS, "action": {**STATS["action"], **values}}
    with pytest.raises(DatasetError, match=re.escape(fault)) as error:
        check_statistics(config(ACTION=mode), stats)
    assert "--operation.type=recompute_stats" in str(error.value)
