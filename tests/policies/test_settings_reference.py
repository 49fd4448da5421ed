"""What the reference of settings says is what the configurations are."""

from dataclasses import fields
from pathlib import Path

import pytest
from lerobot.configs import PreTrainedConfig

import lerobot_act_chunking.plugin  # noqa: F401
from lerobot_act_chunking.cli.main import main
from lerobot_act_chunking.cli.settings import markdown
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.policies.settings_reference import POLICIES, settings_of

REFERENCE = Path(__file__).parents[2] / "docs" / "reference"
PRESETS = [(policy, preset) for policy, (_, presets) in POLICIES.items() for preset in presets]


def by_name(policy, preset=None):
    return {setting.name: setting for setting in settings_of(policy, preset)}


@pytest.mark.parametrize("policy", POLICIES)
def test_the_committed_page_is_the_one_that_the_command_writes(policy, tmp_path, capsys):
    page = tmp_path / "deep" / "page.md"
    assert main(["settings", policy, "--out", str(page)]) == 0
    assert capsys.readouterr().out == f"page: {page}\n"
    committed = REFERENCE / f"{policy}.md"
    assert page.read_text() == committed.read_text(), f"run: act-chunking settings {policy} --out {committed}"


@pytest.mark.parametrize("policy", POLICIES)
def test_every_field_of_ours_is_listed_once_and_explained(policy):
    lerobots = {each.name for each in fields(PreTrainedConfig)} - {"n_obs_steps"}
    expected = {each.name for each in fields(POLICIES[policy][0])} - lerobots
    listed = settings_of(policy)
    assert sorted(setting.name for setting in listed) == sorted(expected)
    for setting in listed:
        assert len(setting.meaning.split()) > 1, setting.name
        assert setting.allowed, setting.name


def test_all_types_of_this_package_are_there():
    ours = {
        name
        for name, config in PreTrainedConfig.get_known_choices().items()
        if config.__module__.startswith("lerobot_act_chunking.")
    }
    assert set(POLICIES) == ours


@pytest.mark.parametrize(("policy", "preset"), PRESETS)
def test_a_preset_shows_what_its_configuration_holds(policy, preset):
    config = POLICIES[policy][0](preset=preset, device="cpu")
    shown = by_name(policy, preset)
    assert list(shown["preset"].values) == [preset]
    for name in ("n_obs_steps", "chunk_stride", "optimizer_lr", "execution", "n_action_steps"):
        value = getattr(config, name)
        assert shown[name].values[preset] == (f"{value:g}" if isinstance(value, float) else str(value))
    assert shown["replan_interval"].values[preset] == f"null → {config.execution_settings.replan_interval}"


def test_known_values():
    act = by_name("act_chunked")
    assert dict(act["optimizer_lr"].values) == {
        "base": "0.0005",
        "paper": "1e-05",
        "autoregressive": "0.0005",
    }
    assert dict(act["use_vae"].values) == {"base": "false", "paper": "true", "autoregressive": "true"}
    assert act["latent_type"].allowed.startswith("gaussian, conditional, mixture, categorical")
    assert act["min_std"].allowed == "number, above 0 to below 1"
    assert act["fps"].allowed == "number, above 0 to 100000, or null"
    assert act["optimizer_betas"].values["base"] == "[0.9, 0.95]"
    assert act["n_components"].meaning == "number of components of `gmm`."
    groups = {act[name].group for name in ("fps", "optimizer_lr", "vision_backbone")}
    assert groups == {"all policies of this package"}
    assert act["execution"].group == act["gripper_dims"].group == "chunk execution"
    assert by_name("temporal_ensemble")["execution"].values == {"default": "ensemble"}


def test_a_page_holds_one_row_for_each_setting():
    settings = settings_of("vqbet_chunked", "paper")
    page = markdown("vqbet_chunked", settings, "paper")
    assert page.count("\n| `") == len(settings)
    assert "act-chunking settings vqbet_chunked --preset paper" in page


def test_the_table_is_printed(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "160")
    assert main(["settings", "act_chunked", "--preset", "paper"]) == 0
    out = capsys.readouterr().out
    assert "settings of chunk execution" in out
    assert "frozen_batch" in out
    assert "AdamW learning rate." in out


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        (("act",), "unknown policy type 'act'; choose one of: act_chunked, diffusion_chunked"),
        (
            ("vqbet_chunked", "autoregressive"),
            "unknown preset of vqbet_chunked 'autoregressive'; choose one of: base, paper",
        ),
        (("temporal_ensemble", "base"), "choose one of: none, it has no presets"),
    ],
)
def test_unknown_names_are_refused_with_the_known_ones(asked, message):
    with pytest.raises(ConfigurationError, match=message):
        settings_of(*asked)
