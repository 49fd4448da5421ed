import numpy as np
import pytest

from lerobot_act_chunking.envs.aloha.experts import RANGES
from lerobot_act_chunking.envs.demonstration import ExpertOptions, correlated_noise
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
        ExpertOptions(**{name: value}).check(RANGES)


def test_noise_has_the_asked_deviation_and_is_smooth():
    noise = correlated_noise((20_000, 3), 0.02, np.random.default_rng(0), period=0.02)
    np.testing.assert_allclose(noise.std(axis=0), 0.02, rtol=0.1)
    np.testing.assert_allclose(noise[[0, -1]].std(), 0.02, rtol=1.0)
    assert np.diff(noise, axis=0).std() < 0.1 * noise.std()
    assert abs(np.corrcoef(noise.T)[0, 1]) < 0.1
