import inspect
import json
import re
import shutil

import httpx
import huggingface_hub.constants
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from huggingface_hub.errors import OfflineModeIsEnabled
from lerobot.configs import NormalizationMode
from lerobot.configs.default import DatasetConfig
from lerobot.configs.train import TrainPipelineConfig
from lerobot.datasets import dataset_metadata, factory
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot_sets import REPO_ID
from policy_cases import any_config

from lerobot_act_chunking.data.fast_chunks import checks
from lerobot_act_chunking.data.fast_chunks.checks import with_checks
from lerobot_act_chunking.data.fast_chunks.dataset import FastChunkDataset
from lerobot_act_chunking.data.fast_chunks.reading import with_reading
from lerobot_act_chunking.errors import ConfigurationError, DatasetError


@pytest.fixture(autouse=True)
def offline(monkeypatch):
    monkeypatch.setattr(huggingface_hub.constants, "HF_HUB_OFFLINE", True)
    monkeypatch.setattr(factory, "LeRobotDataset", FastChunkDataset)
    monkeypatch.setattr(factory, "make_dataset", inspect.unwrap(factory.make_dataset))
    resolve = inspect.unwrap(factory.resolve_delta_timestamps)
    monkeypatch.setattr(factory, "resolve_delta_timestamps", with_reading(resolve))


OURS = any_config()
THEIRS = ACTConfig(chunk_size=3, n_action_steps=3, device="cpu")


def config(root, policy=OURS, **dataset) -> TrainPipelineConfig:
    source = DatasetConfig(REPO_ID, root=root and str(root), video_backend="pyav", **dataset)
    return TrainPipelineConfig(source, policy=policy)


def make(root, policy=OURS, **dataset) -> LeRobotDataset:
    return with_checks(factory.make_dataset)(config(root, policy, **dataset))


@pytest.fixture
def damage(states, tmp_path):
    """A copy of the state dataset with values of a column replaced: {(row, component): value}."""

    def damaged(key: str, values: dict) -> str:
        root = shutil.copytree(states, tmp_path / "damaged")
        (path,) = (root / "data").rglob("*.parquet")
        table = pq.read_table(path)
        column = np.array(table[key].to_pylist())
        for place, value in values.items():
            column[place] = value
        place = table.column_names.index(key)
        new = pa.array(column.tolist(), table.schema.field(key).type)
        pq.write_table(table.set_column(place, key, new).replace_schema_metadata(None), path)
        return root

    return damaged


def test_sound_datasets_pass(states, images):
    assert len(make(states)) == 17
    assert len(make(images)) == 17


def test_streams_that_could_not_be_divided_are_refused(states, monkeypatch):
    run = config(states, streaming=True)
    run.num_workers = 0
    with pytest.raises(ConfigurationError, match="set --num_workers=1 or more"):
        with_checks(factory.make_dataset)(run)
    run.num_workers = 1
    assert len(list(with_checks(factory.make_dataset)(run))) == 17
    monkeypatch.setattr(checks, "is_distributed", lambda: True)
    with pytest.raises(ConfigurationError, match="trains in one process alone"):
        with_checks(factory.make_dataset)(run)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_values_that_are_not_finite_are_named(damage, value):
    # Episodes have 5, 2, 7 and 3 frames: row 8 is frame 1 of episode 2.
    root = damage("action", {(8, 2): value, (8, 3): value, (15, 0): value})
    with pytest.raises(DatasetError) as error:
        make(root)
    assert str(error.value) == (
        f"dataset {REPO_ID!r} holds values that are not finite: "
        "action in 2 frames, first in episode 2, frame 1. Make a copy without those episodes: "
        f"lerobot-edit-dataset --repo_id={REPO_ID} --root={root} --new_repo_id={REPO_ID}_finite "
        "--operation.type=delete_episodes --operation.episode_indices='[2, 3]', and train on that: "
        f"--dataset.repo_id={REPO_ID}_finite, without --dataset.root"
    )


def test_a_damaged_episode_that_is_not_read_is_no_matter(damage):
    root = damage("observation.state", {(8, 0): np.nan})
    assert len(make(root, episodes=[0, 1, 3])) == 10
    with pytest.raises(DatasetError, match=r"observation\.state in 1 frames, first in episode 2, frame 1\."):
        make(root, episodes=[1, 2])


def test_lerobots_own_policies_get_what_they_get_without(damage, tmp_path):
    assert make(damage("action", {(8, 2): np.nan}), THEIRS)[8]["action"].isnan().any()
    with pytest.raises(OfflineModeIsEnabled):
        make(tmp_path / "nowhere", THEIRS)


def test_a_column_that_no_policy_learns_from_may_hold_anything(damage):
    assert len(make(damage("next.reward", {8: np.nan}))) == 17


