"""What `act-chunking bandwidth` reads of a wrapper's checkpoint."""

from lerobot.configs import FeatureType, PolicyFeature
from policy_cases import STATE, A

from act_chunking_runtime.settings import ExecutionSettings
from lerobot_act_chunking.diagnostics.bandwidth.source import read_source
from lerobot_act_chunking.policies.temporal_ensemble.configuration_temporal_ensemble import (
    TemporalEnsembleConfig,
)


def test_reads_a_wrapper(tmp_path):
    inner = {"type": "act", "chunk_size": 20, "n_action_steps": 20, "device": "cpu", "push_to_hub": False}
    config = TemporalEnsembleConfig(
        inner=inner,
        replan_interval=4,
        latency_steps=2,
        input_features=dict(STATE),
        output_features={"action": PolicyFeature(FeatureType.ACTION, (A,))},
        device="cpu",
        push_to_hub=False,
    )
    config._save_pretrained(tmp_path)
    assert read_source(str(tmp_path), {}).settings == ExecutionSettings(
        20,
        "ensemble",
        replan_interval=4,
        ensemble_weighting="act",
        temporal_ensemble_coeff=0.01,
        latency_steps=2,
    )
