"""From an action likelihood's name to its head."""

from lerobot_act_chunking.errors import look_up
from lerobot_act_chunking.heads.action_head import ActionHead
from lerobot_act_chunking.heads.categorical import CategoricalHead
from lerobot_act_chunking.heads.gaussian import GaussianHead
from lerobot_act_chunking.heads.laplace import LaplaceHead
from lerobot_act_chunking.heads.mixture import MixtureHead
from lerobot_act_chunking.heads.regression import RegressionHead
from lerobot_act_chunking.heads.spec import HeadSize, HeadSpec

HEADS: dict[str, type[ActionHead]] = {
    "l1": RegressionHead,
    "l2": RegressionHead,
    "laplace": LaplaceHead,
    "gaussian": GaussianHead,
    "gmm": MixtureHead,
    "categorical": CategoricalHead,
}
"""The action likelihoods. What is listed here can be asked for as ``action_likelihood``."""


def check_head(spec: HeadSpec) -> None:
    """Refuse values that cannot work.

    Raises:
        ConfigurationError: naming the value and the way out.
    """
    head = look_up("action_likelihood", spec.action_likelihood, HEADS)
    spec.check_numbers()
    head.check(spec)


def make_action_head(spec: HeadSpec, size: HeadSize) -> ActionHead:
    """A fresh head.

    Raises:
        ConfigurationError: naming a value that cannot work.
    """
    check_head(spec)
    return HEADS[spec.action_likelihood].from_spec(spec, size)
