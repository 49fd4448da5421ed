"""The cause that planted findings have, and the fix that goes with it."""

from types import SimpleNamespace

import pytest

from lerobot_act_chunking.diagnostics.modes import causes
from lerobot_act_chunking.diagnostics.modes.causes import Cause, Evidence, find_cause
from lerobot_act_chunking.diagnostics.modes.frequencies import Frequencies
from lerobot_act_chunking.diagnostics.modes.inside import CodeModes, LatentModes
from lerobot_act_chunking.diagnostics.modes.settings import Thresholds
from lerobot_act_chunking.diagnostics.modes.switching import Switching
from lerobot_act_chunking.diagnostics.modes.verdict import judge

SHARES = (0.8, 0.15, 0.05)
USUAL = Thresholds()


def taken(*counts, invalid=0):
    return Frequencies(counts, invalid, SHARES)


RIGHT, ONE, INVALID = taken(160, 30, 10), taken(200, 0, 0), taken(100, 10, 0, invalid=90)


def latent(kl=5.0, active_units=3, reconstructed=(1.0, 1.0, 1.0), prior=INVALID, posterior=RIGHT):
    return LatentModes(kl, active_units, [0.1] * 3, list(reconstructed), prior, posterior, ONE)


def config(**settings):
    vae = {"use_vae": True, "kl_weight": 10, "latent_type": "gaussian", "z_inference": "sample"}
    return SimpleNamespace(**{**vae, "execution": "open_loop", "balance_modes": "none", **settings})


def cause_of(chunks, settings=None, episodes=INVALID, **found):
    return find_cause(Evidence(settings or config(), episodes, chunks, **found), USUAL)


def test_chunks_that_do_not_tell_ways_apart_are_no_missing_demonstrations():
    assert "--dataset" in cause_of(None).fix
    untold = cause_of(None, untold=True)
    assert untold.name == causes.UNKNOWN
    assert "act-chunking diagnose" in untold.fix
    assert "--dataset" not in untold.fix


def test_what_is_right_has_no_cause():
    assert cause_of(RIGHT, episodes=RIGHT) == cause_of(None, episodes=RIGHT) == Cause(causes.NONE)


def test_chunks_that_are_wrong_have_a_cause_though_the_episodes_are_right():
    assert cause_of(INVALID, episodes=RIGHT, inside=latent()).name == causes.HOLE


@pytest.mark.parametrize("dead", [{"kl": 0.001}, {"active_units": 0}])
def test_a_latent_that_says_nothing_has_collapsed(dead):
    found = cause_of(ONE, inside=latent(**dead))
    assert found.name == causes.COLLAPSED
    assert "--policy.kl_weight=0.1" in found.fix


def test_a_prior_that_misses_what_the_posteriors_cover_has_a_hole():
    found = cause_of(INVALID, inside=latent())
    assert found.name == causes.HOLE
    assert "fit-prior" in found.fix
    assert "50/5/0 % and 45 % invalid" in found.because


def test_what_the_posteriors_do_not_cover_either_is_no_hole():
    assert cause_of(INVALID, inside=latent(posterior=INVALID)).name == causes.BLENDED


def test_a_fitted_prior_is_not_told_to_be_fitted():
    fitted = LatentModes(5.0, 3, [0.1] * 3, [1.0] * 3, INVALID, RIGHT, ONE, fitted=True)
    found = cause_of(INVALID, inside=fitted)
    assert found.name == causes.HOLE
    assert "fit it again" in found.fix


def test_a_way_that_its_own_style_does_not_bring_back_is_not_learned():
    found = cause_of(INVALID, inside=latent(reconstructed=(1.0, 0.9, 0.2)))
    assert found.name == causes.UNDERTRAINED
    assert "mode 2" in found.because
    assert "balance_modes" in found.fix


def test_a_balanced_policy_is_not_told_to_balance():
    settings = config(use_vae=False, balance_modes="labels")
    assert "balance_modes" not in cause_of(ONE, settings).fix


