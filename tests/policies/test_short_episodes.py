"""Chunks longer than every episode: what is executed, what is said, and that the way out works."""

import logging
import re

import pytest
from lerobot.configs import PreTrainedConfig
from policy_cases import CASES, LENGTHS, A, B, of_every_type
from short_runs import said, trained

from lerobot_act_chunking.errors import ConfigurationError

LONG = of_every_type("LONG")


@pytest.fixture(params=LONG, ids=lambda case: case.name)
def long(request):
    return request.param


def test_nothing_is_executed_that_was_not_taught(long, caplog):
    config = long.config()
    taught = config.timing.taught_steps(7)
    policy = trained(config, 3, 7, 5)
    assert 1 <= config.n_action_steps <= taught <= 7
    assert policy._action_queue.settings.n_action_steps == config.n_action_steps
    (line,) = said(caplog)
    assert "longest episode (7 steps)" in line
    assert policy.select_action(long.batch()).shape == (B, A)


def test_the_setting_that_fits_cures(long, caplog):
    trained(long.config(), 7)
    ((name, value),) = re.findall(r"--policy\.(\w+)=([\d.]+)", said(caplog)[0])
    caplog.clear()
    value = float(value) if "." in value else int(value)
    trained(long.config(**{name: value}), 7)
    assert not said(caplog)


def test_it_is_stored(long, tmp_path):
    config = long.config()
    trained(config, 7)
    config.save_pretrained(tmp_path)
    assert PreTrainedConfig.from_pretrained(tmp_path).n_action_steps == config.n_action_steps


def test_what_was_asked_for_is_kept_and_said(long, caplog):
    asked = {"n_action_steps": 8, "replan_interval": None, "execution": "receding"}
    config = long.config(**asked)
    trained(config, 7)
    assert {name: getattr(config, name) for name in asked} == asked
    (line,) = said(caplog)
    taught = config.timing.taught_steps(7)
    assert f"n_action_steps=8 executes steps from {taught} on, although nothing taught them" in line


def test_a_limit_that_other_settings_rule_out_is_not_set(caplog):
    config = LONG[0].config(replan_interval=9)
    trained(config, 7)
    assert config.n_action_steps == 12
    assert "n_action_steps=12 executes steps from 7 on, although" in said(caplog)[0]
    assert "--policy.n_action_steps" not in said(caplog)[0]


def test_the_weights_of_a_checkpoint_rule_out_another_length(long, caplog):
    config = long.config(n_action_steps=long.config().timing.control_steps, execution="receding")
    before = config.n_action_steps
    trained(config, 7, load_backbone_weights=False)
    (line,) = said(caplog)
    assert config.n_action_steps == before
    assert f"n_action_steps={before} executes steps from" in line
    assert "as the checkpoint learned them" in line
    assert not re.search(r"--policy\.(chunk_size|horizon|horizon_s)=", line)


def test_a_single_taught_step_is_executed_as_it_is():
    config = LONG[0].config()
    trained(config, 1)
    assert (config.n_action_steps, config.execution) == (1, "open_loop")


@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case.type}-{case.name}")
def test_episodes_as_long_as_a_chunk_change_nothing(case, caplog):
    caplog.set_level(logging.INFO)
    config, untouched = (case.config(pretrained_backbone_weights=None) for _ in range(2))
    trained(config, 2, config.timing.control_steps)
    untouched.trained_on = config.trained_on  # what is remembered of the dataset, no setting
    assert config == untouched
    assert not said(caplog)


def test_a_variant_is_what_the_given_settings_make():
    config = LONG[0].config(use_ema=True)
    assert config.given("n_action_steps") is None
    assert config.variant() == config
    assert config.variant(**{LENGTHS[config.type]: 9}).n_action_steps == 9
    with pytest.raises(ConfigurationError, match="n_action_steps=13"):
        config.variant(n_action_steps=13)
