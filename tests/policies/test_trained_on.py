"""What checkpoints remember of the demonstrations, of every type, and the warning of a wrong rate."""

import logging
from types import SimpleNamespace

import lerobot.rollout.context
import pytest
from lerobot.configs import PreTrainedConfig
from lerobot.policies.factory import get_policy_class
from lerobot.rollout.inference import SyncInferenceConfig
from planted_meta import meta_of
from policy_case import STATE
from policy_cases import CASES, WRAPPED

from lerobot_act_chunking.policies import rollout_watch
from lerobot_act_chunking.policies.trained_on import RemembersTraining, TrainedOn, wrong_rate

FIRST = {case.type: case for case in reversed([*CASES, *WRAPPED]) if case.inputs == STATE}
every_type = pytest.mark.parametrize("case", FIRST.values(), ids=FIRST)
(KEY,) = STATE


def named_meta(folder, fps=10, letter="a"):
    meta = meta_of(folder, fps=fps)
    for key in (KEY, "action"):
        (width,) = meta.features[key]["shape"]
        meta.features[key]["names"] = {"motors": [f"{letter}_{dim}" for dim in range(width)]}
    return meta


@every_type
def test_a_checkpoint_holds_rate_names_and_ranges_and_another_training_renews_them(case, tmp_path):
    config, meta = case.config(), named_meta(tmp_path / "a")
    assert config.trained_on is None
    policy = get_policy_class(config.type)(config, dataset_meta=meta)
    policy.save_pretrained(tmp_path / "policy")
    loaded = PreTrainedConfig.from_pretrained(tmp_path / "policy")
    found = loaded.trained_on
    assert found == policy.config.trained_on
    assert found.fps == 10
    assert found.names[KEY] == [f"a_{dim}" for dim in range(len(found.names[KEY]))]
    assert loaded.action_feature_names == found.names["action"]
    for key in (KEY, "action"):
        assert found.low[key] == pytest.approx(meta.stats[key]["min"].tolist())
        assert found.high[key] == pytest.approx(meta.stats[key]["max"].tolist())

    loading = get_policy_class(config.type).from_pretrained
    assert loading(tmp_path / "policy").config.trained_on == found
    other = named_meta(tmp_path / "b", fps=20, letter="b")
    renewed = loading(tmp_path / "policy", dataset_meta=other).config.trained_on
    assert (renewed.fps, renewed.names["action"][0]) == (20, "b_0")


def test_a_wrapper_takes_over_what_the_inner_policy_was_trained_on(tmp_path):
    from lerobot_act_chunking.policies.temporal_ensemble.configuration_temporal_ensemble import (
        TemporalEnsembleConfig,
    )

    config = next(iter(FIRST.values())).config()
    get_policy_class(config.type)(config, dataset_meta=named_meta(tmp_path)).save_pretrained(tmp_path / "p")
    wrapper = TemporalEnsembleConfig(inner_path=str(tmp_path / "p"), device="cpu", push_to_hub=False)
    assert wrapper.trained_on == config.trained_on
    assert wrapper.action_feature_names == config.trained_on.names["action"]


def test_names_that_a_dataset_does_not_have_are_not_made_up(tmp_path):
    found = TrainedOn.of_dataset(meta_of(tmp_path), [KEY, "action", "observation.absent"])
    assert found.names == {}
    assert set(found.low) == {KEY, "action"}


@pytest.mark.parametrize(
    ("fps", "said"), [(30, None), (30.2, None), (5, "6 times as slowly"), (60, "2 times as fast")]
)
def test_a_wrong_rate_is_said_with_its_factor(fps, said):
    text = wrong_rate(SimpleNamespace(trained_on=TrainedOn(fps=30.0)), fps)
    assert text is None if said is None else said in text
    assert wrong_rate(SimpleNamespace(), fps) is None
    assert wrong_rate(SimpleNamespace(trained_on=None), fps) is None


def test_lerobot_rollout_warns_of_a_wrong_rate_once(monkeypatch, caplog):
    module = lerobot.rollout.context
    monkeypatch.setattr(module, "create_inference_engine", original(module))
    rollout_watch.install()
    rollout_watch.install()
    policy = SimpleNamespace(config=RemembersTraining(TrainedOn(fps=30.0)))
    others = "preprocessor postprocessor hw_features dataset_features ordered_action_keys task device"
    arguments = dict.fromkeys(others.split(), ()) | {"device": "cpu", "policy": policy, "fps": 5}
    with caplog.at_level(logging.WARNING):
        engine = module.create_inference_engine(
            SyncInferenceConfig(), robot_wrapper=SimpleNamespace(robot_type="fake"), **arguments
        )
    assert engine._policy is policy
    (line,) = [each.getMessage() for each in caplog.records]
    assert "6 times as slowly as demonstrated; set --fps=30" in line


def original(module):
    """LeRobot's own, whether or not it was installed over before."""
    create = module.create_inference_engine
    return getattr(create, "__wrapped__", create)
