import re

import draccus
import pytest
from lerobot.configs import PreTrainedConfig
from policy_cases import LENGTHS, TYPES

from lerobot_act_chunking.errors import ConfigurationError

LENGTH = LENGTHS[TYPES[0]]


def make(type_, **settings):
    return PreTrainedConfig.get_choice_class(type_)(device="cpu", push_to_hub=False, **settings)


@pytest.mark.parametrize("type_", TYPES)
def test_seconds_become_control_steps(type_):
    config = make(type_, fps=50, horizon_s=2.0, prediction_dt=0.1, replan_s=0.5)
    assert (config.chunk_stride, config.timing.chunk_size, config.timing.control_steps) == (5, 21, 101)
    assert config.execution_settings.replan_interval == 25


@pytest.mark.parametrize("type_", TYPES)
def test_a_chunk_of_every_step_covers_the_time_exactly(type_):
    config = make(type_, fps=10, horizon_s=2.0)
    assert (config.chunk_stride, config.timing.control_steps) == (1, 20)


@pytest.mark.parametrize("type_", TYPES)
def test_a_saved_configuration_still_says_seconds(type_, tmp_path):
    config = make(type_, fps=50, horizon_s=2.0, prediction_dt=0.1)
    config.save_pretrained(tmp_path)
    with draccus.config_type("json"):
        again = PreTrainedConfig.from_pretrained(tmp_path)
    assert (again.horizon_s, again.timing) == (2.0, config.timing)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"horizon_s": 2.0}, "horizon_s=2.0 s needs the control rate: set --policy.fps"),
        ({"replan_s": 2.0, "fps": 0}, "fps=0 must be above 0 and at most 100000"),
        ({"prediction_dt": 0.005, "fps": 50}, "prediction_dt=0.005 s is shorter than a control step"),
        ({"horizon_s": 0.001, "fps": 50}, "horizon_s=0.001 s is shorter than a control step at fps=50"),
        (
            {"replan_s": 0.0, "fps": 50},
            "replan_s=0.0 s is shorter than a control step at fps=50: set replan_s=0.02",
        ),
        (
            {"prediction_dt": 0.1, "chunk_stride": 4, "fps": 50},
            "prediction_dt=0.1 s at fps=50 makes chunk_stride=5, but chunk_stride=4 is given, too",
        ),
        (
            {"horizon_s": 2.0, LENGTH: 50, "fps": 50},
            f"horizon_s=2.0 s at fps=50 makes {LENGTH}=100, but {LENGTH}=50 is given, too",
        ),
    ],
)
def test_seconds_that_cannot_work(settings, message):
    with pytest.raises(ConfigurationError, match=re.escape(message)):
        make(TYPES[0], **settings)


def test_another_recording_rate_is_refused():
    config = make(TYPES[0], fps=50, horizon_s=2.0)
    config.check_fps(50)
    with pytest.raises(ConfigurationError, match="fps=50, but the dataset was recorded at 30 Hz"):
        config.check_fps(30)
