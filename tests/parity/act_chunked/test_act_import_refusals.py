"""What cannot be imported is refused by name, before anything is written."""

import json
import re
from pathlib import Path

import pytest
import torch
from act_checkpoints import B, make_act, save, save_first, save_old
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from safetensors.torch import load_file, save_file

from lerobot_act_chunking.errors import ConfigurationError, DatasetError
from lerobot_act_chunking.policies.act_chunked.importing.conversion import import_checkpoint
from lerobot_act_chunking.policies.act_chunked.importing.weights import WeightMap
from lerobot_act_chunking.policies.loading import load_policy

INPUTS = "state+environment"


@pytest.fixture
def act(tmp_path):
    return save(make_act(INPUTS), tmp_path / "act")


@pytest.fixture
def refusal(tmp_path):
    """Why an import is refused, which leaves nothing."""

    def why(source, *, error=ConfigurationError, **options):
        before = sorted(tmp_path.rglob("*"))
        with pytest.raises(error) as refused:
            import_checkpoint(source, tmp_path / "imported", **options)
        assert sorted(tmp_path.rglob("*")) == before
        return str(refused.value)

    return why


def change_settings(folder, **changes):
    settings = json.loads((folder / "config.json").read_text()) | changes
    (folder / "config.json").write_text(json.dumps(settings))


def change_weights(folder, change):
    weights = load_file(folder / "model.safetensors")
    change(weights)
    save_file(weights, folder / "model.safetensors")


def test_another_policy(act, refusal):
    change_settings(act, type="diffusion")
    assert re.search("holds a policy of type diffusion: only LeRobot's act", refusal(act))
    settings = json.loads((act / "config.json").read_text())
    del settings["type"]
    (act / "config.json").write_text(json.dumps(settings))
    assert re.search("holds a policy of type None", refusal(act))


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("config.json", "holds no config.json$"),
        ("model.safetensors", "holds no model.safetensors$"),
        ("policy_preprocessor.json", "policy_postprocessor.json, but no policy_preprocessor.json"),
    ],
)
def test_a_missing_file(name, message, act, refusal):
    (act / name).unlink()
    assert re.search(message, refusal(act))


def test_an_adapter_without_its_policy(act, refusal):
    (act / "model.safetensors").rename(act / "adapter_model.safetensors")
    assert re.search("it is an adapter: merge it into its policy first", refusal(act))


@pytest.mark.parametrize("name", ["config.json", "model.safetensors"])
def test_a_damaged_file(name, act, refusal):
    (act / name).write_bytes(b"{" * 30)
    assert re.search(f"{name} is damaged", refusal(act))


def test_no_folder(tmp_path, refusal):
    assert re.search(r"there is no folder .*nowhere$", refusal(tmp_path / "nowhere"))


def test_a_repository(refusal, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    assert re.search(
        r"no folder lerobot/act: download it first \(hf download lerobot/act", refusal(Path("lerobot/act"))
    )


def test_an_existing_folder_is_never_overwritten(act, tmp_path, refusal):
    (tmp_path / "imported").mkdir()
    assert re.search("imported exists already", refusal(act))


def test_unknown_settings(act, refusal):
    change_settings(act, n_experts=4)
    assert re.search("holds settings that LeRobot's act lacks: n_experts", refusal(act))


def test_settings_that_lerobot_refuses(act, refusal):
    change_settings(act, vision_backbone="vit_b_16")
    assert re.search("must be one of the ResNet variants. Got vit_b_16", refusal(act))


def test_unknown_weights(act, refusal):
    change_weights(act, lambda weights: weights.update({"model.extra.weight": torch.zeros(2)}))
    assert re.search("LeRobot's act has no weights called extra.weight", refusal(act))


def test_missing_weights(act, refusal):
    change_weights(act, lambda weights: weights.pop("model.decoder.norm.weight"))
    assert re.search("the weights lack model.decoder.norm.weight", refusal(act))


def test_weights_of_other_sizes(act, refusal):
    change_settings(act, chunk_size=6)
    assert re.search("the weights do not fit the settings: .*query_positions", refusal(act))


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"vision_backbone": "resnet101"}, "vision_backbone=resnet101 cannot be imported, only resnet18, "),
        ({"replace_final_stride_with_dilation": True}, "replace_final_stride_with_dilation=true cannot be"),
    ],
)
def test_other_backbones(settings, message, tmp_path, refusal):
    source = save(make_act("state+cameras"), tmp_path / "act")
    change_settings(source, **settings)
    assert re.search(message, refusal(source))


