"""Property: LeRobot's own policies train on the same, and fail alike, with and without the package."""

import contextlib
import io
import json
import logging
import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import torch
from lerobot.datasets import factory
from lerobot.scripts.lerobot_train import train
from lerobot_sets import REPO_ID, camera, record
from tiers import full_tier, some

from lerobot_act_chunking.data import fast_chunks
from lerobot_act_chunking.data.fast_chunks.dataset import FastChunkDataset

POLICIES = {
    "act": "chunk_size=3 n_action_steps=3 dim_model=16 n_heads=2 dim_feedforward=16 n_encoder_layers=1 "
    "n_vae_encoder_layers=1 pretrained_backbone_weights=null",
    "diffusion": "horizon=8 n_action_steps=4 down_dims=[16,32] kernel_size=3 n_groups=4 "
    "num_train_timesteps=4 diffusion_step_embed_dim=8 spatial_softmax_num_keypoints=4 "
    "noise_scheduler_type=DDIM crop_shape=[84,84]",
    "vqbet": "n_obs_steps=2 action_chunk_size=3 n_vqvae_training_steps=1 vqvae_n_embed=4 "
    "vqvae_embedding_dim=8 vqvae_enc_hidden_dim=8 gpt_input_dim=16 gpt_output_dim=16 gpt_hidden_dim=16 "
    "gpt_n_layer=1 gpt_n_head=2 pretrained_backbone_weights=null use_group_norm=true "
    "spatial_softmax_num_keypoints=4 crop_shape=[84,84]",
}
NEEDS = {"vqbet": {"observation.images.top": camera("image", 96, 112)}}
IN_THE_GATE = "act"


def vector(dtype: str, *shape: int) -> dict[str, Any]:
    return {"dtype": dtype, "shape": shape, "names": None}


SOUND = {"observation.state": vector("float32", 6), "observation.environment_state": vector("float32", 3)}
EXTRA = {
    "nothing": {},
    "an unread sensor": {"observation.force": vector("float32", 2)},
    "text": {"observation.label": vector("string", 1)},
    "text beside the action": {"action.note": vector("string", 1)},
    "switches": {"observation.switches": vector("bool", 2)},
    "a camera": {"observation.images.top": camera("image", 96, 112)},
}


def nan_in(key: str, root: Path) -> None:
    replace(root, key, lambda rows: [[np.nan] * len(row) if n == 4 else row for n, row in enumerate(rows)])


def replace(root: Path, key: str, change: Any) -> None:
    (path,) = (root / "data").rglob("*.parquet")
    table = pq.read_table(path)
    new = pa.array(change(table[key].to_pylist()), table.schema.field(key).type)
    place = table.column_names.index(key)
    pq.write_table(table.set_column(place, key, new).replace_schema_metadata(None), path)


def stats(root: Path, change: Any) -> None:
    path = root / "meta/stats.json"
    values = json.loads(path.read_text())
    change(values)
    path.write_text(json.dumps(values))


DAMAGE = {
    "none": lambda root: None,
    "NaN in an unread sensor": lambda root: nan_in("observation.force", root),
    "NaN in the state": lambda root: nan_in("observation.state", root),
    "a shifted index": lambda root: replace(root, "index", lambda rows: [row + 1 for row in rows]),
    "no stats.json": lambda root: (root / "meta/stats.json").unlink(),
    "a negative spread": lambda root: stats(root, lambda s: s["action"].update(std=[-1.0] * 4)),
    "no data": lambda root: shutil.rmtree(root / "data"),
    "no meta": lambda root: shutil.rmtree(root / "meta"),
}
CASES = [(extra, "none") for extra in EXTRA] + [("an unread sensor", damage) for damage in list(DAMAGE)[1:]]


def outcome(policy: str, root: Path, out: Path) -> Any:
    """The kind of error, or the weights after two steps of lerobot-train."""
    options = [f"--policy.{option}" for option in POLICIES[policy].split()]
    argv = ["lerobot-train", f"--policy.type={policy}", "--policy.device=cpu", "--policy.push_to_hub=false"]
    argv += [f"--dataset.repo_id={REPO_ID}", f"--dataset.root={root}", f"--output_dir={out}", "--steps=2"]
    argv += ["--save_freq=9", "--batch_size=4", "--num_workers=0", "--env_eval_freq=0", *options]
    seen: dict[str, Any] = {}
    patch = pytest.MonkeyPatch()
    patch.setattr(sys, "argv", argv)
    patch.setattr("lerobot.scripts.lerobot_train.save_checkpoint", lambda **kw: seen.update(kw))
    patch.setattr("lerobot.scripts.lerobot_train.update_last_checkpoint", lambda _: None)
    silent = io.StringIO()
    try:
        with contextlib.redirect_stdout(silent), contextlib.redirect_stderr(silent):
            train()
    except Exception as error:
        return type(error)
    finally:
        patch.undo()
        logging.getLogger().handlers.clear()
    return {key: value.clone() for key, value in seen["policy"].state_dict().items()}


@pytest.fixture
def clean(monkeypatch):
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_OFFLINE", True)
    installed = factory.LeRobotDataset is FastChunkDataset
    handlers = list(logging.getLogger().handlers)
    yield
    logging.getLogger().handlers[:] = handlers
    (fast_chunks.install if installed else fast_chunks.uninstall)()


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # LeRobot's own, of what it trains on here
@pytest.mark.parametrize(
    "policy", [pytest.param(name, marks=() if name == IN_THE_GATE else full_tier) for name in POLICIES]
)
@pytest.mark.parametrize(("extra", "damage"), some(3, CASES), ids=lambda name: name.replace(" ", "_"))
def test_lerobots_policies_end_as_without_us(tmp_path, clean, policy, extra, damage):
    features = {**SOUND, **NEEDS.get(policy, {}), **EXTRA[extra], "action": vector("float32", 4)}
    root = record(tmp_path / "set", features, (9, 12), use_videos=False)
    DAMAGE[damage](root)
    fast_chunks.uninstall()
    without = outcome(policy, root, tmp_path / "without")
    assert fast_chunks.install()
    ours = outcome(policy, root, tmp_path / "with")
    if isinstance(without, type):
        assert (extra, damage) != ("nothing", "none")
        assert ours is without
    else:
        torch.testing.assert_close(ours, without, rtol=0, atol=0, equal_nan=True)
