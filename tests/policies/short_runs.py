"""Policies to be trained on episodes of given lengths, and what is said about these."""

from types import SimpleNamespace

from lerobot.policies.factory import get_policy_class


def trained(config, *lengths, **kwargs):
    """The policy that LeRobot would make to train on episodes of these lengths."""
    meta = SimpleNamespace(episodes={"length": list(lengths)}, fps=10, features={}, stats=None)
    return get_policy_class(config.type)(config, dataset_meta=meta, **kwargs)


def said(caplog):
    return [record.message for record in caplog.records if "longest episode" in record.message]
