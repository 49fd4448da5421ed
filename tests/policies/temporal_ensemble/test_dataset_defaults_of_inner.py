"""What follows from the dataset for an inner policy of this package, and what the wrapper makes of it."""

import pytest
from lerobot.configs import PreTrainedConfig
from lerobot.policies.factory import get_policy_class
from planted_meta import meta_of
from policy_case import STATE
from policy_cases import CASES, LENGTHS

from lerobot_act_chunking.policies.temporal_ensemble.configuration_temporal_ensemble import (
    TemporalEnsembleConfig,
)

FIRST = {case.type: case for case in reversed(CASES) if case.inputs == STATE}
every_type = pytest.mark.parametrize("kind", FIRST)


def wrapper_of(kind, **settings):
    case = FIRST[kind]
    described = case.config(**{LENGTHS[kind]: None})
    inner = {"type": kind, **case.kind.sizes, **case.settings}
    inner.pop(LENGTHS[kind], None)
    features = {
        "input_features": described.input_features,
        "output_features": described.output_features,
    }
    return TemporalEnsembleConfig(inner=inner, device="cpu", push_to_hub=False, **features, **settings)


@every_type
def test_what_was_chosen_is_executed_stored_and_loaded(kind, tmp_path):
    config = wrapper_of(kind)
    loaded_by_lerobot = config.action_delta_indices
    policy = get_policy_class("temporal_ensemble")(
        config, dataset_meta=meta_of(tmp_path / "data", fps=50, lengths=(400,))
    )
    inner = policy.inner.config
    assert (getattr(inner, LENGTHS[kind]), inner.chunk_stride) == (20, 5)
    assert set(inner.action_delta_indices) < set(loaded_by_lerobot)
    assert policy._action_queue.settings.n_action_steps == config.chunk_size == 96
    assert (config.inner[LENGTHS[kind]], config.inner["chunk_stride"]) == (20, 5)
    FIRST[kind].kind.finish(policy.inner)
    policy.save_pretrained(tmp_path / "checkpoint")
    again = type(policy).from_pretrained(tmp_path / "checkpoint")
    assert again.inner.config.timing == inner.timing
    assert PreTrainedConfig.from_pretrained(tmp_path / "checkpoint").chunk_size == 96


@every_type
def test_a_chunk_that_the_execution_needs_is_kept(kind, tmp_path):
    config = wrapper_of(kind, n_action_steps=100)
    policy = get_policy_class("temporal_ensemble")(
        config, dataset_meta=meta_of(tmp_path, fps=50, lengths=(400,))
    )
    assert policy.inner.config.timing.control_steps == policy._action_queue.settings.n_action_steps == 100
