"""What the reference of settings says is what the configurations are."""

from dataclasses import fields
from pathlib import Path

import pytest
from lerobot.configs import PreTrainedConfig
from policy_cases import MODULES, TYPES

from lerobot_act_chunking.cli.main import main
from lerobot_act_chunking.cli.settings import markdown
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.policies.settings_reference import policy_types, settings_of

REFERENCE = Path(__file__).parents[2] / "docs" / "reference"
POLICIES = policy_types()
PRESETS = [(policy, preset) for policy in TYPES for preset in POLICIES[policy].presets]


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
    expected = {each.name for each in fields(POLICIES[policy])} - lerobots
    listed = settings_of(policy)
    assert sorted(setting.name for setting in listed) == sorted(expected)
    for setting in listed:
        assert len(setting.meaning.split()) > 1, setting.name
        assert setting.allowed, setting.name


def test_all_types_of_this_package_are_there():
    assert set(POLICIES) == set(MODULES)


@pytest.mark.parametrize(("policy", "preset"), PRESETS)
def test_a_preset_shows_what_its_configuration_holds(policy, preset):
    config = POLICIES[policy](preset=preset, device="cpu")
    shown = by_name(policy, preset)
    assert list(shown["preset"].values) == [preset]
    for name in ("n_obs_steps", "chunk_stride", "optimizer_lr", "execution", "n_action_steps"):
        value = getattr(config, name)
        assert shown[name].values[preset] == (f"{value:g}" if isinstance(value, float) else str(value))
    assert shown["replan_interval"].values[preset] == f"null → {config.execution_settings.replan_interval}"


@pytest.mark.parametrize(("policy", "preset"), PRESETS)
def test_a_page_holds_one_row_for_each_setting(policy, preset):
    settings = settings_of(policy, preset)
    page = markdown(policy, settings, preset)
    assert page.count("\n| `") == len(settings)
    assert f"act-chunking settings {policy} --preset {preset}" in page


@pytest.mark.parametrize("columns", [40, 80, 160])
def test_every_setting_is_printed_whole_at_any_width(columns, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", str(columns))
    assert main(["settings", TYPES[0]]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    for setting in settings_of(TYPES[0]):
        values = list(setting.values.values())
        assert f"{setting.name} = {values[0]}" in printed
        assert " ".join(f"{setting.meaning} Allowed: {setting.allowed}.".replace("`", "").split()) in printed
        for preset, value in setting.values.items():
            assert (f"{preset}: {value}" in printed) or value == values[0]


def test_an_unknown_type_is_refused_with_the_known_ones():
    with pytest.raises(ConfigurationError, match=f"unknown policy type 'act'; choose one of: {TYPES[0]}, "):
        settings_of("act")


@pytest.mark.parametrize("policy", TYPES)
def test_an_unknown_preset_is_refused_with_the_known_ones(policy):
    known = ", ".join(POLICIES[policy].presets)
    with pytest.raises(ConfigurationError, match=f"preset of {policy} 'other'; choose one of: {known}"):
        settings_of(policy, "other")
