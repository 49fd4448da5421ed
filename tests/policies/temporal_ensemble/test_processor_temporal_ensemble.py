"""Processors and checkpoints: the inner policy's, found again without it."""

import shutil

import pytest
import torch
from lerobot.configs import PreTrainedConfig
from lerobot.policies.factory import get_policy_class, make_pre_post_processors
from lerobot.processor import (
    AbsoluteActionsProcessorStep,
    NormalizerProcessorStep,
    RelativeActionsProcessorStep,
)
from wrapped_cases import ACT, CASES

from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.policies.loading import load_policy
from lerobot_act_chunking.policies.temporal_ensemble.configuration_temporal_ensemble import (
    TemporalEnsembleConfig,
)
from lerobot_act_chunking.policies.temporal_ensemble.modeling_temporal_ensemble import TemporalEnsemblePolicy
from lerobot_act_chunking.policies.temporal_ensemble.processor_temporal_ensemble import (
    make_temporal_ensemble_pre_post_processors,
)


@pytest.fixture(params=CASES.values(), ids=CASES)
def case(request):
    return request.param


def over(folder, **settings):
    return TemporalEnsembleConfig(inner_path=str(folder), device="cpu", push_to_hub=False, **settings)


def act(policy, processors, case, steps=9):
    """Actions in raw units on raw observations."""
    preprocessor, postprocessor = processors
    policy.reset()
    actions = []
    for step in range(steps):
        torch.manual_seed(step)
        raw = {key: 3 * value for key, value in case.batch(seed=step).items()}
        actions.append(postprocessor(policy.select_action(preprocessor(raw))))
    return torch.stack(actions)


def test_a_wrapper_over_a_path_is_the_checkpoint(case, tmp_path):
    folder = case.checkpoint(tmp_path / "inner")
    config = over(folder, execution="open_loop", n_action_steps=case.executes)
    wrapped = get_policy_class("temporal_ensemble")(config=config).eval()
    bare = load_policy(folder)
    actions = act(wrapped, make_pre_post_processors(config), case)
    assert torch.equal(actions, act(bare.policy, bare[1:], case))


def test_a_saved_wrapper_acts_the_same_without_its_inner_checkpoint(case, tmp_path):
    folder = case.checkpoint(tmp_path / "inner")
    config = over(folder, replan_interval=2)
    policy, processors = TemporalEnsemblePolicy(config).eval(), make_pre_post_processors(config)
    for part in (policy, *processors):
        part.save_pretrained(tmp_path / "saved")
    expected = act(policy, processors, case)
    shutil.rmtree(folder)
    loaded = load_policy(tmp_path / "saved")
    assert torch.equal(act(loaded.policy, loaded[1:], case), expected)
    assert all(name.startswith("inner.") for name in loaded.policy.state_dict())


def test_another_execution_of_a_saved_wrapper(tmp_path):
    config = over(ACT.checkpoint(tmp_path / "inner"))
    TemporalEnsemblePolicy(config).save_pretrained(tmp_path / "saved")
    changed = PreTrainedConfig.from_pretrained(
        tmp_path / "saved", cli_overrides=["--execution=open_loop", "--n_action_steps=4"]
    )
    policy = TemporalEnsemblePolicy.from_pretrained(tmp_path / "saved", config=changed)
    policy.select_action(ACT.batch())
    assert len(policy._action_queue) == 3


def test_weights_that_do_not_fit_are_refused(tmp_path):
    TemporalEnsemblePolicy(ACT.config()).save_pretrained(tmp_path / "saved")
    config = type(ACT)("act", ACT.inputs, {**ACT.settings, "n_encoder_layers": 2}, 9, 5).config()
    with pytest.raises(RuntimeError, match=r"inner\.model\.encoder\.layers\.1"):
        TemporalEnsemblePolicy.from_pretrained(tmp_path / "saved", config=config)


def test_from_scratch_the_processors_are_the_inner_types(tmp_path):
    statistics = {
        key: {"mean": torch.ones(n), "std": torch.ones(n)}
        for key, n in (("observation.state", 6), ("observation.environment_state", 7), ("action", 4))
    }
    preprocessor, postprocessor = make_pre_post_processors(ACT.config(), dataset_stats=statistics)
    expected = make_pre_post_processors(ACT.bare().config, dataset_stats=statistics)
    for pipeline, other in zip((preprocessor, postprocessor), expected, strict=True):
        assert [type(step) for step in pipeline.steps] == [type(step) for step in other.steps]
    batch = preprocessor({"observation.state": torch.full((1, 6), 3.0)})
    assert torch.equal(batch["observation.state"], torch.full((1, 6), 2.0))


def test_a_checkpoint_keeps_its_statistics_and_moves_to_the_device(tmp_path):
    config = over(ACT.checkpoint(tmp_path / "inner"))
    config.device = "meta"
    preprocessor, _ = make_temporal_ensemble_pre_post_processors(
        config, dataset_stats={"observation.state": {"mean": torch.full((6,), 9.0)}}
    )
    [normalizer] = [step for step in preprocessor.steps if isinstance(step, NormalizerProcessorStep)]
    assert normalizer.stats["observation.state"]["mean"][0] == pytest.approx(0.3)
    [device] = [step for step in preprocessor.steps if type(step).__name__ == "DeviceProcessorStep"]
    assert str(device.device) == "meta"


@pytest.mark.parametrize("enabled", [True, False])
def test_relative_actions_are_refused(tmp_path, enabled):
    folder = ACT.checkpoint(tmp_path / "inner")
    preprocessor, postprocessor = make_pre_post_processors(ACT.bare().config, pretrained_path=str(folder))
    preprocessor.steps = [*preprocessor.steps, RelativeActionsProcessorStep(enabled=enabled)]
    postprocessor.steps = [*postprocessor.steps, AbsoluteActionsProcessorStep(enabled=enabled)]
    preprocessor.save_pretrained(folder)
    postprocessor.save_pretrained(folder)
    if not enabled:
        make_pre_post_processors(over(folder))
        return
    with pytest.raises(
        ConfigurationError, match=r"inner act predicts actions relative .* anchored to another"
    ):
        make_pre_post_processors(over(folder))
