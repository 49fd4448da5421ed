import math

import pytest

from act_chunking_runtime.number_checks import check_at_least, check_positive
from lerobot_act_chunking.errors import ConfigurationError


@pytest.mark.parametrize("value", [1, -math.inf, math.inf, math.nan])
def test_what_is_below_the_least_or_infinite_is_refused(value):
    with pytest.raises(ConfigurationError, match=f"^steps={value} must be at least 2$"):
        check_at_least(2, episodes=2, seed=None, steps=value)


@pytest.mark.parametrize("value", [0, -1.0, math.inf, math.nan])
def test_what_is_not_positive_is_refused(value):
    with pytest.raises(ConfigurationError, match=f"^fps={value} must be a positive number$"):
        check_positive(tolerance=None, fps=value)