@pytest.mark.parametrize(
    ("index", "fault"),
    [
        (lambda index: index + 1, "rows 0 to 4, of episode 0, have index 1 to 5, but by .* they have 0 to 4"),
        (lambda index: 0 * index, "rows 0 to 4, of episode 0, have index 0 to 0, not one after the other,"),
        (
            lambda index: np.r_[index[:7], index[8:14], 7, index[14:]],
            "rows 7 to 13, of episode 2, have index",
        ),
    ],
    ids=["shifted", "all the same", "turned within an episode"],
)
def test_rows_out_of_place_are_refused(damage, index, fault):
    root = damage("index", {slice(None): index(np.arange(17))})
    for episodes in (None, [0, 2]):
        with pytest.raises(DatasetError, match=fault.replace("rows 7 to 13", r"rows \d+ to \d+")):
            make(root, episodes=episodes)
    assert make(root, THEIRS)[3]["index"] == index(np.arange(17))[3]


def test_an_episode_that_lacks_rows_is_refused(damage):
    root = damage("index", {})
    (path,) = (root / "data").rglob("*.parquet")
    pq.write_table(pq.read_table(path).slice(0, 16), path)
    with pytest.raises(
        DatasetError, match=r"of episode 3, have index 14 to 15, but by .* they have 14 to 16"
    ):
        make(root)


def test_a_dataset_without_statistics_is_refused(damage):
    root = damage("action", {})
    (root / "meta/stats.json").unlink()
    with pytest.raises(DatasetError) as error:
        make(root)
    assert str(error.value).startswith(f"{root}/meta/stats.json is missing")
    assert f"lerobot-edit-dataset --repo_id={REPO_ID} --root={root} --operation.type=recompute_stats" in str(
        error.value
    )
    assert len(make(root, THEIRS)) == 17
    raw = dict.fromkeys(("STATE", "ACTION"), NormalizationMode.IDENTITY)
    assert len(make(root, any_config(normalization_mapping=raw))) == 17


def test_a_feature_without_statistics_is_named(damage):
    root = damage("action", {})
    stats = json.loads((root / "meta/stats.json").read_text())
    (root / "meta/stats.json").write_text(json.dumps({"action": stats["action"]}))
    with pytest.raises(DatasetError, match=r"no statistics to normalise observation\.state by"):
        make(root)


def test_a_damaged_dataset_can_still_be_opened_and_mended(damage):
    root = damage("action", {(8, 2): np.nan})
    assert FastChunkDataset(REPO_ID, root, video_backend="pyav")[8]["action"].isnan().any()


def test_a_root_that_does_not_exist(tmp_path):
    root = tmp_path / "nowhere"
    with pytest.raises(DatasetError) as error:
        make(root)
    message = str(error.value)
    assert message.startswith(
        f"{root} does not exist, and {REPO_ID!r} could not be fetched from the Hugging Face"
    )
    assert message.endswith(f"act-chunking record --task transfer_cube --repo-id {REPO_ID} --root {root}")
    assert "\n" not in message


def test_a_root_that_holds_something_else(tmp_path):
    (tmp_path / "holiday.txt").touch()
    with pytest.raises(DatasetError, match=r"holds no LeRobot dataset \(no meta/info\.json\)"):
        make(tmp_path)


def test_a_dataset_one_level_below_is_named_and_can_be_read(states, tmp_path):
    shutil.copytree(states, tmp_path / "set")
    with pytest.raises(DatasetError) as error:
        make(tmp_path)
    (root,) = re.findall(r"info\.json\), but (\S+) does", str(error.value))
    assert len(make(root)) == 17


def test_every_missing_file_is_named_and_putting_it_back_cures(states, images, tmp_path):
    for number, dataset in enumerate((states, images)):
        root = shutil.copytree(dataset, tmp_path / str(number))
        files = [file for file in sorted(root.rglob("*")) if file.is_file() and file.name != "stats.json"]
        for file in files:
            content = file.read_bytes()
            file.unlink()
            with pytest.raises(DatasetError) as error:
                make(root)
            assert str(file.relative_to(root)) in str(error.value)
            assert "act-chunking record" not in str(error.value)  # into the user's own folder
            file.write_bytes(content)
            assert len(make(root)) == 17


def test_many_missing_files_are_counted(videos, tmp_path):
    root = shutil.copytree(videos, tmp_path / "set")
    shutil.rmtree(root / "videos")
    shutil.rmtree(root / "data")
    with pytest.raises(DatasetError, match=r"dataset: data/chunk-000/file-000\.parquet, videos/\S+mp4"):
        make(root)


def test_no_root_means_lerobots_home(monkeypatch, tmp_path):
    for module in ("lerobot_act_chunking.data.fast_chunks.checks", dataset_metadata.__name__):
        monkeypatch.setattr(f"{module}.HF_LEROBOT_HOME", tmp_path)
    with pytest.raises(DatasetError) as error:
        make(None)
    assert str(error.value).startswith(f"{tmp_path / REPO_ID} does not exist")


def test_an_unreachable_hub_is_said_in_the_same_words(monkeypatch, tmp_path):
    def unreachable(*_args, **_options):
        raise httpx.ConnectError("no route to host")

    monkeypatch.setattr(dataset_metadata, "get_safe_version", unreachable)
    with pytest.raises(DatasetError, match=r"does not exist, and .* hub \(no route to host\)\. Record one"):
        make(tmp_path / "nowhere")


def test_other_errors_keep_their_name():
    def broken(_cfg):
        raise PermissionError("no")

    with pytest.raises(PermissionError):
        with_checks(broken)(config(None))
