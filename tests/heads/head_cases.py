"""What the tests of all heads share."""

from lerobot_act_chunking.heads.make import HEADS
from lerobot_act_chunking.heads.regression import RegressionHead
from lerobot_act_chunking.heads.spec import HeadSpec

SAMPLED = [name for name, head in HEADS.items() if not issubclass(head, RegressionHead)]

USUAL = {
    "action_likelihood": "l1",
    "nll_beta": 0.5,
    "min_std": 0.01,
    "n_components": 5,
    "n_bins": 256,
    "hl_gauss_sigma": 0.75,
    "soft_local_bins": 2,
    "action_temperature": 0.0,
    "action_top_k": 0,
}


def head_spec(**settings) -> HeadSpec:
    return HeadSpec(**USUAL | settings)
