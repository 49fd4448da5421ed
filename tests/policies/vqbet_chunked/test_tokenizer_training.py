"""Training a tokenizer apart from a policy."""

from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
import torch
from lerobot.configs import NormalizationMode
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from safetensors.torch import load_file
from tokenizer_training_cases import FIELDS, LENGTHS, NAMES, plan, write_dataset

from lerobot_act_chunking.data.actions import read_demonstrations
from lerobot_act_chunking.data.masking import hold_padding
from lerobot_act_chunking.data.timing import ChunkTiming
from lerobot_act_chunking.errors import ConfigurationError, DatasetError
from lerobot_act_chunking.policies.vqbet_chunked import tokenizer_training
from lerobot_act_chunking.policies.vqbet_chunked.action_chunks import ActionChunks
from lerobot_act_chunking.policies.vqbet_chunked.tokenizer_file import TokenizerTraining, read_info
from lerobot_act_chunking.policies.vqbet_chunked.tokenizer_training import plan_training, train_tokenizer


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    return write_dataset(tmp_path_factory.mktemp("data") / "waves")


@pytest.fixture
def every_step_saved(monkeypatch):
    monkeypatch.setattr(tokenizer_training, "SAVE_EVERY_S", -1.0)


def interrupt_at(step):
    def progress(done, numbers):
        if done == step:
            raise KeyboardInterrupt

    return progress


def chunks_of(dataset, mode=NormalizationMode.MEAN_STD, floor=0.01):
    return ActionChunks(read_demonstrations(dataset), ChunkTiming(1, 4, 2), mode, floor)


def test_chunks_are_those_that_a_policy_learns_from(dataset):
    chunks = chunks_of(dataset)
    times = {"action": [step / 20 for step in (0, 2, 4, 6)]}
    reference = LeRobotDataset("me/waves", root=dataset, delta_timestamps=times)
    actions, is_pad = chunks.take(np.arange(len(chunks)))
    assert len(chunks) == len(reference) == sum(LENGTHS)
    for row, item in enumerate(reference):
        assert torch.equal(is_pad[row], item["action_is_pad"])
        held = hold_padding(item["action"][None], item["action_is_pad"][None])
        torch.testing.assert_close(chunks.raw(actions[row : row + 1]), held, rtol=1e-5, atol=1e-6)
    valid = actions[:, 0]
    assert valid[:, 0].mean().abs() < 0.1
    assert valid[:, 0].std() == pytest.approx(1, abs=0.1)


@pytest.mark.parametrize("mode", ["MIN_MAX", "QUANTILES", "MEAN_STD", "IDENTITY"])
def test_normalisation_has_a_floor(dataset, mode):
    chunks = chunks_of(dataset, NormalizationMode(mode), floor=0.25)
    actions, _ = chunks.take(np.arange(3))
    expected = {"IDENTITY": 0.5}.get(mode, 0.0)
    torch.testing.assert_close(actions[:, :, 1], torch.full((3, 4), expected), atol=1e-5, rtol=0)
    assert {name: len(values) for name, values in chunks.statistics.items()} == {
        "MIN_MAX": {"min": 3, "max": 3},
        "QUANTILES": {"q01": 3, "q99": 3},
        "MEAN_STD": {"mean": 3, "std": 3},
        "IDENTITY": {},
    }[mode]
    if mode == "MIN_MAX":
        assert chunks.statistics["min"][1] == pytest.approx(0.25)
        assert chunks.statistics["max"][1] == pytest.approx(0.75)


def test_only_the_action_columns_are_read(dataset, monkeypatch):
    asked = []

    def read_table(file, **options):
        if isinstance(file, Path):  # others are LeRobot's, of its metadata
            asked.append(options.get("columns"))
        return original(file, **options)

    original = pq.read_table
    monkeypatch.setattr(pq, "read_table", read_table)
    read_demonstrations(dataset)
    assert asked
    assert all(columns == ["action", "episode_index"] for columns in asked)


def test_a_tokenizer_file_from_start_to_end(dataset, tmp_path):
    info, chunks = plan(dataset, steps=30)
    seen = []
    trained = train_tokenizer(
        tmp_path / "new" / "t.safetensors", info, chunks, lambda *told: seen.append(told)
    )
    assert [done for done, _ in seen] == list(range(1, 31))
    assert seen[-1][1]["reconstruction_l1"] < seen[0][1]["reconstruction_l1"]
    assert {"loss", "used_codes", "code_perplexity"} <= seen[0][1].keys()
    assert read_info(tmp_path / "new" / "t.safetensors") == info
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["t.safetensors"]
    assert list(trained.error) == NAMES
    assert trained.ranges[1] == 0
    assert all(1 <= used <= 3 for used in trained.used_codes)
    assert trained.steps_before == 0
    assert 1 <= trained.combinations <= 9