def test_codes_that_lose_a_way_are_the_decoders_fault():
    codes = CodeModes(used=[9, 3, 1], shared=1, reconstructed=[1.0, 1.0, None])
    assert cause_of(ONE, config(use_vae=False), inside=codes).name == causes.UNDERTRAINED
    lost = CodeModes(used=[9, 3, 1], shared=1, reconstructed=[1.0, 0.1, 1.0])
    found = cause_of(ONE, config(use_vae=False), inside=lost)
    assert "codes" in found.because
    assert "vqvae_n_embed" in found.fix


def test_truncated_sampling_is_named():
    assert "--policy.top_p=1 (now 0.95" in cause_of(ONE, config(use_vae=False, top_p=0.95)).fix


def test_one_chunk_between_the_ways_is_a_blend_and_one_of_a_way_is_no_sample():
    regression = config(use_vae=False, action_likelihood="l1")
    between, majority = taken(0, 0, 0, invalid=200), ONE
    assert cause_of(between, regression, deterministic=True).name == causes.BLENDED
    found = cause_of(majority, regression, deterministic=True)
    assert found.name == causes.ONE_WAY
    assert "gmm" in found.fix


def test_a_latent_that_is_not_sampled_is_to_be_sampled():
    found = cause_of(ONE, config(z_inference="mode"), deterministic=True, inside=latent())
    assert (found.name, "z_inference=sample" in found.fix) == (causes.ONE_WAY, True)


def test_sampled_chunks_of_no_way_are_blended():
    found = cause_of(INVALID, config(use_vae=False, action_likelihood="categorical"))
    assert found.name == causes.BLENDED
    assert "gmm" in found.fix


@pytest.mark.parametrize(
    ("mode", "name"),
    [
        ("ensemble", causes.OVERLONG),
        ("crossfade", causes.OVERLONG),
        ("receding", causes.SWITCHED),
        ("open_loop", causes.SWITCHED),
    ],
)
def test_right_chunks_of_different_ways_are_averaged_or_switched(mode, name):
    found = cause_of(RIGHT, config(execution=mode), switching=Switching(100, 60))
    assert found.name == name
    assert "z_hold" in found.fix


def test_right_chunks_of_the_same_way_are_none_of_these():
    assert cause_of(RIGHT, switching=Switching(100, 1)).name == causes.UNKNOWN


@pytest.mark.parametrize(
    ("settings", "option"),
    [
        ({"use_vae": False, "code_hold": "chunk"}, "code_hold=episode"),
        ({"use_vae": False, "warm_start": "none"}, "warm_start=noise_hold"),
        ({"use_vae": False}, "coherence"),
    ],
)
def test_each_policy_has_its_way_to_keep_a_way(settings, option):
    assert option in cause_of(RIGHT, config(**settings), switching=Switching(100, 60)).fix


def test_verdicts():
    assert judge(RIGHT, RIGHT, Cause(causes.NONE), USUAL).verdict == "pass"
    worse = judge(RIGHT, INVALID, Cause(causes.HOLE, "it is so", "do this"), USUAL)
    assert worse.verdict == "warn"
    assert "45 % of the chunks" in worse.reasons[1]
    assert worse.reasons[2:] == ["hole in the prior: it is so", "repair: do this"]
    failed = judge(ONE, ONE, Cause(causes.HOLE, "it is so", "do this"), USUAL)
    assert failed.verdict == "fail"
    assert failed.reasons[1:] == ["hole in the prior: it is so", "repair: do this"]
    unlike = judge(taken(66, 67, 67), None, Cause(causes.NONE), USUAL)
    assert (unlike.verdict, "not as often" in unlike.reasons[1]) == ("pass", True)
    assert judge(taken(16, 3, 1), None, Cause(causes.NONE), USUAL).verdict == "inconclusive"
