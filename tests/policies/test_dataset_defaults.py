"""Which defaults follow from the dataset, of every type: what is chosen, said, kept and stored."""

import json
import logging

import pytest
import torch
from lerobot.configs import PreTrainedConfig
from lerobot.policies.factory import get_policy_class
from planted_meta import meta_of
from policy_case import STATE
from policy_cases import CASES, LENGTHS, A

FIRST = {case.type: case for case in reversed(CASES) if case.inputs == STATE}
"""A case of each type that reads states alone."""
every_type = pytest.mark.parametrize("kind", FIRST)


def config_of(kind, **settings):
    """The type with small networks, and the length that its preset gives."""
    return FIRST[kind].config(**{LENGTHS[kind]: None} | settings)


def made(config, meta, **kwargs):
    return get_policy_class(config.type)(config, dataset_meta=meta, **kwargs)


def said(caplog):
    return [record.getMessage() for record in caplog.records if "_defaults" in record.pathname]


@every_type
@pytest.mark.parametrize(
    ("fps", "lengths", "length", "stride"),
    [
        (50, (400, 400, 400), 20, 5),  # what the presets are made for
        (100, (900, 900, 900), 10, 10),  # no more is loaded
        (30, (900, 900, 900), 20, 3),
        (25, (900, 900, 900), 24, 2),
        (15, (900, 900, 900), 14, 2),
        (10, (900, 900, 900), 20, 1),
        (10, (47, 47, 47), 20, 1),
        (10, (24, 24, 24), 10, 1),
        (50, (90, 100, 110), 10, 5),  # half of the median episode
        (50, (9, 9, 9), 2, 5),
        (50, (40, 40, 400), 4, 5),  # the longest episode does not decide
    ],
)
def test_predictions_lie_a_tenth_of_a_second_apart_over_half_an_episode_at_most(
    kind, fps, lengths, length, stride, tmp_path, caplog
):
    config = config_of(kind)
    assert (getattr(config, LENGTHS[kind]), config.chunk_stride) == (100, 1)
    made(config, meta_of(tmp_path, fps=fps, lengths=lengths))
    assert (getattr(config, LENGTHS[kind]), config.chunk_stride) == (length, stride)
    assert config.n_action_steps == config.timing.control_steps == (length - 1) * stride + 1
    (line,) = [line for line in said(caplog) if line.startswith(LENGTHS[kind])]
    assert f"--policy.{LENGTHS[kind]}=100 keeps the preset's" in line


@every_type
@pytest.mark.parametrize(("fps", "length"), [(50, 100), (30, 60), (10, 20), (100, 100)])
def test_a_prediction_for_every_step_that_was_asked_for_lasts_as_long(kind, fps, length, tmp_path):
    config = config_of(kind, chunk_stride=1)
    made(config, meta_of(tmp_path, fps=fps, lengths=(900, 900)))
    assert (getattr(config, LENGTHS[kind]), config.chunk_stride) == (length, 1)


@every_type
def test_of_changes_every_step_is_predicted(kind, tmp_path):
    config = config_of(kind)
    made(config, meta_of(tmp_path, changes=True, fps=25, lengths=(50, 50)))
    assert (getattr(config, LENGTHS[kind]), config.chunk_stride) == (25, 1)


