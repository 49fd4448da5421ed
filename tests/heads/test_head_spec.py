from dataclasses import replace
from types import SimpleNamespace

import pytest
from head_cases import head_spec

from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.heads.make import HEADS, check_head, make_action_head
from lerobot_act_chunking.heads.spec import HeadSize, HeadSpec

SIZE = HeadSize(16, 4, n_queries=5, actions_per_query=2)


@pytest.mark.parametrize("likelihood", HEADS)
def test_the_same_settings_work_for_every_likelihood(likelihood):
    head = make_action_head(head_spec(action_likelihood=likelihood), SIZE)
    assert head.actions_per_query == 2


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"action_likelihood": "cauchy"}, "unknown action_likelihood 'cauchy'; choose one of: l1, l2,"),
        ({"nll_beta": 1.1}, "nll_beta=1.1 must be at least 0 and at most 1"),
        ({"nll_beta": -0.1}, "nll_beta=-0.1 must be at least 0"),
        ({"min_std": 0.0}, "min_std=0.0 must be above 0 and below 1"),
        ({"min_std": 1.0}, "min_std=1.0 must be above 0"),
        ({"n_components": 0}, "n_components=0 must be at least 1"),
        ({"n_bins": 1, "hl_gauss_sigma": 0.0}, "n_bins=1 must be at least 2"),
        ({"n_bins": 9}, "n_bins=9 must be at least 10 with hl_gauss_sigma="),
        ({"hl_gauss_sigma": -0.5}, "hl_gauss_sigma=-0.5 must be at least 0 and at most 1000"),
        ({"hl_gauss_sigma": float("inf")}, "hl_gauss_sigma=inf must be at least 0 and at most 1000"),
        ({"soft_local_bins": -1}, "soft_local_bins=-1 must be at least 0"),
        ({"action_temperature": -1.0}, "action_temperature=-1.0 must be at least 0"),
        ({"action_temperature": float("nan")}, "action_temperature=nan must be"),
        ({"action_top_k": 300}, "action_top_k=300 must be at most n_bins=256"),
        ({"action_temperature": 1.0}, "l1 predicts one action and has nothing to sample"),
        ({"action_temperature": 1.0, "action_likelihood": "l2"}, "l2 predicts one action"),
        ({"action_top_k": 5, "action_likelihood": "categorical"}, "set action_temperature=1"),
    ],
)
def test_what_cannot_work_is_refused(settings, message):
    with pytest.raises(ConfigurationError, match=message):
        check_head(head_spec(**settings))


def test_a_spec_is_read_from_a_configuration():
    expected = head_spec(action_likelihood="gmm", n_components=7, min_std=0.02)
    config = SimpleNamespace(**vars(expected), dim_model=512)
    assert HeadSpec.from_fields(config) == expected


def test_every_setting_arrives():
    """Each head's settings, all other than usual."""
    spec = HeadSpec(
        action_likelihood="categorical",
        nll_beta=0.25,
        min_std=0.03,
        n_components=7,
        n_bins=20,
        hl_gauss_sigma=1.5,
        soft_local_bins=3,
        action_temperature=0.7,
        action_top_k=6,
    )
    head = make_action_head(spec, SIZE)
    assert (head.n_bins, head.sigma, head.soft_local_bins) == (20, 1.5, 3)
    assert (head.temperature, head.top_k, head.draws_shape) == (0.7, 6, (10, 4))
    gaussian, laplace, gmm = (
        make_action_head(replace(spec, action_likelihood=name), SIZE)
        for name in ("gaussian", "laplace", "gmm")
    )
    assert (gaussian.beta, gaussian.temperature, gaussian.draws_shape) == (0.25, 0.7, (10, 4))
    assert (laplace.beta, laplace.temperature, laplace.draws_shape) == (0.25, 0.7, (10, 4))
    assert (gmm.beta, gmm.temperature, gmm.draws_shape, len(gmm.usage)) == (0.25, 0.7, (1,), 7)
    assert gaussian.scale.low == gmm.scale.low == pytest.approx(-3.5066, abs=1e-3)
