"""Settings of the wrapper: where the inner policy comes from, what is refused, what survives."""

import dataclasses
import json
import shutil

import draccus
import pytest
from lerobot.configs import PreTrainedConfig
from lerobot.policies.diffusion.configuration_diffusion import DiffusionConfig
from lerobot.policies.multi_task_dit.configuration_multi_task_dit import MultiTaskDiTConfig
from lerobot.policies.smolvla.configuration_smolvla import SmolVLAConfig
from lerobot.policies.vqbet.configuration_vqbet import VQBeTConfig
from policy_cases import TYPES, of_every_type
from wrapped_cases import ACT, CASES, DIFFUSION, OURS

from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.policies.temporal_ensemble.configuration_temporal_ensemble import (
    TemporalEnsembleConfig,
)
from lerobot_act_chunking.policies.temporal_ensemble.inner import chunk_length, for_chunks


def make(**settings):
    return TemporalEnsembleConfig(device="cpu", push_to_hub=False, **settings)


@pytest.fixture(params=CASES.values(), ids=CASES)
def case(request):
    return request.param


def test_it_ensembles_unless_told_otherwise():
    settings = make(inner=ACT.inner).execution_settings
    assert (settings.execution, settings.chunk_size, settings.n_action_steps) == ("ensemble", 9, 9)
    assert make(inner=ACT.inner, execution="open_loop").execution_settings.replan_interval == 9


def test_the_rest_is_the_inner_policys(case):
    config, inner = case.config(), case.bare().config
    assert config.chunk_size == case.chunk_size
    for name in (
        "n_obs_steps",
        "input_features",
        "output_features",
        "normalization_mapping",
        "observation_delta_indices",
        "action_delta_indices",
        "reward_delta_indices",
    ):
        assert getattr(config, name) == getattr(inner, name), name
    assert config.get_optimizer_preset() == inner.get_optimizer_preset()
    assert config.get_scheduler_preset() == inner.get_scheduler_preset()


def test_settings_that_only_some_policies_have():
    assert make(inner=DIFFUSION.inner).drop_n_last_frames == 7
    assert not hasattr(make(inner=ACT.inner), "drop_n_last_frames")


@pytest.mark.parametrize(
    ("config", "length"),
    [
        (MultiTaskDiTConfig(device="cpu", horizon=16, n_obs_steps=3, n_action_steps=4), 14),
        (SmolVLAConfig(device="cpu", chunk_size=12, n_action_steps=6), 12),
        (VQBeTConfig(device="cpu", action_chunk_size=6), 6),
        (DiffusionConfig(device="cpu", horizon=16, n_obs_steps=3, n_action_steps=4), 14),
    ],
    ids=lambda value: getattr(value, "type", None),
)
def test_the_longest_chunk_and_how_to_get_it(config, length):
    assert chunk_length(config) == length
    raised = for_chunks(config, weights_follow=False)
    if config.type in ("diffusion", "multi_task_dit"):
        assert raised.n_action_steps == length
        assert raised.drop_n_last_frames == config.drop_n_last_frames
        assert config.n_action_steps == 4


def test_nothing_is_downloaded_if_weights_follow():
    config = DiffusionConfig(device="cpu")
    assert for_chunks(config, weights_follow=True).pretrained_backbone_weights is None
    assert for_chunks(config, weights_follow=False).pretrained_backbone_weights is not None
    assert not for_chunks(SmolVLAConfig(load_vlm_weights=True), weights_follow=True).load_vlm_weights


def test_a_policy_without_chunks_is_refused():
    with pytest.raises(
        ConfigurationError,
        match=r"gaussian_actor cannot be wrapped: it predicts single actions, never a chunk",
    ):
        make(inner={"type": "gaussian_actor"})


def test_a_path_becomes_the_full_settings_and_where_they_come_from(case, tmp_path):
    folder = str(case.checkpoint(tmp_path / "inner"))
    config = make(inner_path=folder, execution="open_loop")
    assert (config.inner_path, config.inner_source) == (None, folder)
    assert config.inner["type"] == case.type
    assert config.input_features == case.inputs
    for name, value in case.settings.items():
        assert json.dumps(config.inner[name]) == json.dumps(value), name
    again = dataclasses.replace(config, latency_steps=0)
    assert again == config
    assert again.inner_source == folder


def test_what_is_saved_needs_no_path(tmp_path):
    inner = ACT.checkpoint(tmp_path / "inner")
    config = make(inner_path=str(inner), replan_interval=3)
    config.save_pretrained(tmp_path / "saved")
    shutil.rmtree(inner)
    saved = PreTrainedConfig.from_pretrained(tmp_path / "saved")
    assert (saved.inner_path, saved.inner_source, saved.replan_interval) == (None, None, 3)
    assert saved.inner == {**config.inner, "pretrained_path": None}
    assert saved.input_features == ACT.inputs
    changed = PreTrainedConfig.from_pretrained(
        tmp_path / "saved", cli_overrides=["--execution=crossfade", "--replan_interval=4"]
    )
    assert changed.execution_settings.crossfade_steps == 4