@every_type
@pytest.mark.parametrize("fps", [50, 25, 10, 5])
def test_changes_are_followed_by_the_newest_chunk_alone(kind, fps, tmp_path, caplog):
    config = config_of(kind)
    usual = config.execution
    policy = made(config, meta_of(tmp_path, changes=True, fps=fps))
    settings = policy._action_queue.settings
    assert settings.execution == config.execution == "receding"
    assert settings.replan_interval == max(1, settings.n_action_steps // 4)
    (line,) = [line for line in said(caplog) if line.startswith("execution=receding")]
    assert f"--policy.execution={usual} keeps" in line


@every_type
def test_positions_are_blended(kind, tmp_path, caplog):
    config = config_of(kind)
    before = config.execution
    made(config, meta_of(tmp_path, changes=False))
    assert config.execution == before == "crossfade"
    assert not [line for line in said(caplog) if "execution" in line]


@every_type
@pytest.mark.parametrize(
    "given", [{"execution": "ensemble"}, {"execution": "crossfade"}, {"crossfade_steps": 4}], ids=str
)
def test_an_execution_that_was_given_is_kept(kind, given, tmp_path, caplog):
    config = config_of(kind, **given)
    made(config, meta_of(tmp_path, changes=True))
    assert config.execution == given.get("execution", "crossfade")
    assert not [line for line in said(caplog) if "receding" in line]


@every_type
@pytest.mark.parametrize("given", [{"replan_interval": 3}, {"fps": 10, "replan_s": 0.3}], ids=str)
def test_an_interval_that_was_given_holds_for_the_mode_that_is_chosen(kind, given, tmp_path):
    config = config_of(kind, latency_steps=1, **given)
    policy = made(config, meta_of(tmp_path, changes=True))
    settings = policy._action_queue.settings
    assert (settings.execution, settings.replan_interval, settings.latency_steps) == ("receding", 3, 1)


@every_type
def test_a_length_that_was_given_is_kept(kind, tmp_path, caplog):
    for given in (
        {LENGTHS[kind]: 30},
        {LENGTHS[kind]: 100},
        {"fps": 10, "horizon_s": 3.0},
        {LENGTHS[kind]: 12, "chunk_stride": 2},
    ):
        config = config_of(kind, **given)
        before = getattr(config, LENGTHS[kind])
        made(config, meta_of(tmp_path))
        assert getattr(config, LENGTHS[kind]) == before
    assert not [line for line in said(caplog) if line.startswith(LENGTHS[kind])]


@every_type
@pytest.mark.parametrize(
    ("fps", "given"),
    [
        (10, {"n_action_steps": 40}),
        (10, {"replan_interval": 30}),
        (10, {"chunk_stride": 2}),
        (50, {"n_action_steps": 100}),
    ],
    ids=str,
)
def test_a_length_that_other_settings_need_is_kept(kind, fps, given, tmp_path):
    config = config_of(kind, **given)
    before = getattr(config, LENGTHS[kind]), config.chunk_stride
    made(config, meta_of(tmp_path, fps=fps, lengths=(300, 300)))
    assert (getattr(config, LENGTHS[kind]), config.chunk_stride) == before
    assert all(getattr(config, name) == value for name, value in given.items())


@every_type
def test_what_goes_on_from_a_checkpoint_keeps_all(kind, tmp_path, caplog):
    config = config_of(kind)
    before = getattr(config, LENGTHS[kind]), config.execution
    made(config, meta_of(tmp_path, changes=True), load_backbone_weights=False)
    assert (getattr(config, LENGTHS[kind]), config.execution) == before
    assert not said(caplog)


@every_type
def test_the_paper_keeps_its_settings(kind, tmp_path, caplog):
    config = FIRST[kind].config(preset="paper", **{LENGTHS[kind]: None})
    before = getattr(config, LENGTHS[kind]), config.execution
    made(config, meta_of(tmp_path, changes=True, fps=5, lengths=(900,)))
    assert (getattr(config, LENGTHS[kind]), config.execution) == before
    assert not said(caplog)


@every_type
def test_what_was_chosen_is_stored_and_loaded(kind, tmp_path):
    config = config_of(kind)
    policy = FIRST[kind].kind.finish(made(config, meta_of(tmp_path / "data", changes=True)))
    policy.save_pretrained(tmp_path / "checkpoint")
    stored = json.loads((tmp_path / "checkpoint" / "config.json").read_text())
    names = (LENGTHS[kind], "chunk_stride", "n_action_steps", "execution", "replan_interval")
    assert {name: stored[name] for name in names} == {name: getattr(config, name) for name in names}
    loaded = PreTrainedConfig.from_pretrained(tmp_path / "checkpoint")
    assert loaded.timing == config.timing == config.variant().timing
    assert config.variant().execution == config.execution


@every_type
@pytest.mark.parametrize("fps", [50, 30, 10])
def test_of_what_lerobot_loaded_the_chosen_actions_are_learned(kind, fps, tmp_path):
    config = config_of(kind)
    loaded = config.action_delta_indices  # before the policy is made
    policy = FIRST[kind].kind.finish(made(config, meta_of(tmp_path, fps=fps)))
    places = [loaded.index(step) for step in config.action_delta_indices]
    assert len(places) < len(loaded)
    rng = torch.Generator().manual_seed(0)
    batch = {
        "observation.state": torch.randn(4, 6, generator=rng),
        "action": torch.full((4, len(loaded), A), torch.nan),
        "action_is_pad": torch.rand(4, len(loaded), generator=rng) < 0.1,
    }
    chosen = {
        **batch,
        "action": torch.randn(4, len(places), A, generator=rng),
        "action_is_pad": batch["action_is_pad"][:, places],
    }
    batch["action"][:, places] = chosen["action"]
    losses = []
    for each in (batch, chosen):
        fresh = FIRST[kind].kind.finish(_same(policy, config))
        torch.manual_seed(0)
        losses.append(fresh.train().forward(each)[0])
    assert torch.isfinite(losses[0])
    assert torch.equal(*losses)


def _same(policy, config):
    fresh = get_policy_class(config.type)(config)
    fresh.load_state_dict(policy.state_dict())
    return fresh


@every_type
def test_the_line_names_what_happens(kind, tmp_path, caplog):
    with caplog.at_level(logging.WARNING):
        made(config_of(kind), meta_of(tmp_path, fps=25, lengths=(50, 50), changes=True))
    first, second = said(caplog)
    chosen = f"{LENGTHS[kind]}=25 and chunk_stride=1: predictions 0.04 s apart over 1 s, for 25 fps"
    assert first.startswith(chosen)
    assert second.startswith("execution=receding, because the dataset's actions are changes of the state")