def test_the_error_is_measured_in_raw_units_over_every_valid_step(dataset, tmp_path, monkeypatch):
    monkeypatch.setattr(tokenizer_training, "AT_ONCE", 5)
    info, chunks = plan(dataset)
    trained = train_tokenizer(tmp_path / "t", info, chunks)
    tokenizer = tokenizer_training.make_tokenizer(info.spec)
    tokenizer.load_state_dict(load_file(tmp_path / "t"))
    actions, is_pad = chunks.take(np.arange(len(chunks)))
    std = torch.tensor(info.statistics["std"])
    expected = tokenizer.reconstruction_error(actions, is_pad) * std
    assert list(trained.error.values()) == pytest.approx(expected.tolist(), rel=1e-4)


@pytest.mark.parametrize("fields", [{}, {"tokenizer": "fsq"}, {"dead_code_threshold": 2.0}])
def test_a_resumed_training_ends_where_an_undisturbed_one_does(dataset, tmp_path, every_step_saved, fields):
    info, chunks = plan(dataset, **fields)
    train_tokenizer(tmp_path / "undisturbed", info, chunks)
    for step in (1, 4):
        torch.manual_seed(step)
        with pytest.raises(KeyboardInterrupt):
            train_tokenizer(tmp_path / "resumed", info, chunks, interrupt_at(step))
        assert not (tmp_path / "resumed").exists()
    trained = train_tokenizer(tmp_path / "resumed", info, chunks)
    assert trained.steps_before == 3
    assert (tmp_path / "resumed").read_bytes() == (tmp_path / "undisturbed").read_bytes()
    assert not (tmp_path / "resumed.training").exists()


def test_an_interruption_amid_a_step_loses_that_step_alone(dataset, tmp_path, every_step_saved, monkeypatch):
    info, chunks = plan(dataset)
    train_tokenizer(tmp_path / "undisturbed", info, chunks)
    steps = []

    def stop_at_fourth(self, closure=None):
        steps.append(self)
        if len(steps) == 4:
            raise KeyboardInterrupt
        return original(self, closure)

    original = torch.optim.AdamW.step
    with monkeypatch.context() as patched:
        patched.setattr(torch.optim.AdamW, "step", stop_at_fourth)
        with pytest.raises(KeyboardInterrupt):
            train_tokenizer(tmp_path / "resumed", info, chunks)
    assert train_tokenizer(tmp_path / "resumed", info, chunks).steps_before == 3
    assert (tmp_path / "resumed").read_bytes() == (tmp_path / "undisturbed").read_bytes()


def test_a_torn_write_leaves_the_state_before_it(dataset, tmp_path, every_step_saved, monkeypatch):
    info, chunks = plan(dataset)
    with pytest.raises(KeyboardInterrupt):
        train_tokenizer(tmp_path / "t", info, chunks, interrupt_at(3))
    before = (tmp_path / "t.training").read_bytes()

    def crash(descriptor):
        raise OSError("the disk is gone")

    with monkeypatch.context() as patched:
        patched.setattr("os.fsync", crash)
        with pytest.raises(OSError, match="the disk is gone"):
            train_tokenizer(tmp_path / "t", info, chunks)
    assert (tmp_path / "t.training").read_bytes() == before
    assert [path.name for path in tmp_path.iterdir()] == ["t.training"]


def test_a_finished_tokenizer_is_measured_not_trained_again(dataset, tmp_path):
    info, chunks = plan(dataset)
    first = train_tokenizer(tmp_path / "t", info, chunks)
    before = (tmp_path / "t").stat()
    again = train_tokenizer(tmp_path / "t", info, chunks)
    assert again.steps_before == info.training.steps
    assert (again.error, again.used_codes) == (first.error, first.used_codes)
    assert (tmp_path / "t").stat().st_mtime_ns == before.st_mtime_ns