def test_what_does_not_act_the_same(act, refusal, monkeypatch):
    start = WeightMap.start
    monkeypatch.setattr(WeightMap, "start", lambda self, layer: start(self, layer) + torch.arange(16))
    assert re.search(r"actions differ by up to \d\.\d+; nothing was written", refusal(act))


def test_without_statistics(tmp_path, refusal):
    source = save(make_act(INPUTS), tmp_path / "act")
    for file in source.glob("policy_*"):
        file.unlink()
    assert re.search("give the dataset that it was trained on with --dataset", refusal(source))
    assert re.search(
        "there is no dataset at", refusal(source, error=DatasetError, dataset=tmp_path / "nothing")
    )


def test_two_sources_of_statistics(tmp_path, refusal):
    for save_as in (save, save_old):
        source = save_as(make_act(INPUTS), tmp_path / save_as.__name__)
        assert re.search(
            "brings its own normalisation: leave out --dataset", refusal(source, dataset=tmp_path)
        )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda buffer: buffer.fill_(torch.inf), "statistic 'std' of 'observation.state' is"),
        (None, "no std of 'observation.state'"),
    ],
)
def test_statistics_that_do_not_normalise(change, message, tmp_path, refusal):
    source = save_old(make_act(INPUTS), tmp_path / "act")
    name = "normalize_inputs.buffer_observation_state.std"
    change_weights(
        source, (lambda weights: weights.pop(name)) if change is None else lambda w: change(w[name])
    )
    assert re.search(message, refusal(source, error=DatasetError))


ONE_OF_EACH = {"observation.image0": "mean_std", "observation.image1": "min_max"}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"temporal_ensemble_momentum": 0.9}, "temporal_ensemble_momentum=0.9: this moving average"),
        ({"input_shapes": {"observation.touch": [2]}}, "act has no feature called 'observation.touch'"),
        (
            {"input_normalization_modes": ONE_OF_EACH},
            "'observation.image1' is normalised by min_max, another feature of its type by mean_std",
        ),
    ],
)
def test_settings_of_the_first_versions_that_are_gone(changes, message, tmp_path, refusal):
    source = save_first(make_act("state+cameras"), tmp_path / "act")
    change_settings(source, **changes)
    assert re.search(message, refusal(source))


def test_the_statistics_of_a_dataset(tmp_path):
    """Cameras by ImageNet's statistics, as LeRobot trains by default; all others by the dataset's."""
    theirs = make_act("state+cameras")
    source = save(theirs, tmp_path / "act")
    for file in source.glob("policy_*"):
        file.unlink()
    dataset = record(tmp_path / "dataset", theirs.config)
    import_checkpoint(source, tmp_path / "imported", dataset=dataset)
    _, preprocess, postprocess = load_policy(tmp_path / "imported")
    raw = {key: torch.full((B, *each.shape), 0.5) for key, each in theirs.config.input_features.items()}
    normal = preprocess(raw)
    assert torch.allclose(normal["observation.state"], torch.zeros(B, 6), atol=1e-5)
    red = normal["observation.images.top"][:, 0]
    assert torch.allclose(red, torch.full_like(red, (0.5 - 0.485) / 0.229), atol=1e-5)
    assert torch.allclose(postprocess(torch.ones(B, 4)), torch.full((B, 4), 0.5 + 0.5), atol=1e-5)


def record(root, config):
    """One episode whose vectors are 0 and 1 in turn: mean and standard deviation of one half."""
    features = {
        key: {"dtype": "image" if len(each.shape) == 3 else "float32", "shape": each.shape, "names": None}
        for key, each in {**config.input_features, **config.output_features}.items()
    }
    for feature in features.values():
        if feature["dtype"] == "image":
            feature["names"] = ["channels", "height", "width"]
    dataset = LeRobotDataset.create("test/toy", fps=50, features=features, root=root, use_videos=False)
    for i in range(4):
        frame = {key: torch.full(each["shape"], float(i % 2)) for key, each in features.items()}
        dataset.add_frame({key: value.numpy() for key, value in frame.items()} | {"task": "toy"})
    dataset.save_episode()
    dataset.finalize()
    return root
