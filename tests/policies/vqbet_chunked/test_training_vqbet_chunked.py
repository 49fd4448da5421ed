"""LeRobot's own training command, while and after the tokenizer learns."""

import pytest
from training_runs import fresh, weights

from lerobot_act_chunking.cli.main import main
from lerobot_act_chunking.errors import ConfigurationError

pytestmark = pytest.mark.slow


def test_a_run_must_reach_the_policy(train, dataset, tmp_path):
    with pytest.raises(
        ConfigurationError, match=r"steps=3 are over .* the first 3 .* --steps to more than 3"
    ):
        train(*fresh(dataset, tmp_path / "run", "--steps=3", policy_type="vqbet_chunked"))
    train(*fresh(dataset, tmp_path / "four", "--steps=4", policy_type="vqbet_chunked"))
    checkpoint = tmp_path / "four/checkpoints/last/pretrained_model"
    tuned = fresh(dataset, tmp_path / "tuned", "--steps=2", policy_type="vqbet_chunked")
    train(f"--policy.path={checkpoint}", *(each for each in tuned if "--policy." not in each))
    learned = weights(tmp_path / "tuned", "last")["tokenizer_phase.n_learned"]
    assert learned == 3  # so that a shorter run is enough: nothing is left to the tokenizer


def test_a_tokenizer_trained_apart_stays_as_it_is(train, dataset, tmp_path):
    tokenizer = tmp_path / "tokenizer.safetensors"
    made = f"{dataset} --out {tokenizer} --chunk-size 5 --chunk-stride 1 --steps 3 --batch-size 8"
    assert main(["train-tokenizer", *made.split()]) == 0
    settings = fresh(dataset, tmp_path / "run", policy_type="vqbet_chunked")
    settings = [each for each in settings if "vqvae" not in each and "chunk_size" not in each]
    train(*settings, f"--policy.tokenizer_path={tokenizer}", "--steps=4")
    tokenizer.unlink()  # from here on it is in the checkpoint
    config = tmp_path / "run" / "checkpoints" / "000002" / "pretrained_model" / "train_config.json"
    train(f"--config_path={config}", "--resume=true", f"--output_dir={tmp_path / 'resumed'}")
    whole, resumed = weights(tmp_path / "run", "000004"), weights(tmp_path / "resumed", "000004")
    first = weights(tmp_path / "run", "000002")
    for name, value in whole.items():
        assert value.equal(resumed[name]), name
        if name.startswith("tokenizer."):
            assert value.equal(first[name]), name
