import pytest
import torch
from lerobot.policies.factory import make_pre_post_processors
from policy_cases import CASES, A

from lerobot_act_chunking.errors import DatasetError

CASE = CASES[0]
STATS = {
    "observation.state": {"mean": torch.zeros(6), "std": torch.tensor([1e-6, 1, 1, 1, 1, 1])},
    "action": {"mean": torch.ones(A), "std": torch.full((A,), 1e-6)},
}


def normalised(preprocessor):
    observation = {"observation.state": torch.full((1, 6), 0.02)}
    return preprocessor(observation)["observation.state"][0]


def test_still_joints_are_divided_by_the_floor():
    preprocessor, postprocessor = make_pre_post_processors(CASE.config(), dataset_stats=STATS)
    assert normalised(preprocessor).tolist() == pytest.approx([2.0] + 5 * [0.02], rel=1e-5)
    assert postprocessor(torch.full((1, A), 3.0)).tolist()[0] == pytest.approx(A * [1.03], rel=1e-5)


def test_actions_come_back_as_they_were():
    preprocessor, postprocessor = make_pre_post_processors(CASE.config(), dataset_stats=STATS)
    batch = {"observation.state": torch.zeros(2, 6), "action": torch.randn(2, A)}
    torch.testing.assert_close(postprocessor(preprocessor(batch)["action"]), batch["action"])


def test_the_paper_preset_has_no_floor():
    preprocessor, _ = make_pre_post_processors(CASE.config(preset="paper"), dataset_stats=STATS)
    assert normalised(preprocessor)[0] > 1e4


def test_a_checkpoint_carries_the_floor(tmp_path):
    for part in make_pre_post_processors(CASE.config(), dataset_stats=STATS):
        part.save_pretrained(tmp_path)
    preprocessor, _ = make_pre_post_processors(CASE.config(), pretrained_path=str(tmp_path))
    assert normalised(preprocessor)[0].item() == pytest.approx(2.0, rel=1e-5)


def test_the_steps_have_the_names_that_lerobot_overrides(tmp_path):
    for part in make_pre_post_processors(CASE.config(), dataset_stats=STATS):
        part.save_pretrained(tmp_path)
    overrides = {
        "device_processor": {"device": "cpu"},
        "normalizer_processor": {"stats": STATS},
        "rename_observations_processor": {"rename_map": {"observation.joints": "observation.state"}},
    }
    preprocessor, _ = make_pre_post_processors(
        CASE.config(),
        pretrained_path=str(tmp_path),
        preprocessor_overrides=overrides,
        postprocessor_overrides={"unnormalizer_processor": {"stats": STATS}},
    )
    assert "observation.state" in preprocessor({"observation.joints": torch.zeros(1, 6)})


def test_a_nan_in_the_dataset_is_found_before_training():
    stats = {**STATS, "action": {"mean": torch.full((A,), torch.nan), "std": torch.ones(A)}}
    with pytest.raises(DatasetError, match="statistic 'mean' of 'action'"):
        make_pre_post_processors(CASE.config(), dataset_stats=stats)


def test_without_a_dataset_nothing_is_normalised():
    preprocessor, _ = make_pre_post_processors(CASE.config())
    assert normalised(preprocessor).tolist() == pytest.approx(6 * [0.02])
