import pytest
from fuzz_configurations import IMAGES, named
from lerobot.policies.factory import get_policy_class

from lerobot_act_chunking.errors import ConfigurationError


def test_velocities_need_a_vector():
    with pytest.raises(ConfigurationError, match=r"set --policy\.use_velocity=false"):
        named("act_chunked", IMAGES, preset="autoregressive").config().validate_features()
    config = named("act_chunked", IMAGES, preset="autoregressive", use_velocity=False).config()
    config.validate_features()
    assert get_policy_class("act_chunked")(config) is not None
