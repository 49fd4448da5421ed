"""Which defaults follow from the dataset, of every type: what is chosen, said, kept and stored."""

import json
import logging
import re
from types import SimpleNamespace

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import torch
from lerobot.configs import PreTrainedConfig
from lerobot.policies.factory import get_policy_class
from policy_case import STATE
from policy_cases import CASES, LENGTHS, A

FIRST = {case.type: case for case in reversed(CASES) if case.inputs == STATE}
"""A case of each type that reads states alone."""
every_type = pytest.mark.parametrize("kind", FIRST)


def config_of(kind, **settings):
    """The type with small networks, and the length that its preset gives."""
    return FIRST[kind].config(**{LENGTHS[kind]: None} | settings)


def meta_of(folder, *, changes=False, fps=10, lengths=(47, 50, 55)):
    """Metadata of a dataset, in a folder, whose actions are positions or changes of the state."""
    rng = np.random.default_rng(0)
    (width,) = STATE["observation.state"].shape
    speeds = np.repeat(rng.normal(size=(40, width)), 5, axis=0)
    states = np.cumsum(speeds, axis=0)
    actions = (speeds if changes else states)[1:, :A]
    (folder / "data").mkdir(parents=True, exist_ok=True)
    rows = {
        "observation.state": list(states[:-1]),
        "action": list(actions),
        "episode_index": [0] * len(actions),
    }
    pq.write_table(pa.table(rows), folder / "data" / "file.parquet")
    features = {
        "observation.state": {"dtype": "float32", "shape": (width,)},
        "action": {"dtype": "float32", "shape": (A,)},
    }
    return SimpleNamespace(
        root=folder, fps=fps, features=features, episodes={"length": list(lengths)}, stats=None,
        repo_id="local/planted",
    )  # fmt: skip


def made(config, meta, **kwargs):
    return get_policy_class(config.type)(config, dataset_meta=meta, **kwargs)


def said(caplog):
    return [record.getMessage() for record in caplog.records if "_defaults" in record.pathname]


@pytest.fixture(autouse=True)
def _quiet_statistics(monkeypatch):
    monkeypatch.setattr(
        "lerobot_act_chunking.policies.chunked_config.ChunkedConfig.check_dataset", lambda *_: None
    )


@every_type
@pytest.mark.parametrize(
    ("fps", "lengths", "share", "most"),
    [
        (50, (400, 400, 400), 1.0, 100),  # what the presets are made for
        (100, (900, 900, 900), 1.0, 100),  # never more: no more is loaded
        (30, (900, 900, 900), 0.6, 60),
        (10, (900, 900, 900), 0.2, 20),
        (10, (47, 47, 47), 0.2, 20),
        (50, (47, 50, 55), 0.5, 25),  # half of the median episode
        (50, (9, 9, 9), 0.0, 5),
        (50, (20, 20, 400), 0.2, 10),  # the longest episode does not decide
    ],
)
def test_a_chunk_lasts_as_long_at_any_rate_and_half_an_episode_at_most(
    kind, fps, lengths, share, most, tmp_path, caplog
):
    usual = getattr(config_of(kind), LENGTHS[kind])
    config = config_of(kind)
    made(config, meta_of(tmp_path, fps=fps, lengths=lengths))
    expected = max(5, min(most, 5 * int(usual * fps / 50 / 5), usual))
    assert getattr(config, LENGTHS[kind]) == expected
    assert config.timing.control_steps == config.n_action_steps == expected
    lines = [line for line in said(caplog) if line.startswith(LENGTHS[kind])]
    assert len(lines) == (expected != usual)
    assert all(f"--policy.{LENGTHS[kind]}={usual} keeps it" in line for line in lines)


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
    for given in ({LENGTHS[kind]: 30}, {"fps": 10, "horizon_s": 3.0}, {LENGTHS[kind]: 12, "chunk_stride": 2}):
        config = config_of(kind, **given)
        before = getattr(config, LENGTHS[kind])
        made(config, meta_of(tmp_path))
        assert getattr(config, LENGTHS[kind]) == before
    assert not [line for line in said(caplog) if line.startswith(LENGTHS[kind])]


@every_type
@pytest.mark.parametrize(
    "given", [{"n_action_steps": 40}, {"replan_interval": 30}, {"chunk_stride": 2}], ids=str
)
def test_a_length_that_other_settings_need_is_kept(kind, given, tmp_path):
    config = config_of(kind, **given)
    before = getattr(config, LENGTHS[kind])
    made(config, meta_of(tmp_path, fps=10, lengths=(300, 300)))
    assert getattr(config, LENGTHS[kind]) == before
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
    names = (LENGTHS[kind], "n_action_steps", "execution", "replan_interval")
    assert {name: stored[name] for name in names} == {name: getattr(config, name) for name in names}
    loaded = PreTrainedConfig.from_pretrained(tmp_path / "checkpoint")
    assert loaded.timing == config.timing == config.variant().timing
    assert config.variant().execution == config.execution


@every_type
def test_the_longer_chunk_that_lerobot_loaded_trains_its_beginning(kind, tmp_path):
    config = config_of(kind)
    loaded = len(config.action_delta_indices)  # before the policy is made
    policy = FIRST[kind].kind.finish(made(config, meta_of(tmp_path)))
    kept = len(config.action_delta_indices)
    assert kept < loaded
    rng = torch.Generator().manual_seed(0)
    batch = {
        "observation.state": torch.randn(4, 6, generator=rng),
        "action": torch.randn(4, loaded, A, generator=rng),
        "action_is_pad": torch.zeros(4, loaded, dtype=torch.bool),
    }
    shorter = {
        **batch,
        "action": batch["action"][:, :kept],
        "action_is_pad": batch["action_is_pad"][:, :kept],
    }
    batch["action"][:, kept:] = torch.nan
    losses = []
    for each in (batch, shorter):
        fresh = FIRST[kind].kind.finish(_same(policy, config))
        torch.manual_seed(0)
        losses.append(fresh.train().forward(each)[0])
    assert torch.isfinite(losses[0])
    assert torch.equal(*losses)


def _same(policy, config):
    fresh = get_policy_class(config.type)(config)
    fresh.load_state_dict(policy.state_dict())
    return fresh


def test_the_line_names_what_happens(tmp_path, caplog):
    with caplog.at_level(logging.WARNING):
        made(config_of("act_chunked"), meta_of(tmp_path, fps=25, lengths=(50, 50), changes=True))
    first, second = said(caplog)
    assert re.match(r"chunk_size=25, 1 s at the dataset's 25 fps, because the default of 100", first)
    assert second.startswith("execution=receding, because the dataset's actions are changes of the state")
