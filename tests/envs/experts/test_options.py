import pytest

from lerobot_act_chunking.envs.experts import ExpertOptions
from lerobot_act_chunking.errors import ConfigurationError


def test_defaults_are_nominal_and_noise_free():
    assert ExpertOptions() == ExpertOptions(speed=1.0, waypoint_noise=0.0, action_noise=0.0, dwell=0.0)


@pytest.mark.parametrize(
    ("name", "value", "allowed"),
    [
        ("speed", 0.0, "0.7 .. 1.5 times the nominal pace"),
        ("speed", 2.0, "0.7 .. 1.5 times the nominal pace"),
        ("speed", float("nan"), "0.7 .. 1.5 times the nominal pace"),
        ("waypoint_noise", -0.01, "0.0 .. 0.03 m"),
        ("waypoint_noise", 0.1, "0.0 .. 0.03 m"),
        ("action_noise", -0.1, "0.0 .. 0.05 rad"),
        ("action_noise", float("inf"), "0.0 .. 0.05 rad"),
        ("dwell", -1.0, "0.0 .. 1.0 s"),
        ("dwell", 3.0, "0.0 .. 1.0 s"),
    ],
)
def test_values_outside_their_range_are_refused(name, value, allowed):
    with pytest.raises(ConfigurationError, match=f"expert option {name}={value} is outside {allowed}"):
        ExpertOptions(**{name: value})