def test_other_settings_neither_resume_nor_overwrite(dataset, tmp_path, every_step_saved):
    with pytest.raises(KeyboardInterrupt):
        train_tokenizer(tmp_path / "t", *plan(dataset), interrupt_at(3))
    with pytest.raises(
        ConfigurationError, match=r"t\.training was made with steps 6 \(now 7\): delete it, use"
    ):
        train_tokenizer(tmp_path / "t", *plan(dataset, steps=7))
    train_tokenizer(tmp_path / "t", *plan(dataset))
    with pytest.raises(ConfigurationError, match=r"t was made with vqvae_n_embed 3 \(now 4\): delete it"):
        train_tokenizer(tmp_path / "t", *plan(dataset, vqvae_n_embed=4))


def test_moved_data_are_the_same_data(dataset, tmp_path):
    train_tokenizer(tmp_path / "t", *plan(dataset))
    moved = write_dataset(tmp_path / "moved")
    assert train_tokenizer(tmp_path / "t", *plan(moved)).steps_before == 6
    other = write_dataset(tmp_path / "other", scale=2.0)
    with pytest.raises(ConfigurationError, match="was made with statistics"):
        train_tokenizer(tmp_path / "t", *plan(other))


def test_the_seed_decides_everything(dataset, tmp_path):
    files = {}
    for name, seed in (("a", 0), ("b", 0), ("c", 1)):
        torch.manual_seed(ord(name))
        info, chunks = plan_training(
            dataset, "base", FIELDS, TokenizerTraining(steps=2, batch_size=10, seed=seed)
        )
        train_tokenizer(tmp_path / name, info, chunks)
        files[name] = load_file(tmp_path / name)
    assert all(torch.equal(files["a"][key], files["b"][key]) for key in files["a"])
    assert not all(torch.equal(files["a"][key], files["c"][key]) for key in files["a"])


REFUSED = [
    ({"vqvae_n_embed": 1}, "vqvae_n_embed=1 must be at least 2"),
    ({"tokenizer": "uniform"}, "tokenizer=uniform has nothing to learn: use it without a file, as --policy"),
    ({"tokenizer": "bpe"}, "unknown tokenizer 'bpe'"),
    ({"normalization": "zca"}, "unknown normalization 'ZCA'; choose one of: MIN_MAX, MEAN_STD"),
    ({"steps": 0}, "steps=0 must be at least 1"),
    ({"preset": "autoregressive"}, "unknown preset 'autoregressive'"),
]


@pytest.mark.parametrize(("fields", "message"), REFUSED)
def test_what_cannot_work_is_refused_before_training(dataset, fields, message):
    with pytest.raises(ConfigurationError, match=message):
        plan(dataset, **fields)


@pytest.mark.parametrize(
    ("name", "value"), [("batch_size", 0), ("lr", -1.0), ("weight_decay", -1.0), ("seed", -1)]
)
def test_training_settings_are_checked(name, value):
    with pytest.raises(ConfigurationError, match=f"{name}={value} must"):
        TokenizerTraining(**{name: value}).check()


def test_a_missing_or_damaged_dataset(tmp_path):
    with pytest.raises(
        DatasetError, match=r"there is no dataset at .*nowhere: give a LeRobotDataset's folder"
    ):
        plan(tmp_path / "nowhere")
    damaged = write_dataset(tmp_path / "damaged")
    for file in (damaged / "data").rglob("*.parquet"):
        file.write_bytes(b"torn")
    with pytest.raises(DatasetError, match=r"the actions of the dataset at .*damaged cannot be read"):
        plan(damaged)


def test_presets_fill_in_what_is_not_given(dataset):
    info, _ = plan(dataset, preset="paper", chunk_stride=1)
    assert info.normalization == "MIN_MAX"
    assert info.spec.vqvae_decay == 0.8
    assert info.spec.kmeans_iters == 0
    info, _ = plan(dataset, preset="paper", normalization="quantiles")
    assert info.normalization == "QUANTILES"


@pytest.mark.parametrize(
    ("preset", "given", "expected"),
    [
        ("base", {}, (2, 2)),  # 20 steps a second, half of an episode of 11
        ("base", {"chunk_stride": 1}, (100, 1)),
        ("base", {"chunk_size": 7}, (7, 1)),
        ("paper", {}, (5, 1)),
    ],
    ids=str,
)
def test_chunks_that_nobody_described_are_those_of_a_policy_trained_on_the_same_data(
    dataset, preset, given, expected
):
    training = TokenizerTraining(steps=6, batch_size=10)
    info, _ = plan_training(dataset, preset, given, training)
    assert (info.spec.chunk_size, info.chunk_stride) == expected