def test_the_inner_policy_is_described_on_the_command_line():
    arguments = ["--inner={type: act, chunk_size: 9, n_action_steps: 5}", "--replan_interval=2"]
    config = draccus.parse(TemporalEnsembleConfig, args=[*arguments, "--device=cpu"])
    assert (config.inner["type"], config.chunk_size, config.execution_settings.replan_interval) == (
        "act",
        9,
        2,
    )


def test_features_filled_in_later_reach_the_inner_policy():
    config = make(inner=ACT.inner)
    assert not config.input_features
    config.input_features, config.output_features = ACT.inputs, ACT.config().output_features
    config.validate_features()
    assert config.inner_config.env_state_feature == ACT.inputs["observation.environment_state"]


def test_the_inner_policys_device_and_precision_are_taken_over(tmp_path):
    folder = ACT.checkpoint(tmp_path / "inner")
    settings = json.loads((folder / "config.json").read_text())
    (folder / "config.json").write_text(json.dumps({**settings, "use_amp": True}))
    config = TemporalEnsembleConfig(inner_path=str(folder))
    assert (config.device, config.use_amp, config.inner_config.device) == ("cpu", True, "cpu")


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({}, "set either --policy.inner_path=<checkpoint> or --policy.inner="),
        ({"inner": ACT.inner, "inner_path": "x/y"}, "not both"),
        ({"inner": {"type": "akt"}}, "unknown type of inner policy 'akt'; choose one of: .*act, "),
        ({"inner": {"chunk_size": 4}}, "unknown type of inner policy None"),
        ({"inner": {"type": "act", "chunksize": 4}}, r"\(act\).*chunksize"),
        ({"inner": {"type": "act", "chunk_size": "many"}}, r"\(act\).*many"),
        ({"inner": {"type": "act", "chunk_size": 4}}, r"\(act\).*upper bound"),
        *(
            ({"inner": {"type": name, **settings}}, rf"\({name}\).*divisible by {divisor}")
            for name, settings, _, divisor in of_every_type("INDIVISIBLE")
        ),
        ({"inner": {"type": "temporal_ensemble", "inner": {}}}, "itself a temporal_ensemble"),
        ({"inner": {"type": "act", "use_peft": True}}, "PEFT adapter: merge it"),
        ({"inner": {"type": "pi0", "use_relative_actions": True}}, "anchored to another state"),
        ({"inner_path": "./nowhere"}, "there is no checkpoint at ./nowhere"),
        ({"inner": ACT.inner, "execution": "coherence"}, "inner act always predicts the same one"),
        *(
            (
                {"inner": {"type": name}, "execution": "coherence"},
                f"inner {name} always predicts the same one",
            )
            for name in {"act_chunked"} & set(TYPES)
        ),
        ({"inner": ACT.inner, "n_action_steps": 10}, "n_action_steps=10 exceeds the 9 control steps"),
        ({"inner": DIFFUSION.inner, "n_obs_steps": 3}, "n_obs_steps=3: the inner diffusion observes 2 steps"),
        ({"inner": ACT.inner, "replan_interval": 9}, "needs overlapping chunks: replan_interval=9"),
    ],
)
def test_what_cannot_work_is_refused(settings, message):
    with pytest.raises(ConfigurationError, match=message):
        make(**settings)


def test_a_damaged_checkpoint_is_refused(tmp_path):
    (tmp_path / "config.json").write_text("{")
    with pytest.raises(ConfigurationError, match=r"its config.json cannot be read"):
        make(inner_path=str(tmp_path))


def test_a_repository_that_is_not_there_is_refused(monkeypatch):
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_OFFLINE", True)
    with pytest.raises(
        ConfigurationError, match=r"inner_path=nobody/nothing: its config.json cannot be read"
    ):
        make(inner_path="nobody/nothing")


def test_a_run_that_could_not_push_is_refused(monkeypatch):
    monkeypatch.delenv("LEROBOT_LOCAL_HUB", raising=False)
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_OFFLINE", True)
    config = TemporalEnsembleConfig(inner=OURS.inner, device="cpu", repo_id="me/wrapped")
    with pytest.raises(ConfigurationError, match="would push to 'me/wrapped'"):
        config.get_optimizer_preset()
    config.push_to_hub = False
    assert config.get_optimizer_preset().lr == config.inner["optimizer_lr"]
